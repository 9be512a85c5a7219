"""Draws the default tile pictures, those in tiles/, after Duckietown's appearance specification.

    python -m experiments.perception.draw_tiles [--out DIR]

Every tile is a square of 60 cm. That is within the specification's 58.5 to 61 cm, and exactly as long as eight dashes
and gaps of yellow tape. All lengths are in centimetres.

Seams fit by construction. Where a road leaves a tile, it looks the same in all tiles (tapes, lanes, light) and is
symmetric about the middle of the side. Everything that makes a picture individual (light, wear, crooked tape) fades out
towards the border. Dashes end half a gap before the border.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from experiments.common import Parser, leave, run

Field = NDArray[np.float64]

PIXELS = 384
TILE = 60.0
LANE = 21.0
YELLOW = 2.4
WHITE = 4.8
RED = 4.8
DASH, GAP = 5.0, 2.5
# From the side of a tile to the outer and the inner edge of the white tape.
TAPE_OUT = TILE / 2 - YELLOW / 2 - LANE - WHITE
TAPE_IN = TAPE_OUT + WHITE
# The specification's curve has yellow tape from radius 27.25 around the corner. On a tile of 60 cm the centre is inside
# the tile, so that the tape ends in the middle of the sides.
YELLOW_RADIUS = 27.25 + YELLOW / 2
CENTRE = TILE / 2 - YELLOW_RADIUS

ASPHALT = (78, 74, 67)
WHITE_TAPE = (226, 223, 214)
YELLOW_TAPE = (235, 220, 80)
RED_TAPE = (231, 59, 71)

# kind -> open sides, number of variants
TILES = {
    "turn": ("SW", 4),
    "straight": ("NS", 4),
    "crossing3": ("NSW", 3),
    "crossing4": ("NESW", 1),
    "end": ("S", 2),
}


class Picture(NamedTuple):
    image: NDArray[np.uint8]
    road: NDArray[np.uint8]
    red: NDArray[np.uint8]
    yellow: NDArray[np.uint8]


class Rail(NamedTuple):
    """A strip of white tape along one edge of the road, by the distance from the outside and along the tape."""

    depth: Field
    along: Field
    length: float


def draw(opens: str, rng: np.random.Generator) -> Picture:
    """Draws a tile whose road reaches the given sides."""
    x, y = _coordinates()
    inside = _window(x, y)
    rails = _rails(opens, x, y)
    depths = [rail.depth + _crooked(rail, rng) for rail in rails]
    white = np.max([_between(depth, TAPE_OUT, TAPE_IN) for depth in depths], axis=0)
    road = np.min([_beyond(depth, TAPE_IN) for depth in depths], axis=0)
    yellow = _dashes(opens, x, y, rng) if len(opens) < 3 else np.zeros_like(x)
    red = _stop_lines(opens, x, y, rng) if len(opens) > 2 else np.zeros_like(x)
    red = red * (1 - white)

    light = 1 + inside * (_light(x, y, rng) + rng.uniform(-0.09, 0.09))
    tint = 1 + inside[..., None] * rng.uniform(-0.035, 0.035, 3)
    picture = np.ones((*x.shape, 3)) * ASPHALT
    picture += (_grain(inside, rng) + inside * 4.5 * _noise(rng, 40))[..., None]
    for cover, colour in ((red, RED_TAPE), (yellow, YELLOW_TAPE), (white, WHITE_TAPE)):
        worn = cover * (1 - inside * _wear(rng))
        shade = 1 + 0.02 * _noise(rng, 1) + inside * 0.04 * _noise(rng, 14)
        picture += worn[..., None] * (shade[..., None] * colour - picture)
    image = np.clip(np.rint(picture * light[..., None] * tint), 0, 255).astype(np.uint8)
    return Picture(image, *(np.where(cover >= 0.5, 255, 0).astype(np.uint8) for cover in (road, red, yellow)))


def _coordinates() -> tuple[Field, Field]:
    """Returns the distance of each pixel's centre from the western and from the northern side."""
    centres = (np.arange(PIXELS) + 0.5) * TILE / PIXELS
    x, y = np.meshgrid(centres, centres)
    return x, y


def _beyond(field: Field, edge: float) -> Field:
    """Returns the share of each pixel whose field is larger than the edge: 0 to 1, smooth over one pixel."""
    return np.clip((field - edge) * PIXELS / TILE + 0.5, 0, 1)


