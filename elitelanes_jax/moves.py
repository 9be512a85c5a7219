"""Moves in the space of networks: whole streets, loops and blocks at a time.

A network is a set of links. Adding the links of a loop to it, where those already there go, keeps the parity of every
tile's connections: corners, outlines and all that is made of them are the cycle space of the lattice. Blocks carry what
has proved good elsewhere: in another grid, turned or mirrored, or in another place.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric
from jax.flatten_util import ravel_pytree

from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST, turned
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError
from elitelanes_jax.repairs import repair
from elitelanes_jax.variation import Move, Variation

__all__ = [
    "Mix",
    "clear_block",
    "completed",
    "lay_straight",
    "mirror_block",
    "mixed",
    "slide_lines",
    "toggle_corner",
    "toggle_link",
    "toggle_outline",
    "toggle_street",
    "transplant",
    "twinned",
]


class Mix(NamedTuple):
    """How often each move is made, in shares; the default is what reached farthest soonest.

    Attributes:
      link: of `toggle_link`.
      corner: of `toggle_corner`.
      outline: of `toggle_outline`.
      street: of `toggle_street`.
      straight: of `lay_straight`.
      clear: of `clear_block`.
      mirrored: of `mirror_block`.
      slide: of `slide_lines`.
      transplant: of `transplant` to the same place.
      displaced: of `transplant` to any place.
      completed: probability that the varied grid is also completed (see `completed`), where repair does not.
    """

    link: int = 1
    corner: int = 4
    outline: int = 1
    street: int = 1
    straight: int = 8
    clear: int = 1
    mirrored: int = 1
    slide: int = 1
    transplant: int = 16
    displaced: int = 4
    completed: Numeric = 0.3

    def checked(self) -> "Mix":
        """The mix with the probability as a float.

        Raises:
          InputError: for a share that is no whole number or negative, or where all are 0.
        """
        for name, share in self._asdict().items():
            if name != "completed" and share != 0:
                check_count("moves", name, share)
        if not any(self[:-1]):
            raise InputError("moves: expected a share over 0 for at least one move, got none")
        return self._replace(completed=check_real("moves", "completed", self.completed, 0, 1))


def mixed(mix: Mix, *, fill: bool, kept: Any = None) -> Move:
    """One move of the mix at random, in proportion to the shares.

    Args:
      mix: with at least one share over 0.
      fill: whether repair fills anyway, so that nothing need be completed.
      kept: bool ``[H, W]``, see `repair`.
    """
    shares = {
        _linked: mix.link,
        _cornered: mix.corner,
        _outlined: mix.outline,
        _streeted: mix.street,
        _straightened: mix.straight,
        _cleared: mix.clear,
        _mirrored: mix.mirrored,
        _slid: mix.slide,
        _transplanted: mix.transplant,
        _displaced: mix.displaced,
    }
    move = _moving({plan: share for plan, share in shares.items() if share})
    return move if fill else completed(mix.completed, move, kept=kept)


def toggle_link() -> Move:
    """Makes or cuts the link between two neighbouring tiles."""
    return _moving({_linked: 1})


def toggle_corner() -> Move:
    """Toggles the four links around a point where four tiles meet: the smallest loop."""
    return _moving({_cornered: 1})


def toggle_outline() -> Move:
    """Toggles the links along the outline of a rectangle of at least 2 x 2 tiles, each height and width alike often."""
    return _moving({_outlined: 1})


def toggle_street() -> Move:
    """Toggles the links along a stretch of a row or a column."""
    return _moving({_streeted: 1})


def lay_straight() -> Move:
    """Lays straight tiles along a stretch of a row or a column, whatever was there."""
    return _moving({_straightened: 1})


def clear_block() -> Move:
    """Empties a block of tiles."""
    return _moving({_cleared: 1})


def mirror_block() -> Move:
    """Mirrors a block of tiles in its place, east to west or north to south."""
    return _moving({_mirrored: 1})


def slide_lines() -> Move:
    """Slides the rows between two rows, or the columns between two columns, by one: the last comes first, or back."""
    return _moving({_slid: 1})


def transplant(*, displaced: bool = False) -> Move:
    """Sets in a block of the mate, which is first turned or mirrored: as it is, or any of the other seven ways.

    Grids that are not square are turned by half turns only.

    Args:
      displaced: whether the block comes from another place in the same rows or in the same columns.
    """
    return _moving({_displaced if displaced else _transplanted: 1})


def completed(probability: Numeric, move: Move, *, kept: Any = None) -> Move:
    """The move, and with the given probability the filling repair after it, in grids that are else only matched.

    Where cells may stay empty this leads from a network with loose ends to the nearest without, which single moves find
    slowly.
    """

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        varied = move.apply(words[:-1], grid, mate)
        happens = chance(words[-1], probability)
        whole = repair(*varied, fill=True, kept=kept)
        # What is whole has no mismatch left for the dirty tiles to decide.
        return Variation(jnp.where(happens, whole, varied.grid), varied.dirty)

    return Move(move.words + 1, apply)


def twinned(probability: Numeric, move: Move) -> Move:
    """The move, and with the given probability the same in the place opposite, turned by half a turn.

    What is symmetric under half a turn stays so, but where repair fills (see `completed`), and takes in one step what
    would be two with something worse between.
    """

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        varied, dirty = move.apply(words[:-1], grid, mate)
        rows, columns = _places(grid.shape)
        first = rows * grid.shape[1] + columns < (grid.size + 1) // 2
        opposite = dirty[::-1, ::-1] & chance(words[-1], probability)
        # Where the two places overlap the first half of the grid decides.
        taken = opposite & ~(dirty & first)
        return Variation(jnp.where(taken, turned(varied, 2)[::-1, ::-1], varied), dirty | opposite)

    return Move(move.words + 1, apply)


_Sides = tuple[Array, Array, Array, Array]


class _Change(NamedTuple):
    """What a move does, and where: numbers only, so that of all moves one is drawn before any tile is touched.

    Attributes:
      sides: north, south, west and east of a rectangle of tiles, all included.
      toggles: bool, whether the links along its outline are toggled; where it is one tile wide, those along it. Else
        its tiles are written.
      code: int32, what is written; -1 for tiles that are copied.
      rows: int32 ``[H]``, the row that each row's tiles are copied from.
      columns: int32 ``[W]``, likewise.
      upside_down: bool, whether copied tiles are mirrored north to south.
      mirrored: bool, whether they are mirrored east to west.
      swapped: bool, whether rows and columns of the source are swapped first.
      foreign: bool, whether they come from the mate.
    """

    sides: _Sides
    toggles: Array
    code: Array
    rows: Array
    columns: Array
    upside_down: Array
    mirrored: Array
    swapped: Array
    foreign: Array


_Plan = Callable[[Array, tuple[int, int]], _Change]

# A word to draw the plan by, and at most seven for the plan.
_WORDS = 1 + 7


def _moving(shares: dict[_Plan, int]) -> Move:
    """A move by one of the plans, each in proportion to its share."""
    ends = np.cumsum(list(shares.values()), dtype=np.int32)

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        plans, changes = zip(*(ravel_pytree(plan(words[1:], grid.shape)) for plan in shares), strict=True)
        drawn = (below(words[0], ends[-1]) >= ends[:-1]).sum()
        # XLA computes a sum once for each grid, but a mere choice anew for every tile: three times the time of a move.
        plan = jnp.where((np.arange(len(shares)) == drawn)[:, None], jnp.stack(plans), 0).sum(axis=0, dtype=jnp.int32)
        return _changed(changes[0](plan), grid, grid if mate is None else mate)

    return Move(_WORDS, apply)


def _changed(change: _Change, grid: Array, mate: Array) -> Variation:
    rows, columns = _places(grid.shape)
    north, south, west, east = change.sides
    inside = (rows >= north) & (rows <= south) & (columns >= west) & (columns <= east)
    along = inside & ((rows == north) | (rows == south))
    upright = inside & ((columns == west) | (columns == east))
    links = jnp.where(along & (columns < east), EAST, 0) | jnp.where(along & (columns > west), WEST, 0)
    links = links | jnp.where(upright & (rows < south), SOUTH, 0) | jnp.where(upright & (rows > north), NORTH, 0)
    written = jnp.where(change.code < 0, _copied(change, grid, mate), change.code)
    varied = jnp.where(change.toggles, grid ^ links, jnp.where(inside, written, grid))
    return Variation(varied.astype(jnp.int8), jnp.where(change.toggles, links != 0, inside))


def _copied(change: _Change, grid: Array, mate: Array) -> Array:
    width = grid.shape[1]
    source = jnp.where(change.foreign, mate, grid).reshape(-1)
    rows, columns = change.rows[:, None], change.columns[None]
    tiles = source[jnp.where(change.swapped, columns * width + rows, rows * width + columns)]
    # Swapping rows and columns swaps north with west and south with east.
    tiles = jnp.where(change.swapped, (tiles & 8) >> 3 | (tiles & 1) << 3 | (tiles & 4) >> 1 | (tiles & 2) << 1, tiles)
    tiles = jnp.where(change.mirrored, tiles & 10 | (tiles & 4) >> 2 | (tiles & 1) << 2, tiles)
    return jnp.where(change.upside_down, tiles & 5 | (tiles & 8) >> 2 | (tiles & 2) << 2, tiles)


def _toggling(sides: _Sides, shape: tuple[int, int]) -> _Change:
    return _writing(sides, jnp.int32(0), shape)._replace(toggles=_YES)


def _writing(sides: _Sides, code: Array, shape: tuple[int, int]) -> _Change:
    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    return _Change(sides, ~_YES, code, rows, columns, ~_YES, ~_YES, ~_YES, ~_YES)


def _copying(sides: _Sides, rows: Array, columns: Array, shape: tuple[int, int]) -> _Change:
    return _writing(sides, jnp.int32(-1), shape)._replace(rows=rows, columns=columns)


def _linked(words: Array, shape: tuple[int, int]) -> _Change:
    height, width = shape
    across = height * (width - 1)
    drawn = below(words[0], across + (height - 1) * width)
    east = drawn < across
    number = jnp.where(east, drawn, drawn - across)
    length = jnp.where(east, width - 1, width)
    row, column = number // length, number % length
    return _toggling((row, row + ~east, column, column + east), shape)


def _cornered(words: Array, shape: tuple[int, int]) -> _Change:
    north, west = below(words[0], shape[0] - 1), below(words[1], shape[1] - 1)
    return _toggling((north, north + 1, west, west + 1), shape)


def _outlined(words: Array, shape: tuple[int, int]) -> _Change:
    height, width = shape
    down, across = 1 + below(words[0], height - 1), 1 + below(words[1], width - 1)
    north, west = below(words[2], height - down), below(words[3], width - across)
    return _toggling((north, north + down, west, west + across), shape)


def _streeted(words: Array, shape: tuple[int, int]) -> _Change:
    return _toggling(_stretch(words, shape)[1], shape)


def _straightened(words: Array, shape: tuple[int, int]) -> _Change:
    east, sides = _stretch(words, shape)
    return _writing(sides, jnp.where(east, EAST | WEST, NORTH | SOUTH), shape)


def _cleared(words: Array, shape: tuple[int, int]) -> _Change:
    return _writing(_block(words, shape), jnp.int32(0), shape)


def _mirrored(words: Array, shape: tuple[int, int]) -> _Change:
    sides = _block(words, shape)
    across = words[4] & 1 == 0
    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    north, south, west, east = sides
    change = _copying(
        sides,
        jnp.where(across, rows, jnp.clip(north + south - rows, 0, shape[0] - 1)),
        jnp.where(across, jnp.clip(west + east - columns, 0, shape[1] - 1), columns),
        shape,
    )
    return change._replace(upside_down=~across, mirrored=across)


def _slid(words: Array, shape: tuple[int, int]) -> _Change:
    by_rows, back = words[4] & 1 == 0, words[4] & 2 == 0
    north, south, west, east = _block(words, shape)

    def moved(length: int, first: Array, last: Array) -> Array:
        places = np.arange(length, dtype=np.int32)
        step = places + jnp.where(back, -1, 1)
        return jnp.clip(jnp.where(step < first, last, jnp.where(step > last, first, step)), 0, length - 1)

    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    ends = (north, south, jnp.int32(0), jnp.int32(shape[1] - 1)), (jnp.int32(0), jnp.int32(shape[0] - 1), west, east)
    north, south, west, east = (jnp.where(by_rows, one, other) for one, other in zip(*ends, strict=True))
    return _copying(
        (north, south, west, east),
        jnp.where(by_rows, moved(shape[0], north, south), rows),
        jnp.where(by_rows, columns, moved(shape[1], west, east)),
        shape,
    )


def _transplanted(words: Array, shape: tuple[int, int]) -> _Change:
    return _from_mate(words, shape, jnp.int32(0), jnp.int32(0))


def _displaced(words: Array, shape: tuple[int, int]) -> _Change:
    north, south, west, east = _block(words, shape)
    same_columns = words[4] & 8 == 0
    down = below(words[5], shape[0] - (south - north)) - north
    right = below(words[6], shape[1] - (east - west)) - west
    return _from_mate(words, shape, jnp.where(same_columns, down, 0), jnp.where(same_columns, 0, right))


def _from_mate(words: Array, shape: tuple[int, int], down: Array, right: Array) -> _Change:
    """A block of the mate, as many tiles farther down and right there, turned or mirrored one of eight ways."""
    height, width = shape
    way = words[4]
    mirrored, upside_down = way & 1 != 0, way & 2 != 0
    swapped = (way & 4 != 0) & (height == width)
    rows = jnp.clip(np.arange(height, dtype=np.int32) + down, 0, height - 1)
    columns = jnp.clip(np.arange(width, dtype=np.int32) + right, 0, width - 1)
    change = _copying(
        _block(words, shape),
        jnp.where(upside_down, height - 1 - rows, rows),
        jnp.where(mirrored, width - 1 - columns, columns),
        shape,
    )
    return change._replace(upside_down=upside_down, mirrored=mirrored, swapped=swapped, foreign=_YES)


_YES = np.ones((), bool)


def _places(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[0])[:, None], np.arange(shape[1])[None]


def _block(words: Array, shape: tuple[int, int]) -> _Sides:
    """North, south, west and east of a random block: two rows and two columns, each drawn alone, in order.

    One time in eight a side is at the grid's edge instead: half a network, turned or mirrored, makes a whole one.
    """
    one, other = below(words[:2], shape[0]), below(words[2:4], shape[1])
    north, south, west, east = words[:4] & 7 == 0
    return (
        jnp.where(north, 0, one.min()),
        jnp.where(south, shape[0] - 1, one.max()),
        jnp.where(west, 0, other.min()),
        jnp.where(east, shape[1] - 1, other.max()),
    )


def _stretch(words: Array, shape: tuple[int, int]) -> tuple[Array, _Sides]:
    """Whether a random stretch runs east, and its sides."""
    height, width = shape
    east = words[0] & 1 == 0
    line = below(words[1], jnp.where(east, height, width))
    ends = below(words[2:4], jnp.where(east, width, height))
    low, high = ends.min(), ends.max()
    sides = (jnp.where(east, line, low), jnp.where(east, line, high))
    return east, (*sides, jnp.where(east, low, line), jnp.where(east, high, line))
