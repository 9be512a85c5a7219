"""The cycles of annealed chains that pursue niches.

A cycle of a chain has a goal, a start and mates. Half of the chains are isolated. They form groups,
and a group knows only the elites that it found.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real, UInt32

from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.xla import take
from elitelanes_jax.optimizers._emitters import Niches, draw_goal, nearest_elite
from elitelanes_jax.problem.archive import Population, insert
from elitelanes_jax.problem.problem import Problem

GROUPS = 4
"""The number of groups of isolated chains, measured in experiments/search/moves.md."""

# The number of random niches from which the elite nearest to the goal becomes the mate, measured in
# experiments/search/moves.md.
_TOURNAMENT = 8


class CycleBits(NamedTuple):
    """The random bits of C chains in a step that choose goals, starts and mates."""

    goal: UInt32[Array, "*C 2"]
    restart: UInt32[Array, "*C"]
    elite_mate: UInt32[Array, "*C"]
    rivals: UInt32[Array, "*C T"]

    @staticmethod
    def of(bits: UInt32[Array, "C B"]) -> "CycleBits":
        return CycleBits(bits[:, :2], bits[:, 2], bits[:, 3], bits[:, 4:])


CYCLE_BITS = 4 + _TOURNAMENT
"""The number of random numbers in `CycleBits` for each chain."""


class Cycle(NamedTuple):
    """The cycles of C chains.

    Attributes:
      goal: the bins of the niche that the cycle pursues.
      restarts: whether the cycle starts from a random grid.
      start: the index of the elite that any other cycle starts from.
      penalty: the fitness that each bin of distance from the goal adds.
    """

    goal: Int32[Array, "*C D"]
    restarts: Bool[Array, "*C"]
    start: Int32[Array, "*C"]
    penalty: Int32[Array, "*C"]

    @staticmethod
    def none(chains: int, axes: int) -> "Cycle":
        """Returns the cycles of chains before their first one."""
        zero = jnp.zeros(chains, jnp.int32)
        return Cycle(jnp.zeros((chains, axes), jnp.int32), jnp.zeros(chains, bool), zero, zero)


class Groups(NamedTuple):
    """The archives of the groups of isolated chains, then the archive of all chains; static.

    The archives are end to end in one array.

    Attributes:
      niches: the N niches of each archive.
      isolated: whether each chain is isolated, as the first half of them are.
      first: the index at which the archive that each chain knows begins.
      last: the index at which the archive of all chains, the last one, begins.
      accept_equal: whether a grid replaces an elite of equal fitness.
    """

    niches: Niches
    isolated: Bool[np.ndarray, " C"]
    first: Int32[np.ndarray, " C"]
    last: int
    accept_equal: bool

    @staticmethod
    def of(problem: Problem, chains: int, accept_equal: bool) -> "Groups":
        size = problem.niches
        # The first half of the chains is divided into the groups. All others know the archive of
        # all chains, which comes after the archives of the groups.
        group = (np.arange(chains) * 2 * GROUPS // chains).clip(max=GROUPS)
        first = (group * size).astype(np.int32)
        return Groups(Niches.of(problem.axes), group < GROUPS, first, GROUPS * size, accept_equal)

    def insert(
        self, archives: Population, niche: Int32[Array, " C"], grids: Population
    ) -> Population:
        """Offers each chain's grid to two archives.

        One is the archive that the chain knows, the other is the archive of all chains.
        """
        indices = jnp.stack([niche + self.first, niche + self.last])
        return insert(archives, indices, grids, accept_equal=self.accept_equal)

    def archive_of_all(self, archives: Population) -> Population:
        """Returns the archive of all chains."""
        return jax.tree.map(lambda array: array[self.last :], archives)

    def draw_cycles(
        self,
        bits: CycleBits,
        fitness: Real[Array, " A"],
        filled: Bool[Array, " A"],
        *,
        restart: Real[ArrayLike, ""],
        vacant_probability: Real[ArrayLike, ""],
        bin_penalty: Int[ArrayLike, ""],
        draw_penalty: bool,
    ) -> Cycle:
        """Draws the next cycle of each chain.

        `fitness` and `filled` are those of all archives; niches that are not filled count as
        vacant. `restart`, `vacant_probability` and `bin_penalty` are those of
        `AnnealedMapElitesConfig`. The penalty of each cycle is drawn below `bin_penalty`, or is
        `bin_penalty`.
        """
        niches = self.niches

        def draw(
            bits: CycleBits, first: Array, isolated: Array, fitness: Array, filled: Array
        ) -> Cycle:
            # A chain sees one archive, that of its group or that of all chains.
            known_fitness = jax.lax.dynamic_slice_in_dim(fitness, first, len(niches.bins))
            known_filled = jax.lax.dynamic_slice_in_dim(filled, first, len(niches.bins))
            restarts = isolated & bernoulli(bits.restart, restart)
            goal = draw_goal(niches, bits.goal, known_filled, vacant_probability)
            penalty = jnp.asarray(bin_penalty, jnp.int32)
            if draw_penalty:
                # A chain that begins a cycle makes no move, so the bits that choose its mate have
                # no other use.
                penalty = randint(bits.elite_mate, penalty)
            nearest = nearest_elite(known_fitness, niches.bins, goal, penalty)
            return Cycle(goal, restarts, first + nearest, penalty)

        first, isolated = jnp.asarray(self.first), jnp.asarray(self.isolated)
        return jax.vmap(draw, (0, 0, 0, None, None))(bits, first, isolated, fitness, filled)

    def draw_mates(
        self,
        bits: CycleBits,
        cycle: Cycle,
        archives: Population,
        otherwise: Int8[Array, "C H W"],
        *,
        elite_mate: Real[ArrayLike, ""],
    ) -> Int8[Array, "C H W"]:
        """Draws a mate for each chain: the elite nearest to its goal among a few random niches.

        With probability 1 - `elite_mate`, and where these niches are vacant, the chain gets the
        mate in `otherwise`.
        """
        # Vacant niches rank last, so the mate is vacant only if all drawn niches are.
        rivals = randint(bits.rivals, len(self.niches.bins))
        fitness = take(archives.fitness, rivals + self.first[:, None])
        bins = take(self.niches.bins, rivals)
        nearest = nearest_elite(fitness, bins, cycle.goal, cycle.penalty[:, None, None])
        mate = self.first + jnp.take_along_axis(rivals, nearest[:, None], axis=1)[:, 0]
        is_elite = bernoulli(bits.elite_mate, elite_mate) & take(archives.valid, mate)
        return jnp.where(is_elite[:, None, None], take(archives.grids, mate), otherwise)
