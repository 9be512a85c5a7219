"""Moves in the space of networks: each changes a whole street, loop or block.

A network is a set of links. Toggling the links of a loop keeps the parity of every tile's
connections: corners, outlines and their sums are the cycle space of the lattice. Other moves copy a
block of the grid itself or of a mate. The block goes to the same position or to another one, and
may be rotated or mirrored.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int8, Int32, Real, UInt32

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
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.records import Record, number_or_array, one_number, option, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows, UserValue
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import rotate_codes
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.optimizers._changes import apply_change, choose_change, refit
from elitelanes_jax.optimizers._mutations import Move, Variation
from elitelanes_jax.optimizers._plans import PLANS, Draws, Plan, plan_refit


def _check_user_moves(moves: UserValue) -> dict[str, tuple[Int[ArrayLike, "..."], Move]]:
    """Checks moves of the user and returns them sorted by name.

    Therefore results do not depend on the order of the moves.
    """
    # The default of a field has to be immutable, so an empty tuple means no moves.
    if isinstance(moves, tuple) and not moves:
        moves = {}
    if not isinstance(moves, Mapping):
        raise InputError("", "moves by name", quote(moves))
    checked = {}
    for name, value in sorted(moves.items(), key=lambda item: str(item[0])):
        is_name = isinstance(name, str) and name.isidentifier()
        if not is_name or name in KNOWN_MOVES:
            expected = "names of letters, digits and _ that no other move has"
            raise InputError("", expected, quote(name))
        checked[name] = _check_user_move(name, value)
    return checked


def _check_user_move(name: str, value: UserValue) -> tuple[Int[ArrayLike, "..."], Move]:
    """Checks the weight and the move of one name."""
    weight, move = value if isinstance(value, tuple | list) and len(value) == 2 else (None, None)
    if not isinstance(move, Move):
        raise InputError(name, "a weight and a Move", quote(value))
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
            raise InputError("moves", "weights and moves by name", quote(moves))
        weights = {}
        user_moves = {}
        for name, value in moves.items():
            if name in KNOWN_MOVES:
                weights[name] = value
            elif isinstance(value, tuple | list | Move):
                # The weight and the `Move` are checked with all moves of the user below.
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


def _is_never_drawn(weight: ArrayLike | None) -> bool:
    """Returns whether a move is known to have weight 0.

    An array may be traced, so its number is not known.
    """
    return weight is None or (isinstance(weight, int) and weight == 0)


@name_wrong_arguments
def random_move(weights: MoveWeights, *, fill: bool, fixed: ArrayOrRows | None = None) -> Move:
    """Makes one move, drawn in proportion to the weights.

    If repair always fills, `MoveWeights.fill_probability` has no effect. For `fixed`, bool
    ``[H, W]``, see `repair`.
    """
    weights_by_plan: dict[Plan, ArrayLike | None] = {
        plan: getattr(weights, name) for name, plan in PLANS.items()
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
    plan = PLANS[check_named("name", one_of(*KNOWN_MOVES), name)]
    return _move({plan: 1}, empty=empty)


@name_wrong_arguments
def with_fill(
    probability: Real[ArrayLike, ""], move: Move, *, fixed: ArrayOrRows | None = None
) -> Move:
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
        grid = jnp.asarray(check_grid(grid))
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
        grid = jnp.asarray(check_grid(grid))
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


# One number draws the plan, and a plan uses at most seven numbers.
_BITS = 1 + 7


@runs_jax
def _move(
    weights: Mapping[Plan, ArrayLike | None],
    user_moves: Mapping[str, tuple[ArrayLike, Move]] = MappingProxyType({}),
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
        grid = jnp.asarray(check_grid(grid))
        # The four lowest bits of a traced code are read.
        grid = grid & 15
        mate = grid if mate is None else check_array("mate", mate, grid.shape, jnp.int8) & 15
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
    plans: Sequence[Plan],
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
    draws = Draws(bits[1:_BITS], grid.shape)
    change = choose_change(index, [plan(draws) for plan in plans])
    window = None
    if plan_refit in plans:
        window = refit(draws.bits[2], change, grid, empty=empty)
    return apply_change(change, grid, mate, window)
