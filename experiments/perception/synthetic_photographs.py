"""Draws photographs of laid floors and of single tiles as a phone takes them, with the true position of every tile.

The camera looks down obliquely, from any direction. It has a focal length of 0.65 to 1.1 of the picture's width, a lens
with radial distortion, blur, noise and JPEG's losses. The light has a gradient, falls off towards the corners, has a
colour, and is cut by the shadow of a person or a table. Under the tiles is one of six kinds of floor.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.tiles import Tile, TileSet, render
from experiments.perception.draw_tiles import TILES, draw
from experiments.perception.training_sets import shift_lines

__all__ = [
    "FLOORS",
    "SCENES",
    "Photographed",
    "draw_scene",
    "draw_set",
    "lay_floor",
    "move_middle",
    "photograph",
    "tape_by_hand",
]

FLOORS = {
    "wood": (190, 140, 96),
    "light lino": (210, 208, 205),
    "blue carpet": (50, 80, 120),
    "mid grey": (120, 120, 120),
    "dark grey": (70, 70, 70),
    "terracotta": (176, 104, 80),
}
"""The mean colour of each kind of floor, RGB."""

SCENES = ("bare floor", "planks", "carpet", "checkerboard", "one tile")
"""Names of what a photograph shows that is no floor of several tiles."""

WIDTH, HEIGHT = 2016, 1512


class Photographed(NamedTuple):
    """A photograph, and where its tiles are.

    Attributes:
      image: uint8 ``[H, W, 3]``, RGB.
      homography: float ``[3, 3]``, from tiles (x to the east, y to the south) to pixels before distortion.
      radial: distortion: a point at the distance r from the centre, in half diagonals, moves outwards by radial·r³.
      tilt: of the camera from straight down, in degrees.
    """

    image: NDArray[np.uint8]
    homography: NDArray[np.float64]
    radial: float
    tilt: float

    def undistort(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the undistorted positions of pixels ``[N, 2]``."""
        centre, half = np.array([WIDTH - 1, HEIGHT - 1]) / 2, np.hypot(WIDTH, HEIGHT) / 2
        distorted = (points - centre) / half
        plain = distorted.copy()
        for _ in range(8):
            plain = distorted / (1 + self.radial * (plain**2).sum(axis=1, keepdims=True))
        return plain * half + centre

    def tiles_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the true position in tiles of pixels ``[N, 2]``."""
        plain = self.undistort(points)
        return np.asarray(cv2.perspectiveTransform(plain[None], np.linalg.inv(self.homography))[0], np.float64)

    def pixels_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns the pixels of positions ``[N, 2]`` in tiles."""
        plain = np.asarray(cv2.perspectiveTransform(points[None].astype(np.float64), self.homography)[0], np.float64)
        return _distort(plain, self.radial)


def draw_set(seed: int) -> TileSet:
    """Draws a tile set of its own: other asphalt, other tape, white lines shifted by up to 0.05 tiles."""
    rng, tiles = np.random.default_rng([seed, 77]), []
    ground, tint = rng.uniform(0.8, 1.25), rng.uniform(0.93, 1.07, 3)
    for index, (kind, (opens, variants)) in enumerate(TILES.items()):
        if kind == "end":
            continue
        for variant in range(1, variants + 1):
            picture = draw(opens, np.random.default_rng([seed, index, variant]))
            image = picture.image * tint
            dark = np.clip((140 - image.max(axis=2)) / 40, 0, 1)[..., None]
            image = np.clip(image * (1 + dark * (ground - 1)), 0, 255).astype(np.uint8)
            code = sum(bit for side, bit in zip("NESW", (8, 4, 2, 1), strict=True) if side in opens)
            masks = (picture.road > 0, picture.red > 0, picture.yellow > 0)
            tiles.append(Tile(f"{kind}_{variant}", code, image, *masks))
    drawn = TileSet(f"drawn {seed}", "", tuple(tiles))
    return shift_lines(drawn, rng.uniform(-0.02, 0.05))


