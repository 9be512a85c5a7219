"""A grid in one row: its tiles laid end to end, so that every neighbour is a shift.

Each row of the grid ends in one empty guard cell, and an empty row lies above the grid and below it. Seen
from a border tile, what is beyond the border is then an empty cell like any other: no kernel needs a
special case there, and long contiguous vectors are what compilers make fast code of.

    . . . . .        . is empty padding; a row of W tiles has the stride W + 1
    a b c d .
    e f g h .
    . . . . .
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from chex import Array
from jax import lax

from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST

__all__ = ["Lattice", "Links", "links_of"]


class Lattice(NamedTuple):
    """The layout of a grid as one vector.

    `pad` makes the padded vector of a grid. `here`, `east`, `west`, `south` and `north` cut out of a padded vector what
    each tile sees there: vectors of length `size` = height x stride, guard cells included.

    Attributes:
      height: rows of the grid.
      width: columns of the grid.
    """

    height: int
    width: int

    @property
    def stride(self) -> int:
        return self.width + 1

    @property
    def size(self) -> int:
        return self.height * self.stride

    def pad(self, grid: Array) -> Array:
        return jnp.pad(grid, ((1, 1), (0, 1))).reshape(-1)

    def here(self, padded: Array) -> Array:
        return self._seen(padded, 0)

    def east(self, padded: Array) -> Array:
        return self._seen(padded, 1)

    def west(self, padded: Array) -> Array:
        return self._seen(padded, -1)

    def south(self, padded: Array) -> Array:
        return self._seen(padded, self.stride)

    def north(self, padded: Array) -> Array:
        return self._seen(padded, -self.stride)

    def _seen(self, padded: Array, shift: int) -> Array:
        start = self.stride + shift
        return lax.slice_in_dim(padded, start, start + self.size)

    def unpad(self, vector: Array) -> Array:
        """The (height, width) grid in a vector of length `size`."""
        return vector.reshape(self.height, self.stride)[:, : self.width]

    def rows(self) -> np.ndarray:
        """The row of each place in a vector of length `size`."""
        return np.arange(self.size) // self.stride

    def columns(self) -> np.ndarray:
        """The column of each place in a vector of length `size`; a guard cell has column `width`."""
        return np.arange(self.size) % self.stride


class Links(NamedTuple):
    """Which neighbouring tiles are joined by a road: vectors ``[size]`` on the lattice.

    Attributes:
      east: bool, the tile and its eastern neighbour.
      south: bool, the tile and its southern neighbour.
    """

    east: Array
    south: Array


def links_of(lattice: Lattice, padded: Array) -> Links:
    """The links in a padded vector of codes: where both tiles connect to each other."""
    here = lattice.here(padded)
    return Links(
        east=(here & EAST > 0) & (lattice.east(padded) & WEST > 0),
        south=(here & SOUTH > 0) & (lattice.south(padded) & NORTH > 0),
    )
