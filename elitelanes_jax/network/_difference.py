"""The difference of two grids by their roads, at any position, rotation and reflection."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float32, Int8, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows, Numeric
from elitelanes_jax.network.checks import check_grid, is_traced, known_grid
from elitelanes_jax.network.likeness import RoadSet
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.symmetry import images_of
from elitelanes_jax.network.xla import take, vary_together


@name_wrong_arguments
def difference(grid: ArrayOrRows, other: ArrayOrRows) -> Numeric:
    """Returns the share of tiles in which two grids differ.

    The grids are compared at the position where they are most alike. One grid's roads are laid on
    the other's at every position, rotated and mirrored in all eight ways. In each way, the cells
    with different codes are counted; a tile on an empty cell differs too. The least count is
    divided by the number of cells of the larger grid, empty cells at its border included. The share
    is 0 if and only if the roads are the same.

    Returns a float, or under `jax.jit` and `jax.vmap` the nearest float32. There codes are not
    checked, and their four lowest bits are read. Raises `InputError` for a bad grid.
    """
    if is_traced(grid) or is_traced(other):
        return _traced_difference(check_grid(grid), check_grid(other))
    first, second = known_grid(grid), known_grid(other)
    roads, share = RoadSet([first]), np.inf
    for below in (0.15, 0.3, 0.6, np.inf):
        # The smaller the limit, the fewer positions are compared.
        share = float(roads.differences(second, below)[0])
        if share < below:
            break
    return share


@runs_jax
@jax.jit
@divide_batches
def _traced_difference(
    grid: Int8[Array | np.ndarray, "H W"], other: Int8[Array | np.ndarray, "h w"]
) -> Float32[Array, ""]:
    """Returns the difference of two grids; all positions and images are compared."""
    # The four lowest bits of a traced code are read.
    codes = jnp.asarray(grid) & 15
    images = images_of(jnp.asarray(other) & 15)
    # Every other image is rotated by a quarter turn, so the images have two shapes.
    least = jnp.minimum(
        _least_count(codes, jnp.stack(images[::2])), _least_count(codes, jnp.stack(images[1::2]))
    )
    # A table gives the quotients, because a GPU divides less exactly than a processor.
    cells = max(codes.size, images[0].size)
    return take((np.arange(2 * cells + 1) / cells).astype(np.float32), least)


def _least_count(grid: Int8[Array, "H W"], images: Int8[Array, "4 h w"]) -> Int32[Array, ""]:
    """Returns the least number of cells in which a grid and images differ, at any position."""
    height, width = grid.shape
    rows, columns = images.shape[1] + height - 1, images.shape[2] + width - 1
    # The padding gives all positions at which the grid overlaps an image.
    beside = [(height - 1, height - 1), (width - 1, width - 1)]
    padded = jnp.pad(images, [(0, 0), *beside])
    tiles = (images > 0).sum(axis=(1, 2), dtype=jnp.int32)

    def compare(position: Array, least: Array) -> Array:
        start = (0, position // columns, position % columns)
        window = lax.dynamic_slice(padded, start, (len(images), height, width))
        # Cells of the grid differ, and so do the tiles of an image outside of the grid.
        inside = (window != grid[None]).astype(jnp.int32) - (window > 0).astype(jnp.int32)
        return jnp.minimum(least, (tiles + inside.sum(axis=(1, 2), dtype=jnp.int32)).min())

    most = vary_together(jnp.int32(2 * (grid.size + images[0].size)), grid, images)
    return lax.fori_loop(0, rows * columns, compare, most)