def tape_by_hand(tiles: TileSet, rng: np.random.Generator, members: int) -> TileSet:
    """Makes tiles of a kind differ, as tiles do that somebody taped and photographed one by one.

    Tape is displaced by about 1 % of a tile, up to 0.5 % wider or narrower at each edge, and of several lots. Each
    picture has a light and a grain of its own.

    Args:
      tiles: to start from.
      rng: of everything random.
      members: that are made of each tile.
    """
    taped: list[Tile] = []
    for tile in tiles.tiles:
        if tile.name.startswith("end"):
            continue
        for member in range(1, members + 1):
            height, width = tile.image.shape[:2]
            x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
            shift = rng.normal(0, rng.uniform(0.004, 0.012) * width, (2, 4, 4)).astype(np.float32)
            x += cv2.resize(shift[0], (width, height), interpolation=cv2.INTER_CUBIC)
            y += cv2.resize(shift[1], (width, height), interpolation=cv2.INTER_CUBIC)
            layers = [np.asarray(layer, np.uint8) for layer in (tile.road, tile.red, tile.yellow)]
            road, red, yellow = (
                cv2.remap(layer, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT) for layer in layers
            )
            image = cv2.remap(tile.image[..., :3], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
            wider = round(rng.uniform(-0.005, 0.005) * width)
            kernel = np.ones((2 * abs(wider) + 1,) * 2, np.uint8)
            image = cv2.dilate(image, kernel) if wider > 0 else cv2.erode(image, kernel)
            lot = np.array([1.0, rng.uniform(0.8, 1.05), rng.uniform(0.6, 1.4)])
            light = rng.uniform(0.85, 1.1) * rng.normal(1, 0.03, 3)
            colours = np.where(yellow[..., None] > 0, image * lot, image) * light
            grain = cv2.GaussianBlur(rng.normal(0, rng.uniform(2, 12), (height, width)), (0, 0), 1.5)
            picture = np.clip(colours + grain[..., None], 0, 255).astype(np.uint8)
            taped.append(Tile(f"{tile.name}{member}", tile.code, picture, road > 0, red > 0, yellow > 0))
    return TileSet(f"{tiles.name}, by hand", "", tuple(taped))


def move_middle(tiles: TileSet, rng: np.random.Generator, most: float = 0.05) -> TileSet:
    """Displaces what is in the middle of each tile's sides: separators, and the ends of stop lines.

    Each tile has displacements of its own, so that the lines of neighbours do not meet.

    Args:
      tiles: to start from.
      rng: of everything random.
      most: the largest displacement in tiles.
    """
    moved = []
    for tile in tiles.tiles:
        side = len(tile.road)
        places = (np.arange(side) + 0.5) / side
        across, down = (places - rng.uniform(-most, most) * np.sin(np.pi * places) ** 2 for _ in range(2))
        x, y = np.meshgrid(*((at * side - 0.5).astype(np.float32) for at in (across, down)))
        image = cv2.remap(tile.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        road, red, yellow = (
            cv2.remap(np.asarray(mask, np.uint8), x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0
            for mask in (tile.road, tile.red, tile.yellow)
        )
        moved.append(tile._replace(image=np.asarray(image, np.uint8), road=road, red=red, yellow=yellow))
    return replace(tiles, tiles=tuple(moved))


def draw_scene(rng: np.random.Generator, name: str, tiles: TileSet) -> NDArray[np.uint8]:
    """Draws a photograph, uint8 ``[H, W, 3]``, RGB, of one of `SCENES`."""
    if name == "one tile":
        code = np.array([[rng.choice(tiles.alphabet)]], np.int8)
        return photograph(rng, code, tiles, str(rng.choice(list(FLOORS))), fill=(0.5, 0.9)).image
    if name == "checkerboard":
        image = np.full((HEIGHT, WIDTH, 3), 225, np.float32)
        rows, columns, side = int(rng.integers(4, 9)), int(rng.integers(5, 12)), 130
        board = np.kron(np.indices((rows, columns)).sum(axis=0) % 2, np.ones((side, side))).astype(np.float32)
        corners = np.array([[0, 0], [board.shape[1], 0], [board.shape[1], board.shape[0]], [0, board.shape[0]]])
        there = np.array([[0.15, 0.2], [0.85, 0.2], [0.9, 0.85], [0.1, 0.85]]) * [WIDTH, HEIGHT]
        there += rng.normal(0, 60, (4, 2))
        matrix = cv2.getPerspectiveTransform(corners.astype(np.float32), there.astype(np.float32))
        image *= 1 - 0.85 * cv2.warpPerspective(board, matrix, (WIDTH, HEIGHT))[..., None]
    else:
        kinds = {"planks": "wood", "carpet": "blue carpet"}
        image = _floor(rng, kinds.get(name) or str(rng.choice(list(FLOORS))))
    image *= _light(rng)[..., None]
    return _develop(rng, image)


def lay_floor(rng: np.random.Generator, shape: tuple[int, int], tiles: TileSet) -> NDArray[np.int8]:
    """Makes the codes of a floor without roads that end at its border; four tiles in ten floors' cells are empty."""
    alphabet = tiles.alphabet if rng.random() < 0.6 else (0, *tiles.alphabet)
    while True:
        laid = generate_batch(rng, 1, shape, border="closed", alphabet=alphabet)
        corners = laid.grid[0][[0, 0, -1, -1], [0, -1, 0, -1]]
        if laid.success[0] and np.count_nonzero(laid.grid[0]) >= 0.7 * laid.grid[0].size and corners.all():
            return np.asarray(laid.grid[0], np.int8)


def photograph(
    rng: np.random.Generator, codes: NDArray[np.int8], tiles: TileSet, floor: str, *, fill: tuple[float, float]
) -> Photographed:
    """Draws a photograph of tiles that lie on a floor, where nothing blends their seams.

    Args:
      rng: of everything random.
      codes: of the tiles ``[H, W]``; a cell without road shows the floor.
      tiles: their pictures.
      floor: a name of `FLOORS`.
      fill: range of the share of the picture's height that the tiles' longer side takes.
    """
    rows, columns = codes.shape
    radial = float(rng.uniform(-0.05, 0.05))
    homography, tilt = _camera(rng, rows, columns, radial, fill)
    view = Photographed(np.zeros((1, 1, 3), np.uint8), homography, radial, tilt)
    # Every eighth pixel, and bilinear between them: the error is below 1e-4 tiles.
    x, y = np.meshgrid(np.arange(3.5, WIDTH, 8), np.arange(3.5, HEIGHT, 8))
    some = view.tiles_of(np.stack([x, y], axis=-1).reshape(-1, 2)).astype(np.float32)
    places = np.asarray(cv2.resize(some.reshape(*x.shape, 2), (WIDTH, HEIGHT)), np.float32)
    # Tiles are drawn about as large as they are seen: a sharper picture would alias.
    seen = np.linalg.norm(np.diff(places[HEIGHT // 2, WIDTH // 2 - 1 : WIDTH // 2 + 1], axis=0))
    px = int(np.clip(1.2 / seen, 64, 512))
    unblended = replace(tiles, blend=False)
    laid = np.asarray(render(codes, unblended, tile_px=px, seed=int(rng.integers(2**31))).image, np.float32)
    covered = np.asarray(np.kron(codes > 0, np.ones((px, px))), np.float32)
    at_x, at_y = np.moveaxis(places * px - 0.5, -1, 0)
    image = _floor(rng, floor)
    cover = cv2.remap(covered, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    contact = cv2.GaussianBlur(cv2.resize(cover, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA), (0, 0), 3)
    image *= 1 - rng.uniform(0.05, 0.3) * cv2.resize(contact, (WIDTH, HEIGHT))[..., None]
    above = cv2.remap(laid, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    image += cover[..., None] * (above - image)
    image *= _light(rng)[..., None]
    image *= rng.uniform(0.9, 1.1, 3).astype(np.float32)
    return Photographed(_develop(rng, image), homography, radial, tilt)


def _develop(rng: np.random.Generator, image: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Returns a picture with the blur and the noise of a camera, and JPEG's losses."""
    image = np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.5, 1.3)), np.float32)
    image += np.float32(rng.uniform(1, 6)) * rng.standard_normal(image.shape, np.float32)
    plain = np.clip(image, 0, 255).astype(np.uint8)
    packed = cv2.imencode(".jpg", plain[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 95))])[1]
    lossy = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]
    return np.ascontiguousarray(lossy)


def _distort(plain: NDArray[np.float64], radial: float) -> NDArray[np.float64]:
    centre, half = np.array([WIDTH - 1, HEIGHT - 1]) / 2, np.hypot(WIDTH, HEIGHT) / 2
    away = (plain - centre) / half
    return away * (1 + radial * (away**2).sum(axis=1, keepdims=True)) * half + centre


def _camera(
    rng: np.random.Generator, rows: int, columns: int, radial: float, fill: tuple[float, float]
) -> tuple[NDArray[np.float64], float]:
    """Returns a homography from tiles to pixels in which all corners are in the picture, and the tilt."""
    corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    while True:
        tilt, around, roll = np.radians(rng.uniform(0, 50)), rng.uniform(0, 2 * np.pi), rng.normal(0, 0.1)
        focal = rng.uniform(0.65, 1.1) * WIDTH
        forward = np.array([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), -np.cos(tilt)])
        right = np.cross(forward, [0.0, 0.0, 1.0]) if tilt > 0.02 else np.array([1.0, 0.0, 0.0])
        right /= np.linalg.norm(right)
        down = np.cross(forward, right)
        right, down = (
            np.cos(roll) * right + np.sin(roll) * down,
            np.cos(roll) * down - np.sin(roll) * right,
        )
        longer = max(rows, columns)
        distance = focal * longer / (rng.uniform(*fill) * HEIGHT)
        target = np.array([columns / 2, -rows / 2, 0]) + np.append(rng.normal(0, 0.05 * longer, 2), 0)
        eye = target - forward * distance
        # A tile's position (x, y) is the point (x, -y, 0) of the world, whose z points up.
        turn = np.stack([right, down, forward])
        basis = np.stack([turn[:, 0], -turn[:, 1], turn @ -eye], axis=1)
        lens = np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1]])
        homography = lens @ basis
        seen = _distort(cv2.perspectiveTransform(corners[None], homography)[0], radial)
        if (seen > 15).all() and (seen < np.array([WIDTH, HEIGHT]) - 15).all():
            return homography, float(np.degrees(tilt))