def _between(field: Field, low: float, high: float) -> Field:
    return _beyond(field, low) - _beyond(field, high)


def _window(x: Field, y: Field, margin: float = 9.0) -> Field:
    """Returns 0 on the tile's border, which rises to 1 at a margin inside."""
    border = np.minimum(np.minimum(x, TILE - x), np.minimum(y, TILE - y))
    return _smooth(border / margin)


def _smooth(t: Field) -> Field:
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _noise(rng: np.random.Generator, scale: float) -> Field:
    """Makes smooth, periodic noise of unit variance, with grains about `scale` pixels wide."""
    white = rng.standard_normal((PIXELS, PIXELS))
    frequencies = np.fft.fftfreq(PIXELS)
    square = frequencies[:, None] ** 2 + frequencies**2
    noise = np.fft.ifft2(np.fft.fft2(white) * np.exp(-2 * (np.pi * scale / 2) ** 2 * square)).real
    return noise / noise.std()


def _grain(inside: Field, rng: np.random.Generator) -> Field:
    """Makes asphalt: fine grains everywhere. Coarser grains and speckles differ from tile to tile."""
    coarse, speckled = rng.uniform(1, 3.5), rng.uniform(0.5, 3)
    speckles = np.clip(_noise(rng, 2) - 2, 0, None)
    return 3 * _noise(rng, 0.8) + inside * (coarse * _noise(rng, 4) + 8 * speckled * speckles)


