"""A grid with eight cells in a word, four bits each: the bits of a tile code, or masks of its sides.

The cells lie in one long vector, row by row, and after the last row lie empty cells, at least one more than a row has.
So many grids can lie end to end in one vector, and every neighbour is a shift of it: what comes in from the grid before
or after is empty. A step on all cells is then a few operations on few words.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int, UInt32

_BITS, _CELLS = 4, 8
_SHIFTS = np.arange(_CELLS, dtype=np.uint32) * _BITS


def in_all_cells(bits: int) -> np.uint32:
    """Returns a word whose cells all have the same four bits."""
    return np.uint32(bits * 0x11111111)


class PackedCells(NamedTuple):
    """The layout of a grid in words.

    Attributes:
      height: rows of the grid.
      width: columns of the grid.
    """

    height: int
    width: int

    @property
    def words(self) -> int:
        """The number of words, N."""
        return -(-(self.height * self.width + self.width + 1) // _CELLS)

    def pack(self, cells: Int[Array | np.ndarray, "H W"]) -> UInt32[Array, " N"]:
        """Packs cells of 0 to 15."""
        flat = jnp.asarray(cells, jnp.uint32).reshape(-1)
        flat = jnp.pad(flat, (0, -flat.size % _CELLS)).reshape(-1, _CELLS)
        words = (flat << _SHIFTS).sum(axis=1, dtype=jnp.uint32)
        return jnp.pad(words, (0, self.words - words.size))

    def unpack(self, words: UInt32[Array, " N"]) -> Int[Array, "H W"]:
        """Returns the cells, int8."""
        cells = (words[:, None] >> _SHIFTS & 15).astype(jnp.int8).reshape(-1)
        return cells[: self.height * self.width].reshape(self.height, self.width)

    def following(self, words: UInt32[Array, " M"], cells: int) -> UInt32[Array, " M"]:
        """Returns for each cell the one so many places on, of one grid or of many end to end."""
        step, bits = divmod(cells * _BITS, 32)
        ahead = jnp.pad(words, (0, step + 1))
        near, far = (lax.slice_in_dim(ahead, start, start + words.size) for start in (step, step + 1))
        return near >> bits | far << (32 - bits) if bits else near

    def preceding(self, words: UInt32[Array, " M"], cells: int) -> UInt32[Array, " M"]:
        """Returns for each cell the one so many places before, of one grid or of many end to end."""
        step, bits = divmod(cells * _BITS, 32)
        behind = jnp.pad(words, (step + 1, 0))
        far, near = (lax.slice_in_dim(behind, start, start + words.size) for start in (0, 1))
        return near << bits | far >> (32 - bits) if bits else near
