"""Grey photographs, whose stop lines and separators have no colours."""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.tileset import TileSet

# The largest difference of the channels of a grey picture, in levels. Programs that save it in
# colours may round its channels to different levels.
_GREY = 4


def is_grey(image: NDArray[np.uint8]) -> bool:
    """Returns whether red, green and blue are the same at each pixel."""
    red, green, blue = cv2.split(image)
    differences = cv2.absdiff(red, green).max(), cv2.absdiff(green, blue).max()
    return max(differences) <= _GREY


def in_grey(tiles: TileSet) -> TileSet:
    """Returns a tile set whose pictures are grey."""
    grey = []
    for tile in tiles.tiles:
        brightness = np.asarray(cv2.cvtColor(tile.image, cv2.COLOR_RGB2GRAY), np.uint8)
        grey.append(tile._replace(image=np.repeat(brightness[..., None], 3, axis=2)))
    return replace(tiles, tiles=tuple(grey))


def check_grey_tiles(photograph: Photograph, tiles: TileSet) -> None:
    """Raises `InputError` unless the tiles of a set are grey too.

    Compared with coloured tiles, grey crossings are read as straights.
    """
    if not all(is_grey(tile.image) for tile in tiles.tiles):
        raise InputError(
            photograph.name,
            "a photograph in colours, which tell crossings from straights",
            "a grey one",
        )
