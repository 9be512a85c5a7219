"""The evolutionary algorithm (paper, section "Evolutionary Algorithm with MAP-Elites", without the archive)."""

import jax.numpy as jnp
from jaxtyping import Array

from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers._mutations import paper_mutation
from elitelanes_jax.optimizers._population import (
    EvolutionConfig,
    breed,
    random_population,
    survivors,
    tournament,
)
from elitelanes_jax.optimizers.base import Info, Optimizer, count_refused
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.problem import Problem


def ea(problem: Problem, config: EvolutionConfig = EvolutionConfig()) -> Optimizer:
    """Makes an evolutionary algorithm for a problem; its state is the `Population`, sorted, best first.

    The default configuration is the preset `paper`.
    """
    mutation = paper_mutation(problem.alphabet, config.tile_rate, config.crossing_rate)

    def init(key: Array) -> Population:
        return random_population(problem, key, config.population)

    def step(key: Array, state: Population) -> tuple[Population, Info]:
        bits = random_bits(key, (config.offspring, config.tournament + mutation.bits))
        parents = tournament(bits[:, : config.tournament], state)
        offspring = breed(problem, mutation, bits[:, config.tournament :], parents)
        state = survivors(config, state, offspring)
        return state, Info(state.fitness[0], jnp.int32(config.population), count_refused(offspring))

    return Optimizer(init, step, elites=lambda state: state, evaluations_per_step=config.offspring)
