"""Draws the first picture of the README: a photograph of a floor, its tile set, towns of it, and a robot's view.

python -m experiments.perception.story
python -m experiments.perception.story --photograph floor.jpg

The second command writes the photograph alone, for the commands of the README.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import evolve, load_tiles, render
from elitelanes_jax.drive import Camera, look, make_sight, random_pose
from elitelanes_jax.photographs import Cut, Photograph, Proposal, cut_tiles, propose_tiles, write_cuts
from elitelanes_jax.tiles import TileSet, choose_tiles, propose_masks
from experiments.common import Parser, leave, run
from experiments.perception.synthetic_photographs import draw_set, photograph

__all__ = ["FLOOR", "main"]

OUT = Path(__file__).parents[2] / "docs" / "story.jpg"
FLOOR = np.array([[6, 7, 5, 3], [14, 15, 5, 11], [12, 13, 5, 9]], np.int8)
"""The codes of the floor: all kinds of tiles, twelve of them."""

WIDTH, HEIGHT, GAP, HEAD = 560, 420, 16, 34
PAPER, INK, OUTLINE = (250, 249, 246), (40, 40, 44), (235, 40, 160)
POSE = 4  # seed of the robot's pose
COLOURS = {"road": (90, 150, 200), "red": (255, 0, 60), "yellow": (255, 225, 0)}  # of masks
TITLES = (
    "1. A photograph of a floor",
    "2. Its tiles, with masks",
    "3. Towns of these tiles",
    "4. What a robot sees there",
)

Picture = NDArray[np.uint8]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("story", __doc__)
    parser.add_argument("--photograph", type=Path, metavar="FILE", help="a new file, .jpg or .png")
    file = parser.parse_args(arguments).photograph
    if file is None:
        return run("story", draw)
    if file.exists() or file.suffix not in (".jpg", ".png"):
        parser.error(f"--photograph: expected a new file, .jpg or .png, got {file}")
    return run("story", lambda: _write_photograph(file))


def _write_photograph(file: Path) -> None:
    cv2.imwrite(str(file), _photograph_floor()[..., ::-1])


def _photograph_floor() -> Picture:
    """Draws a photograph of the floor, of a set whose asphalt and tape differ from those of the package's own."""
    return photograph(np.random.default_rng(5), FLOOR, draw_set(201), "wood", fill=(0.8, 1.0)).image


def draw() -> None:
    """Writes the picture."""
    shot = Photograph("floor", _photograph_floor())
    proposal = propose_tiles(shot, shape=FLOOR.shape)
    cuts = cut_tiles(shot, proposal)
    with tempfile.TemporaryDirectory() as folder:
        write_cuts(folder, cuts)
        tiles = load_tiles(folder)
    result = evolve(0, shape=(6, 8), evaluations=8_000, style="town")
    towns = [road_map.codes for road_map in result.maps(4, where="bridges=0")]
    drawn = [np.asarray(render(codes, tiles, tile_px=33, seed=1).image) for codes in towns]
    parts = (_outlined(shot, proposal), _masked(cuts), _two_by_two(drawn), _robot_view(towns[0], tiles))
    panels = [_panel(title, part) for title, part in zip(TITLES, parts, strict=True)]
    sheet = _two_by_two(panels)
    cv2.imwrite(str(OUT), sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


def _two_by_two(pictures: list[Picture]) -> Picture:
    return np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:4])])


def _outlined(shot: Photograph, proposal: Proposal) -> Picture:
    """Draws the sides of all tiles over a photograph."""
    picture, rows, columns = shot.image.copy(), *FLOOR.shape
    lines = [np.array([[0, row], [columns, row]], float) for row in range(rows + 1)]
    lines += [np.array([[column, 0], [column, rows]], float) for column in range(columns + 1)]
    for ends in lines:
        points = proposal.view.pixels_of(np.linspace(ends[0], ends[1], 40))
        cv2.polylines(picture, [np.rint(points).astype(np.int32)], False, OUTLINE, 4, cv2.LINE_AA)
    return picture


def _masked(cuts: list[Cut]) -> Picture:
    """Draws the tiles, and below each its masks."""
    rows = []
    for first in range(0, len(cuts), 6):
        chosen = cuts[first : first + 6]
        images = [cv2.resize(cut.image, (180, 180), interpolation=cv2.INTER_AREA) for cut in chosen]
        rows.append(_row([np.asarray(image, np.uint8) for image in images]))
        rows.append(_row([_masks_of(np.asarray(image, np.uint8)) for image in images]))
    return np.vstack(rows)


def _row(pictures: list[Picture]) -> Picture:
    return np.hstack([np.pad(picture, ((4, 4), (4, 4), (0, 0)), constant_values=PAPER[0]) for picture in pictures])


def _masks_of(image: Picture) -> Picture:
    masks, picture = propose_masks(image), np.full_like(image, 60)
    for name, colour in COLOURS.items():
        picture[masks[name]] = colour
    return picture


def _robot_view(codes: NDArray[np.int8], tiles: TileSet) -> Picture:
    pose = random_pose(jax.random.key(POSE), codes, lane_offset=tiles.lane_offset)
    sight = make_sight(tiles, Camera(rows=4 * HEIGHT, columns=4 * WIDTH), tile_px=256)
    return np.asarray(look(pose, codes, sight, chosen=choose_tiles(codes, tiles)).image)


def _panel(title: str, picture: Picture) -> Picture:
    """Scales a picture into a panel, below its title."""
    scale = min(WIDTH / picture.shape[1], HEIGHT / picture.shape[0])
    size = (round(picture.shape[1] * scale), round(picture.shape[0] * scale))
    scaled = cv2.resize(picture, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    panel = np.full((HEAD + HEIGHT + GAP, WIDTH + GAP, 3), PAPER, np.uint8)
    top, left = HEAD + (HEIGHT - size[1]) // 2, (WIDTH - size[0]) // 2 + GAP // 2
    panel[top : top + size[1], left : left + size[0]] = scaled
    cv2.putText(panel, title, (GAP // 2, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.75, INK, 1, cv2.LINE_AA)
    return panel


if __name__ == "__main__":
    leave(main())
