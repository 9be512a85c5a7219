"""The tuned MAP-Elites: annealed chains, each of which pursues one niche a cycle.

A penalty grows with the distance from that niche. A cycle starts from the elite with the lowest penalised fitness, or
from a random grid, and copies parts of other elites. All that is evaluated enters the archive.

Elites descend from each other: an archive soon holds one family of networks, and loses what leads to the other niches.
Half of the chains are therefore isolated, in groups that know only the elites that they found themselves; some of their
cycles restart from random grids. While niches are vacant, some restarts go in a direction: in one long cycle they count
penalties alone, and go past a vacant niche to the ends of the axes, so that no reward holds them on the way.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Key, Real, UInt32

from elitelanes_jax._util.checks import flag, none_or, real, whole
from elitelanes_jax._util.pytrees import pytree, static, traced
from elitelanes_jax._util.records import Record, nested
from elitelanes_jax._util.types import Pytree
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.network.growth import SMALLEST_GROWN, grow_town
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
    draw_direction,
    draw_target,
    nearest_elite,
    penalise_distance,
    reachable,
)
from elitelanes_jax.optimizers._moves import with_opposite
from elitelanes_jax.optimizers._mutations import Move
from elitelanes_jax.optimizers._population import Population, evaluate, select
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.problem.archive import VACANT, Archive, empty_archive, insert_at
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, niche_bins, niche_index
from elitelanes_jax.problem.problem import Problem

# From experiments/search/moves.md: the share of `refit_window` on small grids; the groups of isolated chains; among how
# many niches the mate is the nearest elite; and of cycles in a direction, their share of the restarts, length in usual
# cycles, penalty of a bin and temperatures.
_REFIT, _GROUPS, _TOURNAMENT = 25, 4, 8
_DIRECTION_SHARE, _DIRECTION_LENGTH, _DIRECTION_PENALTY, _DIRECTION_HOTTEST, _DIRECTION_COLDEST = 0.4, 49, 200, 50, 25


@pytree
@dataclass(frozen=True)
class AnnealedMapElitesConfig(Record):
    """Settings; the defaults are the preset `tuned`. A pytree: numbers may be mapped by `jax.vmap`.

    Attributes:
      annealing: of the chains, each an island of its own; its cycles do not grow, and by default are a thirty-second of
        the first one of the tuned EA.
      bin_penalty: the fitness that each bin of distance from the target niche adds.
      restart: probability that a cycle of an isolated chain starts from a random grid.
      restart_length: the length of such a cycle, in usual ones.
      frontier: probability that a cycle pursues a vacant niche, if one is within reach.
      elite_mate: probability that a mate is an elite.
      opposite: probability that a move of a cycle from an elite is made at the opposite place too, see `with_opposite`.
      mirrored: whether the opposite place may also be the image in a diagonal; static. By default it may on grids of
        up to 64 cells, where cells may stay empty.
      grown: the number of cells from which on the chains begin with towns that were grown (see `grow_town`) in place
        of random grids, and restart from none; None for never; static. On 24 x 24 tiles the moves do not lead from
        random grids to networks without a flaw.
      drifts: whether a grid takes the place of an elite of the same fitness; static. Where many networks have the
        same fitness, as towns have, elites would else hardly change, and cycles begin from the same ones.
      complete: whether a niche counts as vacant until its elite has no penalty; static. Else cycles seldom pursue those
        that hold flawed elites.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig(chains=1, hottest=40, coldest=12))
    bin_penalty: Int[ArrayLike, "..."] = traced(400, whole(1, 10_000))
    restart: Real[ArrayLike, "..."] = traced(0.1, real(0, 1))
    restart_length: Int[ArrayLike, "..."] = traced(16, whole(1))
    frontier: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    elite_mate: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    opposite: Real[ArrayLike, "..."] = traced(0.5, real(0, 1))
    mirrored: bool | None = static(None, none_or(flag))
    grown: int | None = static(None, none_or(whole(1)))
    drifts: bool = static(False, flag)
    complete: bool = static(False, flag)


