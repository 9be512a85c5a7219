"""Draws the pictures of docs/tiles.md.

python docs/tiles.py
"""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.formats import RoadMap, read_map
from elitelanes_jax.tiles import TileSet, load_tiles, propose_masks, render

FOLDER = Path(__file__).parent
CORNERS = ((412, 188), (1210, 204), (1394, 1082), (236, 1050))  # of the tile, in the photograph
SIDE, PHOTO = 512, (1600, 1200)
PANEL, GAP, HEAD = 330, 20, 40
WIDE = 1000
TABLE, PAPER, INK, MARK = (190, 168, 136), (250, 249, 246), (40, 40, 44), (235, 40, 160)
PLANNED = np.array([[6, 7, 3], [10, 10, 10], [12, 13, 9]], np.int8)
LAID = np.array([[9, 7, 3], [10, 5, 0], [12, 13, 9]], np.int8)
MASKS = {"road": (90, 150, 200), "red": (255, 0, 60), "yellow": (255, 225, 0)}


def main() -> None:
    tiles = load_tiles()
    photo = photograph(tiles.tiles[0].image)
    image = cropped(photo)
    write("tiles-masks.jpg", steps(photo, image))
    write("tiles-blend.jpg", before_and_after(in_other_light(tiles)))
    write("tiles-read.jpg", differences(tiles))


def photograph(tile: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draws a tile on a table as a slanted camera sees it; RGB."""
    width, height = PHOTO
    photo = np.full((height, width, 3), TABLE, np.uint8)
    there = cv2.getPerspectiveTransform(_square(tile.shape[0]), np.array(CORNERS, np.float32))
    cv2.warpPerspective(tile, there, PHOTO, dst=photo, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_TRANSPARENT)
    light = np.linspace(1.05, 0.9, width)[None, :, None]
    return np.clip(photo * light, 0, 255).astype(np.uint8)


def cropped(photo: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the square that is cut out of a photograph."""
    back = cv2.getPerspectiveTransform(np.array(CORNERS, np.float32), _square(4 * SIDE))
    large = cv2.warpPerspective(photo, back, (4 * SIDE, 4 * SIDE), flags=cv2.INTER_CUBIC)
    return np.asarray(cv2.resize(large, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8)


def in_other_light(tiles: TileSet) -> TileSet:
    """Returns a set with a light and a colour of its own on each tile, as photographs have them."""
    rng, lit = np.random.default_rng(3), []
    for tile in tiles.tiles:
        slope = np.linspace(-8, 8, tile.image.shape[0])[:, None, None]
        image = tile.image * rng.uniform(0.8, 1.2) * rng.uniform(0.93, 1.07, 3) + rng.uniform(-8, 12) + slope
        lit.append(tile._replace(image=np.clip(np.rint(image), 0, 255).astype(np.uint8)))
    return TileSet("my tiles", tiles.licence, tuple(lit), blend=True)


def before_and_after(tiles: TileSet) -> NDArray[np.uint8]:
    """Draws a town with the tiles' own light, and with their light brought together."""
    town = read_map(FOLDER / "examples" / "town.json").codes
    sets = (replace(tiles, blend=blend) for blend in (False, True))
    plain, blended = (render(town, one, tile_px=96, seed=4).image for one in sets)
    return np.hstack([plain, np.full((len(plain), GAP, 3), 255, np.uint8), blended])


def differences(tiles: TileSet) -> NDArray[np.uint8]:
    """Returns what `elitelanes tiles read` draws of a floor on which three tiles are wrong."""
    is_tile = np.kron(LAID, np.ones((SIDE, SIDE)))[..., None] > 0
    floor = np.where(is_tile, render(LAID, tiles, tile_px=SIDE).image, np.array(TABLE, np.uint8))
    with TemporaryDirectory() as name:
        folder = Path(name)
        cv2.imwrite(str(folder / "floor.png"), photograph(floor)[..., ::-1])
        RoadMap(PLANNED).save(folder / "plan.json")
        files = [str(folder / file) for file in ("floor.png", "plan.json", "read.png")]
        command = [sys.executable, "-m", "elitelanes_jax", "tiles", "read", files[0], "--against", files[1]]
        subprocess.run([*command, "--picture", files[2]], check=True)
        picture = np.asarray(cv2.imread(files[2]), np.uint8)
    height = round(picture.shape[0] * WIDE / picture.shape[1])
    return np.asarray(cv2.resize(picture, (WIDE, height), interpolation=cv2.INTER_AREA)[..., ::-1], np.uint8)


def steps(photo: NDArray[np.uint8], image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Draws photograph, square and masks side by side."""
    marked = photo.copy()
    for number, corner in enumerate(CORNERS, start=1):
        cv2.circle(marked, corner, 22, MARK, 6, cv2.LINE_AA)
        beside = (corner[0] + (-90 if number in (1, 4) else 40), corner[1] + 15)
        cv2.putText(marked, str(number), beside, cv2.FONT_HERSHEY_SIMPLEX, 2.2, MARK, 6, cv2.LINE_AA)
    painted = image.copy()
    for name, mask in propose_masks(image).items():
        painted[mask] = MASKS[name]
    panels = [
        titled("a photograph, and the tile's corners in it", marked, round(PANEL * PHOTO[0] / PHOTO[1])),
        titled("cropped: turn_1/image.png", image, PANEL),
        titled("proposed masks", painted, PANEL),
    ]
    return np.hstack(panels)


def titled(text: str, picture: NDArray[np.uint8], width: int) -> NDArray[np.uint8]:
    panel = np.full((HEAD + PANEL + GAP, width + 2 * GAP, 3), PAPER, np.uint8)
    panel[HEAD : HEAD + PANEL, GAP : GAP + width] = cv2.resize(picture, (width, PANEL), interpolation=cv2.INTER_AREA)
    cv2.putText(panel, text, (GAP, HEAD - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.5, INK, 1, cv2.LINE_AA)
    return panel


def write(name: str, pixels: NDArray[np.uint8]) -> None:
    cv2.imwrite(str(FOLDER / name), pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])


def _square(side: int) -> NDArray[np.float32]:
    return np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)


if __name__ == "__main__":
    main()
