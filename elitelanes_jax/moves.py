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

from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError
from elitelanes_jax.repairs import repair
from elitelanes_jax.variation import Move, Variation, drawn_by_share, one_of

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
    straight: int = 5
    clear: int = 1
    mirrored: int = 2
    slide: int = 1
    transplant: int = 8
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
        toggle_link(): mix.link,
        toggle_corner(): mix.corner,
        toggle_outline(): mix.outline,
        toggle_street(): mix.street,
        lay_straight(): mix.straight,
        clear_block(): mix.clear,
    }
    copies = {
        _mirrored: mix.mirrored,
        _slid: mix.slide,
        _transplanted: mix.transplant,
        _displaced: mix.displaced,
    }
    if any(copies.values()):  # all together, as fetching tiles is what takes time: it is done once
        shares[_copying({plan: share for plan, share in copies.items() if share})] = sum(copies.values())
    move = one_of({move: share for move, share in shares.items() if share})
    return move if fill else completed(mix.completed, move, kept=kept)


def toggle_link() -> Move:
    """Makes or cuts the link between two neighbouring tiles."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        height, width = grid.shape
        rows, columns = _places(grid.shape)
        across = height * (width - 1)
        drawn = below(words[0], across + (height - 1) * width)
        east = drawn < across
        number = jnp.where(east, drawn, drawn - across)
        length = jnp.where(east, width - 1, width)
        row, column = number // length, number % length
        first = (rows == row) & (columns == column)
        second = (rows == row + ~east) & (columns == column + east)
        links = jnp.where(first, jnp.where(east, EAST, SOUTH), jnp.where(second, jnp.where(east, WEST, NORTH), 0))
        return _toggled(grid, links)

    return Move(1, apply)


def toggle_corner() -> Move:
    """Toggles the four links around a point where four tiles meet: the smallest loop."""
    return Move(2, lambda words, grid, mate=None: _outline(grid, *_corner(words, grid.shape)))


def toggle_outline() -> Move:
    """Toggles the links along the outline of a rectangle of at least 2 x 2 tiles, each height and width alike often."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        height, width = grid.shape
        down, across = 1 + below(words[0], height - 1), 1 + below(words[1], width - 1)
        north, west = below(words[2], height - down), below(words[3], width - across)
        return _outline(grid, north, north + down, west, west + across)

    return Move(4, apply)


def toggle_street() -> Move:
    """Toggles the links along a stretch of a row or a column."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        east, (north, south, west, to_east) = _stretch(words, grid.shape)
        rows, columns = _places(grid.shape)
        on = _within(grid.shape, north, south, west, to_east)
        along = jnp.where(columns < to_east, EAST, 0) | jnp.where(columns > west, WEST, 0)
        down = jnp.where(rows < south, SOUTH, 0) | jnp.where(rows > north, NORTH, 0)
        return _toggled(grid, jnp.where(on, jnp.where(east, along, down), 0))

    return Move(4, apply)


def lay_straight() -> Move:
    """Lays straight tiles along a stretch of a row or a column, whatever was there."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        east, stretch = _stretch(words, grid.shape)
        on = _within(grid.shape, *stretch)
        return Variation(jnp.where(on, jnp.where(east, EAST | WEST, NORTH | SOUTH).astype(jnp.int8), grid), on)

    return Move(4, apply)


def clear_block() -> Move:
    """Empties a block of tiles."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        block = _within(grid.shape, *_block(words, grid.shape))
        return Variation(jnp.where(block, jnp.int8(0), grid), block)

    return Move(4, apply)


def mirror_block() -> Move:
    """Mirrors a block of tiles in its place, east to west or north to south."""
    return _copying({_mirrored: 1})


def slide_lines() -> Move:
    """Slides the rows between two rows, or the columns between two columns, by one: the last comes first, or back."""
    return _copying({_slid: 1})


def transplant(*, displaced: bool = False) -> Move:
    """Sets in a block of the mate, which is first turned or mirrored: as it is, or any of the other seven ways.

    Grids that are not square are turned by half turns only.

    Args:
      displaced: whether the block comes from another place in the same rows or in the same columns.
    """
    return _copying({_displaced if displaced else _transplanted: 1})


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


class _Copy(NamedTuple):
    """Which tiles come from where.

    Attributes:
      sides: north, south, west and east of the block that is written.
      rows: int32 ``[H]``, the row that each row's tiles come from.
      columns: int32 ``[W]``, likewise.
      upside_down: bool, whether tiles are mirrored north to south.
      mirrored: bool, whether they are mirrored east to west.
      swapped: bool, whether rows and columns of the source are swapped first.
      foreign: bool, whether they come from the mate.
    """

    sides: Array
    rows: Array
    columns: Array
    upside_down: Array
    mirrored: Array
    swapped: Array
    foreign: Array


_COPY_WORDS = 7

_Plan = Callable[[Array, tuple[int, int]], _Copy]


def _copying(shares: dict[_Plan, int]) -> Move:
    """A move that copies tiles by one of the plans, each in proportion to its share."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        copies = [plan(words[1:], grid.shape) for plan in shares]
        copy = drawn_by_share(words[0], copies, list(shares.values()))
        return _copied(copy, grid, grid if mate is None else mate)

    return Move(1 + _COPY_WORDS, apply)


