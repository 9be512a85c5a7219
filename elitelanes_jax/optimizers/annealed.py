"""The tuned EA, PSO and GWO: annealed chains on islands that differ in whose grids they take parts of.

In the EA a chain is a parent with one offspring a step, and its mate is any of its island. The swarms move through the
space of networks and not through one of real numbers: a pull towards a good position sets in a block of that grid, the
motion of one's own is a move of the mix (for permutations the idea is Clerc's, "Discrete particle swarm optimization",
2004). So nothing is lost in sampling, and what is near an optimum can come nearer.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.annealing import AnnealingConfig, Cooling, Draw, accepts, fresh_grid, island_mates, tuned_move
from elitelanes_jax.checks import check_count, check_real
from elitelanes_jax.draws import below, chance
from elitelanes_jax.errors import InputError
from elitelanes_jax.evolution import Population, evaluated, taken
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, all_of
from elitelanes_jax.problem import Problem

__all__ = ["AnnealedState", "DiscreteGwoConfig", "DiscretePsoConfig", "annealed_ea", "discrete_gwo", "discrete_pso"]


class DiscretePsoConfig(NamedTuple):
    """Settings of the tuned PSO; the defaults are its preset `tuned`.

    Attributes:
      annealing: of the particles, which know those of their island.
      cognitive: probability that a particle is pulled towards the best position of its own.
      social: probability that it is pulled towards the best of its island; else it moves by itself.
    """

    annealing: AnnealingConfig = AnnealingConfig()
    cognitive: Numeric = 0.3
    social: Numeric = 0.3

    def checked(self) -> "DiscretePsoConfig":
        """The settings with probabilities as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        cognitive = check_real("config", "cognitive", self.cognitive, 0, 1)
        social = check_real("config", "social", self.social, 0, 1)
        if isinstance(cognitive, float) and isinstance(social, float) and cognitive + social > 1:
            raise InputError(f"config: expected cognitive + social to be at most 1, got {cognitive:g} + {social:g}")
        return DiscretePsoConfig(self.annealing.checked(), cognitive, social)


class DiscreteGwoConfig(NamedTuple):
    """Settings of the tuned GWO; the defaults are its preset `tuned`.

    Attributes:
      annealing: of the wolves, each island a pack.
      leaders: how many of a pack's best positions lead it: alpha, beta and so on; at most all.
    """

    annealing: AnnealingConfig = AnnealingConfig()
    leaders: int = 3

    def checked(self) -> "DiscreteGwoConfig":
        """The settings.

        Raises:
          InputError: for a setting out of its range.
        """
        check_count("config", "leaders", self.leaders)
        return self._replace(annealing=self.annealing.checked())


class AnnealedState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      chains: the grids that the chains are at.
      cycle_best: the best grid that each has been at in this cycle.
      best: likewise, in all cycles.
      cooling: where in its cycle the run is.
    """

    chains: Population
    cycle_best: Population
    best: Population
    cooling: Cooling


_Mates = Callable[[Draw, AnnealedState], Array]


def annealed_ea(problem: Problem, config: AnnealingConfig = AnnealingConfig()) -> Optimizer:  # noqa: B008
    """The tuned EA; its elites are the chains' best grids.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `tuned`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()

    def mates(draw: Draw, state: AnnealedState) -> Array:
        return island_mates(draw.mate, state.chains.grids, config.chains_on(problem.shape))

    return _annealed(problem, config, mates)


def discrete_pso(problem: Problem, config: DiscretePsoConfig = DiscretePsoConfig()) -> Optimizer:  # noqa: B008
    """The tuned PSO; its elites are the particles' best grids. Arguments and errors are those of `annealed_ea`."""
    config = config.checked()
    each = config.annealing.chains_on(problem.shape)

    def mates(draw: Draw, state: AnnealedState) -> Array:
        known = state.cycle_best
        best = jnp.argmin(known.fitness.reshape(-1, each), axis=1) + np.arange(known.fitness.size // each) * each
        own = chance(draw.mate, config.cognitive)[:, None, None]
        either = chance(draw.mate, config.cognitive + config.social)[:, None, None]
        pulled = jnp.where(own, known.grids, jnp.repeat(known.grids[best], each, axis=0))
        return jnp.where(either, pulled, state.chains.grids)

    return _annealed(problem, config.annealing, mates)


def discrete_gwo(problem: Problem, config: DiscreteGwoConfig = DiscreteGwoConfig()) -> Optimizer:  # noqa: B008
    """The tuned GWO; its elites are the wolves' best grids. Arguments and errors are those of `annealed_ea`."""
    config = config.checked()
    each = config.annealing.chains_on(problem.shape)

    def mates(draw: Draw, state: AnnealedState) -> Array:
        known = state.cycle_best
        ranking = jnp.argsort(known.fitness.reshape(-1, each), axis=1, stable=True)
        pack = np.arange(known.fitness.size) // each
        return known.grids[ranking[pack, below(draw.mate, min(config.leaders, each))] + pack * each]

    return _annealed(problem, config.annealing, mates)


def _annealed(problem: Problem, config: AnnealingConfig, mates: _Mates) -> Optimizer:
    count = config.population
    move = tuned_move(problem, config.moves)

    def init(key: PRNGKey) -> AnnealedState:
        chains = evaluated(problem, problem.random(key, count))
        return AnnealedState(chains, chains, chains, Cooling.first(config, problem.shape))

    def step(key: PRNGKey, state: AnnealedState) -> tuple[AnnealedState, Info]:
        chains, cycle_best, best, cooling = state
        draw = Draw.of(key, count, move)
        start = cooling.begins

        def child(grid: Array, mate: Array, fresh: Array, words: Array) -> Array:
            varied = move.apply(words, grid, mate)
            new, rank = fresh_grid(problem, fresh)
            return problem.repair(jnp.where(start, new, varied.grid), jnp.where(start, rank, varied.dirty))

        grids = jax.vmap(child)(chains.grids, mates(draw, state), draw.fresh, draw.move)
        children = evaluated(problem, grids)
        temperature = cooling.temperature(config, problem.shape)
        chains = taken(start | accepts(draw.accept, temperature, chains.fitness, children.fitness), children, chains)
        cycle_best = taken(start | (children.fitness < cycle_best.fitness), children, cycle_best)
        best = taken(children.fitness < best.fitness, children, best)
        info = Info(best_fitness=best.fitness.min(), elite_count=jnp.int32(count))
        return AnnealedState(chains, cycle_best, best, cooling.after(grows=True)), info

    def elites(state: AnnealedState) -> Elites:
        return all_of(state.best)

    return Optimizer(init, step, elites, evaluations_per_step=count)
