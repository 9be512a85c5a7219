"""Moves in the space of networks: each changes a whole street, loop or block.

A network is a set of links. Toggling the links of a loop keeps the parity of every tile's
connections: corners, outlines and their sums are the cycle space of the lattice. Other moves copy a
block of the grid itself or of a mate. The block goes to the same position or to another one, and
may be rotated or mirrored.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    LARGEST,
    check_named,
    function_of,
    none_or,
    one_of,
    real,
    whole,
)
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, shorten, suggest
from elitelanes_jax._util.records import Record, number_or_array, one_number, option, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.codes import (
    EAST,
    NORTH,
    SOUTH,
    WEST,
    exchange_sides,
    rotate_codes,
    transpose_codes,
)
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import lookup, materialize, take
from elitelanes_jax.optimizers._mutations import Move, Variation, materialize_variation
from elitelanes_jax.optimizers._windows import valid_windows


def _check_user_moves(moves: UserValue) -> dict[str, tuple[AnyArray, Move]]:
    """Checks moves of the user and returns them sorted by name.

    Therefore results do not depend on the order of the moves.
    """
    # The default of a field has to be immutable, so an empty tuple means no moves.
    if isinstance(moves, tuple) and not moves:
        moves = {}
    if not isinstance(moves, Mapping):
        raise InputError("", "moves by name", shorten(repr(moves)))
    checked = {}
    for name, value in sorted(moves.items(), key=lambda item: str(item[0])):
        is_name = isinstance(name, str) and name.isidentifier()
        if not is_name or name in KNOWN_MOVES:
            expected = "names of letters, digits and _ that no other move has"
            raise InputError("", expected, shorten(repr(name)))
        checked[name] = _check_user_move(name, value)
    return checked


def _check_user_move(name: str, value: UserValue) -> tuple[AnyArray, Move]:
    """Checks the weight and the move of one name."""
    weight, move = value if isinstance(value, tuple | list) and len(value) == 2 else (None, None)
    if not isinstance(move, Move):
        raise InputError(name, "a weight and a Move", shorten(repr(value)))
    check_named(f"{name}: apply", function_of("bits", "grid", "mate"), move.apply)
    return check_named(name, number_or_array(whole(0), whole=True), weight), move


@pytree
@dataclass(frozen=True)
class MoveWeights(Record):
    """The weights of the moves, from which `random_move` draws one.

    A pytree: `jax.vmap` may map over the weights. A weight is a whole number; a move is drawn with
    probability weight / sum of all weights. The defaults were measured
    (experiments/search/moves.md).

    Attributes:
      link: weight of making or cutting the link between two neighbouring tiles.
      corner: weight of toggling the four links around a point where four tiles meet: the smallest
        loop.
      outline: weight of toggling the links along the outline of a rectangle of at least 2 x 2
        tiles; all sizes are equally likely.
      street: weight of toggling the links along a stretch of a row or a column.
      straight: weight of laying straight tiles along a stretch of a row or a column, over any
        tiles.
      clear: weight of emptying a block of tiles.
      mirror: weight of mirroring a block of tiles in its position, east to west or north to south.
      slide: weight of rotating the rows between two rows, or the columns between two columns, by
        one, in either direction.
      transplant: weight of copying a block of the mate to the same position, after rotating or
        mirroring the mate: one of the eight symmetries of a square. A grid that is not square is
        rotated by half turns only.
      displaced: weight of such a copy from another position in the same rows or in the same
        columns.
      refit: weight of replacing a window of 3 x 3 tiles by another valid window that has the same
        links to the tiles around it. The windows come from a table, and are about equally likely.
        If no other window fits, the grid does not change. By default 0, and 25 in MAP-Elites on
        grids of up to 64 cells.
      fill_probability: probability that repair fills the grid after the move, see `with_fill`. No
        effect where repair always fills.
      user_moves: moves of the user by name, each with its weight: ``{"zigzag": (4, zigzag)}``.
    """

    link: Int[ArrayLike, "..."] = traced(1, whole(0))
    corner: Int[ArrayLike, "..."] = traced(4, whole(0))
    outline: Int[ArrayLike, "..."] = traced(1, whole(0))
    street: Int[ArrayLike, "..."] = traced(1, whole(0))
    straight: Int[ArrayLike, "..."] = traced(8, whole(0))
    clear: Int[ArrayLike, "..."] = traced(1, whole(0))
    mirror: Int[ArrayLike, "..."] = traced(1, whole(0))
    slide: Int[ArrayLike, "..."] = traced(1, whole(0))
    transplant: Int[ArrayLike, "..."] = traced(16, whole(0))
    displaced: Int[ArrayLike, "..."] = traced(4, whole(0))
    refit: Int[ArrayLike, "..."] | None = traced(None, none_or(whole(0)))
    fill_probability: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))
    user_moves: dict[str, tuple[Int[ArrayLike, "..."], Move]] = option((), _check_user_moves)

    def check_together(self) -> None:
        """Checks that a move can be drawn, and that whole weights add up to at most 2**30."""
        weights = [getattr(self, name) for name in KNOWN_MOVES]
        for weight, _ in self.user_moves.values():
            weights.append(weight)
        if all(_is_never_drawn(weight) for weight in weights):
            raise InputError("link", "a weight over 0 for at least one move", "none")
        # A move is drawn by a whole number below the sum of all weights, which has to fit int32.
        total = sum(weight for weight in weights if isinstance(weight, int))
        if total > LARGEST:
            expected = f"weights of moves that add up to at most {LARGEST}"
            raise InputError("link", expected, total)

    def with_moves(self, moves: UserValue) -> "MoveWeights":
        """Returns the weights with some changed, and with moves of the user.

        Args:
          moves: the changes by name: the weight of a move above, such as ``{"mirror": 0}``; or for
            another name a weight and a `Move`, such as ``{"zigzag": (4, zigzag)}``.

        Raises:
          InputError: for anything else.
        """
        if not isinstance(moves, Mapping):
            raise InputError("moves", "weights and moves by name", shorten(repr(moves)))
        weights = {}
        user_moves = {}
        for name, value in moves.items():
            if name in KNOWN_MOVES:
                weights[name] = value
            elif isinstance(value, tuple | list):
                # The pair of a weight and a `Move` is checked with all moves of the user below.
                user_moves[name] = value
            else:
                known_names = ", ".join(KNOWN_MOVES)
                expected = (
                    f"one of {known_names} with a weight, or another name with a weight and a Move"
                )
                raise InputError("moves", expected, repr(name), suggest(name, KNOWN_MOVES))
        return check_named("moves", self._replace_moves, weights, user_moves)

    def _replace_moves(self, weights: dict[str, UserValue], user_moves: UserValue) -> "MoveWeights":
        """Returns a copy with other weights of known moves, and with more moves of the user."""
        all_user_moves = self.user_moves | _check_user_moves(user_moves)
        return self.replace(**weights, user_moves=all_user_moves)


KNOWN_MOVES = tuple(
    name for name in MoveWeights.options() if name not in ("fill_probability", "user_moves")
)
"""The names of the moves that `MoveWeights` has a weight for."""


def _is_never_drawn(weight: AnyArray) -> bool:
    """Returns whether a move is known to have weight 0.

    An array may be traced, so its number is not known.
    """
    return weight is None or (isinstance(weight, int) and weight == 0)


@name_wrong_arguments
def random_move(weights: MoveWeights, *, fill: bool, fixed: AnyArray = None) -> Move:
    """Makes one move, drawn in proportion to the weights.

    If repair always fills, `MoveWeights.fill_probability` has no effect. For `fixed`, bool
    ``[H, W]``, see `repair`.
    """
    weights_by_plan: dict[_Plan, AnyArray] = {
        plan: getattr(weights, name) for name, plan in _PLANS.items()
    }
    # Where repair always fills, a refitted window must have no empty cells, and a move that fills
    # would change nothing.
    move = _move(weights_by_plan, weights.user_moves, empty=not fill)
    if fill:
        return move
    return with_fill(weights.fill_probability, move, fixed=fixed)


@name_wrong_arguments
def make_move(name: str, *, empty: bool = True) -> Move:
    """Makes one of the moves that `MoveWeights` has a weight for.

    Args:
      name: the name of its weight, such as "street". `MoveWeights` says what each move does.
      empty: whether the new tiles of "refit" may be empty cells. The other moves ignore it.

    Raises:
      InputError: for another name.
    """
    plan = _PLANS[check_named("name", one_of(*KNOWN_MOVES), name)]
    return _move({plan: 1}, empty=empty)


@name_wrong_arguments
def with_fill(probability: Real[ArrayLike, ""], move: Move, *, fixed: AnyArray = None) -> Move:
    """Makes a move, then with the given probability a repair that fills.

    If cells may stay empty, this leads from a network with dead ends to a near network without.
    Single moves find it slowly.
    """
    fixed = frozen_copy(fixed)
    probability = check_named("probability", one_number(real(0, 1)), probability)

    @runs_jax
    @divide_batches
    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        bits = check_array("bits", bits, (move.bits + 1,), jnp.uint32)
        varied = Variation(*move.apply(bits[:-1], grid, mate))
        happens = bernoulli(bits[-1], probability)
        filled = repair(*varied, fill=True, fixed=fixed)
        # A filled grid has no mismatch that dirty tiles could decide.
        return Variation(jnp.where(happens, filled, varied.grid), varied.dirty)

    return Move(move.bits + 1, apply)


@name_wrong_arguments
def with_symmetric_copy(probability: Real[ArrayLike, ""], move: Move) -> Move:
    """Makes a move, then with the given probability the same change again, rotated.

    The change is rotated by half a turn around the centre of the grid. A grid that is symmetric
    under half a turn stays symmetric, unless repair fills or the move changes the tile at the
    centre of a grid with odd sides. One step then replaces two steps with a worse grid in between.
    """
    probability = check_named("probability", one_number(real(0, 1)), probability)

    @runs_jax
    @divide_batches
    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        bits = check_array("bits", bits, (move.bits + 1,), jnp.uint32)
        varied, dirty = move.apply(bits[:-1], grid, mate)
        rotated_grid = rotate_codes(varied, 2)[::-1, ::-1]
        is_copied = dirty[::-1, ::-1]
        is_copied &= bernoulli(bits[-1], probability)
        # Where the two changes overlap, the tile of the lower index decides.
        indices = np.arange(grid.size, dtype=np.int32).reshape(grid.shape)
        is_decided = dirty & (indices <= indices[::-1, ::-1])
        grid = jnp.where(is_copied & ~is_decided, rotated_grid, varied)
        return Variation(grid, dirty | is_copied)

    return Move(move.bits + 1, apply)


class _Change(NamedTuple):
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


# The values of `_Change.code` that are no codes. In order, they mean: tiles are copied; the tiles
# of a window are written; the links along the outline of the rectangle are toggled. The outline of
# a rectangle that is one tile wide is its middle line.
_COPIED, _REFITTED, _TOGGLED = -1, -2, -3

# The values of `_Change.how` are sums of the constants that follow.

# The tiles are mirrored north to south.
_FLIPPED = 1
# The tiles are mirrored east to west.
_MIRRORED = 2
# The rows and columns of the source are exchanged first.
_TRANSPOSED = 4
# The source is the mate.
_FROM_MATE = 8
# What leaves the rectangle on one side enters it on the other.
_CYCLIC = 16


class _Draws:
    """What the plans draw from random bits, uint32 [7], on a grid of a shape.

    bits[0:4] give a position. In bits[4], 1 and 2 give directions, axes or mirror images, 4 a
    transposition, and 8 the axis of a displacement. bits[5:7] give its offset. Only one plan is
    applied, so plans share the bits.
    """

    def __init__(self, bits: UInt32[Array, " 7"], shape: tuple[int, ...]):
        self.bits, self.shape = bits, np.array(shape, np.int32)

    @cached_property
    def block(self) -> tuple[Int32[Array, " 2"], Int32[Array, " 2"]]:
        """The first row and column, and the last row and column, of a block.

        Two rows and two columns are drawn independently and sorted. With probability 1/8 a side is
        at the grid's edge instead, so that half a network, rotated or mirrored, completes another
        half.
        """
        ends = randint(self.bits[:4].reshape(2, 2), self.shape[:, None])
        # The lowest bits, on which `randint` hardly depends, draw the edges.
        is_at_edge = self.bits[:4].reshape(2, 2) & 7 == 0
        first = jnp.where(is_at_edge[:, 0], 0, jnp.minimum(ends[:, 0], ends[:, 1]))
        last = jnp.where(is_at_edge[:, 1], self.shape - 1, jnp.maximum(ends[:, 0], ends[:, 1]))
        return first, last

    @cached_property
    def stretch(self) -> tuple[Bool[Array, ""], Int32[Array, " 2"], Int32[Array, " 2"]]:
        """Whether a stretch runs east, and its first and last row and column."""
        height, width = self.shape
        east = self.bits[0] & 1 == 0
        line = randint(self.bits[1], jnp.where(east, height, width))
        ends = randint(self.bits[2:4], jnp.where(east, width, height))
        # A stretch that runs east has one row, the line, and ends at two columns.
        is_line = _either(east)
        first = jnp.where(is_line, line, jnp.minimum(*ends))
        last = jnp.where(is_line, line, jnp.maximum(*ends))
        return east, first, last


_Plan = Callable[[_Draws], _Change]

# The longest side of a refitted window.
_WINDOW = 3

# One number draws the plan, and a plan uses at most seven numbers.
_BITS = 1 + 7


@runs_jax
def _move(
    weights: Mapping[_Plan, AnyArray],
    user_moves: Mapping[str, tuple[AnyArray, Move]] = MappingProxyType({}),
    *,
    empty: bool = True,
) -> Move:
    """Makes one of the plans or moves, drawn in proportion to its weight.

    For `empty` see `make_move`.
    """
    # Moves of weight 0 are not computed.
    weights_by_plan = {
        plan: weight for plan, weight in weights.items() if not _is_never_drawn(weight)
    }
    drawn_weights = list(weights_by_plan.values())
    drawn_moves: dict[str, Move] = {}
    for name, (weight, move) in user_moves.items():
        if not _is_never_drawn(weight):
            drawn_weights.append(weight)
            drawn_moves[name] = move
    cumulative_weights = jnp.cumsum(jnp.array(drawn_weights, jnp.int32))
    plans = tuple(weights_by_plan)
    most_user_bits = max((move.bits for move in drawn_moves.values()), default=0)

    @runs_jax
    @divide_batches
    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        bits = check_array("bits", bits, (_BITS + most_user_bits,), jnp.uint32)
        # The four lowest bits of a traced code are read.
        grid = grid & 15
        mate = grid if mate is None else mate & 15
        number = randint(bits[0], cumulative_weights[-1])
        # The index is the number of cumulative weights that the drawn number reaches.
        drawn_index = (number >= cumulative_weights[:-1]).sum(dtype=jnp.int32)
        if plans:
            varied = _apply_one_plan(plans, drawn_index, bits, grid, mate, empty=empty)
        else:
            varied = Variation(grid, jnp.zeros(grid.shape, bool))
        # All moves of the user are computed. A branch would save nothing, because under `jax.vmap`
        # JAX computes every branch.
        for index, (name, move) in enumerate(drawn_moves.items(), start=len(plans)):
            user_result = move.apply(bits[_BITS : _BITS + move.bits], grid, mate)
            user_variation = _check_variation(name, user_result, grid.shape)
            varied = jax.tree.map(partial(jnp.where, drawn_index == index), user_variation, varied)
        return varied

    return Move(_BITS + most_user_bits, apply)


def _check_variation(name: str, result: UserValue, shape: tuple[int, ...]) -> Variation:
    """Checks what a move of the user returned: a grid and its dirty mask."""
    arrays = result if isinstance(result, tuple | list) else (result,)
    kinds = [(np.shape(array), getattr(array, "dtype", type(array).__name__)) for array in arrays]
    if kinds != [(shape, jnp.int8), (shape, jnp.bool_)]:
        raise InputError("moves", f"{name} to return int8 and bool {shape}", kinds)
    grid, dirty = arrays
    return Variation(grid, dirty)


def _apply_one_plan(
    plans: Sequence[_Plan],
    index: Int32[Array, ""],
    bits: UInt32[Array, " bits"],
    grid: Int8[Array, "H W"],
    mate: Int8[Array, "H W"],
    *,
    empty: bool,
) -> Variation:
    """Applies the plan with an index.

    All plans are computed as numbers, and only the chosen one on tiles.
    """
    draws = _Draws(bits[1:_BITS], grid.shape)
    change = _choose_change(index, [plan(draws) for plan in plans])
    window = None
    if _plan_refit in plans:
        window = _refit(draws.bits[2], change, grid, empty=empty)
    return _apply_change(change, grid, mate, window)


def _choose_change(index: Int32[Array, ""], changes: Sequence[_Change]) -> _Change:
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
    return _Change(
        first=numbers[0],
        last=numbers[1],
        code=numbers[3, 0],
        how=numbers[3, 1],
        offset=numbers[2],
    )


def _apply_change(
    change: _Change,
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
        written = jnp.where(change.code == _REFITTED, window, written)
    is_toggled = change.code == _TOGGLED
    toggled_grid = grid ^ links.astype(jnp.int8)
    written_grid = jnp.where(inside, written, grid)
    varied = jnp.where(is_toggled, toggled_grid, written_grid)
    dirty = jnp.where(is_toggled, links != 0, inside)
    return materialize_variation(Variation(varied, dirty))


def _copy(
    change: _Change, grid: Int8[Array, "H W"], mate: Int8[Array, "H W"]
) -> Int8[Array, "H W"]:
    """Returns for each tile the transformed tile that a copy would write there.

    Tiles outside the rectangle are included.
    """
    flipped = change.how & _FLIPPED > 0
    mirrored = change.how & _MIRRORED > 0
    transposed = change.how & _TRANSPOSED > 0
    from_mate = change.how & _FROM_MATE > 0
    cyclic = change.how & _CYCLIC > 0

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
    change: _Change, axis: int, length: int, *, backwards: AnyArray, cyclic: AnyArray
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


def _refit(
    bits: UInt32[Array, ""], change: _Change, grid: Int8[Array, "H W"], *, empty: bool
) -> Int8[Array, "H W"]:
    """Draws another valid window for the rectangle of a change, on the whole grid.

    Tiles outside the rectangle have no meaning.
    """
    height, width = (min(side, _WINDOW) for side in grid.shape)
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


def _plan_link(draws: _Draws) -> _Change:
    # The links to the east come first, row by row, then the links to the south.
    height, width = draws.shape
    across = height * (width - 1)
    drawn = randint(draws.bits[0], across + (height - 1) * width)
    east = drawn < across
    index = jnp.where(east, drawn, drawn - across)
    length = jnp.where(east, width - 1, width)
    row = jax.lax.div(index, length)
    first = jnp.stack([row, index - row * length])
    return _Change(first, first + (~_either(east)).astype(jnp.int32), _TOGGLED)


def _plan_corner(draws: _Draws) -> _Change:
    first = randint(draws.bits[:2], draws.shape - 1)
    return _Change(first, first + 1, _TOGGLED)


def _plan_outline(draws: _Draws) -> _Change:
    # The size is drawn before the position. Two random corners would make large sizes rare.
    span = 1 + randint(draws.bits[:2], draws.shape - 1)
    first = randint(draws.bits[2:4], draws.shape - span)
    return _Change(first, first + span, _TOGGLED)


def _plan_street(draws: _Draws) -> _Change:
    _, first, last = draws.stretch
    return _Change(first, last, _TOGGLED)


def _plan_straight(draws: _Draws) -> _Change:
    east, first, last = draws.stretch
    return _Change(first, last, jnp.where(east, EAST | WEST, NORTH | SOUTH))


def _plan_clearing(draws: _Draws) -> _Change:
    first, last = draws.block
    return _Change(first, last, 0)


def _plan_mirroring(draws: _Draws) -> _Change:
    first, last = draws.block
    across = draws.bits[4] & 1 == 0
    how = jnp.where(across, _MIRRORED, _FLIPPED)
    # A mirrored row or column i of the block is copied from first + last - i.
    offset = jnp.where(_either(across), 0, first + last)
    return _Change(first, last, _COPIED, how, offset)


def _plan_slide(draws: _Draws) -> _Change:
    first, last = draws.block
    # Either the rows of the block slide, over the whole width, or its columns over the whole
    # height.
    slides = _either(draws.bits[4] & 1 == 0)
    step = jnp.where(draws.bits[4] & 2 == 0, -1, 1)
    return _Change(
        first=jnp.where(slides, first, 0),
        last=jnp.where(slides, last, draws.shape - 1),
        code=_COPIED,
        how=_CYCLIC,
        offset=jnp.where(slides, step, 0),
    )


def _plan_transplant(draws: _Draws) -> _Change:
    return _plan_mate_block(draws, np.zeros(2, np.int32))


def _plan_displaced_transplant(draws: _Draws) -> _Change:
    first, last = draws.block
    # The source is any block of this size inside the grid.
    offset = randint(draws.bits[5:7], draws.shape - (last - first)) - first
    return _plan_mate_block(draws, jnp.where(_either(draws.bits[4] & 8 == 0), offset, 0))


def _plan_refit(draws: _Draws) -> _Change:
    size = np.minimum(draws.shape, _WINDOW)
    first = randint(draws.bits[:2], draws.shape - size + 1)
    return _Change(first, first + size - 1, _REFITTED)


def _plan_mate_block(draws: _Draws, offset: Int[ArrayLike, " 2"]) -> _Change:
    """Plans to copy a block from the mate, transformed.

    Without a transformation, each tile comes from `offset` rows below it and columns to its right.
    """
    height, width = draws.shape
    # Transposing changes the shape, so only a square grid draws its bit.
    symmetry_bits = 7 if height == width else 3
    symmetry = (draws.bits[4] & symmetry_bits).astype(jnp.int32)
    mirrored = symmetry & 1 > 0
    flipped = symmetry & 2 > 0
    transposed = symmetry & 4 > 0
    flags = ((mirrored, _MIRRORED), (flipped, _FLIPPED), (transposed, _TRANSPOSED))
    how = _FROM_MATE + sum(jnp.where(is_chosen, flag, 0) for is_chosen, flag in flags)
    backwards = jnp.stack([flipped, mirrored])
    first, last = draws.block
    # The mate as a whole is mirrored, so row i comes from the row that is as far from the other
    # end.
    return _Change(
        first, last, _COPIED, how, jnp.where(backwards, draws.shape - 1 - offset, offset)
    )


def _either(rows: Bool[Array, ""]) -> Bool[Array, " 2"]:
    """Returns a flag for rows and its opposite for columns."""
    return np.array([True, False]) == rows


def _row_and_column_indices(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[0])[:, None], np.arange(shape[1])[None]


# The plan of each move, by the name of its weight.
_PLANS: dict[str, _Plan] = {
    "link": _plan_link,
    "corner": _plan_corner,
    "outline": _plan_outline,
    "street": _plan_street,
    "straight": _plan_straight,
    "clear": _plan_clearing,
    "mirror": _plan_mirroring,
    "slide": _plan_slide,
    "transplant": _plan_transplant,
    "displaced": _plan_displaced_transplant,
    "refit": _plan_refit,
}
