"""Draws the pictures of the README and of docs/render.md.

python docs/pictures.py
"""

from pathlib import Path

import cv2
import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax.formats.road_map import read_map
from elitelanes_jax.selection import choose_maps
from elitelanes_jax.tiles.render import overlay, render
from elitelanes_jax.tiles.tileset import load_tiles

FOLDER = Path(__file__).parent


def main() -> None:
    tiles = load_tiles()
    village = render(read_map(FOLDER / "examples" / "village.json").codes, tiles, tile_px=128, seed=2)
    write("village.jpg", np.hstack([village.image, overlay(village, opacity=0.85)]), 1)

    result = evolve(jax.random.split(jax.random.key(0), 16), evaluations=200_000)
    maps = sorted(choose_maps(result, 200).maps, key=lambda road_map: road_map.fitness or 0)
    best = {(road_map.metrics or {})["cyclomatic"]: road_map for road_map in reversed(maps)}  # of each number
    picture = render(best[12].codes, tiles, tile_px=64, seed=1)
    gap = np.full((picture.image.shape[0], 24, 3), 255, np.uint8)
    write("map-and-labels.jpg", np.hstack([picture.image, gap, overlay(picture, opacity=0.85)]), 0.75)

    small = [render(best[number].codes, tiles, tile_px=24, seed=2).image for number in (4, 7, 10, 13, 16, 19)]
    framed = [np.pad(image, [(6, 6), (6, 6), (0, 0)], constant_values=255) for image in small]
    write("six-maps.jpg", np.vstack([np.hstack(framed[:3]), np.hstack(framed[3:])]), 1)


def write(name: str, pixels: NDArray[np.uint8], scale: float) -> None:
    scaled = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(FOLDER / name), scaled[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])


if __name__ == "__main__":
    main()
