"""A grid in one row: its tiles laid end to end, so that every neighbour is a shift.

Each row of the grid ends in one empty guard cell, and an empty row lies above the grid and below it. Beyond the border
a tile then sees an empty cell like any other: no kernel needs a special case there, and compilers make fast code of
long contiguous vectors.

    . . . . .        . is empty padding; a row of W tiles has the stride W + 1
    a b c d .
    e f g h .
    . . . . .
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Shaped

from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST


class PaddedLayout(NamedTuple):
    """The layout of a grid as one vector.

    `pad` makes the padded vector of a grid. `here`, `east`, `west`, `south` and `north` cut out of a padded vector what
    each tile sees there: vectors of length `size`, guard cells included.

    Attributes:
      height: rows of the grid.
      width: columns of the grid.
    """

    height: int
    width: int

    @property
    def stride(self) -> int:
        """The length of a row with its guard cell."""
        return self.width + 1

    @property
    def size(self) -> int:
        """The length of the vector without the two empty rows: height x stride."""
        return self.height * self.stride

    def pad(self, grid: Shaped[Array | np.ndarray, "H W"]) -> Shaped[Array, " padded"]:
        """Lays a grid out, with two empty rows and a guard cell behind each row."""
        return jnp.pad(grid, ((1, 1), (0, 1))).reshape(-1)

    def unpad(self, vector: Shaped[Array, " size"]) -> Shaped[Array, "H W"]:
        """Returns the grid in a vector of length `size`."""
        return vector.reshape(self.height, self.stride)[:, : self.width]

    def here(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        """Returns each tile's own value."""
        return self._shift(padded, 0)

    def east(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        """Returns the value of each tile's eastern neighbour."""
        return self._shift(padded, 1)

    def west(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        """Returns the value of each tile's western neighbour."""
        return self._shift(padded, -1)

    def south(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        """Returns the value of each tile's southern neighbour."""
        return self._shift(padded, self.stride)

    def north(self, padded: Shaped[Array, " padded"]) -> Shaped[Array, " size"]:
        """Returns the value of each tile's northern neighbour."""
        return self._shift(padded, -self.stride)

    def _shift(self, padded: Shaped[Array, " padded"], places: int) -> Shaped[Array, " size"]:
        start = self.stride + places
        return lax.slice_in_dim(padded, start, start + self.size)

    def rows(self) -> np.ndarray:
        """Returns the row of each place in a vector of length `size`."""
        return np.arange(self.size) // self.stride

    def columns(self) -> np.ndarray:
        """Returns the column of each place in a vector of length `size`; a guard cell has column `width`."""
        return np.arange(self.size) % self.stride


class Links(NamedTuple):
    """The links of a grid, a road between two neighbouring tiles each, as vectors ``[size]`` of its layout.

    Attributes:
      east: bool, the tile and its eastern neighbour are linked.
      south: bool, the tile and its southern neighbour are linked.
    """

    east: Bool[Array, " size"]
    south: Bool[Array, " size"]


def find_links(layout: PaddedLayout, padded: Int[Array, " padded"]) -> Links:
    """Finds the links in a padded vector of codes: where both tiles connect to each other."""
    here = layout.here(padded)
    return Links(
        east=(here & EAST > 0) & (layout.east(padded) & WEST > 0),
        south=(here & SOUTH > 0) & (layout.south(padded) & NORTH > 0),
    )
