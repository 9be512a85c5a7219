"""The tuned MAP-Elites: annealed chains, each of which pursues one niche, its goal, for one cycle.

A penalty grows with the distance from the goal. Each cycle draws how fast: some hardly leave the
goal, and some follow the best fitness. A cycle starts from the elite with the lowest penalised
fitness, or from a random grid, and copies parts of other elites. Every evaluated grid is offered to
the archive.

Elites descend from each other, so an archive soon holds one family of networks and loses the
stepping stones to the other niches. Half of the chains are therefore isolated. They form groups,
and a group knows only the elites that it found. Some of their cycles restart from random grids.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import flag, none_or, real, whole
from elitelanes_jax._util.records import Record, nested, static, traced
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import split
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.growth import SMALLEST_GROWN, grow_town
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.xla import run_if, take
from elitelanes_jax.optimizers._annealing import (
    LONGEST_CYCLE,
    SMALL,
    AnnealingConfig,
    Cooling,
    StepBits,
    island_mates,
    metropolis_accepts,
    problem_move,
    random_grid,
    usual_cycle,
)
from elitelanes_jax.optimizers._cycles import CYCLE_BITS, GROUPS, Cycle, CycleBits, Groups
from elitelanes_jax.optimizers._emitters import penalise_distance
from elitelanes_jax.optimizers._moves import with_symmetric_copy
from elitelanes_jax.optimizers._mutations import Move, Variation, materialize_variation
from elitelanes_jax.optimizers._population import concatenate, evaluate, select, unevaluated
from elitelanes_jax.optimizers._strips import refit_strip
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.descriptor import niche_bins
from elitelanes_jax.problem.problem import Problem

# The weight of `refit` on small grids, measured in experiments/search/moves.md.
_REFIT = 25


@pytree
@dataclass(frozen=True)
class AnnealedMapElitesConfig(Record):
    """Options of the tuned MAP-Elites; the defaults are the preset `tuned`.

    A pytree: `jax.vmap` may map over the numbers that are not static.

    Attributes:
      annealing: options of the chains; each is an island of its own. Cycles do not grow; their
        default length is 1/32 of the tuned EA's first cycle.
      bin_penalty: the most fitness that each bin of distance from the goal adds. Each cycle draws
        its own penalty below this, all equally likely.
      restart: probability that a cycle of an isolated chain starts from a random grid.
      restart_length: the length of a restarted cycle, in usual cycles. Usual cycles become shorter
        if a restarted one would exceed 2**22 steps.
      vacant_probability: probability that the goal is a vacant niche, if one is reachable.
      elite_mate: probability that a mate is an elite.
      symmetric_probability: probability that a move is also made symmetrically in a cycle from an
        elite, see `with_symmetric_copy`.
      strips: whether half of the moves are `refit_strip` instead of moves drawn by weight; static.
      initial_towns_from: the least number of cells with which the chains start from grown towns
        instead of random grids; None for never; static. On 24 x 24 tiles the moves do not lead from
        random grids to networks without violations.
      accept_equal: whether a grid replaces an elite of equal fitness; static. Many towns have equal
        fitness. Without this, elites would hardly change, and cycles would start from the same
        elites.
      require_feasible: whether a niche counts as vacant until its elite has no penalty, and each
        cycle has the whole `bin_penalty`; static. Without this, cycles seldom pursue niches with
        infeasible elites.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig(chains=1, hottest=40, coldest=12))
    bin_penalty: Int[ArrayLike, "..."] = traced(400, whole(1, 10_000))
    restart: Real[ArrayLike, "..."] = traced(0.1, real(0, 1))
    restart_length: Int[ArrayLike, "..."] = traced(16, whole(1, LONGEST_CYCLE))
    vacant_probability: Real[ArrayLike, "..."] = traced(0.1, real(0, 1))
    elite_mate: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    symmetric_probability: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    strips: bool = static(True, flag)
    initial_towns_from: int | None = static(None, none_or(whole(1)))
    accept_equal: bool = static(False, flag)
    require_feasible: bool = static(False, flag)


class AnnealedMapElitesState(NamedTuple):
    """The state of all chains.

    Attributes:
      chains: the current grids.
      cycles: the current cycles.
      archives: one archive for each group of isolated chains, then the archive of all chains, end
        to end.
      cooling: arrays ``[C]``, the step of each chain within its cycle; -1 while no grid is
        evaluated.
    """

    chains: Population
    cycles: Cycle
    archives: Population
    cooling: Cooling


