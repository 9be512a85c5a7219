"""Moves in the space of networks: whole streets, loops and blocks at a time.

A network is a set of links. Toggling the links of a loop keeps the parity of every tile's connections: corners,
outlines and their sums are the cycle space of the lattice. Blocks copy a part of a network: to the same place or
another one, rotated or mirrored, from the grid itself or from a mate.
"""

from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real, UInt32

from elitelanes_jax._util.checks import none_or, real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.pytrees import pytree, traced
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST, exchange_sides, rotate_codes
from elitelanes_jax.network.materialize import lookup, materialize
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.optimizers._mutations import Move, Variation
from elitelanes_jax.optimizers._windows import flawless_fillings


@pytree
@dataclass(frozen=True)
class Mix(Record):
    """The shares of the moves in a random move; a pytree, whose numbers may be arrays, mapped by `jax.vmap`.

    The defaults were measured (experiments/search/moves.md).

    Attributes:
      link: share of `toggle_link`, a whole number.
      corner: share of `toggle_corner`.
      outline: share of `toggle_outline`.
      street: share of `toggle_street`.
      straight: share of `lay_straight`.
      clear: share of `clear_block`.
      mirror: share of `mirror_block`.
      slide: share of `slide_lines`.
      transplant: share of `transplant` to the same place.
      displaced: share of `transplant` from another place.
      refit: share of `refit_window`; by default 0, and 25 in MAP-Elites on grids of up to 64 cells.
      filling: probability that the filling repair follows the move (see `with_filling`), where repair does not fill.
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
    filling: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))

    def check_together(self) -> None:
        """Checks that there is a move to make."""
        if all(share is None or (isinstance(share, int) and share == 0) for share in astuple(self)[:-1]):
            raise InputError("link: expected a share over 0 for at least one move, got none")


def random_move(mix: Mix, *, fill: bool, fixed: AnyArray = None) -> Move:
    """Makes one move of the mix at random, in proportion to the shares.

    Args:
      mix: with at least one share over 0.
      fill: whether repair fills anyway, so that `Mix.filling` has no effect.
      fixed: bool ``[H, W]``, see `repair`.
    """
    move = _move(
        {
            _plan_link: mix.link,
            _plan_corner: mix.corner,
            _plan_outline: mix.outline,
            _plan_street: mix.street,
            _plan_straight: mix.straight,
            _plan_clearing: mix.clear,
            _plan_mirroring: mix.mirror,
            _plan_slide: mix.slide,
            _plan_transplant: mix.transplant,
            _plan_displaced_transplant: mix.displaced,
            _plan_refit: 0 if mix.refit is None else mix.refit,
        },
        empty=not fill,
    )
    return move if fill else with_filling(mix.filling, move, fixed=fixed)


def toggle_link() -> Move:
    """Makes or cuts the link between two neighbouring tiles."""
    return _move({_plan_link: 1})


def toggle_corner() -> Move:
    """Toggles the four links around a point where four tiles meet: the smallest loop."""
    return _move({_plan_corner: 1})


def toggle_outline() -> Move:
    """Toggles the links along the outline of a rectangle of at least 2 x 2 tiles, each height and width as likely."""
    return _move({_plan_outline: 1})


def toggle_street() -> Move:
    """Toggles the links along a stretch of a row or a column."""
    return _move({_plan_street: 1})


def lay_straight() -> Move:
    """Lays straight tiles along a stretch of a row or a column, over any tiles."""
    return _move({_plan_straight: 1})


def clear_block() -> Move:
    """Empties a block of tiles."""
    return _move({_plan_clearing: 1})


def mirror_block() -> Move:
    """Mirrors a block of tiles in its place, east to west or north to south."""
    return _move({_plan_mirroring: 1})


def slide_lines() -> Move:
    """Moves the rows between two rows, or the columns between two columns, on by one: the last comes first, or back."""
    return _move({_plan_slide: 1})


def transplant(*, displaced: bool = False) -> Move:
    """Copies a block of the mate, which is first rotated or mirrored: one of eight ways, the plain one included.

    Grids that are not square are rotated by half turns only.

    Args:
      displaced: whether the block comes from another place in the same rows or in the same columns.
    """
    return _move({_plan_displaced_transplant if displaced else _plan_transplant: 1})


def refit_window(*, empty: bool = True) -> Move:
    """Replaces a window of 3 x 3 tiles by another flawless filling that has the same links to the tiles around it.

    The fillings come from a table (see `flawless_fillings`) and are about equally likely. Where there is no other one
    the grid stays as it is.

    Args:
      empty: whether cells of a filling may be empty.
    """
    return _move({_plan_refit: 1}, empty=empty)


def with_filling(probability: Real[ArrayLike, ""], move: Move, *, fixed: AnyArray = None) -> Move:
    """Makes a move, and with the given probability the filling repair after it.

    Where cells may stay empty this leads from a network with loose ends to the nearest one without, which single moves
    find slowly.
    """

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        varied = move.apply(bits[:-1], grid, mate)
        happens = bernoulli(bits[-1], probability)
        filled = repair(*varied, fill=True, fixed=fixed)
        # A filled grid has no mismatch left for the dirty tiles to decide.
        return Variation(jnp.where(happens, filled, varied.grid), varied.dirty)

    return Move(move.bits + 1, apply)


def with_opposite(probability: Real[ArrayLike, ""], move: Move, *, mirrored: bool = False) -> Move:
    """Makes a move, and with the given probability the same change at the opposite place, rotated by half a turn.

    A grid that is symmetric under half a turn stays so, unless repair fills. One step then does what would take two,
    with a worse grid in between.

    Args:
      probability: of the second change.
      move: the move.
      mirrored: whether the second change may be mirrored in a diagonal instead: in each a third of the time, on square
        grids.
    """

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        varied, dirty = move.apply(bits[: move.bits], grid, mate)
        places = np.arange(grid.size, dtype=np.int32).reshape(grid.shape)
        if mirrored and grid.shape[0] == grid.shape[1]:
            # A tile, whether it is dirty, and its place in one number: what is at the opposite place comes from there.
            packed = _opposite(
                randint(bits[move.bits + 1], 3), varied.astype(jnp.int32) | dirty.astype(jnp.int32) << 4 | places << 5
            )
            image, dirty_there, first = (packed & 15).astype(jnp.int8), packed & 16 > 0, places <= packed >> 5
        else:
            image, dirty_there = rotate_codes(varied, 2)[::-1, ::-1], dirty[::-1, ::-1]
            first = places <= places[::-1, ::-1]
        opposite = dirty_there & bernoulli(bits[move.bits], probability)
        # Where the two places overlap the first of them decides.
        return Variation(jnp.where(opposite & ~(dirty & first), image, varied), dirty | opposite)

    return Move(move.bits + 1 + mirrored, apply)


def _opposite(diagonal: Int32[Array, ""], tiles: Int32[Array, "N N"]) -> Int32[Array, "N N"]:
    """Rotates codes by half a turn, or mirrors them in diagonal 1 or 2; what is above their four bits goes along."""

    def exchanged(tiles: Array, one: int, other: int, third: int, fourth: int) -> Array:
        return tiles & ~15 | exchange_sides(exchange_sides(tiles, one, other), third, fourth)

    once = jnp.where(diagonal == 1, tiles, exchanged(tiles, NORTH, SOUTH, EAST, WEST)[::-1, ::-1])
    return jnp.where(diagonal == 0, once, exchanged(once, NORTH, WEST, EAST, SOUTH).T)


_Sides = tuple[Int32[Array, ""], Int32[Array, ""], Int32[Array, ""], Int32[Array, ""]]


class _Change(NamedTuple):
    """The change that a move makes, as numbers: of all moves one is drawn before any tile is touched.

    Attributes:
      sides: north, south, west and east of a rectangle of tiles, all included.
      toggles: bool, whether the links along its outline are toggled; where it is one tile wide, those along it. Else
        its tiles are written.
      code: int32, the code that is written; `_COPIED` for tiles that are copied, `_REFITTED` for those of a window.
      rows: int32 ``[H]`` and
      columns: int32 ``[W]``, which add up to the place, row by row, that each tile is copied from.
      flipped: bool, whether copied tiles are mirrored north to south.
      mirrored: bool, whether they are mirrored east to west.
      transposed: bool, whether rows and columns of the source are exchanged first.
      from_mate: bool, whether they come from the mate.
    """

    sides: _Sides
    toggles: Bool[Array, ""]
    code: Int32[Array, ""]
    rows: Int32[Array, " H"]
    columns: Int32[Array, " W"]
    flipped: Bool[Array, ""]
    mirrored: Bool[Array, ""]
    transposed: Bool[Array, ""]
    from_mate: Bool[Array, ""]


# From random bits, uint32 [7], and the grid's shape.
_Plan = Callable[[Array, tuple[int, ...]], _Change]

_COPIED, _REFITTED = -1, -2

# The longest side of a window that is refitted.
_WINDOW = 3

# One number to draw the plan by, and at most seven for the plan.
_BITS = 1 + 7


def _move(shares: dict[_Plan, AnyArray], *, empty: bool = True) -> Move:
    """Makes a move by one of the plans, each in proportion to its share; `empty` is that of `refit_window`."""
    # What is never drawn need not be computed.
    shares = {plan: share for plan, share in shares.items() if not (isinstance(share, int) and share == 0)}
    ends = jnp.cumsum(jnp.array(list(shares.values()), jnp.int32))

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        plans, changes = zip(*(ravel_pytree(plan(bits[1:], grid.shape)) for plan in shares), strict=True)
        drawn = (randint(bits[0], ends[-1]) >= ends[:-1]).sum()
        # XLA computes a sum once for each grid, but a mere choice anew for every tile: three times the time of a move.
        plan = jnp.where((np.arange(len(shares)) == drawn)[:, None], jnp.stack(plans), 0).sum(axis=0, dtype=jnp.int32)
        change = changes[0](plan)
        window = _refit(bits[3], change.sides, grid, empty=empty) if _plan_refit in shares else None
        return _apply(change, grid, grid if mate is None else mate, window)

    return Move(_BITS, apply)


def _apply(
    change: _Change, grid: Int8[Array, "H W"], mate: Int8[Array, "H W"], window: Int8[Array, "H W"] | None
) -> Variation:
    rows, columns = _places(grid.shape)
    north, south, west, east = change.sides
    inside = (rows >= north) & (rows <= south) & (columns >= west) & (columns <= east)
    along = inside & ((rows == north) | (rows == south))
    upright = inside & ((columns == west) | (columns == east))
    links = jnp.where(along & (columns < east), EAST, 0) | jnp.where(along & (columns > west), WEST, 0)
    links = links | jnp.where(upright & (rows < south), SOUTH, 0) | jnp.where(upright & (rows > north), NORTH, 0)
    written = jnp.where(change.code < 0, _copy(change, grid, mate), change.code)
    if window is not None:
        written = jnp.where(change.code == _REFITTED, window, written)
    varied = jnp.where(change.toggles, grid ^ links, jnp.where(inside, written, grid)).astype(jnp.int8)
    dirty = jnp.where(change.toggles, links != 0, inside)
    both = materialize(varied | dirty.astype(jnp.int8) << 4)
    return Variation(both & 15, both > 15)


def _copy(change: _Change, grid: Int8[Array, "H W"], mate: Int8[Array, "H W"]) -> Int8[Array, "H W"]:
    source = materialize(jnp.where(change.from_mate, mate, grid).reshape(-1))
    tiles = materialize(lookup(source, change.rows[:, None] + change.columns))
    transposed = exchange_sides(exchange_sides(tiles, NORTH, WEST), EAST, SOUTH)
    tiles = jnp.where(change.transposed, transposed, tiles)
    tiles = jnp.where(change.mirrored, exchange_sides(tiles, EAST, WEST), tiles)
    return jnp.where(change.flipped, exchange_sides(tiles, NORTH, SOUTH), tiles)


def _refit(bits: UInt32[Array, ""], sides: _Sides, grid: Int8[Array, "H W"], *, empty: bool) -> Int8[Array, "H W"]:
    """Draws another flawless filling of a window, given by its sides; only the tiles in it mean anything."""
    height, width = (min(side, _WINDOW) for side in grid.shape)
    fillings = flawless_fillings(height, width, empty=empty)
    all_first, all_rows = jnp.asarray(fillings.first), jnp.asarray(fillings.rows)
    north, _, west, _ = sides
    tiles = jax.lax.dynamic_slice(grid, (north, west), (height, width)).astype(jnp.int32)
    borders = tiles[0] & NORTH, tiles[-1] & SOUTH, tiles[:, 0] & WEST, tiles[:, -1] & EAST
    border = ((jnp.concatenate(borders) > 0) << np.arange(2 * (height + width))).sum()
    first, count = all_first[border], all_first[border + 1] - all_first[border]
    before = (tiles << 4 * np.arange(width)).sum(axis=1)
    drawn = randint(bits, jnp.maximum(count, 1))
    one, next_one = (all_rows[first + (drawn + step) % jnp.maximum(count, 1)] for step in (0, 1))
    filling = jnp.where(count == 0, before, jnp.where((one == before).all(), next_one, one))
    rows, columns = _places(grid.shape)
    row = filling[jnp.clip(rows - north, 0, height - 1)]
    return (row >> 4 * jnp.clip(columns - west, 0, width - 1) & 15).astype(jnp.int8)


def _toggle(sides: _Sides, shape: tuple[int, ...]) -> _Change:
    return _write(sides, jnp.int32(0), shape)._replace(toggles=jnp.asarray(True))


def _write(sides: _Sides, code: Int32[Array, ""], shape: tuple[int, ...]) -> _Change:
    rows, columns = (jnp.arange(side, dtype=jnp.int32) for side in shape)
    no = jnp.asarray(False)
    return _Change(sides, no, code, rows, columns, no, no, no, no)


def _copy_from(
    sides: _Sides, rows: Array, columns: Array, shape: tuple[int, ...], transposed: Bool[ArrayLike, ""] = False
) -> _Change:
    down, right = jnp.where(transposed, 1, shape[1]), jnp.where(transposed, shape[1], 1)
    change = _write(sides, jnp.int32(_COPIED), shape)
    return change._replace(rows=rows * down, columns=columns * right, transposed=jnp.asarray(transposed))


def _plan_link(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    height, width = shape
    across = height * (width - 1)
    drawn = randint(bits[0], across + (height - 1) * width)
    east = drawn < across
    number = jnp.where(east, drawn, drawn - across)
    length = jnp.where(east, width - 1, width)
    row, column = number // length, number % length
    return _toggle((row, row + ~east, column, column + east), shape)


def _plan_corner(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    north, west = randint(bits[0], shape[0] - 1), randint(bits[1], shape[1] - 1)
    return _toggle((north, north + 1, west, west + 1), shape)


def _plan_outline(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    height, width = shape
    down, across = 1 + randint(bits[0], height - 1), 1 + randint(bits[1], width - 1)
    north, west = randint(bits[2], height - down), randint(bits[3], width - across)
    return _toggle((north, north + down, west, west + across), shape)


def _plan_street(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    return _toggle(_stretch(bits, shape)[1], shape)


def _plan_straight(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    east, sides = _stretch(bits, shape)
    return _write(sides, jnp.where(east, EAST | WEST, NORTH | SOUTH), shape)


def _plan_clearing(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    return _write(_block(bits, shape), jnp.int32(0), shape)


def _plan_mirroring(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    sides = _block(bits, shape)
    across = bits[4] & 1 == 0
    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    north, south, west, east = sides
    change = _copy_from(
        sides,
        jnp.where(across, rows, jnp.clip(north + south - rows, 0, shape[0] - 1)),
        jnp.where(across, jnp.clip(west + east - columns, 0, shape[1] - 1), columns),
        shape,
    )
    return change._replace(flipped=~across, mirrored=across)


def _plan_slide(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    by_rows, back = bits[4] & 1 == 0, bits[4] & 2 == 0
    north, south, west, east = _block(bits, shape)

    def sources(length: int, first: Array, last: Array) -> Array:
        places = np.arange(length, dtype=np.int32)
        step = places + jnp.where(back, -1, 1)
        return jnp.clip(jnp.where(step < first, last, jnp.where(step > last, first, step)), 0, length - 1)

    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    ends = (north, south, jnp.int32(0), jnp.int32(shape[1] - 1)), (jnp.int32(0), jnp.int32(shape[0] - 1), west, east)
    north, south, west, east = (jnp.where(by_rows, one, other) for one, other in zip(*ends, strict=True))
    return _copy_from(
        (north, south, west, east),
        jnp.where(by_rows, sources(shape[0], north, south), rows),
        jnp.where(by_rows, columns, sources(shape[1], west, east)),
        shape,
    )


def _plan_transplant(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    return _plan_mate_block(bits, shape, jnp.int32(0), jnp.int32(0))


def _plan_displaced_transplant(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    north, south, west, east = _block(bits, shape)
    same_columns = bits[4] & 8 == 0
    down = randint(bits[5], shape[0] - (south - north)) - north
    right = randint(bits[6], shape[1] - (east - west)) - west
    return _plan_mate_block(bits, shape, jnp.where(same_columns, down, 0), jnp.where(same_columns, 0, right))


def _plan_refit(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Change:
    height, width = (min(side, _WINDOW) for side in shape)
    north, west = randint(bits[0], shape[0] - height + 1), randint(bits[1], shape[1] - width + 1)
    return _write((north, north + height - 1, west, west + width - 1), jnp.int32(_REFITTED), shape)


def _plan_mate_block(bits: UInt32[Array, " 7"], shape: tuple[int, ...], down: Array, right: Array) -> _Change:
    """Plans to copy a block of the mate, so many tiles farther down and right there, one of eight ways."""
    height, width = shape
    way = bits[4]
    mirrored, flipped = way & 1 != 0, way & 2 != 0
    transposed = (way & 4 != 0) & (height == width)
    rows = jnp.clip(np.arange(height, dtype=np.int32) + down, 0, height - 1)
    columns = jnp.clip(np.arange(width, dtype=np.int32) + right, 0, width - 1)
    change = _copy_from(
        _block(bits, shape),
        jnp.where(flipped, height - 1 - rows, rows),
        jnp.where(mirrored, width - 1 - columns, columns),
        shape,
        transposed,
    )
    return change._replace(flipped=flipped, mirrored=mirrored, from_mate=jnp.asarray(True))


def _places(shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[0])[:, None], np.arange(shape[1])[None]


def _block(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> _Sides:
    """Draws north, south, west and east of a block: two rows and two columns, each drawn alone, in order.

    One time in eight a side is at the grid's edge instead: half a network, rotated or mirrored, makes a whole one.
    """
    one, other = randint(bits[:2], shape[0]), randint(bits[2:4], shape[1])
    north, south, west, east = bits[:4] & 7 == 0
    return (
        jnp.where(north, 0, one.min()),
        jnp.where(south, shape[0] - 1, one.max()),
        jnp.where(west, 0, other.min()),
        jnp.where(east, shape[1] - 1, other.max()),
    )


def _stretch(bits: UInt32[Array, " 7"], shape: tuple[int, ...]) -> tuple[Bool[Array, ""], _Sides]:
    """Draws whether a stretch runs east, and its sides."""
    height, width = shape
    east = bits[0] & 1 == 0
    line = randint(bits[1], jnp.where(east, height, width))
    ends = randint(bits[2:4], jnp.where(east, width, height))
    low, high = ends.min(), ends.max()
    sides = (jnp.where(east, line, low), jnp.where(east, line, high))
    return east, (*sides, jnp.where(east, low, line), jnp.where(east, high, line))
