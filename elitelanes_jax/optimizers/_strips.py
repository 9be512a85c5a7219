"""Strips of three lines, refitted by an exact search over all their valid fillings.

Two adjacent tiles may stay together if their sides carry a common label. A side that faces east or
south offers labels a and b without a link (a turn: a alone), c and d with a link (a turn: c alone,
a crossing: d alone). For sides that face west or north, a and b are exchanged, and c and d: so
neither two turns nor two linked crossings have a common label. The labels between two columns of a
strip are one of 64 states, and a set of states is 64 bits.
"""

from functools import cache
from itertools import pairwise, product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int32, Real, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, real
from elitelanes_jax._util.records import one_number
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import bernoulli, mix, randint
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CROSSINGS, EAST, KINDS, NORTH, SOUTH, WEST, transpose_codes
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import lookup, materialize, take, vary_together
from elitelanes_jax.optimizers._mutations import Move, Variation

LINES = 3
"""The rows, or columns, of a strip."""

# The number of states between two columns, and of things that a tile may show on a side.
_STATES, _SHOWN = 4**LINES, 5
# The number of bits of a column in `StripTables.columns`, and the entry if no column fits.
_BITS, _NONE = 4 * LINES, -1
# The random numbers that the move takes.
_MOVE_BITS = 5

_FORTH = np.array([0b0011, 0b0001, 0b1100, 0b0100, 0b1000])
"""The labels that each index of `_shown` offers on an eastern or southern side.

In order, the side shows: no link, a turn without a link, a link, the link of a turn, the link of a
crossing.
"""
_BACK = np.array([0b0011, 0b0010, 0b1100, 0b1000, 0b0100])


def _shown(side: int) -> Int32[np.ndarray, " 16"]:
    """Returns what each code shows on a side, an index into `_FORTH` or `_BACK`."""
    codes = np.arange(16)
    turn, crossing = (np.isin(codes, kinds) for kinds in (KINDS["turn"], CROSSINGS))
    return np.where(codes & side, np.where(turn, 3, np.where(crossing, 4, 2)), turn).astype(
        np.int32
    )


_EAST, _SOUTH, _WEST, _NORTH = (_shown(side) for side in (EAST, SOUTH, WEST, NORTH))


class StripTables(NamedTuple):
    """All columns and states that fit.

    The first axis of four tables is what the tiles above and below a column show, 5 x above +
    below.

    Attributes:
      before: the states west of a column if the states east of it are these eight bits, ``[25 * 8 *
        256, 2]``.
      after: the states east of a column, by what the column to its west shows, ``[25 * 125, 2]``.
      between: the states west of a column with a state east of it, ``[25 * 64, 2]``.
      columns: the at most two columns with a state east and a state west of them, ``[25 * 64 *
        64]``. Each has 12 bits, four a tile, the northernmost tile lowest. If one column fits, it
        is there twice; if none fits, the number is `_NONE`.
      shown: what any column shows to the east, 5^line a tile.
      forth: the states that fit what a column shows to the east, and the states with the same
        links, ``[125, 4]``.
      back: the states west of any column that fit it.
    """

    before: UInt32[np.ndarray, "B 2"]
    after: UInt32[np.ndarray, "A 2"]
    between: UInt32[np.ndarray, "C 2"]
    columns: Int32[np.ndarray, " C"]
    shown: Int32[np.ndarray, " 4096"]
    forth: UInt32[np.ndarray, "125 4"]
    back: UInt32[np.ndarray, "4096 2"]


