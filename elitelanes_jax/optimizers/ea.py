"""The evolutionary algorithm (paper, section "Evolutionary Algorithm with MAP-Elites", without the archive)."""

import jax.numpy as jnp
from chex import PRNGKey

from elitelanes_jax.draws import random_words
from elitelanes_jax.evolution import (
    EvolutionConfig,
    Population,
    breed,
    random_population,
    survivors,
    tournament,
)
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer, all_of
from elitelanes_jax.problem import Problem
from elitelanes_jax.variation import paper_mutation

__all__ = ["ea"]


def ea(problem: Problem, config: EvolutionConfig = EvolutionConfig()) -> Optimizer:  # noqa: B008
    """An evolutionary algorithm; its state is the `Population`, sorted, best first.

    Args:
      problem: with a shape, an alphabet and a fitness.
      config: the defaults are the preset `paper`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    mutate = paper_mutation(problem.alphabet, config.tile_rate, config.crossing_rate)

    def init(key: PRNGKey) -> Population:
        return random_population(problem, key, config.population)

    def step(key: PRNGKey, state: Population) -> tuple[Population, Info]:
        words = random_words(key, (config.offspring, config.tournament + mutate.words))
        parents = tournament(words[:, : config.tournament], state)
        state = survivors(config, state, breed(problem, mutate, words[:, config.tournament :], parents))
        return state, Info(best_fitness=state.fitness[0], elite_count=jnp.int32(config.population))

    def elites(state: Population) -> Elites:
        return all_of(state)

    return Optimizer(init, step, elites, evaluations_per_step=config.offspring)
