"""What a move changes: first as a few whole numbers, then as tiles."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32, UInt32

from elitelanes_jax.network.bits import randint
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST, exchange_sides, transpose_codes
from elitelanes_jax.network.xla import lookup, materialize, take
from elitelanes_jax.optimizers._mutations import Variation, materialize_variation
from elitelanes_jax.optimizers._windows import valid_windows


class Change(NamedTuple):
    """The change that a move makes, as whole numbers.

    A move is therefore drawn before any tile is computed.

    Attributes:
      first: the northernmost row and the westernmost column of a rectangle of tiles.
      last: the southernmost row and the easternmost column, both included.
      code: the code that is written into the rectangle, or one of the constants below.
      how: how tiles are copied, a sum of the constants below.
      offset: the row and the column that a tile is copied from are these numbers plus its own row
        and column, or minus them in a mirrored copy.
    """

    first: Int32[Array, " 2"]
    last: Int32[Array, " 2"]
    code: Int32[Array, ""] | int
    how: Int32[Array, ""] | int = 0
    offset: Int32[Array | np.ndarray, " 2"] = np.zeros(2, np.int32)


# The values of `Change.code` that are no codes. In order, they mean: tiles are copied; the tiles
# of a window are written; the links along the outline of the rectangle are toggled. The outline of
# a rectangle that is one tile wide is its middle line.
COPIED, REFITTED, TOGGLED = -1, -2, -3

# The values of `Change.how` are sums of the constants that follow.

# The tiles are mirrored north to south.
FLIPPED = 1

# The tiles are mirrored east to west.
MIRRORED = 2

# The rows and columns of the source are exchanged first.
TRANSPOSED = 4

# The source is the mate.
FROM_MATE = 8

# What leaves the rectangle on one side enters it on the other.
CYCLIC = 16

# The longest side of a refitted window.
WINDOW = 3


def choose_change(index: Int32[Array, ""], changes: Sequence[Change]) -> Change:
    """Returns the change with an index; for an index beyond the last change, the last change."""
    index = jnp.minimum(index, len(changes) - 1)
    chosen_fields = []
    for values in zip(*changes, strict=True):
        candidates = [jnp.asarray(value, jnp.int32) for value in values]
        chosen_fields.append(jax.lax.select_n(index, *candidates))
    first, last, code, how, offset = chosen_fields
    # The numbers are stored as one array, because XLA would otherwise compute them again for every
    # tile. Selects build the array: with a concatenation, XLA compiles all plans once for each
    # number.
    row = np.arange(4)[:, None]
    numbers = jnp.where(np.array([True, False]), code, how)
    numbers = jnp.where(row == 2, offset, numbers)
    numbers = jnp.where(row == 1, last, numbers)
    numbers = jnp.where(row == 0, first, numbers)
    numbers = materialize(numbers)
    return Change(
        first=numbers[0],
        last=numbers[1],
        code=numbers[3, 0],
        how=numbers[3, 1],
        offset=numbers[2],
    )


def apply_change(
    change: Change,
    grid: Int8[Array, "H W"],
    mate: Int8[Array, "H W"],
    window: Int8[Array, "H W"] | None,
) -> Variation:
    """Computes the tiles of a change.

    Tiles of a `window` are written where the change refits a window.
    """
    rows, columns = _row_and_column_indices(grid.shape)
    (north, west), (south, east) = change.first, change.last
    # A tile in the first or last row has links along this row, and a tile in the first or last
    # column links along this column, but none that leaves the rectangle.
    inside = (rows >= north) & (rows <= south) & (columns >= west) & (columns <= east)
    along = inside & ((rows == north) | (rows == south))
    upright = inside & ((columns == west) | (columns == east))
    links = jnp.where(along & (columns < east), EAST, 0) | jnp.where(
        along & (columns > west), WEST, 0
    )
    links = (
        links
        | jnp.where(upright & (rows < south), SOUTH, 0)
        | jnp.where(upright & (rows > north), NORTH, 0)
    )
    written = jnp.where(
        change.code < 0, _copy(change, grid, mate), jnp.asarray(change.code, jnp.int8)
    )
    if window is not None:
        written = jnp.where(change.code == REFITTED, window, written)
    is_toggled = change.code == TOGGLED
    toggled_grid = grid ^ links.astype(jnp.int8)
    written_grid = jnp.where(inside, written, grid)
    varied = jnp.where(is_toggled, toggled_grid, written_grid)
    dirty = jnp.where(is_toggled, links != 0, inside)
    return materialize_variation(Variation(varied, dirty))


def _copy(change: Change, grid: Int8[Array, "H W"], mate: Int8[Array, "H W"]) -> Int8[Array, "H W"]:
    """Returns for each tile the transformed tile that a copy would write there.

    Tiles outside the rectangle are included.
    """
    flipped = change.how & FLIPPED > 0
    mirrored = change.how & MIRRORED > 0
    transposed = change.how & TRANSPOSED > 0
    from_mate = change.how & FROM_MATE > 0
    cyclic = change.how & CYCLIC > 0

    height, width = grid.shape
    rows = _source_indices(change, 0, height, backwards=flipped, cyclic=cyclic)
    columns = _source_indices(change, 1, width, backwards=mirrored, cyclic=cyclic)
    # A transposed source has its rows in the direction of columns.
    row_indices = rows[:, None] * jnp.where(transposed, 1, width)
    column_indices = columns[None] * jnp.where(transposed, width, 1)
    indices = row_indices + column_indices

    source = materialize(jnp.where(from_mate, mate, grid).reshape(-1))
    tiles = materialize(lookup(source, indices))
    # The codes turn with the cells.
    tiles = jnp.where(transposed, transpose_codes(tiles), tiles)
    tiles = jnp.where(mirrored, exchange_sides(tiles, EAST, WEST), tiles)
    return jnp.where(flipped, exchange_sides(tiles, NORTH, SOUTH), tiles)


def _source_indices(
    change: Change, axis: int, length: int, *, backwards: Array | bool, cyclic: Array | bool
) -> Int32[Array, " length"]:
    """Returns the index of the row or column that each row or column is copied from.

    The indices are those of rows for `axis` 0, and of columns for `axis` 1.
    """
    indices = np.arange(length, dtype=np.int32)
    first, last = change.first[axis], change.last[axis]
    sources = change.offset[axis] + jnp.where(backwards, -indices, indices)
    before_first = cyclic & (sources < first)
    after_last = cyclic & (sources > last)
    sources = jnp.where(before_first, last, jnp.where(after_last, first, sources))
    # Sources beyond the grid belong to tiles outside the rectangle, which are not written.
    return jnp.clip(sources, 0, length - 1)


def refit(
    bits: UInt32[Array, ""], change: Change, grid: Int8[Array, "H W"], *, empty: bool
) -> Int8[Array, "H W"]:
    """Draws another valid window for the rectangle of a change, on the whole grid.

    Tiles outside the rectangle have no meaning.
    """
    height, width = (min(side, WINDOW) for side in grid.shape)
    windows = valid_windows(height, width, empty=empty)
    north, west = change.first
    tiles = jax.lax.dynamic_slice(grid, (north, west), (height, width)).astype(jnp.int32)

    # The windows of one border, whose links to the tiles around it are the same, are neighbours in
    # the table.
    borders = tiles[0] & NORTH, tiles[-1] & SOUTH, tiles[:, 0] & WEST, tiles[:, -1] & EAST
    is_linked = (jnp.concatenate(borders) > 0).astype(jnp.int32)
    border = (is_linked << np.arange(is_linked.size, dtype=np.int32)).sum(dtype=jnp.int32)
    first = take(windows.first, border)
    count = take(windows.first, border + 1) - first

    # A window is a number for each row, with four bits for each tile. If the present window is
    # drawn, the next window replaces it, so that the move changes the grid.
    present = (tiles << 4 * np.arange(width, dtype=np.int32)[None]).sum(axis=1, dtype=jnp.int32)
    number_of_choices = jnp.maximum(count, 1)
    index = randint(bits, number_of_choices)
    drawn = take(windows.rows, first + index)
    following = take(windows.rows, first + (index + 1) % number_of_choices)
    window = jnp.where((drawn == present).all(), following, drawn)
    window = jnp.where(count == 0, present, window)

    # Each tile of the grid reads its code from the window, if it is inside.
    rows, columns = _row_and_column_indices(grid.shape)
    row = window[jnp.clip(rows - north, 0, height - 1)]
    shift = 4 * jnp.clip(columns - west, 0, width - 1)
    return (row >> shift & 15).astype(jnp.int8)


def _row_and_column_indices(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[0])[:, None], np.arange(shape[1])[None]