def _floor(rng: np.random.Generator, name: str) -> NDArray[np.float32]:
    image = np.ones((HEIGHT, WIDTH, 3), np.float32) * np.array(FLOORS[name], np.float32)
    for scale, strength in ((3, 3), (10, 5), (50, 6), (300, 8)):
        noise = rng.normal(0, strength, (HEIGHT // scale + 2, WIDTH // scale + 2)).astype(np.float32)
        image += cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)[..., None]
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    angle = rng.uniform(0, np.pi)
    across, along = np.cos(angle) * x + np.sin(angle) * y, np.cos(angle) * y - np.sin(angle) * x
    if name == "wood":
        plank = np.floor(across / 180).astype(int)
        shades = 0.9 + 0.2 * rng.random(64, np.float32)
        image *= shades[plank % 64][..., None]
        image[np.abs(across / 180 - np.rint(across / 180)) < 0.008] *= 0.6
    if name == "terracotta":
        joint = np.minimum(np.abs(across / 260 - np.rint(across / 260)), np.abs(along / 260 - np.rint(along / 260)))
        image[joint < 0.012] = 150
    return image


def _light(rng: np.random.Generator) -> NDArray[np.float32]:
    """Makes the light of each pixel: a gradient, darker corners, and in half of the pictures a shadow."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, WIDTH), np.linspace(-0.5, 0.5, HEIGHT))
    slope = rng.uniform(-0.5, 0.5, 2)
    light = rng.uniform(0.8, 1.1) * (1 + slope[0] * x + slope[1] * y - 0.4 * rng.random() * (x * x + y * y))
    if rng.random() < 0.5:
        angle, offset, width = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3), rng.uniform(0.01, 0.08)
        edge = np.cos(angle) * x + np.sin(angle) * y - offset
        light *= 1 - rng.uniform(0.15, 0.5) / (1 + np.exp(-edge / width * 4))
    return light.astype(np.float32)
