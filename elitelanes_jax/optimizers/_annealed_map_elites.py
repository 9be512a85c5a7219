"""The tuned MAP-Elites: annealed chains, each of which pursues one niche, its goal, for one cycle.

A penalty grows with the distance from the goal. Each cycle draws how fast: some hardly leave the goal, and some follow
the best fitness. A cycle starts from the elite with the lowest penalised fitness, or from a random grid, and copies
parts of other elites. Every evaluated grid is offered to the archive.

Elites descend from each other, so an archive soon holds one family of networks and loses the stepping stones to the
other niches. Half of the chains are therefore isolated. They form groups, and a group knows only the elites that it
found. Some of their cycles restart from random grids.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real, UInt32

from elitelanes_jax._util.checks import flag, none_or, real, whole
from elitelanes_jax._util.pytrees import pytree, static, traced
from elitelanes_jax._util.records import Record, nested
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import bernoulli, randint, split
from elitelanes_jax.network.growth import SMALLEST_GROWN, grow_town
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
)
from elitelanes_jax.optimizers._emitters import (
    Niches,
    draw_goal,
    nearest_elite,
    penalise_distance,
)
from elitelanes_jax.optimizers._moves import with_symmetric_copy
from elitelanes_jax.optimizers._mutations import Move, Variation, materialize_variation
from elitelanes_jax.optimizers._population import concatenate, evaluate, select, unevaluated
from elitelanes_jax.optimizers._strips import refit_strip
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population, insert
from elitelanes_jax.problem.descriptor import niche_bins
from elitelanes_jax.problem.problem import Problem

# All measured in experiments/search/moves.md. The weight of `refit_window` on small grids, the number of groups of
# isolated chains, and the number of niches from which the elite nearest to the goal becomes the mate.
_REFIT, _GROUPS, _TOURNAMENT = 25, 4, 8


@pytree
@dataclass(frozen=True)
class AnnealedMapElitesConfig(Record):
    """Options; the defaults are the preset `tuned`. A pytree: `jax.vmap` may map over the numbers that are not static.

    Attributes:
      annealing: options of the chains; each is an island of its own. Cycles do not grow; their default length is 1/32
        of the tuned EA's first cycle.
      bin_penalty: the most fitness that each bin of distance from the goal adds. Each cycle draws its own penalty below
        this, all equally likely.
      restart: probability that a cycle of an isolated chain starts from a random grid.
      restart_length: the length of a restarted cycle, in usual cycles.
      vacant_probability: probability that the goal is a vacant niche, if one is reachable.
      elite_mate: probability that a mate is an elite.
      symmetric_probability: probability that a move is also made symmetrically in a cycle from an elite, see
        `with_symmetric_copy`.
      strips: whether half of the moves are `refit_strip` instead of moves drawn by weight; static.
      initial_towns_from: the least number of cells with which the chains start from grown towns
        instead of random grids; None for never; static. On 24 x 24 tiles the moves do not lead from random grids to
        networks without violations.
      accept_equal: whether a grid replaces an elite of equal fitness; static. Many towns have equal fitness. Without
        this, elites would hardly change, and cycles would start from the same elites.
      require_feasible: whether a niche counts as vacant until its elite has no penalty, and each cycle has the whole
        `bin_penalty`; static. Without this, cycles seldom pursue niches with infeasible elites.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig(chains=1, hottest=40, coldest=12))
    bin_penalty: Int[ArrayLike, "..."] = traced(400, whole(1, 10_000))
    restart: Real[ArrayLike, "..."] = traced(0.1, real(0, 1))
    restart_length: Int[ArrayLike, "..."] = traced(16, whole(1))
    vacant_probability: Real[ArrayLike, "..."] = traced(0.1, real(0, 1))
    elite_mate: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    symmetric_probability: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    strips: bool = static(True, flag)
    initial_towns_from: int | None = static(None, none_or(whole(1)))
    accept_equal: bool = static(False, flag)
    require_feasible: bool = static(False, flag)


class _Bits(NamedTuple):
    """The random bits of a chain in a step that this method adds to `StepBits`; uint32 ``[C]`` unless stated."""

    goal: UInt32[Array, "*C 2"]
    restart: UInt32[Array, "*C"]
    elite_mate: UInt32[Array, "*C"]
    rivals: UInt32[Array, "*C T"]

    @staticmethod
    def of(bits: UInt32[Array, "C B"]) -> "_Bits":
        return _Bits(bits[:, :2], bits[:, 2], bits[:, 3], bits[:, 4:])