@name_wrong_arguments
@runs_jax
def annealed_map_elites(
    problem: Problem, config: AnnealedMapElitesConfig = AnnealedMapElitesConfig()
) -> Optimizer:
    """Makes MAP-Elites whose chains pursue niches; its elites are the archive of all chains.

    The problem has at least one axis; otherwise `InputError` is raised. Niches outside an axis'
    target bin are stepping stones. The default configuration is the preset `tuned`.
    """
    check_arguments(problem, config, AnnealedMapElitesConfig)
    method = _Method(problem, config)
    return Optimizer.of(
        method.init,
        method.step,
        method.elites,
        evaluations_per_step=method.count,
        init_unevaluated=method.init_unevaluated,
    )


class _Method:
    """The functions of the optimiser for one problem and one configuration."""

    def __init__(self, problem: Problem, config: AnnealedMapElitesConfig) -> None:
        self.problem, self.config = problem, config
        self.count = config.annealing.population
        self.groups = Groups.of(problem, self.count, config.accept_equal)
        # The length in steps of a cycle that starts from an elite.
        self.length = _usual_length(config, problem.shape)
        self.starts_from_towns = _starts_from_towns(config, problem.shape)
        self.drawn = problem.drawn(self.count)
        self.move = _random_move(problem, config)
        self.strip = _strip(problem) if config.strips else None

    def init_unevaluated(self, key: Array) -> AnnealedMapElitesState:
        grids = self._first_grids(key)
        chains = unevaluated(self.problem, grids)
        # The last archive is that of all chains.
        archives = self.problem.empty_archive(chains.fitness.dtype, copies=GROUPS + 1)
        zero = jnp.zeros(self.count, jnp.int32)
        cycles = Cycle.none(self.count, len(self.problem.axes))
        return AnnealedMapElitesState(
            chains, cycles, archives, Cooling(zero - 1, jnp.broadcast_to(self.length, self.count))
        )

    def init(self, key: Array) -> AnnealedMapElitesState:
        return self.step(key, self.init_unevaluated(key))[0]

    def step(
        self, key: Array, state: AnnealedMapElitesState
    ) -> tuple[AnnealedMapElitesState, Info]:
        # The number of bits is the same for every probability of a symmetric copy.
        bits = StepBits.draw(key, self.count, self._symmetric_move(0), extra=CYCLE_BITS)
        cycle_bits, begins = CycleBits.of(bits.extra), state.cooling.begins
        cycles, first_grids, cooling = self._begin_cycles(bits, cycle_bits, begins, state)
        mates = self._draw_mates(bits, cycle_bits, cycles, state)
        temperature = self._temperature(cooling)
        children = self._make_children(bits, temperature, begins, cycles, first_grids, mates, state)
        accepted = self._accepts(bits, temperature, cycles, state.chains, children)
        # A cycle begins with its first grid, whatever the grid's fitness.
        chains = select(begins | accepted, children, state.chains)
        # All children are offered to the archives, also those that their chains refuse.
        archives = self.groups.insert(
            state.archives, self.problem.niche(children.features), children
        )
        elites = self.groups.archive_of_all(archives)
        info = Info(
            elites.fitness.min(), elites.valid.sum(dtype=jnp.int32), count_refused(children)
        )
        return AnnealedMapElitesState(chains, cycles, archives, cooling.after(grows=False)), info

    def elites(self, state: AnnealedMapElitesState) -> Population:
        return self.groups.archive_of_all(state.archives)

    def _first_grids(self, key: Array) -> Int8[Array, "C H W"]:
        """Returns the grids that the chains start from.

        The problem's initial grids come first. Grown towns, or random grids that are not repaired,
        follow.
        """
        grids = self.problem.random_unrepaired(key, self.count)
        if not self.starts_from_towns:
            return grids
        towns = jax.vmap(lambda key: grow_town(key, self.problem.shape))(split(key, self.count))
        initial = np.count_nonzero(~self.drawn)
        return towns.at[:initial].set(grids[:initial])

    def _begin_cycles(
        self,
        bits: StepBits,
        cycle_bits: CycleBits,
        begins: Bool[Array, " C"],
        state: AnnealedMapElitesState,
    ) -> tuple[Cycle, Int8[Array, "C H W"], Cooling]:
        """Draws new cycles for the chains that begin one.

        Returns the cycles of all chains, the grids that the new ones start from, and the cooling.
        """
        config, problem = self.config, self.problem
        archives, cooling = state.archives, state.cooling

        def draw(pending: Array, before: tuple[Cycle, Array]) -> tuple[Cycle, Array]:
            # These arrays depend on the loop, because otherwise XLA computes all that follows
            # before the loop, in every step.
            fitness = jnp.where(pending, archives.fitness, 0)
            features = jnp.where(pending, archives.features, 0)
            fresh = jnp.where(pending, bits.fresh, 0)
            filled = archives._replace(fitness=fitness).valid
            if config.require_feasible:
                # A niche whose elite has a penalty counts as vacant, so that more cycles pursue it.
                penalties = problem.penalties(features)
                check_array("penalties", penalties, features.shape[:-1], jnp.int32)
                filled &= penalties == 0
            drawn = self.groups.draw_cycles(
                cycle_bits,
                fitness,
                filled,
                restart=config.restart,
                vacant_probability=config.vacant_probability,
                bin_penalty=config.bin_penalty,
                draw_penalty=not config.require_feasible,
            )
            cycles = select(begins, drawn, before[0])
            random = jax.vmap(partial(random_grid, problem))(fresh)
            return cycles, select(cycles.restarts, random, take(archives.grids, cycles.start))

        # Steps in which no chain begins a cycle skip these draws.
        cycles, first_grids = run_if(begins.any(), draw, (state.cycles, state.chains.grids))
        lengths = (self.length * jnp.where(cycles.restarts, config.restart_length, 1)).astype(
            jnp.int32
        )
        cooling = cooling._replace(length=jnp.where(begins, lengths, cooling.length))
        return cycles, first_grids, cooling

    def _draw_mates(
        self, bits: StepBits, cycle_bits: CycleBits, cycles: Cycle, state: AnnealedMapElitesState
    ) -> Int8[Array, "C H W"]:
        """Draws a mate for each chain.

        With probability `elite_mate` it is an elite near the chain's goal, otherwise a grid of its
        island.
        """
        each = self.config.annealing.chains_on(self.problem.shape)
        islanders = island_mates(bits.mate, state.chains.grids, each)
        return self.groups.draw_mates(
            cycle_bits, cycles, state.archives, islanders, elite_mate=self.config.elite_mate
        )

    def _temperature(self, cooling: Cooling) -> Int32[Array, " C"]:
        annealing = self.config.annealing
        return cooling.temperature(annealing.hottest, annealing.coldest, self.problem.shape)

    def _make_children(
        self,
        bits: StepBits,
        temperature: Int32[Array, " C"],
        begins: Bool[Array, " C"],
        cycles: Cycle,
        first_grids: Int8[Array, "C H W"],
        mates: Int8[Array, "C H W"],
        state: AnnealedMapElitesState,
    ) -> Population:
        """Varies, repairs and evaluates the grid of each chain.

        A chain that begins a cycle gets the first grid of the cycle instead of a varied one.
        """
        grids = state.chains.grids
        varied = self._vary(bits, temperature, cycles.restarts, grids, mates)
        # Grids that are not evaluated yet are their own children. They are accepted, because the
        # fitness of the chains is that of vacant slots.
        is_unevaluated = state.cooling.step < 0
        varied = Variation(
            select(is_unevaluated, grids, varied.grid),
            varied.dirty & ~is_unevaluated[:, None, None],
        )
        # Random grids are repaired in raster order, initial grids and grown towns are not.
        in_raster_order = self.drawn & (not self.starts_from_towns)
        raster = begins & cycles.restarts | is_unevaluated & in_raster_order
        repair = jax.vmap(self.problem.repair)
        repaired = repair(select(begins, first_grids, varied.grid), varied.dirty, raster=raster)
        return evaluate(self.problem, repaired)

    def _accepts(
        self,
        bits: StepBits,
        temperature: Int32[Array, " C"],
        cycles: Cycle,
        chains: Population,
        children: Population,
    ) -> Bool[Array, " C"]:
        """Returns which children replace the grid of their chain.

        Their fitness is the one that the chain pursues.
        """
        before = _pursued_fitness(self.problem, cycles, chains)
        after = _pursued_fitness(self.problem, cycles, children)
        return metropolis_accepts(bits.accept, temperature, before, after)

    def _symmetric_move(self, probability: Real[ArrayLike, ""]) -> Move:
        return with_symmetric_copy(probability, move=self.move)

    def _vary(
        self,
        bits: StepBits,
        temperature: Int32[Array, " C"],
        restarts: Bool[Array, " C"],
        grids: Int8[Array, "C H W"],
        mates: Int8[Array, "C H W"],
    ) -> Variation:
        """Makes a move from the grid of each chain.

        Half of the chains get a refitted strip, and the others a random move. Chains form pairs,
        and the colder chain of each pair makes the strip. So every step computes each kind of move
        for half of the chains. If each chain drew for itself, both kinds would be computed for all.
        """

        @jax.vmap
        def vary_at_random(bits: Array, restarts: Array, grid: Array, mate: Array) -> Variation:
            probability = jnp.where(restarts, 0, jnp.float32(self.config.symmetric_probability))
            return self._symmetric_move(probability).apply(bits, grid, mate)

        # The last chain of an odd number has no partner, and makes a random move.
        chains, half = (bits.move, restarts, grids, mates), len(grids) // 2
        if self.strip is None or not half:
            return vary_at_random(*chains)
        first, second, unpaired = _pairs(chains, half)
        first_temperature, second_temperature = temperature[:half], temperature[half : 2 * half]
        # Strips of the colder chains end at 75 of 208 certified optima at 8 x 8 B, those of chains
        # drawn at random at 63 (experiments/search/moves.md).
        colder = first_temperature < second_temperature
        tie = first_temperature == second_temperature
        # A tie is drawn from bits that a chain uses only when a cycle begins. Then it makes no
        # move.
        first_is_strip = colder | tie & (bits.fresh[:half] & 1 > 0)
        strip_bits, _, strip_grids, _ = select(first_is_strip, first, second)
        others = concatenate(select(first_is_strip, second, first), unpaired)
        # Both kinds are stored, because otherwise XLA computes them for each of their uses. A step
        # then takes 1.15 times as long.
        refitted = materialize_variation(
            jax.vmap(self.strip.apply)(strip_bits[:, : self.strip.bits], strip_grids)
        )
        random = materialize_variation(vary_at_random(*others))
        return jax.tree.map(partial(_unpair, first_is_strip), refitted, random)


