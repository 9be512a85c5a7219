"""The cells of a floor without their light, and how alike they are to pictures of tiles.

Colours are relative to the ground around them. So tiles of one kind look alike in light and shadow.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from elitelanes_jax.photographs._views import FloorView, flatten, places_of
from elitelanes_jax.tiles.light import colours_on_ground
from elitelanes_jax.tiles.rendering import scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

# The side of a tile in pixels at which kinds are read.
_TILE_PX = 32
# The width around a cell in pixels within which its tile is looked for.
_MARGIN_PX = _TILE_PX // 8
# How many times larger a fitted floor is first read. A neighbour's tape is then mixed into a third
# of the outermost pixels of a cell instead of into all of them.
_FINER = 3
# The part of a picture's contrast below which lines are faint.
_FAINT = 0.35
# The weight of colour beside brightness: white lines are the largest but tell kinds apart least.
_CHROMA = 2.0
# The most pictures of each code that cells are compared with.
_MOST_PICTURES = 3

Picture = NDArray[np.float32]
"""How bright, red and yellow each pixel is beside the ground around it, float32 ``[H, W, 3]``."""


CodedPicture = tuple[int, Picture]
"""The code of a tile, and its picture without light."""


class Cells(NamedTuple):
    """The cells of a floor.

    Attributes:
      pictures: float32 ``[H, W, S, S, 3]``, each cell with a margin around it.
      contrasts: float32 ``[H, W, D, D]``, the contrast of the part of a cell at each displacement
        within the margin.
    """

    pictures: NDArray[np.float32]
    contrasts: NDArray[np.float32]

    @staticmethod
    def of(pictures: NDArray[np.float32]) -> "Cells":
        contrasts = [[_contrasts(cell) for cell in row] for row in pictures]
        return Cells(pictures, np.array(contrasts))

    @property
    def shape(self) -> tuple[int, int]:
        """The rows and columns of the floor."""
        rows, columns = self.pictures.shape[:2]
        return rows, columns

    def picture(self, row: int, column: int) -> Picture:
        """Returns a cell without the margin."""
        inner = slice(_MARGIN_PX, -_MARGIN_PX)
        return np.ascontiguousarray(self.pictures[row, column, inner, inner])

    def likeness(self, tiles: Sequence[Picture]) -> NDArray[np.float64]:
        """Returns the correlation of each cell with pictures of P tiles, ``[H, W, P]``.

        The best displacement within the margin counts. A correlation does not depend on how strong
        lines are. In a cell without a tile, a little of a neighbour's tape looks like a line.
        Therefore a part that is much fainter than the tile is less alike.
        """
        rows, columns = self.shape
        alike = np.empty((rows, columns, len(tiles)))
        faint = [max(_FAINT * _contrast(tile), 1e-6) for tile in tiles]
        for row, column, index in np.ndindex(alike.shape):
            correlation = cv2.matchTemplate(
                self.pictures[row, column], tiles[index], cv2.TM_CCOEFF_NORMED
            )
            strength = np.minimum(self.contrasts[row, column] / faint[index], 1)
            alike[row, column, index] = (correlation * strength).max()
        return alike


def guessed_cells(image: NDArray[np.uint8], view: FloorView) -> Cells:
    """Returns the cells of a floor whose view may be off by up to an eighth of a tile.

    The margin around a cell shows what is around it in the photograph.
    """
    places = places_of(*view.shape, _TILE_PX, _MARGIN_PX)
    floor = without_light(flatten(image, view, places, _TILE_PX))
    side = _TILE_PX + 2 * _MARGIN_PX
    windows = sliding_window_view(floor, (side, side), axis=(0, 1))[::_TILE_PX, ::_TILE_PX]
    return Cells.of(np.ascontiguousarray(windows.transpose(0, 1, 3, 4, 2)))


def fitted_cells(image: NDArray[np.uint8], view: FloorView) -> Cells:
    """Returns the cells of a floor whose view is fitted.

    The margin around a cell is its own mirror image. Otherwise the tape of its neighbours would
    look like its own, and so would the edge of a bright floor.
    """
    rows, columns = view.shape
    tile_px = _FINER * _TILE_PX
    floor = flatten(image, view, places_of(rows, columns, tile_px, 0), tile_px)
    size = columns * _TILE_PX, rows * _TILE_PX
    small = np.asarray(cv2.resize(floor, size, interpolation=cv2.INTER_AREA), np.uint8)
    return apart(small)


def apart(floor: NDArray[np.uint8]) -> Cells:
    """Returns the cells of a floor ``[H * P, W * P, 3]`` seen from above, each with its mirror image."""
    pictures = [
        [_alone(cell) for cell in np.split(row, row.shape[1] // _TILE_PX, axis=1)]
        for row in np.split(floor, len(floor) // _TILE_PX)
    ]
    return Cells.of(np.array(pictures))


def _alone(cell: NDArray[np.uint8]) -> Picture:
    return without_light(
        np.asarray(cv2.copyMakeBorder(cell, *(_MARGIN_PX,) * 4, cv2.BORDER_REFLECT), np.uint8)
    )


def pictures_of(tiles: TileSet) -> list[CodedPicture]:
    """Returns up to three pictures of each code that a set draws."""
    pictures = scale_tiles(tiles, _TILE_PX)["image"]
    return [
        (code, without_light(pictures[4 * drawn.tile + drawn.quarter_turns]))
        for code, draws in tiles.rotations.items()
        for drawn in draws[:: -(-len(draws) // _MOST_PICTURES)]
        if code
    ]


def without_light(flat: NDArray[np.uint8]) -> Picture:
    """Returns a picture of a floor or a tile, RGB, without its light."""
    relative, red, yellow = colours_on_ground(flat, _TILE_PX)
    bright = np.clip(relative.max(axis=-1), 0, 3)
    parts = [bright, _CHROMA * np.clip(red, 0, 2), _CHROMA * np.clip(yellow, 0, 2)]
    return np.asarray(cv2.GaussianBlur(np.stack(parts, axis=-1), (0, 0), 1), np.float32)


def _contrasts(cell: Picture) -> NDArray[np.float32]:
    parts = sliding_window_view(cell, (_TILE_PX, _TILE_PX), axis=(0, 1))
    return np.sqrt(parts.var(axis=(-2, -1)).sum(axis=-1))


def _contrast(tile: Picture) -> float:
    """Returns the standard deviation of a picture, of all channels together."""
    return float(np.linalg.norm(cv2.meanStdDev(tile)[1]))