def _copied(copy: _Copy, grid: Array, mate: Array) -> Variation:
    width = grid.shape[1]
    source = jnp.where(copy.foreign, mate, grid).reshape(-1)
    rows, columns = copy.rows[:, None], copy.columns[None]
    tiles = source[jnp.where(copy.swapped, columns * width + rows, rows * width + columns)]
    # Swapping rows and columns swaps north with west and south with east.
    tiles = jnp.where(copy.swapped, (tiles & 8) >> 3 | (tiles & 1) << 3 | (tiles & 4) >> 1 | (tiles & 2) << 1, tiles)
    tiles = jnp.where(copy.mirrored, tiles & 10 | (tiles & 4) >> 2 | (tiles & 1) << 2, tiles)
    tiles = jnp.where(copy.upside_down, tiles & 5 | (tiles & 8) >> 2 | (tiles & 2) << 2, tiles)
    block = _within(grid.shape, *copy.sides)
    return Variation(jnp.where(block, tiles, grid), block)


def _mirrored(words: Array, shape: tuple[int, int]) -> _Copy:
    sides = _block(words, shape)
    across = words[4] & 1 == 0
    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    north, south, west, east = sides
    return _Copy(
        sides,
        jnp.where(across, rows, jnp.clip(north + south - rows, 0, shape[0] - 1)),
        jnp.where(across, jnp.clip(west + east - columns, 0, shape[1] - 1), columns),
        upside_down=~across,
        mirrored=across,
        swapped=_NO,
        foreign=_NO,
    )


def _slid(words: Array, shape: tuple[int, int]) -> _Copy:
    by_rows, back = words[4] & 1 == 0, words[4] & 2 == 0
    north, south, west, east = _block(words, shape)

    def moved(length: int, first: Array, last: Array) -> Array:
        places = np.arange(length, dtype=np.int32)
        step = places + jnp.where(back, -1, 1)
        return jnp.clip(jnp.where(step < first, last, jnp.where(step > last, first, step)), 0, length - 1)

    rows, columns = (np.arange(side, dtype=np.int32) for side in shape)
    ends = (north, south, jnp.int32(0), jnp.int32(shape[1] - 1)), (jnp.int32(0), jnp.int32(shape[0] - 1), west, east)
    return _Copy(
        tuple(jnp.where(by_rows, one, other) for one, other in zip(*ends, strict=True)),
        jnp.where(by_rows, moved(shape[0], north, south), rows),
        jnp.where(by_rows, columns, moved(shape[1], west, east)),
        upside_down=_NO,
        mirrored=_NO,
        swapped=_NO,
        foreign=_NO,
    )


def _transplanted(words: Array, shape: tuple[int, int]) -> _Copy:
    return _from_mate(words, shape, jnp.int32(0), jnp.int32(0))


def _displaced(words: Array, shape: tuple[int, int]) -> _Copy:
    north, south, west, east = _block(words, shape)
    same_columns = words[4] & 8 == 0
    down = below(words[5], shape[0] - (south - north)) - north
    right = below(words[6], shape[1] - (east - west)) - west
    return _from_mate(words, shape, jnp.where(same_columns, down, 0), jnp.where(same_columns, 0, right))


def _from_mate(words: Array, shape: tuple[int, int], down: Array, right: Array) -> _Copy:
    """A block of the mate, as many tiles farther down and right there, turned or mirrored one of eight ways."""
    height, width = shape
    way = words[4]
    mirrored, upside_down = way & 1 != 0, way & 2 != 0
    swapped = (way & 4 != 0) & (height == width)
    rows = jnp.clip(np.arange(height, dtype=np.int32) + down, 0, height - 1)
    columns = jnp.clip(np.arange(width, dtype=np.int32) + right, 0, width - 1)
    return _Copy(
        _block(words, shape),
        jnp.where(upside_down, height - 1 - rows, rows),
        jnp.where(mirrored, width - 1 - columns, columns),
        upside_down=upside_down,
        mirrored=mirrored,
        swapped=swapped,
        foreign=~_NO,
    )


_NO = np.zeros((), bool)


def _places(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    return np.arange(shape[0])[:, None], np.arange(shape[1])[None]


def _within(shape: tuple[int, int], north: Array, south: Array, west: Array, east: Array) -> Array:
    """The tiles from one row and column to another, both included."""
    rows, columns = _places(shape)
    return (rows >= north) & (rows <= south) & (columns >= west) & (columns <= east)


def _block(words: Array, shape: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
    """North, south, west and east of a random block: two rows and two columns, each drawn alone, in order."""
    one, other = below(words[:2], shape[0]), below(words[2:4], shape[1])
    return one.min(), one.max(), other.min(), other.max()


def _stretch(words: Array, shape: tuple[int, int]) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Whether a random stretch runs east, and its sides."""
    height, width = shape
    east = words[0] & 1 == 0
    line = below(words[1], jnp.where(east, height, width))
    ends = below(words[2:4], jnp.where(east, width, height))
    low, high = ends.min(), ends.max()
    sides = (jnp.where(east, line, low), jnp.where(east, line, high))
    return east, (*sides, jnp.where(east, low, line), jnp.where(east, high, line))


def _corner(words: Array, shape: tuple[int, int]) -> tuple[Array, Array, Array, Array]:
    north, west = below(words[0], shape[0] - 1), below(words[1], shape[1] - 1)
    return north, north + 1, west, west + 1


def _outline(grid: Array, north: Array, south: Array, west: Array, east: Array) -> Variation:
    rows, columns = _places(grid.shape)
    inside = _within(grid.shape, north, south, west, east)
    along = inside & ((rows == north) | (rows == south))
    upright = inside & ((columns == west) | (columns == east))
    links = jnp.where(along & (columns < east), EAST, 0) | jnp.where(along & (columns > west), WEST, 0)
    links = links | jnp.where(upright & (rows < south), SOUTH, 0) | jnp.where(upright & (rows > north), NORTH, 0)
    return _toggled(grid, links)


def _toggled(grid: Array, links: Array) -> Variation:
    return Variation(grid ^ links.astype(jnp.int8), links != 0)