@cache
def strip_tables(*, empty: bool) -> StripTables:
    codes = [code for code in range(16) if code.bit_count() > 1 or (empty and not code)]
    # These are the columns whose tiles fit each other from north to south.
    columns = [
        column
        for column in product(codes, repeat=LINES)
        if all(_FORTH[_SOUTH[one]] & _BACK[_NORTH[other]] for one, other in pairwise(column))
    ]
    # An entry has the columns that fit what is above and below, and the states east and west of
    # them. It has room for two columns.
    pairs = np.full((_SHOWN, _SHOWN, _STATES, _STATES), _NONE, np.int32)
    for column in columns:
        packed = sum(code << 4 * line for line, code in enumerate(column))
        fitting = (
            _FORTH & _BACK[_NORTH[column[0]]] > 0,
            _FORTH[_SOUTH[column[-1]]] & _BACK > 0,
            _states(_FORTH, _EAST[list(column)]),
            _states(_BACK, _WEST[list(column)]),
        )
        # The first column of an entry stays in the lower bits, and the last one is in the upper
        # bits.
        slots = np.ix_(*fitting)
        pairs[slots] = (
            np.where(pairs[slots] == _NONE, packed, pairs[slots] & 2**_BITS - 1) | packed << _BITS
        )
    # The axes are what is around the column, the state east of it, and the state west of it.
    leads = (pairs != _NONE).reshape(_SHOWN**2, _STATES, _STATES)
    # This is all that a column can show to a side, line by line, and the states that fit it.
    shows = np.arange(_SHOWN**LINES)[:, None] // _SHOWN ** np.arange(LINES) % _SHOWN
    forth, back, alike = (
        np.array([_states(labels, show) for show in shows])
        for labels in (_FORTH, _BACK, _FORTH | _BACK)
    )
    # A table of all sets of 64 states would be too large. So the union over a set is looked up for
    # eight states at a time. Products of matrices compute all these unions.
    eight = (np.arange(256)[:, None] >> np.arange(8) & 1).astype(np.float32)
    before = eight @ leads.reshape(_SHOWN**2, _STATES // 8, 8, _STATES) > 0
    after = forth.astype(np.float32) @ leads.transpose(0, 2, 1) > 0
    east, west, both = (_packed(states.reshape(-1, _STATES)) for states in (before, after, leads))
    # These numbers say what each column of 12 bits shows to the east and to the west.
    tiles = np.arange(16**LINES)[:, None] >> 4 * np.arange(LINES) & 15
    shown, border = (
        (side[tiles] * _SHOWN ** np.arange(LINES)).sum(axis=1) for side in (_EAST, _WEST)
    )
    return StripTables(
        east,
        west,
        both,
        pairs.reshape(-1),
        shown.astype(np.int32),
        np.hstack([_packed(forth), _packed(alike)]),
        _packed(back)[border],
    )


def _states(labels: Int[np.ndarray, " 5"], shown: Int[np.ndarray, " 3"]) -> Bool[np.ndarray, " 64"]:
    """Returns which states fit what the tiles of a column show."""
    states = np.arange(_STATES)
    return (
        np.logical_and.reduce(
            [labels[kind] >> (states >> 2 * line & 3) & 1 for line, kind in enumerate(shown)]
        )
        > 0
    )


def _packed(states: Bool[np.ndarray, "N 64"]) -> UInt32[np.ndarray, "N 2"]:
    return np.packbits(states, axis=1, bitorder="little").view("<u4").astype(np.uint32)


@name_wrong_arguments
def refit_strip(
    *, empty: bool = True, whole: Real[ArrayLike, ""] = 0.5, straight: Real[ArrayLike, ""] = 0.0
) -> Move:
    """Replaces a stretch of three rows or columns by a valid filling that fits the tiles around it.

    The search for fillings is exact: every valid filling has a probability over 0. A filling is
    valid if it has no mismatch, dead end, adjacent turns and adjacent crossings, inside or with the
    tiles around it. If there is none, and on grids with fewer than three rows or columns, the grid
    does not change. Short stretches of dense networks seldom have another filling. So 7 of 8
    stretches are made long enough for another one, which is then drawn. If all fillings were
    equally likely, the streets of long ones would be short, and searches would reject them.

    Args:
      empty: whether cells of a filling may be empty.
      whole: probability that the stretch is as long as the grid. Otherwise its ends are random.
      straight: probability that a line of three tiles across the strip has the same links to the
        next line as to the line before, if a filling with these links exists.

    Raises:
      InputError: for a probability outside 0 to 1.
    """
    whole = check_named("whole", one_number(real(0, 1)), whole)
    straight = check_named("straight", one_number(real(0, 1)), straight)

    @runs_jax
    @divide_batches
    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        bits = check_array("bits", bits, (_MOVE_BITS,), jnp.uint32)
        # The four lowest bits of a traced code are read.
        grid = jnp.asarray(check_grid(grid)) & 15
        height, width = grid.shape
        if min(height, width) < LINES:
            return Variation(grid, jnp.zeros(grid.shape, bool))
        # An upright strip has three columns.
        upright = bits[0] & 1 > 0
        first = randint(bits[1], jnp.where(upright, width, height) - LINES + 1)
        length = jnp.where(upright, height, width)
        one, other = randint(bits[2:4], length)
        all_of_it = bernoulli(bits[0], whole)
        start = jnp.where(all_of_it, 0, jnp.minimum(one, other))
        end = jnp.where(all_of_it, length - 1, jnp.maximum(one, other))
        # These are the index of each cell across the strip, from its first line on, and along it.
        rows, columns = np.arange(height)[:, None], np.arange(width)[None]
        line, along = jnp.where(upright, columns, rows) - first, jnp.where(upright, rows, columns)

        # The three lines and the lines beside them are gathered, from a square with an empty
        # border. An upright strip is transposed, so all strips run east.
        side = max(height, width)
        padded = jnp.pad(grid, ((1, side - height + 1), (1, side - width + 1)))
        padded = materialize(padded).reshape(-1)
        lines, steps = first + np.arange(LINES + 2)[:, None], np.arange(1, side + 1)[None]
        stride = side + 2
        indices = jnp.where(upright, steps * stride + lines, lines * stride + steps)
        tiles = lookup(padded, indices).astype(jnp.int32)
        tiles = materialize(jnp.where(upright, transpose_codes(tiles), tiles))
        # 7 of 8 fillings differ from the present one.
        differs = bits[0] >> 1 & 7 > 0
        begin, strip = _refitted(bits[4], tiles, start, end, differs, straight, empty=empty)
        strip = materialize(strip)
        inside = (line >= 0) & (line < LINES) & (along >= begin) & (along <= end)
        # Each cell of the grid reads its code from the column of the strip.
        new = (
            lookup(strip, jnp.broadcast_to(along, grid.shape)) >> 4 * jnp.clip(line, 0, LINES - 1)
            & 15
        )
        new = jnp.where(upright, transpose_codes(new), new)
        return Variation(jnp.where(inside, new.astype(jnp.int8), grid), inside)

    return Move(_MOVE_BITS, apply)


def _refitted(
    bits: UInt32[Array, ""],
    tiles: Int32[Array, "5 N"],
    west: Int32[Array, ""],
    east: Int32[Array, ""],
    differs: Bool[Array, ""],
    straight: Real[ArrayLike, ""],
    *,
    empty: bool,
) -> tuple[Int32[Array, ""], Int32[Array, " N"]]:
    """Draws a valid filling of the columns `west` to `east` of a strip.

    `tiles` are those of the strip and of the lines above and below it. If `differs`, `west` moves
    to the west until a column can show something else to the east, and the filling differs from the
    present one.

    Returns `west`, and columns as in `StripTables`; the same as before if there is no filling.
    """
    tables = jax.tree.map(jnp.asarray, strip_tables(empty=empty))
    length = tiles.shape[1]
    around = take(_SOUTH, tiles[0]) * _SHOWN + take(_NORTH, tiles[-1])
    old = tiles[1] | tiles[2] << 4 | tiles[3] << 8
    index = jnp.arange(length, dtype=jnp.int32)

    # The first scan goes from east to west. It finds the states on the east side of each column
    # from which the columns up to `east` can be filled.
    def back(states: Array, column: tuple[Array, Array]) -> tuple[Array, Array]:
        around, at_end = column
        states = jnp.where(at_end, end, states)
        # The set of 64 states becomes eight groups of eight states, and each group leads to a set.
        eights = (
            (states[:, None] >> np.arange(0, 32, 8, dtype=np.uint32)[None] & 255)
            .reshape(-1)
            .astype(jnp.int32)
        )
        sets = take(tables.before, (around * 8 + np.arange(8)) * 256 + eights)
        return jax.lax.reduce(sets, np.uint32(0), jax.lax.bitwise_or, (0,)), states

    # East of the stretch the present column stays, and east of the strip is an empty one.
    end = take(tables.back, take(jnp.append(old[1:], 0), east))
    none = vary_together(jnp.zeros(2, jnp.uint32), end, around)
    _, ahead = jax.lax.scan(back, none, (around, index == east), reverse=True)

    # These states let each column show something else than at present.
    shown = take(tables.shown, old)
    present = take(tables.forth, shown)[:, :2]
    others = take(tables.after, around * 125 + jnp.append(0, shown[:-1])) & ahead & ~present
    free = differs & _any(others) & (index <= east)
    # This is the last column with which the filling can begin to differ.
    last = jnp.where(free, index, -1).max()
    west = jnp.where(last < 0, west, jnp.minimum(west, last))
    refused = jnp.where((index == last)[:, None], present, 0)
    inside = (index >= west) & (index <= east)

    # The second scan goes from west to east. It draws each column among those with which the strip
    # can be filled.
    def forth(
        carry: tuple[Array, Array], column: tuple[Array, ...]
    ) -> tuple[tuple[Array, Array], Array]:
        # The carry is what the western column shows, and whether the filling is the present one so
        # far.
        shown, same = carry
        index, around, old, inside, ahead, refused = column
        # Each column has eight random numbers.
        draws = mix(bits + (index * 8 + np.arange(8)).astype(jnp.uint32) * np.uint32(0x9E3779B9))
        possible = take(tables.after, around * 125 + shown) & ahead & ~jnp.where(same, refused, 0)
        fitting = take(tables.forth, shown)
        # With a probability the links to the next column are those from the column before.
        again = possible & fitting[2:]
        again = jnp.where(_any(again) & bernoulli(draws[7], straight), again, possible)
        # The state east of the column is drawn, then the state west of it, then one of two columns.
        pair = around * _STATES + _draw_state(draws[:3], again)
        ahead_of = _draw_state(draws[3:6], take(tables.between, pair) & fitting[:2])
        both = take(tables.columns, pair * _STATES + ahead_of)
        drawn = jnp.where(draws[6] >> 31 > 0, both >> _BITS, both) & 2**_BITS - 1
        new = jnp.where(inside, drawn, old)
        fits = ~inside | (_any(possible) & (both != _NONE))
        return (take(tables.shown, new), same & (new == old)), jnp.where(fits, new, _NONE)

    columns = (index, around, old, inside, ahead, refused)
    first = vary_together((jnp.int32(0), jnp.array(True)), bits, columns)
    _, new = jax.lax.scan(forth, first, columns)
    return west, jnp.where((new == _NONE).any(), old, new)


def _any(states: UInt32[Array, "*N 2"]) -> Bool[Array, "*N"]:
    """Returns whether a set has a state."""
    return (states[..., 0] | states[..., 1]) != 0


def _draw_state(bits: UInt32[Array, " 3"], states: UInt32[Array, " 2"]) -> Int32[Array, ""]:
    """Draws a state of a set, about evenly."""
    # Random masks thin out the set, because a state after a long gap would be drawn too often. The
    # first state from a random bit on remains.
    for mask in (bits[:2], bits[1] ^ bits[:2] << 7):
        fewer = states & mask
        states = jnp.where(_any(fewer), fewer, states)
    second = (states[1] != 0) & ((states[0] == 0) | (bits[2] & 32 > 0))
    word, turn = jnp.where(second, states[1], states[0]), bits[2] & 31
    turned = word >> turn | word << (32 - turn & 31)
    lowest = turned & (~turned + np.uint32(1))
    place = jax.lax.population_count(lowest - np.uint32(1)) + turn & 31
    return jnp.where(second, 32 + place, place).astype(jnp.int32)
