"""Repair: every connection returned by the neighbour, none across the border (paper, "Constraint Repair")."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int, Int8, Shaped

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.padded_layout import Links, PaddedLayout

__all__ = ["raster_rank", "repair"]


def repair(grid: Any, dirty: Any = None, *, fill: bool = False, fixed: Any = None) -> Int8[Array, "H W"]:
    """Matches all connections of a grid and removes those across the border.

    Where two neighbours disagree about the link between them, the dirty one decides and the other's bit is flipped;
    where both are dirty, or neither, the link is made. All 16 codes are allowed, so flipping one side breaks no other
    link: a single pass is exact, and the iterations of the paper's loop are not needed.

    Args:
      grid: integer codes ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that decide; none by default. Integers rank the tiles: the higher one decides.
      fill: afterwards add connections to every tile with fewer than two, until all tiles are straights, turns or
        crossings. A stub is continued straight ahead where the grid goes on. Every grid can be filled, but for those
        one tile wide.
      fixed: bool ``[H, W]``, tiles that stay as they are: they decide over all others, and filling adds no connection
        to them. Tiles beside them may then be left with fewer than two. None by default.

    Returns:
      int8 ``[H, W]``.

    Raises:
      InputError: for a bad grid (see `check_grid`), a mask of another shape or kind, or a grid to fill that is one
        tile wide.
    """
    grid = check_grid(grid)
    if fill and min(grid.shape) < 2:
        raise InputError(f"fill: expected a grid of at least 2 x 2, got {grid.shape[0]} x {grid.shape[1]}")
    dirty = np.zeros(grid.shape, bool) if dirty is None else _check_mask("dirty", dirty, grid.shape)
    return _repair(grid, dirty, None if fixed is None else _check_mask("fixed", fixed, grid.shape), fill)


def _check_mask(name: str, mask: Any, shape: tuple[int, int]) -> Any:
    expected = f"{name}: expected bool or 32-bit integers of the grid's shape {shape}"
    try:
        array = mask if isinstance(mask, jax.Array) else np.asarray(mask)
    except ValueError:
        raise InputError(f"{expected}, got rows of several lengths") from None
    if array.shape != shape or array.dtype.kind not in "biu":
        raise InputError(f"{expected}, got {array.dtype} {array.shape}")
    if array.dtype.itemsize > 4 and not isinstance(array, jax.Array) and (array != array.astype(np.int32)).any():
        raise InputError(f"{expected}, got numbers beyond")
    return array


@partial(jax.jit, static_argnames="fill")
def _repair(
    grid: Int8[Array, "H W"], dirty: Shaped[Array, "H W"], fixed: Shaped[Array, "H W"] | None, fill: bool
) -> Int8[Array, "H W"]:
    layout = PaddedLayout(*grid.shape)
    free = _pairs(layout)
    if fixed is not None:
        dirty = jnp.where(fixed, jnp.iinfo(jnp.int32).max, dirty)
        padded = layout.pad(fixed)
        here = layout.here(padded)
        free = Links(free.east & ~here & ~layout.east(padded), free.south & ~here & ~layout.south(padded))
    links = _agree(layout, layout.pad(grid), layout.pad(dirty))
    return layout.unpad(_codes(layout, _fill(layout, links, free) if fill else links))


def raster_rank(shape: tuple[int, int]) -> np.ndarray:
    """Returns ranks int32 ``[H, W]`` that fall from north-west to south-east, row by row.

    As `repair`'s `dirty` they give what the paper's loop gives when every tile is dirty: it goes through the tiles in
    this order, and each decides over the neighbours that come after it.
    """
    return np.arange(shape[0] * shape[1], 0, -1, dtype=np.int32).reshape(shape)


def _pairs(layout: PaddedLayout) -> Links:
    """Returns where the grid has room for a link: all neighbouring pairs of tiles."""
    rows, columns = layout.rows(), layout.columns()
    return Links(
        east=jnp.asarray(columns < layout.width - 1),
        south=jnp.asarray((rows < layout.height - 1) & (columns < layout.width)),
    )


def _agree(layout: PaddedLayout, padded: Int[Array, " padded"], dirty: Shaped[Array, " padded"]) -> Links:
    here, rank = layout.here(padded), layout.here(dirty)

    def decide(mine: Array, theirs: Array, their_rank: Array, inside: Array) -> Array:
        made = jnp.where(rank == their_rank, mine | theirs, jnp.where(rank > their_rank, mine, theirs))
        return made & inside

    inside = _pairs(layout)
    return Links(
        east=decide(here & EAST > 0, layout.east(padded) & WEST > 0, layout.east(dirty), inside.east),
        south=decide(here & SOUTH > 0, layout.south(padded) & NORTH > 0, layout.south(dirty), inside.south),
    )


def _shift_on(vector: Bool[Array, " size"], places: int) -> Bool[Array, " size"]:
    """Moves each value so many places on; False comes in at the start."""
    return jnp.pad(vector[:-places], (places, 0))


def _shift_back(vector: Bool[Array, " size"], places: int) -> Bool[Array, " size"]:
    """Moves each value so many places back; False comes in at the end."""
    return jnp.pad(vector[places:], (0, places))


def _codes(layout: PaddedLayout, links: Links) -> Int8[Array, " size"]:
    codes = jnp.where(_shift_on(links.south, layout.stride), NORTH, 0)
    codes = codes | jnp.where(links.east, EAST, 0) | jnp.where(links.south, SOUTH, 0)
    return (codes | jnp.where(_shift_on(links.east, 1), WEST, 0)).astype(jnp.int8)


def _fill(layout: PaddedLayout, links: Links, inside: Links) -> Links:
    stride = layout.stride
    east, south = links

    def needy() -> Array:
        connections = east.astype(jnp.int8) + south + _shift_on(east, 1) + _shift_on(south, stride)
        return connections < 2

    # A stub is first continued straight ahead: the roads found are better than with any other first choice (measured).
    stub = needy()
    on_east, on_west = stub & _shift_on(east, 1), _shift_back(stub & east, 1)
    on_south, on_north = stub & _shift_on(south, stride), _shift_back(stub & south, stride)
    east, south = east | (on_east | on_west) & inside.east, south | (on_south | on_north) & inside.south
    # What is still missing is added in one direction after another. A tile that then still lacked a connection
    # would have fewer than two neighbours.
    east = east | (needy() & inside.east)
    south = south | (needy() & inside.south)
    east = east | (_shift_back(needy(), 1) & inside.east)
    south = south | (_shift_back(needy(), stride) & inside.south)
    return Links(east, south)