class _Bits(NamedTuple):
    """The random bits of a chain in a step, beside those of all annealed methods; uint32 ``[C]``, or as said."""

    target: UInt32[Array, "*C 2"]
    restart: UInt32[Array, "*C"]
    direction: UInt32[Array, "*C"]
    elite_mate: UInt32[Array, "*C"]
    rivals: UInt32[Array, "*C T"]

    @staticmethod
    def of(bits: UInt32[Array, "C B"]) -> "_Bits":
        return _Bits(bits[:, :2], bits[:, 2], bits[:, 3], bits[:, 4], bits[:, 5:])


_BITS = 5 + _TOURNAMENT


class Cycle(NamedTuple):
    """The cycles of the chains.

    Attributes:
      target: int32 ``[D]``, the bins of the niche that it pursues.
      directed: bool, whether it goes in a direction.
      restarts: bool, whether it starts from a random grid.
      start: int32, the place of the elite that it starts from else.
    """

    target: Int32[Array, "*C D"]
    directed: Bool[Array, "*C"]
    restarts: Bool[Array, "*C"]
    start: Int32[Array, "*C"]


class AnnealedMapElitesState(NamedTuple):
    """The state that is carried from step to step.

    Attributes:
      chains: the current grids of the chains.
      cycles: of the chains.
      archives: the best grids by niche of each group of isolated chains, one after another, and last of all chains.
      cooling: arrays ``[C]``, each chain's place in its cycle.
    """

    chains: Population
    cycles: Cycle
    archives: Archive
    cooling: Cooling


def annealed_map_elites(problem: Problem, config: AnnealedMapElitesConfig = AnnealedMapElitesConfig()) -> Optimizer:
    """Makes MAP-Elites whose chains pursue niches; its elites are the archive of all chains.

    Args:
      problem: with a shape, an alphabet, a fitness and axes; niches outside an axis' target bin are stepping stones.
      config: the defaults are the preset `tuned`.
    """
    annealing, shape, count = config.annealing, problem.shape, config.annealing.population
    grows = config.grown is not None and shape[0] * shape[1] >= config.grown and min(shape) >= SMALLEST_GROWN
    if grows:
        config = replace(config, restart=0.0)
    groups, length = _Groups.of(problem.axes, count, config.drifts), _usual_length(config, shape)
    small, moves = shape[0] * shape[1] <= SMALL, annealing.moves
    if small and moves.refit is None:
        moves = replace(moves, refit=_REFIT)
    move = problem_move(problem, moves)
    mirrored = small and not problem.fill if config.mirrored is None else config.mirrored
    opposite = partial(with_opposite, move=move, mirrored=mirrored)
    make_children = jax.vmap(partial(_make_child, problem, opposite, config.opposite))
    draw_cycles = jax.vmap(partial(_draw_cycle, groups, config), (0, 0, 0, None, None))

    def init(key: Array) -> AnnealedMapElitesState:
        chains = evaluate(problem, _first_towns(problem, key, count) if grows else problem.random(key, count))
        vacant = empty_archive(problem.axes, shape, copies=_GROUPS + 1, columns=problem.columns)
        archives = groups.insert(vacant, chains)
        zero, no = jnp.zeros(count, jnp.int32), jnp.zeros(count, bool)
        cycles = Cycle(jnp.zeros((count, len(problem.axes)), jnp.int32), no, no, zero)
        return AnnealedMapElitesState(chains, cycles, archives, Cooling(zero, jnp.broadcast_to(length, count)))

    def step(key: Array, state: AnnealedMapElitesState) -> tuple[AnnealedMapElitesState, Info]:
        chains, cycles, archives, cooling = state
        bits = StepBits.draw(key, count, opposite(0), extra=_BITS)
        own_bits, begins = _Bits.of(bits.extra), cooling.begins

        def new_cycles(fitness: Array) -> Cycle:
            filled = fitness < VACANT
            if config.complete:
                filled &= problem.penalties(archives.counts) == 0
            drawn = draw_cycles(own_bits, jnp.asarray(groups.first), jnp.asarray(groups.isolated), fitness, filled)
            return select(begins, drawn, cycles)

        cycles = _compute_if(begins.any(), new_cycles, archives.fitness, cycles)
        times = jnp.where(cycles.directed, _DIRECTION_LENGTH, jnp.where(cycles.restarts, config.restart_length, 1))
        lengths = (length * times).astype(jnp.int32)
        cooling = cooling._replace(length=jnp.where(begins, lengths, cooling.length))

        mates = island_mates(bits.mate, chains.grids, annealing.chains_on(shape))
        mates = _draw_mates(groups, config, own_bits, cycles, archives, mates)
        elites = archives.grids[cycles.start]
        children = evaluate(problem, make_children(bits, begins, cycles.restarts, chains.grids, mates, elites))
        temperature = jnp.where(
            cycles.directed,
            cooling.temperature(_DIRECTION_HOTTEST, _DIRECTION_COLDEST, shape),
            cooling.temperature(annealing.hottest, annealing.coldest, shape),
        )
        pursued = partial(_pursued_fitness, problem, groups.niches, config, cycles)
        accepted = metropolis_accepts(bits.accept, temperature, pursued(chains), pursued(children))
        chains = select(begins | accepted, children, chains)
        archives = groups.insert(archives, children)
        found = archives.fitness[groups.last :]
        info = Info(best_fitness=found.min(), elite_count=(found < VACANT).sum(dtype=jnp.int32))
        return AnnealedMapElitesState(chains, cycles, archives, cooling.after(grows=False)), info

    def elites(state: AnnealedMapElitesState) -> Elites:
        found = jax.tree.map(lambda array: array[groups.last :], state.archives)
        return Elites(found.grids, found.fitness, found.counts, valid=found.valid)

    def receive(state: AnnealedMapElitesState, found: Elites) -> AnnealedMapElitesState:
        # The chains that are not isolated know the last archive: the groups stay as they are.
        mine = jax.tree.map(lambda array: array[groups.last :], state.archives)
        new = select(found.fitness < mine.fitness, Archive(*found[:3]), mine)
        archives = jax.tree.map(lambda array, part: array.at[groups.last :].set(part), state.archives, new)
        return state._replace(archives=archives)

    return Optimizer(init, step, elites, evaluations_per_step=count, receive=receive)