_BITS = 4 + _TOURNAMENT


class Cycle(NamedTuple):
    """The cycles of C chains."""

    goal: Int32[Array, "*C D"]  # the bins of the niche that the cycle pursues
    restarts: Bool[Array, "*C"]  # whether the cycle starts from a random grid
    start: Int32[Array, "*C"]  # the index of the elite that any other cycle starts from
    penalty: Int32[Array, "*C"]  # the fitness that each bin of distance from the goal adds


class AnnealedMapElitesState(NamedTuple):
    """The state of all chains."""

    chains: Population  # the current grids
    cycles: Cycle  # the current cycles
    archives: Population  # one archive for each group of isolated chains, then the archive of all chains, end to end
    cooling: Cooling  # arrays [C], the step of each chain within its cycle; -1 while no grid is evaluated


@runs_jax
def annealed_map_elites(problem: Problem, config: AnnealedMapElitesConfig = AnnealedMapElitesConfig()) -> Optimizer:
    """Makes MAP-Elites whose chains pursue niches; its elites are the archive of all chains.

    The problem has at least one axis; otherwise `InputError` is raised. Niches outside an axis' target bin are stepping
    stones. The default configuration is the preset `tuned`.
    """
    check_arguments(problem, config, AnnealedMapElitesConfig)
    annealing, shape, count = config.annealing, problem.shape, config.annealing.population
    cells = shape[0] * shape[1]
    starts_from_towns = cells >= (config.initial_towns_from or np.inf) and min(shape) >= SMALLEST_GROWN
    groups, length = _Groups.of(problem, count, config.accept_equal), _usual_length(config, shape)
    moves = annealing.moves
    if cells <= SMALL and moves.refit is None:
        moves = replace(moves, refit=_REFIT)
    move = problem_move(problem, moves)
    symmetric = partial(with_symmetric_copy, move=move)
    # Streets that go on find 259 instead of 221 of 416 optima at 8 x 8 B, and 144 instead of 149 of 160 at 9 x 9 A.
    strip = refit_strip(empty=not problem.fill, straight=0.0 if problem.fill else 0.75) if config.strips else None
    vary = partial(_vary, symmetric, strip, config.symmetric_probability)
    repair = jax.vmap(problem.repair)
    drawn = problem.drawn(count)
    in_raster_order = drawn & (not starts_from_towns)
    draw_cycles = jax.vmap(partial(_draw_cycle, groups, config), (0, 0, 0, None, None))

    def elites_of(archives: Population) -> Population:
        return jax.tree.map(lambda array: array[groups.last :], archives)

    def init_unevaluated(key: Array) -> AnnealedMapElitesState:
        grids = problem.random_unrepaired(key, count)
        if starts_from_towns:
            towns = jax.vmap(lambda key: grow_town(key, shape))(split(key, count))
            given = np.count_nonzero(~drawn)  # they come first; random grids are not drawn if there are none
            grids = towns.at[:given].set(grids[:given])
        chains = unevaluated(problem, grids)
        archives = problem.empty_archive(chains.fitness.dtype, copies=_GROUPS + 1)
        zero, no = jnp.zeros(count, jnp.int32), jnp.zeros(count, bool)
        cycles = Cycle(jnp.zeros((count, len(problem.axes)), jnp.int32), no, zero, zero)
        return AnnealedMapElitesState(chains, cycles, archives, Cooling(zero - 1, jnp.broadcast_to(length, count)))

    def step(key: Array, state: AnnealedMapElitesState) -> tuple[AnnealedMapElitesState, Info]:
        chains, cycles, archives, cooling = state
        bits = StepBits.draw(key, count, symmetric(0), extra=_BITS)
        own_bits, begins = _Bits.of(bits.extra), cooling.begins

        def new_cycles(pending: Array, before: tuple[Cycle, Array]) -> tuple[Cycle, Array]:
            # Dependent on the loop, because otherwise XLA computes what follows before it, in every step.
            fitness, features, fresh = (
                jnp.where(pending, array, 0) for array in (archives.fitness, archives.features, bits.fresh)
            )
            filled = archives._replace(fitness=fitness).valid
            if config.require_feasible:
                filled &= problem.penalties(features) == 0
            drawn = draw_cycles(own_bits, jnp.asarray(groups.first), jnp.asarray(groups.isolated), fitness, filled)
            cycles = select(begins, drawn, before[0])
            random = jax.vmap(partial(random_grid, problem))(fresh)
            return cycles, select(cycles.restarts, random, take(archives.grids, cycles.start))

        cycles, first = run_if(begins.any(), new_cycles, (cycles, chains.grids))
        lengths = (length * jnp.where(cycles.restarts, config.restart_length, 1)).astype(jnp.int32)
        cooling = cooling._replace(length=jnp.where(begins, lengths, cooling.length))

        mates = island_mates(bits.mate, chains.grids, annealing.chains_on(shape))
        mates = _draw_mates(groups, config, own_bits, cycles, archives, mates)
        temperature = cooling.temperature(annealing.hottest, annealing.coldest, shape)
        varied = vary(bits, temperature, cycles.restarts, chains.grids, mates)
        # Grids that are not evaluated are their own children, and accepted: their fitness is that of vacant slots.
        starts = cooling.step < 0
        varied = Variation(select(starts, chains.grids, varied.grid), varied.dirty & ~starts[:, None, None])
        raster = begins & cycles.restarts | starts & in_raster_order
        children = evaluate(problem, repair(select(begins, first, varied.grid), varied.dirty, raster=raster))
        pursued = partial(_pursued_fitness, problem, cycles)
        accepted = metropolis_accepts(bits.accept, temperature, pursued(chains), pursued(children))
        chains = select(begins | accepted, children, chains)
        archives = groups.insert(archives, problem.niche(children.features), children)
        found = elites_of(archives)
        info = Info(found.fitness.min(), found.valid.sum(dtype=jnp.int32), count_refused(children))
        return AnnealedMapElitesState(chains, cycles, archives, cooling.after(grows=False)), info

    def init(key: Array) -> AnnealedMapElitesState:
        return step(key, init_unevaluated(key))[0]

    def elites(state: AnnealedMapElitesState) -> Population:
        return elites_of(state.archives)

    return Optimizer.of(init, step, elites, evaluations_per_step=count, init_unevaluated=init_unevaluated)


