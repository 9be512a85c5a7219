"""MAP-Elites: the evolutionary loop with an archive.

The algorithm is the paper's "Evolutionary Algorithm with MAP-Elites".
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import one_of
from elitelanes_jax._util.records import Record, nested, static
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.optimizers._emitters import draw_true
from elitelanes_jax.optimizers._mutations import paper_mutation
from elitelanes_jax.optimizers._population import (
    EvolutionConfig,
    breed,
    random_population,
    survivors,
    tournament,
)
from elitelanes_jax.optimizers.base import Info, Optimizer, check_arguments, count_refused
from elitelanes_jax.problem.archive import Population, insert
from elitelanes_jax.problem.problem import Problem


@pytree
@dataclass(frozen=True)
class MapElitesConfig(Record):
    """Options of MAP-Elites; the defaults are the preset `paper`.

    The preset `standard` draws parents from the archive. A pytree.

    Attributes:
      loop: options of the evolutionary loop.
      parents: "population" draws parents by tournament from a population beside the archive, as the
        paper does. "archive" draws them uniformly from the filled niches, as MAP-Elites is usually
        defined. Static: it chooses the program.
    """

    loop: EvolutionConfig = nested(EvolutionConfig())
    parents: Literal["population", "archive"] = static(
        "population", one_of("population", "archive")
    )


class MapElitesState(NamedTuple):
    """The population and the archive.

    Attributes:
      population: the population, best first; if parents come from the archive, always the first
        population.
      archive: the best grid of each niche so far.
    """

    population: Population
    archive: Population


@name_wrong_arguments
@runs_jax
def map_elites(problem: Problem, config: MapElitesConfig = MapElitesConfig()) -> Optimizer:
    """Makes MAP-Elites on the problem's descriptor space.

    The first population is also inserted into the archive. The problem has at least one axis;
    otherwise `InputError` is raised. The default configuration is the preset `paper`.
    """
    check_arguments(problem, config, MapElitesConfig)
    loop = config.loop
    mutation = paper_mutation(problem.alphabet, loop.tile_rate, loop.crossing_rate)

    def init(key: Array) -> MapElitesState:
        population = random_population(problem, key, loop.population)
        vacant = problem.empty_archive(population.fitness.dtype)
        return MapElitesState(
            population, insert(vacant, problem.niche(population.features), population)
        )

    def step(key: Array, state: MapElitesState) -> tuple[MapElitesState, Info]:
        population, archive = state
        bits = random_bits(key, (loop.offspring, loop.tournament + mutation.bits))
        if config.parents == "archive":
            # One number draws a filled niche. A tournament would need several.
            parents = archive.grids[draw_true(bits[:, 0], archive.valid)]
        else:
            parents = tournament(bits[:, : loop.tournament], population)
        offspring = breed(problem, mutation, bits[:, loop.tournament :], parents)
        if config.parents == "population":
            population = survivors(loop, population, offspring)
        # All offspring are offered to the archive, also those that do not survive.
        archive = insert(archive, problem.niche(offspring.features), offspring)
        info = Info(
            archive.fitness.min(), archive.valid.sum(dtype=jnp.int32), count_refused(offspring)
        )
        return MapElitesState(population, archive), info

    return Optimizer.of(
        init, step, lambda state: state.archive, evaluations_per_step=loop.offspring
    )