def _first_towns(problem: Problem, key: Key[Array, ""], count: int) -> Int8[Array, "C H W"]:
    """Returns the given grids, and for the other chains towns that were grown."""
    towns = jax.vmap(lambda key: problem.repair(grow_town(key, problem.shape)))(jax.random.split(key, count))
    return towns.at[: problem.given].set(problem.random(key, count)[: problem.given])


def _usual_length(config: AnnealedMapElitesConfig, shape: tuple[int, int]) -> Int32[Array, ""]:
    """Returns the steps of a cycle from an elite; the longest of all cycles has `LONGEST_CYCLE` at most."""
    length = config.annealing.cycle
    if length is None:
        length = max(16, config.annealing.first_cycle(shape) // 32)
    longest = jnp.maximum(config.restart_length, _DIRECTION_LENGTH)
    return jnp.clip(length, 1, LONGEST_CYCLE // longest).astype(jnp.int32)


class _Groups(NamedTuple):
    """The archives of G groups of isolated chains, one after another, and last the archive of all chains; static.

    Attributes:
      axes: of the descriptor space.
      niches: of each archive, N.
      isolated: bool ``[C]``, which chains are: the first half.
      first: int32 ``[C]``, where the archive begins that each chain knows.
      last: where that of all chains begins.
      drifts: whether a grid takes the place of an elite of the same fitness.
    """

    axes: tuple[Axis, ...]
    niches: Niches
    isolated: Bool[np.ndarray, " C"]
    first: Int32[np.ndarray, " C"]
    last: int
    drifts: bool

    @staticmethod
    def of(axes: tuple[Axis, ...], chains: int, drifts: bool) -> "_Groups":
        niches = Niches.of(axes)
        size = len(niches.places)
        group = (np.arange(chains) * 2 * _GROUPS // chains).clip(max=_GROUPS)
        return _Groups(axes, niches, group < _GROUPS, (group * size).astype(np.int32), _GROUPS * size, drifts)

    def insert(self, archives: Archive, found: Population) -> Archive:
        """Offers each chain's grid to the archive that it knows, and to that of all."""
        niche = niche_index(compute_descriptor(found.counts, self.axes), self.axes)
        return insert_at(archives, jnp.stack([niche + self.first, niche + self.last]), *found, drifts=self.drifts)


def _draw_cycle(
    groups: _Groups,
    config: AnnealedMapElitesConfig,
    bits: _Bits,
    first: Int32[Array, ""],
    isolated: Bool[Array, ""],
    fitness: Int32[Array, " A"],
    filled: Bool[Array, " A"],
) -> Cycle:
    """Draws one chain's cycle.

    Args:
      groups: of the chains.
      config: the settings.
      bits: of the chain.
      first: where the archive begins that the chain knows.
      isolated: whether the chain is.
      fitness: int32 ``[A]``, of all archives.
      filled: bool ``[A]``, the niches that are not pursued as vacant ones.
    """
    niches = groups.niches
    known, own = (jax.lax.dynamic_slice_in_dim(array, first, len(niches.places)) for array in (fitness, filled))
    filled = filled[groups.last :]
    restarts = isolated & bernoulli(bits.restart, config.restart)
    directed = restarts & reachable(niches, filled).any() & bernoulli(bits.direction, _DIRECTION_SHARE)
    target = draw_target(niches, bits.target, own, config.frontier)
    target = jnp.where(directed, draw_direction(niches, bits.target[1], filled), target)
    return Cycle(target, directed, restarts, first + nearest_elite(known, niches.places, target, config.bin_penalty))


def _draw_mates(
    groups: _Groups,
    config: AnnealedMapElitesConfig,
    bits: _Bits,
    cycle: Cycle,
    archives: Archive,
    otherwise: Int8[Array, "C H W"],
) -> Int8[Array, "C H W"]:
    """Draws a mate for each chain: of a few random niches the elite nearest to its target, or the given grid."""
    rivals = randint(bits.rivals, len(groups.niches.places))
    fitness, places = archives.fitness[rivals + groups.first[:, None]], jnp.asarray(groups.niches.places)[rivals]
    nearest = nearest_elite(fitness, places, cycle.target, config.bin_penalty)
    mate = groups.first + jnp.take_along_axis(rivals, nearest[:, None], axis=1)[:, 0]
    is_elite = bernoulli(bits.elite_mate, config.elite_mate) & archives.valid[mate] & ~cycle.directed
    return jnp.where(is_elite[:, None, None], archives.grids[mate], otherwise)


def _make_child(
    problem: Problem,
    opposite: Callable[[Real[ArrayLike, ""]], Move],
    probability: Real[ArrayLike, ""],
    bits: StepBits,
    begins: Bool[Array, ""],
    restarts: Bool[Array, ""],
    grid: Int8[Array, "H W"],
    mate: Int8[Array, "H W"],
    elite: Int8[Array, "H W"],
) -> Int8[Array, "H W"]:
    """Moves from a chain's grid; where a cycle begins, returns a random grid or the elite that it starts from."""
    varied = opposite(jnp.where(restarts, 0, jnp.float32(probability))).apply(bits.move, grid, mate)
    first = jnp.where(restarts, random_grid(problem, bits.fresh), elite)
    return problem.repair(jnp.where(begins, first, varied.grid), varied.dirty, begins & restarts)


def _pursued_fitness(
    problem: Problem, niches: Niches, config: AnnealedMapElitesConfig, cycle: Cycle, found: Population
) -> Int32[Array, " C"]:
    """Returns the penalised fitness of each chain's grid, by what its cycle pursues."""
    place = niche_bins(compute_descriptor(found.counts, problem.axes), problem.axes)
    usual = penalise_distance(found.fitness, place, cycle.target, config.bin_penalty)
    bin_penalties = np.where(niches.free, _DIRECTION_PENALTY, 0).astype(np.int32)
    directed = penalise_distance(problem.penalties(found.counts), place, cycle.target, bin_penalties)
    return jnp.where(cycle.directed, directed, usual)


def _compute_if(
    condition: Bool[Array, ""], compute: Callable[[Pytree], Pytree], operand: Int32[Array, " N"], otherwise: Pytree
) -> Pytree:
    """Returns `compute(operand)` if a condition holds: what is seldom needed is seldom computed.

    It is a loop of one round or none. `jax.lax.cond` would always compute both where seeds are a batch.
    """

    def body(carry: tuple[Array, Pytree]) -> tuple[Array, Pytree]:
        pending, _ = carry
        # It depends on the carry, so that XLA does not see that all this could be done outside the loop.
        return jnp.array(False), compute(jnp.where(pending, operand, 0))

    return jax.lax.while_loop(lambda carry: carry[0], body, (condition, otherwise))[1]