def _usual_length(config: AnnealedMapElitesConfig, shape: tuple[int, int]) -> Int32[Array, ""]:
    """Returns the number of steps of a cycle that begins with an elite.

    A cycle that begins with a random grid is `restart_length` times as long. Neither has more than
    `LONGEST_CYCLE` steps.
    """
    length = config.annealing.cycle
    if length is None:
        length = max(16, usual_cycle(shape) // 32)
    return jnp.clip(length, 1, LONGEST_CYCLE // jnp.asarray(config.restart_length)).astype(
        jnp.int32
    )


def _starts_from_towns(config: AnnealedMapElitesConfig, shape: tuple[int, int]) -> bool:
    least = config.initial_towns_from
    return least is not None and shape[0] * shape[1] >= least and min(shape) >= SMALLEST_GROWN


def _random_move(problem: Problem, config: AnnealedMapElitesConfig) -> Move:
    """Returns the random move of the chains.

    On small grids it also refits windows, unless the configuration has a weight for that move.
    """
    moves = config.annealing.moves
    if problem.shape[0] * problem.shape[1] <= SMALL and moves.refit is None:
        moves = replace(moves, refit=_REFIT)
    return problem_move(problem, moves)


def _strip(problem: Problem) -> Move:
    """Returns the move that refits a strip."""
    # If streets go straight on, runs find 259 instead of 221 of 416 optima at 8 x 8 B, where cells
    # may be empty. At 9 x 9 A, where no cell is empty, they find 144 instead of 149 of 160.
    straight = 0.0 if problem.fill else 0.75
    return refit_strip(empty=not problem.fill, straight=straight)


def _pairs(
    chains: tuple[Array, ...], half: int
) -> tuple[tuple[Array, ...], tuple[Array, ...], tuple[Array, ...]]:
    """Divides arrays of chains into pairs.

    Returns the first chains of all pairs, the second chains of all pairs, and the chain that is
    left over from an odd number.
    """
    first = tuple(array[:half] for array in chains)
    second = tuple(array[half : 2 * half] for array in chains)
    unpaired = tuple(array[2 * half :] for array in chains)
    return first, second, unpaired


def _unpair(first_is_strip: Bool[Array, " P"], strips: Array, others: Array) -> Array:
    """Returns the strips of P chains and the moves of the others in the order of the chains.

    Computes both halves at once, because XLA on a CPU concatenates number by number.
    """
    half = len(strips)
    # In the first half the first chain of each pair is in question, in the second half the second
    # one.
    by_strip = first_is_strip[None] ^ np.array([[False], [True]])
    pairs = jnp.where(by_strip[..., None, None], strips, others[:half])
    pairs = pairs.reshape(2 * half, *others.shape[1:])
    return jnp.concatenate([pairs, others[half:]]) if len(others) > half else pairs


def _pursued_fitness(problem: Problem, cycle: Cycle, grids: Population) -> Real[Array, " C"]:
    bins = niche_bins(problem.descriptor(grids.features), problem.axes)
    penalised = penalise_distance(grids.fitness, bins, cycle.goal, cycle.penalty[:, None])
    # A sum with the fitness of a refused grid would not fit int32.
    return jnp.where(grids.valid, penalised, grids.fitness)
