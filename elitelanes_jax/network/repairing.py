"""Repair: makes neighbours return every connection, and removes those across the border.

The method is that of the paper's section "Constraint Repair".
"""

from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Bool, Int8, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.checks import is_flag
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, Numeric
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import PackedCells, batch_all, in_all_cells, materialize

_NORTH, _EAST, _SOUTH, _WEST = (in_all_cells(side) for side in (NORTH, EAST, SOUTH, WEST))


@name_wrong_arguments
@runs_jax
def repair(
    grid: ArrayOrRows,
    dirty: ArrayOrRows | None = None,
    *,
    raster: Numeric = False,
    fill: bool = False,
    fixed: ArrayOrRows | None = None,
) -> Int8[Array, "H W"]:
    """Matches all connections of a grid and removes those across the border.

    If two neighbours disagree about the link between them, the dirty one decides and the other's
    bit is flipped. If both or neither are dirty, the link is made. All 16 codes are allowed, so
    flipping one side breaks no other link: a single pass is exact, and the iterations of the
    paper's loop are not needed. Under `jax.jit` and `jax.vmap` codes are not checked, and their four
    lowest bits are read.

    Args:
      grid: integer codes ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that decide; none by default.
      raster: bool, whether each tile decides over its neighbours to the east and south instead. The
        paper's loop, which goes row by row, does this if all tiles are dirty.
      fill: whether to add connections to every tile with fewer than two, until all tiles are
        straights, turns or crossings. A stub is continued straight ahead if the grid does not end
        there. Every grid at least two tiles wide can be filled.
      fixed: bool ``[H, W]``, tiles that do not change: they decide over all others, and filling
        adds no connection to them. Their neighbours may then have fewer than two. Two fixed
        neighbours that disagree are linked, and a fixed tile's connection across the border is
        removed. None by default.

    Returns:
      int8 ``[H, W]``.

    Raises:
      InputError: for a bad grid, a mask of another shape or dtype, a `raster` that is no bool, or a
        grid to fill that is one tile wide.
    """
    grid = check_grid(grid)
    if fill and min(grid.shape) < 2:
        raise InputError("fill", "a grid of at least 2 x 2", describe_size(grid.shape))
    dirty = np.zeros(grid.shape, bool) if dirty is None else _check_mask("dirty", dirty, grid.shape)
    _check_raster(raster)
    fixed = None if fixed is None else _check_mask("fixed", fixed, grid.shape)
    return _repair(grid, dirty, raster, fixed, fill=fill)


def _check_raster(raster: Numeric) -> None:
    """Checks True, False or an array with one of them, which may be traced."""
    is_bool = raster.dtype == bool if hasattr(raster, "dtype") else is_flag(raster)
    if not is_bool:
        raise InputError("raster", "True or False", quote(raster))
    if np.ndim(raster):
        raise InputError("raster", "one bool", f"shape {list(np.shape(raster))}")


def _check_mask(name: str, mask: ArrayOrRows, shape: tuple[int, ...]) -> AnyArray:
    expected = f"bool of the grid's shape {shape}"
    try:
        array = mask if isinstance(mask, jax.Array) else np.asarray(mask)
    except ValueError:
        raise InputError(name, expected, "rows of several lengths") from None
    if array.shape != shape or array.dtype != bool:
        raise InputError(name, expected, f"{array.dtype} {array.shape}")
    return array


@partial(jax.jit, static_argnames="fill")
@divide_batches
def _repair(
    grid: Int8[Array, "H W"],
    dirty: Bool[Array | np.ndarray, "H W"],
    raster: Bool[ArrayLike, ""],
    fixed: Bool[Array | np.ndarray, "H W"] | None,
    *,
    fill: bool,
) -> Int8[Array, "H W"]:
    cells = PackedCells(*grid.shape)
    # These are the links inside the grid: to the east and south of all cells, except at the border.
    rows, columns = np.indices(grid.shape)
    room = np.where(columns < cells.width - 1, EAST, 0) | np.where(
        rows < cells.height - 1, SOUTH, 0
    )
    fixed = np.zeros(grid.shape, bool) if fixed is None else fixed
    # The four lowest bits of a traced code are read. A True cell of a mask has all four bits, so that
    # a mask can be combined with codes and links.
    words = (
        cells.pack(array)
        for array in (
            materialize(grid) & 15,
            jnp.where(dirty, 15, 0),
            jnp.where(fixed, 15, 0),
            room,
        )
    )
    all_bits = jnp.broadcast_to(jnp.where(raster, np.uint32(0xFFFFFFFF), 0), cells.words)
    return cells.unpack(_mender(cells, fill)(*words, all_bits))


