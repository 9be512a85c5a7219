"""The tuned EA, PSO and GWO: annealed chains on islands that differ in which grids they copy parts of.

In the EA a chain is a parent with one offspring a step, and its mate is any grid of its island. The swarms move through
the space of networks and not through one of real numbers: a pull towards a good position copies a block of that grid, a
particle's own motion is a move of the mix (for permutations the idea is Clerc's, "Discrete particle swarm
optimization", 2004). So sampling loses nothing, and a grid near an optimum can come nearer.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int8, Real

from elitelanes_jax._util.checks import real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.pytrees import pytree, traced
from elitelanes_jax._util.records import Record, nested
from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.optimizers._annealing import (
    AnnealingConfig,
    Cooling,
    StepBits,
    island_mates,
    metropolis_accepts,
    problem_move,
    random_grid,
)
from elitelanes_jax.optimizers._population import Population, evaluate, select
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, as_elites
from elitelanes_jax.problem.problem import Problem


@pytree
@dataclass(frozen=True)
class AnnealedPsoConfig(Record):
    """Settings of the tuned PSO; the defaults are its preset `tuned`. A pytree: numbers may be mapped by `jax.vmap`.

    Attributes:
      annealing: of the particles, each of which knows those of its island.
      cognitive: probability that a particle is pulled towards its own best position.
      social: probability that it is pulled towards the best of its island; else it moves by itself.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig())
    cognitive: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))
    social: Real[ArrayLike, "..."] = traced(0.3, real(0, 1))

    def check_together(self) -> None:
        """Checks that the probabilities add up to 1 at most."""
        one, other = self.cognitive, self.social
        if isinstance(one, float) and isinstance(other, float) and one + other > 1:
            raise InputError(f"social: expected cognitive + social to be at most 1, got {one:g} + {other:g}")


@pytree
@dataclass(frozen=True)
class AnnealedGwoConfig(Record):
    """Settings of the tuned GWO; the defaults are its preset `tuned`. A pytree: numbers may be mapped by `jax.vmap`.

    Attributes:
      annealing: of the wolves, each island a pack.
      leaders: how many of a pack's best positions lead it: alpha, beta and so on; at most all.
    """

    annealing: AnnealingConfig = nested(AnnealingConfig())
    leaders: Int[ArrayLike, "..."] = traced(3, whole(1))


class AnnealedState(NamedTuple):
    """The state that is carried from step to step.

    Attributes:
      chains: the current grids of the chains.
      cycle_best: the best grid of each chain in this cycle.
      best: the best grid of each chain in all cycles.
      cooling: the run's place in its cycle.
    """

    chains: Population
    cycle_best: Population
    best: Population
    cooling: Cooling


_Mates = Callable[[StepBits, AnnealedState], Int8[Array, "C H W"]]


def annealed_ea(problem: Problem, config: AnnealingConfig = AnnealingConfig()) -> Optimizer:
    """Makes the tuned EA; its elites are the chains' best grids.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `tuned`.
    """

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        return island_mates(bits.mate, state.chains.grids, config.chains_on(problem.shape))

    return _make_optimizer(problem, config, mates)


def annealed_pso(problem: Problem, config: AnnealedPsoConfig = AnnealedPsoConfig()) -> Optimizer:
    """Makes the tuned PSO; its elites are the particles' best grids. Arguments are as in `annealed_ea`."""
    each = config.annealing.chains_on(problem.shape)

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        known = state.cycle_best
        best = jnp.argmin(known.fitness.reshape(-1, each), axis=1) + np.arange(known.fitness.size // each) * each
        own = bernoulli(bits.mate, config.cognitive)[:, None, None]
        either = bernoulli(bits.mate, config.cognitive + config.social)[:, None, None]
        pulled = jnp.where(own, known.grids, jnp.repeat(known.grids[best], each, axis=0))
        return jnp.where(either, pulled, state.chains.grids)

    return _make_optimizer(problem, config.annealing, mates)


def annealed_gwo(problem: Problem, config: AnnealedGwoConfig = AnnealedGwoConfig()) -> Optimizer:
    """Makes the tuned GWO; its elites are the wolves' best grids. Arguments are as in `annealed_ea`."""
    each = config.annealing.chains_on(problem.shape)

    def mates(bits: StepBits, state: AnnealedState) -> Array:
        known = state.cycle_best
        ranking = jnp.argsort(known.fitness.reshape(-1, each), axis=1, stable=True)
        pack = np.arange(known.fitness.size) // each
        return known.grids[ranking[pack, randint(bits.mate, jnp.minimum(config.leaders, each))] + pack * each]

    return _make_optimizer(problem, config.annealing, mates)


def _make_optimizer(problem: Problem, config: AnnealingConfig, mates: _Mates) -> Optimizer:
    count = config.population
    move = problem_move(problem, config.moves)

    def init(key: Array) -> AnnealedState:
        chains = evaluate(problem, problem.random(key, count))
        return AnnealedState(chains, chains, chains, Cooling.first(config, problem.shape))

    def step(key: Array, state: AnnealedState) -> tuple[AnnealedState, Info]:
        chains, cycle_best, best, cooling = state
        bits = StepBits.draw(key, count, move)
        restart = cooling.begins

        def make_child(grid: Array, mate: Array, fresh: Array, move_bits: Array) -> Array:
            varied = move.apply(move_bits, grid, mate)
            new = random_grid(problem, fresh)
            return problem.repair(jnp.where(restart, new, varied.grid), varied.dirty, restart)

        grids = jax.vmap(make_child)(chains.grids, mates(bits, state), bits.fresh, bits.move)
        children = evaluate(problem, grids)
        temperature = cooling.temperature(config.hottest, config.coldest, problem.shape)
        accepted = metropolis_accepts(bits.accept, temperature, chains.fitness, children.fitness)
        chains = select(restart | accepted, children, chains)
        cycle_best = select(restart | (children.fitness < cycle_best.fitness), children, cycle_best)
        best = select(children.fitness < best.fitness, children, best)
        info = Info(best_fitness=best.fitness.min(), elite_count=jnp.int32(count))
        return AnnealedState(chains, cycle_best, best, cooling.after(grows=True)), info

    def elites(state: AnnealedState) -> Elites:
        return as_elites(state.best)

    return Optimizer(init, step, elites, evaluations_per_step=count)
