"""Measures a view by the tiles of a floor that look alike.

The floor itself, seen from above, is the template: each cell is compared with the mean of all other
cells of its kind, turned to its direction.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import KIND_OF, KINDS, rotate_codes
from elitelanes_jax.photographs._equations import Measurement, tukey
from elitelanes_jax.photographs._views import FloorView, flatten, places_of
from elitelanes_jax.tiles.light import ground_of

# The number of pixels that count as one measurement, at 64 pixels a tile, because texture and tape
# are larger than a pixel.
_GRAIN = 1000.0
# The least standard deviation of the differences of cells.
_LEAST_NOISE = 0.02


class _Seen(NamedTuple):
    """A cell of a kind.

    Attributes:
      row: the row of the cell on the floor, from 0.
      column: the column of the cell on the floor, from 0.
      turns: the quarter turns counter-clockwise that bring the cell to the first code of its kind;
        several for kinds with symmetries.
    """

    row: int
    column: int
    turns: list[int]


AlikeCells = list[list[_Seen]]
"""The cells of each kind of a floor that can be compared with each other."""


def alike_cells(codes: NDArray[np.int8]) -> AlikeCells:
    """Returns the cells of each kind with at least two comparable pictures."""
    groups: dict[str, list[_Seen]] = {}
    for row, column in np.argwhere(codes > 0).tolist():
        code = int(codes[row, column])
        seen = _Seen(row, column, turns_to_first(code))
        groups.setdefault(KIND_OF[code], []).append(seen)
    return [cells for cells in groups.values() if sum(len(cell.turns) for cell in cells) > 1]


def turns_to_first(code: int) -> list[int]:
    """Returns the quarter turns counter-clockwise that bring a code to the first one of its kind."""
    return [turns for turns in range(4) if rotate_codes(code, turns) == KINDS[KIND_OF[code]][0]]


def compare_cells(
    image: NDArray[np.uint8],
    view: FloorView,
    groups: AlikeCells,
    laid: NDArray[np.bool_],
    tile_px: int,
) -> tuple[Measurement, float]:
    """Returns how far cells of a kind are from where they look alike, and how alike they are.

    The second result is the correlation of the cells with the mean of their kind. Without groups
    nothing is measured, and the correlation is 0.

    Args:
      image: the photograph.
      view: where the cells are in it.
      groups: the cells of each kind, from `alike_cells`.
      laid: bool ``[rows, columns]``, the cells that have a tile.
      tile_px: the pixels of a tile.
    """
    if not groups:
        return Measurement(np.empty((9, 0)), np.empty(0), np.empty(0)), 0.0
    places = places_of(*view.shape, tile_px, 0)
    flat = flatten(image, view, places, tile_px)
    tape = _tape_of(_with_ground_in_gaps(flat, laid, tile_px), tile_px)
    moves = view.moves(places)
    # The first layer is the picture, and nine others are its derivatives by the parameters.
    down, right = np.gradient(tape)
    derivatives = (moves[..., 0] * right + moves[..., 1] * down) * tile_px
    layers = np.concatenate([tape[None], derivatives]).astype(np.float32)
    compared = [_compare(layers, cells, tile_px) for cells in groups]
    rest = np.concatenate([away for away, _ in compared], axis=1)
    mean = np.concatenate([means for _, means in compared])
    # In normal noise, 1.48 times the median of absolute values is the standard deviation.
    scale = max(1.48 * float(np.median(np.abs(rest[0]))), _LEAST_NOISE)
    # Larger pictures have more pixels, but not more measurements.
    weights = tukey(rest[0] / (4 * scale)) / (scale**2 * _GRAIN * (tile_px / 64) ** 2)
    correlation = 1 - rest[0].var() / max(mean.var() + rest[0].var() / 2, 1e-6)
    return Measurement(rest[1:], -rest[0], weights), float(np.clip(correlation, 0, 1))


def _compare(
    layers: NDArray[np.float32], cells: list[_Seen], tile_px: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Returns how the cells of a kind differ from each other ``[10, N]``, and their means ``[N]``."""
    # A cell is turned to the first code of its kind, in each way that does so.
    turned = []
    for cell in cells:
        top, left = cell.row * tile_px, cell.column * tile_px
        window = layers[:, top : top + tile_px, left : left + tile_px]
        turned.append([np.rot90(window, turn, (1, 2)) for turn in cell.turns])
    total, count = sum(sum(pictures) for pictures in turned), sum(map(len, turned))
    away, means = [], []
    for pictures in turned:
        for picture in pictures:
            # A picture is compared with the mean of all others, so that it is not compared with
            # itself.
            others = (total - picture) / (count - 1)
            # A cell with several rotations counts as one.
            away.append((picture - others).reshape(10, -1) / np.sqrt(len(pictures)))
            means.append(others[0].ravel())
    return np.concatenate(away, axis=1), np.concatenate(means)


def _with_ground_in_gaps(
    flat: NDArray[np.uint8], laid: NDArray[np.bool_], tile_px: int
) -> NDArray[np.uint8]:
    """Returns a floor whose cells without a tile have the colour of the nearest tiles.

    The ground around a pixel reaches into the neighbouring cell. A gap that shows a bright floor
    would change it: the correlation of photographed tiles on a white floor was 0.83 with the gaps
    as they are, and 0.97 with this colour.
    """
    if laid.all():
        return flat
    cells = flat.reshape(laid.shape[0], tile_px, laid.shape[1], tile_px, 3).swapaxes(1, 2).copy()
    places = np.argwhere(laid)
    # Most of a tile is asphalt.
    colours = np.median(cells[laid], axis=(1, 2))
    for gap in np.argwhere(~laid):
        weights = ((places - gap) ** 2).sum(axis=1) ** -2.0
        cells[tuple(gap)] = weights @ colours / weights.sum()
    return cells.swapaxes(1, 2).reshape(flat.shape)


def _tape_of(flat: NDArray[np.uint8], tile_px: int) -> NDArray[np.float32]:
    """Returns how much brighter than the ground around it each pixel is.

    The result is a logarithm. It shows tape without the light.
    """
    value = flat.max(axis=2).astype(np.float32) + 4
    tape = np.clip(
        np.log(cv2.GaussianBlur(value, (0, 0), tile_px / 40) / ground_of(flat, tile_px)), -0.2, 1.2
    )
    return np.asarray(cv2.GaussianBlur(tape, (0, 0), tile_px / 40), np.float32)