@cache
def _mender(cells: PackedCells, fill: bool) -> Callable[..., UInt32[Array, " N"]]:
    """Makes the repair of packed cells.

    It takes the grids of a batch end to end, as one long vector.
    """

    @jax.custom_batching.custom_vmap
    def mend(grid: Array, dirty: Array, fixed: Array, room: Array, raster: Array) -> Array:
        # A link is stored in the east or south bit of its western or northern cell. These are the
        # neighbours' bits for the same links.
        theirs = (cells.following(grid, 1) & _WEST) << 2 | (
            cells.following(grid, cells.width) & _NORTH
        ) >> 2
        dirty_there, fixed_there = _at_other_end(cells, dirty), _at_other_end(cells, fixed)
        free = ~(fixed | fixed_there)
        # A cell decides over its neighbour if it alone is fixed, or if neither is fixed and it
        # alone is dirty. In raster order the first cell decides. Otherwise a link is there if
        # either cell has it.
        wins = fixed & ~fixed_there | free & (raster | dirty & ~dirty_there)
        loses = fixed_there & ~fixed | free & ~raster & dirty_there & ~dirty
        links = (grid & ~loses | theirs & ~wins) & room
        # The result is stored, because otherwise each of a word's eight cells would compute it.
        return materialize(_both_ends(cells, _fill(cells, links, room & free) if fill else links))

    @mend.def_vmap
    def _(axis_size: int, batched: list[bool], *words: Array) -> tuple[Array, bool]:
        arrays = batch_all(axis_size, batched, words)
        return mend(*(array.reshape(-1) for array in arrays)).reshape(arrays[0].shape), True

    return mend


def _at_other_end(cells: PackedCells, masks: UInt32[Array, " N"]) -> UInt32[Array, " N"]:
    """Returns the mask of the neighbour at the other end of two links of each cell.

    The links are those to the east and to the south.
    """
    return cells.following(masks, 1) & _EAST | cells.following(masks, cells.width) & _SOUTH


def _both_ends(cells: PackedCells, links: UInt32[Array, " N"]) -> UInt32[Array, " N"]:
    """Returns the codes of tiles with links to the east and south."""
    return (
        links
        | (cells.preceding(links, 1) & _EAST) >> 2
        | (cells.preceding(links, cells.width) & _SOUTH) << 2
    )


# The links that each stage of filling adds to cells with fewer than two connections. The first
# stage continues stubs straight ahead; with it searches find better roads than with any other first
# stage. The others add links to the east, to the south, and to the west and north, which the
# neighbours there hold.
_OWN = np.array([0, _EAST, _SOUTH, 0, 0], np.uint32)
_NEIGHBOURS = np.array([_EAST | _SOUTH, 0, 0, _EAST, _SOUTH], np.uint32)


def _fill(
    cells: PackedCells, links: UInt32[Array, " N"], room: UInt32[Array, " N"]
) -> UInt32[Array, " N"]:
    def add(stage: Array, links: Array) -> Array:
        codes = _both_ends(cells, links)
        # The four sides of a cell are two pairs. For each pair these bits say whether both sides
        # are connected, and whether any is. Two connections are both of one pair, or one of each.
        pairs = codes & codes >> 1 & in_all_cells(5), (codes | codes >> 1) & in_all_cells(5)
        enough = (pairs[0] | pairs[0] >> 2 | pairs[1] & pairs[1] >> 2) & in_all_cells(1)
        # The masks of cells that need links have all four bits, in the first stage only their
        # stub's.
        needy = (enough ^ in_all_cells(1)) * 15
        needy = materialize(jnp.where(stage == 0, needy & codes, needy))
        # A stub to the west is continued to the east, and a stub to the north to the south. These
        # links are the cell's own. The other two belong to its neighbours.
        straight = jnp.where(stage == 0, (needy & _WEST) << 2 | (needy & _NORTH) >> 2, 0)
        added = (
            needy & jnp.asarray(_OWN)[stage]
            | _at_other_end(cells, needy) & jnp.asarray(_NEIGHBOURS)[stage]
        )
        return links | (straight | added) & room

    return lax.fori_loop(0, len(_OWN), add, links)
