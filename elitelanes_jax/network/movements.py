"""The movements across a tile, with traffic on the right.

A movement enters a tile with a heading, an index of `codes.SIDES`, and turns right, goes straight on or turns left.
"""

import numpy as np
from jaxtyping import Int
from numpy.typing import NDArray

from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.codes import SIDES

TURNS = ("right", "straight", "left")
"""The turns of a movement by their indices."""

EXIT = np.array([[(heading + turn) % 4 for turn in (1, 0, -1)] for heading in range(4)], np.int8)
"""int8 ``[4, 3]``: the heading with which a movement leaves, by the heading with which it enters and by its turn."""

MOVEMENTS = np.array(
    [
        [
            [bool(code & SIDES[heading].opposite and code & SIDES[out].bit) for out in EXIT[heading]]
            for heading in range(4)
        ]
        for code in range(16)
    ]
)
"""bool ``[16, 4, 3]``: whether a tile has a movement, by its code (of links), the heading and the turn."""


def list_movements(codes: Int[NDArray, "H W"]) -> Int[NDArray, "N 4"]:
    """Lists the movements of a map: row, column, heading and turn, in ascending order."""
    return np.argwhere(MOVEMENTS[linked_codes(codes)])


def linked_codes(codes: AnyArray) -> AnyArray:
    """Keeps the connections that the neighbour returns, of codes ``[H, W]``, an integer array of NumPy or JAX."""
    xp = codes.__array_namespace__()
    height, width = codes.shape
    padded, kept = xp.pad(codes, 1), xp.zeros_like(codes)
    for bit, _, _, down, right, opposite in SIDES:
        other = padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]
        kept |= xp.where(other & opposite > 0, codes & bit, 0).astype(codes.dtype)
    return kept