def _usual_length(config: AnnealedMapElitesConfig, shape: tuple[int, int]) -> Int32[Array, ""]:
    """Returns the steps of a cycle from an elite, so that no cycle exceeds `LONGEST_CYCLE`."""
    length = config.annealing.cycle
    if length is None:
        length = max(16, config.annealing.first_cycle(shape) // 32)
    return jnp.clip(length, 1, LONGEST_CYCLE // jnp.asarray(config.restart_length)).astype(jnp.int32)


class _Groups(NamedTuple):
    """The archives of G groups of isolated chains and the archive of all chains, end to end; static."""

    niches: Niches  # the N niches of each archive
    isolated: Bool[np.ndarray, " C"]  # whether each chain is isolated: the first half of them
    first: Int32[np.ndarray, " C"]  # the first index of the archive that each chain knows
    last: int  # the first index of the archive of all chains
    accept_equal: bool  # whether a grid replaces an elite of equal fitness

    @staticmethod
    def of(problem: Problem, chains: int, accept_equal: bool) -> "_Groups":
        size = problem.niches
        group = (np.arange(chains) * 2 * _GROUPS // chains).clip(max=_GROUPS)
        first = (group * size).astype(np.int32)
        return _Groups(Niches.of(problem.axes), group < _GROUPS, first, _GROUPS * size, accept_equal)

    def insert(self, archives: Population, niche: Int32[Array, " C"], found: Population) -> Population:
        """Offers each chain's grid to the archive that the chain knows, and to the archive of all chains."""
        indices = jnp.stack([niche + self.first, niche + self.last])
        return insert(archives, indices, found, accept_equal=self.accept_equal)


def _draw_cycle(
    groups: _Groups,
    config: AnnealedMapElitesConfig,
    bits: _Bits,
    first: Int32[Array, ""],
    isolated: Bool[Array, ""],
    fitness: Real[Array, " A"],
    filled: Bool[Array, " A"],
) -> Cycle:
    """Draws the next cycle of one chain, which knows the archive from index `first` on.

    `fitness` and `filled` are those of all archives; niches that are not filled count as vacant.
    """
    niches = groups.niches
    known, filled = (jax.lax.dynamic_slice_in_dim(array, first, len(niches.bins)) for array in (fitness, filled))
    restarts = isolated & bernoulli(bits.restart, config.restart)
    goal = draw_goal(niches, bits.goal, filled, config.vacant_probability)
    penalty = jnp.asarray(config.bin_penalty, jnp.int32)
    if not config.require_feasible:
        penalty = randint(bits.elite_mate, penalty)  # these bits have no other use here, because no mate is drawn
    return Cycle(goal, restarts, first + nearest_elite(known, niches.bins, goal, penalty), penalty)


def _draw_mates(
    groups: _Groups,
    config: AnnealedMapElitesConfig,
    bits: _Bits,
    cycle: Cycle,
    archives: Population,
    otherwise: Int8[Array, "C H W"],
) -> Int8[Array, "C H W"]:
    """Draws a mate for each chain: with a probability the elite nearest to its goal among a few random niches.

    Other chains get the mate in `otherwise`.
    """
    rivals = randint(bits.rivals, len(groups.niches.bins))
    fitness, bins = take(archives.fitness, rivals + groups.first[:, None]), take(groups.niches.bins, rivals)
    nearest = nearest_elite(fitness, bins, cycle.goal, cycle.penalty[:, None, None])
    mate = groups.first + jnp.take_along_axis(rivals, nearest[:, None], axis=1)[:, 0]
    is_elite = bernoulli(bits.elite_mate, config.elite_mate) & take(archives.valid, mate)
    return jnp.where(is_elite[:, None, None], take(archives.grids, mate), otherwise)


def _vary(
    symmetric: Callable[[Real[ArrayLike, ""]], Move],
    strip: Move | None,
    probability: Real[ArrayLike, ""],
    bits: StepBits,
    temperature: Int32[Array, " C"],
    restarts: Bool[Array, " C"],
    grids: Int8[Array, "C H W"],
    mates: Int8[Array, "C H W"],
) -> Variation:
    """Makes a move from each chain's grid. Chains form pairs, and the colder chain of each pair makes the strip.

    So every step computes each kind of move for half of the chains. If each chain drew for itself, both kinds would be
    computed for all.
    """

    @jax.vmap
    def mix(bits: Array, restarts: Array, grid: Array, mate: Array) -> Variation:
        return symmetric(jnp.where(restarts, 0, jnp.float32(probability))).apply(bits, grid, mate)

    chains, half = (bits.move, restarts, grids, mates), len(grids) // 2
    if strip is None or not half:
        return mix(*chains)
    first, second, left = (
        jax.tree.map(lambda array, part=part: array[part], chains)
        for part in (slice(half), slice(half, 2 * half), slice(2 * half, None))
    )
    one, other = temperature[:half], temperature[half : 2 * half]
    # A chain uses these bits only when a cycle begins, and then makes no move.
    turn = (one < other) | (one == other) & (bits.fresh[:half] & 1 > 0)
    drawn, _, before, _ = select(turn, first, second)
    # Without this XLA computes them for each of their uses: a step then takes 1.15 times as long.
    refitted = materialize_variation(jax.vmap(strip.apply)(drawn[:, : strip.bits], before))
    mixed = materialize_variation(mix(*concatenate(select(turn, second, first), left)))
    # Computes both halves at once, because XLA on a CPU concatenates number by number.
    by_strip = turn[None] ^ np.array([[False], [True]])

    def paired(refitted: Array, mixed: Array) -> Array:
        pairs = jnp.where(by_strip[..., None, None], refitted, mixed[:half]).reshape(2 * half, *mixed.shape[1:])
        return jnp.concatenate([pairs, mixed[half:]]) if len(mixed) > half else pairs

    return jax.tree.map(paired, refitted, mixed)


def _pursued_fitness(problem: Problem, cycle: Cycle, found: Population) -> Real[Array, " C"]:
    bins = niche_bins(problem.descriptor(found.features), problem.axes)
    penalised = penalise_distance(found.fitness, bins, cycle.goal, cycle.penalty[:, None])
    # A sum with the fitness of a refused grid would not fit int32.
    return jnp.where(found.valid, penalised, found.fitness)
