"""Mutations: one grid in, one grid and its dirty mask out (paper, section "Mutation Operators").

A `Move` changes a few tiles and marks them dirty. Its result need not fit together: `repair` lets the dirty
tiles dictate to their neighbours. What is random about a move comes to it as words of random bits, so that a
whole generation's moves cost a single draw, and a move is a plain function that can be replayed.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from chex import Array, Numeric

from elitelanes_jax.codes import CROSSINGS
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError

__all__ = [
    "Move",
    "Variation",
    "change_tile",
    "in_turn",
    "insert_crossing",
    "paper_mutation",
    "sometimes",
]


class Variation(NamedTuple):
    """What a move returns.

    Attributes:
      grid: int8 ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that were changed.
    """

    grid: Array
    dirty: Array


class Move(NamedTuple):
    """A random change of a grid.

    Attributes:
      words: int, how many random words it uses.
      apply: (uint32 ``[words]``, int8 ``[H, W]``, another such grid or None) -> `Variation`. The second grid, a mate,
        is for moves that take a part of it; without one they take it of the first.
    """

    words: int
    apply: Callable[..., Variation]


def change_tile(alphabet: tuple[int, ...]) -> Move:
    """One random tile becomes another code of the alphabet, each other code equally likely."""
    codes = jnp.array(alphabet, jnp.int8)
    # The place of each code in the alphabet; what is not in it stands behind the last.
    place = jnp.array([alphabet.index(code) if code in alphabet else len(alphabet) for code in range(16)])

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(words, grid)
        own = place[jnp.max(jnp.where(dirty, grid, 0))]
        others = len(alphabet) - (own < len(alphabet))
        choice = below(words[2], jnp.maximum(others, 1))
        code = codes[jnp.minimum(choice + (choice >= own), len(alphabet) - 1)]
        return Variation(jnp.where(dirty, code, grid), dirty)

    return Move(3, apply)


def insert_crossing(alphabet: tuple[int, ...]) -> Move:
    """One random tile becomes a crossing of the alphabet, each equally likely, perhaps the same again.

    Raises:
      InputError: if the alphabet has no crossing.
    """
    crossings = jnp.array([code for code in alphabet if code in CROSSINGS], jnp.int8)
    if not crossings.size:
        raise InputError(f"alphabet: expected at least one crossing among {CROSSINGS}, got {alphabet}")

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(words, grid)
        return Variation(jnp.where(dirty, crossings[below(words[2], crossings.size)], grid), dirty)

    return Move(3, apply)


def sometimes(probability: Numeric, move: Move) -> Move:
    """The move with the given probability, else the grid as it was and no tile dirty."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        happens = chance(words[-1], probability)
        varied = move.apply(words[:-1], grid, mate)
        return Variation(jnp.where(happens, varied.grid, grid), varied.dirty & happens)

    return Move(move.words + 1, apply)


def in_turn(*moves: Move) -> Move:
    """All the moves one after another, with the tiles of all of them dirty."""

    def apply(words: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty, used = jnp.zeros(grid.shape, bool), 0
        for move in moves:
            grid, changed = move.apply(words[used : used + move.words], grid, mate)
            dirty, used = dirty | changed, used + move.words
        return Variation(grid, dirty)

    return Move(sum(move.words for move in moves), apply)


def paper_mutation(alphabet: tuple[int, ...], tile_rate: Numeric = 0.7, crossing_rate: Numeric = 0.5) -> Move:
    """The paper's two mutations, each with its probability (table "Algorithm-specific parameters").

    The "mutation rate 0.3" of the paper's base configuration has no role in it that could be identified: taken as a
    probability per tile it fits the paper's results worst, and nothing here uses it.
    """
    return in_turn(sometimes(tile_rate, change_tile(alphabet)), sometimes(crossing_rate, insert_crossing(alphabet)))


def _one_tile(words: Array, grid: Array) -> Array:
    height, width = grid.shape
    return (jnp.arange(height)[:, None] == below(words[0], height)) & (jnp.arange(width) == below(words[1], width))
