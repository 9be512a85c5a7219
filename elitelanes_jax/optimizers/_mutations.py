"""Mutations: functions from a grid to a changed grid and its dirty mask.

The mutations are those of the paper's section "Mutation Operators". A `Move` changes a few tiles
and marks them dirty. Neighbouring tiles need not match afterwards: `repair` lets the dirty tiles
decide over their neighbours. A move takes its randomness as random bits. One draw then serves a
whole generation, and a move is a plain function that can be repeated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int8, Real, UInt32

from elitelanes_jax._util.checks import function, whole
from elitelanes_jax._util.records import REQUIRED, Record, option
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.codes import CROSSINGS
from elitelanes_jax.network.xla import materialize


class Variation(NamedTuple):
    """The result of a move.

    Attributes:
      grid: int8 ``[H, W]``.
      dirty: bool ``[H, W]``, the tiles that were changed.
    """

    grid: Int8[Array, "H W"]
    dirty: Bool[Array, "H W"]


def materialize_variation(varied: Variation) -> Variation:
    """Returns an unchanged variation that XLA computes once and stores, see `materialize`."""
    both = materialize(varied.grid.astype(jnp.int8) | varied.dirty.astype(jnp.int8) << 4)
    return Variation(both & 15, both > 15)


@jax.tree_util.register_static
@dataclass(frozen=True, repr=False)
class Move(Record):
    """A random change of a grid.

    Attributes:
      bits: int, the number of uint32 random numbers that it takes.
      apply: (bits uint32 ``[bits]``, grid int8 ``[H, W]``, mate int8 ``[H, W]`` or None) ->
        `Variation`. A move may copy a part of the mate; without a mate it copies from the grid.
    """

    bits: int = option(REQUIRED, whole(0))
    apply: Callable[..., Variation] = option(REQUIRED, function)

    def __repr__(self) -> str:
        """Returns a text without the function's address, which differs in every process."""
        return f"Move({self.bits} bits)"


# The bits that `_one_tile` uses: one for the row and one for the column.
_TILE_BITS = 2


def change_tile(alphabet: tuple[int, ...]) -> Move:
    """Changes one random tile to another code of the alphabet, each equally likely."""
    codes = jnp.array(alphabet, jnp.int8)
    # The index of each code in the alphabet. A code outside the alphabet has the index after the
    # last.
    index = jnp.array(
        [alphabet.index(code) if code in alphabet else len(alphabet) for code in range(16)]
    )

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(bits, grid)
        # The new code is drawn among the others: the drawn index skips that of the present code.
        before = index[jnp.max(jnp.where(dirty, grid, 0))]
        others = len(alphabet) - (before < len(alphabet)).astype(jnp.int32)
        # An alphabet of one code has no others. Both limits make the draw return this code.
        choice = randint(bits[_TILE_BITS], jnp.maximum(others, 1))
        code = codes[jnp.minimum(choice + (choice >= before).astype(jnp.int32), len(alphabet) - 1)]
        return Variation(jnp.where(dirty, code, grid), dirty)

    return Move(_TILE_BITS + 1, apply)


def insert_crossing(alphabet: tuple[int, ...]) -> Move:
    """Changes one random tile to a crossing of the alphabet, each equally likely.

    The tile stays the same if the drawn crossing is its code.
    """
    crossings = jnp.array([code for code in alphabet if code in CROSSINGS], jnp.int8)

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = _one_tile(bits, grid)
        return Variation(
            jnp.where(dirty, crossings[randint(bits[_TILE_BITS], crossings.size)], grid), dirty
        )

    return Move(_TILE_BITS + 1, apply)


def paper_mutation(
    alphabet: tuple[int, ...],
    tile_rate: Real[ArrayLike, ""] = 0.7,
    crossing_rate: Real[ArrayLike, ""] = 0.5,
) -> Move:
    """Makes the paper's two mutations in turn, each with its probability.

    The probabilities are those of the paper's table "Algorithm-specific parameters". For an
    alphabet without crossings, returns the first one alone. The paper's base configuration also has
    a "mutation rate 0.3", which is not used because its role is unclear: as a probability per tile
    it fits the paper's results worst.
    """
    mutations = [(change_tile(alphabet), tile_rate)]
    if set(alphabet) & set(CROSSINGS):
        mutations.append((insert_crossing(alphabet), crossing_rate))

    def apply(bits: Array, grid: Array, mate: Array | None = None) -> Variation:
        dirty = jnp.zeros(grid.shape, bool)
        first = 0
        # A mutation is computed even if it does not happen. A branch would save nothing, because
        # under `jax.vmap` JAX computes every branch.
        for mutation, rate in mutations:
            last = first + mutation.bits
            varied = mutation.apply(bits[first:last], grid)
            happens = bernoulli(bits[last], rate)
            grid = jnp.where(happens, varied.grid, grid)
            dirty = dirty | varied.dirty & happens
            first = last + 1
        return Variation(grid, dirty)

    return Move(sum(mutation.bits + 1 for mutation, _ in mutations), apply)


def _one_tile(bits: UInt32[Array, " bits"], grid: Int8[Array, "H W"]) -> Bool[Array, "H W"]:
    height, width = grid.shape
    row, column = randint(bits[0], height), randint(bits[1], width)
    return (np.arange(height)[:, None] == row) & (np.arange(width)[None] == column)
