"""All valid windows of a small size, by the links that lead out of them.

A window is valid if its links match, no tile has a single connection, no two turns share a side and
no two crossings are linked. There are a few thousand windows of 3 x 3 tiles.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int32

from elitelanes_jax.network.codes import CROSSINGS, EAST, KINDS, NORTH, SOUTH, WEST


class WindowTable(NamedTuple):
    """The N valid windows of h x w tiles, sorted by their border.

    A border has 2 (h + w) bits, one for each link that leads out of the window: first to the north
    and to the south, both from west to east, then to the west and to the east, both from north to
    south.

    Attributes:
      first: ``[2^(2 (h + w)) + 1]``, the index of the first window of each border, and N at the
        end.
      rows: the rows of each window, four bits a tile, the westernmost tile lowest.
    """

    first: Int32[np.ndarray, " B"]
    rows: Int32[np.ndarray, "N h"]


@cache
def valid_windows(height: int, width: int, *, empty: bool) -> WindowTable:
    """Returns the valid windows of a size; `empty` says whether cells may be empty."""
    codes = np.array([code for code in range(16) if code.bit_count() > 1 or (empty and not code)])
    beside, below = _fitting(EAST, WEST), _fitting(SOUTH, NORTH)
    # Rows grow tile by tile to the east, and keep only tiles that fit.
    rows = codes[:, None]
    for _ in range(width - 1):
        rows = _extended(rows, codes[:, None], beside[rows[:, -1:], codes])
    # Two rows fit if all their tiles do.
    under = np.logical_and.reduce(
        [below[rows[:, [column]], rows[:, column]] for column in range(width)]
    )
    # Windows grow row by row to the south, as indices of rows.
    indices = np.arange(len(rows))
    windows = indices[:, None]
    for _ in range(height - 1):
        windows = _extended(windows, indices[:, None], under[windows[:, -1]])
    tiles = rows[windows]
    # The windows are sorted by their borders, so those of one border are a slice.
    sides = tiles[:, 0] & NORTH, tiles[:, -1] & SOUTH, tiles[:, :, 0] & WEST, tiles[:, :, -1] & EAST
    links = np.concatenate([side > 0 for side in sides], axis=1)
    border = (links << np.arange(2 * (height + width))).sum(axis=1)
    order = np.argsort(border, kind="stable")
    first = np.searchsorted(border[order], np.arange(2 ** (2 * (height + width)) + 1))
    packed = (tiles << 4 * np.arange(width)).sum(axis=-1)
    return WindowTable(first.astype(np.int32), packed[order].astype(np.int32))


def _fitting(forth: int, back: int) -> Bool[np.ndarray, "16 16"]:
    """Returns which pairs of codes may be neighbours.

    The second code is on the side `forth` of the first.
    """
    one, other = np.indices((16, 16))
    turns, crossings = (
        np.isin([one, other], codes).all(axis=0) for codes in (KINDS["turn"], CROSSINGS)
    )
    linked = one & forth > 0
    return (linked == (other & back > 0)) & ~turns & ~(crossings & linked)


def _extended(before: np.ndarray, more: np.ndarray, fits: Bool[np.ndarray, "A B"]) -> np.ndarray:
    one, other = np.nonzero(fits)
    return np.concatenate([before[one], more[other]], axis=1)
