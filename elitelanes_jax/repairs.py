"""Repair: every connection answered by the neighbour, none leaving the grid (paper, "Constraint Repair")."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array

from elitelanes_jax.checks import check_grid
from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.errors import InputError
from elitelanes_jax.lattice import Lattice, Links

__all__ = ["raster_rank", "repair"]


def repair(grid: Any, dirty: Any = None, *, fill: bool = False, kept: Any = None) -> Array:
    """The grid with all connections matched and none across the border.

    Where two neighbours disagree about the road between them, the dirty one dictates and the other's bit is
    flipped; where both are dirty, or neither, the road is made. All 16 codes are allowed, so flipping one
    side breaks no other road: a single pass is exact, and the iterations of the paper's loop are not needed.

    Args:
      grid: integer codes ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that dictate; none by default. Integers rank the tiles: the higher
        one dictates.
      fill: afterwards give every tile with fewer than two connections more of them, until all tiles are
        straights, turns or crossings. A stub leads straight on if the grid does. Every grid can be filled.
      kept: bool ``[H, W]``, tiles that stay as they are: they dictate to all others, and filling adds no connection
        to them. Tiles beside them may then be left with fewer than two. None by default.

    Returns:
      int8 ``[H, W]``.

    Raises:
      InputError: for a bad grid (see `check_grid`), or a mask of another shape or kind.
    """
    grid = check_grid(grid)
    dirty = np.zeros(grid.shape, bool) if dirty is None else _check_mask("dirty", dirty, grid.shape)
    return _repair(grid, dirty, None if kept is None else _check_mask("kept", kept, grid.shape), fill)


def _check_mask(name: str, dirty: Any, shape: tuple[int, int]) -> Any:
    expected = f"{name}: expected bool or 32-bit integers of the grid's shape {shape}"
    try:
        array = dirty if isinstance(dirty, jax.Array) else np.asarray(dirty)
    except ValueError:
        raise InputError(f"{expected}, got rows of several lengths") from None
    if array.shape != shape or array.dtype.kind not in "biu":
        raise InputError(f"{expected}, got {array.dtype} {array.shape}")
    if array.dtype.itemsize > 4 and not isinstance(array, jax.Array) and (array != array.astype(np.int32)).any():
        raise InputError(f"{expected}, got numbers beyond")
    return array


@partial(jax.jit, static_argnames="fill")
def _repair(grid: Array, dirty: Array, kept: Array | None, fill: bool) -> Array:
    lattice = Lattice(*grid.shape)
    free = _inside(lattice)
    if kept is not None:
        dirty = jnp.where(kept, jnp.iinfo(jnp.int32).max, dirty)
        fixed = lattice.pad(kept)
        here = lattice.here(fixed)
        free = Links(free.east & ~here & ~lattice.east(fixed), free.south & ~here & ~lattice.south(fixed))
    links = _agree(lattice, lattice.pad(grid), lattice.pad(dirty))
    return lattice.unpad(_codes(lattice, _fill(lattice, links, free) if fill else links))


def raster_rank(shape: tuple[int, int]) -> np.ndarray:
    """Ranks int32 ``[H, W]`` that fall from north-west to south-east, row by row.

    As `repair`'s `dirty` they give what the paper's loop gives when every tile is dirty: it goes through
    the tiles in this order, and each dictates to the neighbours that come after it.
    """
    return np.arange(shape[0] * shape[1], 0, -1, dtype=np.int32).reshape(shape)


def _inside(lattice: Lattice) -> Links:
    """Where the grid has room for a link: all neighbouring pairs of tiles."""
    rows, columns = lattice.rows(), lattice.columns()
    return Links(
        east=columns < lattice.width - 1,
        south=(rows < lattice.height - 1) & (columns < lattice.width),
    )


def _agree(lattice: Lattice, padded: Array, dirty: Array) -> Links:
    here, rank = lattice.here(padded), lattice.here(dirty)

    def settle(mine: Array, theirs: Array, their_rank: Array, inside: np.ndarray) -> Array:
        made = jnp.where(rank == their_rank, mine | theirs, jnp.where(rank > their_rank, mine, theirs))
        return made & inside

    inside = _inside(lattice)
    return Links(
        east=settle(here & EAST > 0, lattice.east(padded) & WEST > 0, lattice.east(dirty), inside.east),
        south=settle(here & SOUTH > 0, lattice.south(padded) & NORTH > 0, lattice.south(dirty), inside.south),
    )


def _from(vector: Array, places: int) -> Array:
    """Each place's value taken from so many places before it; False at the start."""
    return jnp.pad(vector[:-places], (places, 0))


def _to(vector: Array, places: int) -> Array:
    """Each place's value taken from so many places after it; False at the end."""
    return jnp.pad(vector[places:], (0, places))


def _codes(lattice: Lattice, links: Links) -> Array:
    codes = jnp.where(_from(links.south, lattice.stride), NORTH, 0)
    codes = codes | jnp.where(links.east, EAST, 0) | jnp.where(links.south, SOUTH, 0)
    return (codes | jnp.where(_from(links.east, 1), WEST, 0)).astype(jnp.int8)


def _fill(lattice: Lattice, links: Links, inside: Links) -> Links:
    stride = lattice.stride
    east, south = links

    def needy() -> Array:
        ends = (east, south, _from(east, 1), _from(south, stride))
        return sum(end.astype(jnp.int8) for end in ends) < 2

    # A stub first leads straight on: the roads found are better than with any other first choice (measured).
    stub = needy()
    on_east, on_west = stub & _from(east, 1), _to(stub & east, 1)
    on_south, on_north = stub & _from(south, stride), _to(stub & south, stride)
    east, south = east | (on_east | on_west) & inside.east, south | (on_south | on_north) & inside.south
    # What is still missing is added in one direction after another. A tile that then still lacked a connection
    # would have fewer than two neighbours.
    east = east | (needy() & inside.east)
    south = south | (needy() & inside.south)
    east = east | (_to(needy(), 1) & inside.east)
    south = south | (_to(needy(), stride) & inside.south)
    return Links(east, south)
