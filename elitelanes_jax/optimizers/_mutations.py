"""Mutations: one grid in, one grid and its dirty mask out (paper, section "Mutation Operators").

A `Move` changes a few tiles and marks them dirty. The result need not fit together: `repair` lets the dirty tiles
decide over their neighbours. A move takes its randomness as random bits, so that a whole generation's moves cost a
single draw, and a move is a plain function that can be replayed.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Int8, Real, UInt32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.codes import CROSSINGS


class Variation(NamedTuple):
    """The result of a move.

    Attributes:
      grid: int8 ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that were changed.
    """

    grid: Int8[Array, "H W"]
    dirty: Bool[Array, "H W"]


class Move(NamedTuple):
    """A random change of a grid.

    Attributes:
      bits: int, how many uint32 of random bits it takes.
      apply: (uint32 ``[bits]``, int8 ``[H, W]``, another such grid or None) -> `Variation`. The second grid, the mate,
        is for moves that copy a part of it; without one they copy from the first.
    """

    bits: int
    apply: Callable[..., Variation]


def change_tile(alphabet: tuple[int, ...]) -> Move:
    """Makes one random tile another code of the alphabet, each other code equally likely."""
    codes = jnp.array(alphabet, jnp.int8)
    # The place of each code in the alphabet; a code outside it stands behind the last.
    place = jnp.array([alphabet.index(code) if code in alphabet else len(alphabet) for code in range(16)])

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(bits, grid)
        own = place[jnp.max(jnp.where(dirty, grid, 0))]
        others = len(alphabet) - (own < len(alphabet))
        choice = randint(bits[2], jnp.maximum(others, 1))
        code = codes[jnp.minimum(choice + (choice >= own), len(alphabet) - 1)]
        return Variation(jnp.where(dirty, code, grid), dirty)

    return Move(3, apply)


def insert_crossing(alphabet: tuple[int, ...]) -> Move:
    """Makes one random tile a crossing of the alphabet, each equally likely, perhaps the same again.

    Raises:
      InputError: if the alphabet has no crossing.
    """
    crossings = jnp.array([code for code in alphabet if code in CROSSINGS], jnp.int8)
    if not crossings.size:
        raise InputError(f"alphabet: expected at least one crossing among {CROSSINGS}, got {alphabet}")

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(bits, grid)
        return Variation(jnp.where(dirty, crossings[randint(bits[2], crossings.size)], grid), dirty)

    return Move(3, apply)


def with_probability(probability: Real[ArrayLike, ""], move: Move) -> Move:
    """Makes a move with the given probability, else leaves the grid as it is, no tile dirty."""

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        happens = bernoulli(bits[-1], probability)
        varied = move.apply(bits[:-1], grid, mate)
        return Variation(jnp.where(happens, varied.grid, grid), varied.dirty & happens)

    return Move(move.bits + 1, apply)


def compose(*moves: Move) -> Move:
    """Makes all the moves one after another; the tiles of all of them are dirty."""

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty, used = jnp.zeros(grid.shape, bool), 0
        for move in moves:
            grid, changed = move.apply(bits[used : used + move.bits], grid, mate)
            dirty, used = dirty | changed, used + move.bits
        return Variation(grid, dirty)

    return Move(sum(move.bits for move in moves), apply)


def paper_mutation(
    alphabet: tuple[int, ...],
    tile_rate: Real[ArrayLike, ""] = 0.7,
    crossing_rate: Real[ArrayLike, ""] = 0.5,
) -> Move:
    """Returns the paper's two mutations, each with its probability (table "Algorithm-specific parameters").

    The "mutation rate 0.3" of the paper's base configuration has no role that could be identified: taken as a
    probability per tile it fits the paper's results worst, and nothing here uses it.
    """
    return compose(
        with_probability(tile_rate, change_tile(alphabet)),
        with_probability(crossing_rate, insert_crossing(alphabet)),
    )


def _one_tile(bits: UInt32[Array, " bits"], grid: Int8[Array, "H W"]) -> Bool[Array, "H W"]:
    height, width = grid.shape
    row, column = randint(bits[0], height), randint(bits[1], width)
    return (jnp.arange(height)[:, None] == row) & (jnp.arange(width) == column)