def _light(x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Makes the light of a lamp at a random position: a slope and a broad spot."""
    angle = rng.uniform(0, 2 * np.pi)
    slope = (np.cos(angle) * (x - TILE / 2) + np.sin(angle) * (y - TILE / 2)) / TILE
    spot_x, spot_y = rng.uniform(0.2 * TILE, 0.8 * TILE, 2)
    spot = np.exp(-((x - spot_x) ** 2 + (y - spot_y) ** 2) / (2 * 12.0**2))
    return rng.uniform(0.06, 0.2) * slope + rng.uniform(-0.12, 0.17) * spot


def _wear(rng: np.random.Generator) -> Field:
    """Makes the wear of a tape: spots through which the ground shows."""
    return np.clip(0.35 * (_noise(rng, 9) + 0.6 * _noise(rng, 3)) - rng.uniform(0.45, 0.8), 0, 0.55)


def _from_corner(x: Field, y: Field) -> tuple[Field, Field]:
    """Returns positions on a road around the south-western corner: the distance from it, and along it from the west.

    The road is a quarter circle around the centre, with short straights to the two sides.
    """
    u, v = np.maximum(x - CENTRE, 0), np.maximum(TILE - y - CENTRE, 0)
    angle = np.arctan2(u, v)
    along = np.minimum(x, CENTRE) + YELLOW_RADIUS * angle + np.maximum(CENTRE - (TILE - y), 0)
    return np.hypot(u, v) + CENTRE, along


_ARC = 2 * CENTRE + YELLOW_RADIUS * np.pi / 2


def _around_end(x: Field, y: Field) -> Rail:
    """Returns the tape around a dead end: along the western side, in a half circle around the middle, and back."""
    right, up = x - TILE / 2, TILE / 2 - y
    half = TILE / 2 - TAPE_OUT
    angle = np.where(up > 0, np.arctan2(np.maximum(up, 0), -right), np.where(right < 0, 0, np.pi))
    before, after = np.where(right < 0, np.minimum(up, 0), 0), np.where(right < 0, 0, np.maximum(-up, 0))
    along = TILE / 2 + before + half * angle + after
    return Rail(TILE / 2 - np.hypot(right, np.maximum(up, 0)), along, TILE + half * np.pi)


def _rails(opens: str, x: Field, y: Field) -> list[Rail]:
    if len(opens) == 2 and opens == "SW":
        across, along = _from_corner(x, y)
        return [Rail(across, along, _ARC), Rail(TILE - across, along, _ARC)]
    if opens == "S":
        return [_around_end(x, y)]
    sides = {"W": (x, y), "N": (y, x), "E": (TILE - x, y), "S": (TILE - y, x)}
    closed = [Rail(*sides[side], TILE) for side in "NESW" if side not in opens]
    corners = {"SW": (x, y), "NW": (y, TILE - x), "NE": (TILE - x, TILE - y), "SE": (TILE - y, x)}
    return closed + [
        Rail(*_from_corner(*turned), _ARC)
        for pair, turned in corners.items()
        if len(opens) > 2 and set(pair) <= set(opens)
    ]


def _crooked(rail: Rail, rng: np.random.Generator) -> Field:
    """Makes the displacement of a tape: two or three pieces, each slightly displaced and turned, with torn edges."""
    count = int(rng.integers(2, 4))
    cuts = (np.arange(1, count) + rng.uniform(-0.25, 0.25, count - 1)) * rail.length / count
    middles = (np.arange(count) + 0.5) * rail.length / count
    offset, turn = rng.uniform(-0.3, 0.3, count), rng.uniform(-0.014, 0.014, count)
    piece = np.searchsorted(cuts, rail.along)
    off = offset[piece] + turn[piece] * (rail.along - middles[piece])
    tears = 0.25 * np.clip(np.abs(_noise(rng, 8)) - 1.8, 0, None) * np.sign(_noise(rng, 30))
    ends = _smooth(np.minimum(rail.along, rail.length - rail.along) / 7)
    return ends * (off + tears + 0.025 * _noise(rng, 4))


def _dashes(opens: str, x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Draws the yellow tape along the middle: dashes, each slightly displaced, turned and torn."""
    if opens == "SW":
        across, along = _from_corner(x, y)
        length, count = _ARC, 6
    elif opens == "S":  # up to the middle of the half circle, where cars turn round
        across, along, length, count = x, TILE - y, TILE / 2, 4
    else:
        across, along, length, count = x, y, TILE, 8
    pitch = length / count
    ragged = 0.06 * _noise(rng, 4)
    yellow = np.zeros_like(x)
    for index in range(count):
        s = along - (index + 0.5) * pitch - rng.uniform(-0.35, 0.35)
        t = across - TILE / 2 - rng.uniform(-0.35, 0.35)
        angle = rng.uniform(-0.06, 0.06)
        s, t = s * np.cos(angle) - t * np.sin(angle), s * np.sin(angle) + t * np.cos(angle)
        half = (DASH + rng.uniform(-0.3, 0.3)) / 2
        dash = np.minimum(_beyond(half - np.abs(s) + ragged, 0), _beyond(YELLOW / 2 - np.abs(t) + ragged / 2, 0))
        yellow = np.maximum(yellow, dash)
    return yellow


def _stop_lines(opens: str, x: Field, y: Field, rng: np.random.Generator) -> Field:
    """Draws a stop line on each open side, across the incoming lane: traffic keeps to the right."""
    middle = TILE / 2
    incoming: dict[str, tuple[Field, Field]] = {  # depth into the tile, distance to the driver's right
        "N": (y, middle - x),
        "E": (TILE - x, middle - y),
        "S": (TILE - y, x - middle),
        "W": (x, y - middle),
    }
    red = np.zeros_like(x)
    for side in opens:
        depth, right = incoming[side]
        ragged = 0.07 * _noise(rng, 4) * _smooth(depth / 2)
        slant = rng.uniform(-0.02, 0.02) * (right - YELLOW / 2 - LANE / 2) + rng.uniform(-0.25, 0.25)
        line = np.minimum(
            _beyond(RED + slant + ragged - depth, 0),
            _between(right + ragged, YELLOW / 2 + rng.uniform(0, 0.4), YELLOW / 2 + LANE),
        )
        red = np.maximum(red, line)
    return red


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("draw_tiles", __doc__)
    out = Path(__file__).parents[2] / "tiles"
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help="folder of tiles; default tiles")
    options = parser.parse_args(arguments)
    return run("draw_tiles", lambda: draw_all(options.out))


def draw_all(folder: Path) -> None:
    """Draws all tiles into a folder."""
    for index, (kind, (opens, variants)) in enumerate(TILES.items()):
        for variant in range(1, variants + 1):
            picture = draw(opens, np.random.default_rng([index, variant]))
            tile = folder / f"{kind}_{variant}"
            tile.mkdir(parents=True, exist_ok=True)
            for name, pixels in picture._asdict().items():
                file = tile / f"{name}.png"
                if not cv2.imwrite(str(file), pixels[..., ::-1] if pixels.ndim == 3 else pixels, _SMALL):
                    raise OSError(f"{file}: could not be written")


_SMALL = [cv2.IMWRITE_PNG_COMPRESSION, 9]

if __name__ == "__main__":
    leave(main())
