"""MAP-Elites: the evolutionary loop with an archive (paper, algorithm "Evolutionary Algorithm with MAP-Elites")."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from chex import Array, PRNGKey

from elitelanes_jax.archive import Archive, empty_archive, insert
from elitelanes_jax.draws import below, random_words
from elitelanes_jax.evolution import (
    EvolutionConfig,
    Population,
    breed,
    random_population,
    survivors,
    tournament,
)
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.problem import Problem
from elitelanes_jax.variation import paper_mutation

__all__ = ["MapElitesConfig", "MapElitesState", "map_elites"]


class MapElitesConfig(NamedTuple):
    """Settings; the defaults are the preset `paper`.

    loop: of the evolutionary loop.
    parents: "population" draws them by tournament from a population beside the archive, as the paper does;
      "archive" uniformly from the filled niches, as MAP-Elites is usually defined.
    """

    loop: EvolutionConfig = EvolutionConfig()
    parents: Literal["population", "archive"] = "population"


class MapElitesState(NamedTuple):
    """population: sorted, best first.  archive: the best of all grids evaluated so far, by niche."""

    population: Population
    archive: Archive


def map_elites(problem: Problem, config: MapElitesConfig = MapElitesConfig()) -> Optimizer:  # noqa: B008
    """MAP-Elites on the problem's descriptor space. The first population enters the archive too.

    Args:
      problem: with a shape, an alphabet, a fitness and axes.
      config: the defaults are the preset `paper`.
    """
    loop = config.loop
    mutate = paper_mutation(problem.alphabet, loop.tile_rate, loop.crossing_rate)

    def init(key: PRNGKey) -> MapElitesState:
        population = random_population(problem, key, loop.population)
        archive = empty_archive(problem.axes, problem.shape)
        return MapElitesState(population, insert(archive, problem.axes, *population))

    def step(key: PRNGKey, state: MapElitesState) -> tuple[MapElitesState, Info]:
        words = random_words(key, (loop.offspring, loop.tournament + mutate.words))
        if config.parents == "archive":
            parents = _uniform(words[:, 0], state.archive)
        else:
            parents = tournament(words[:, : loop.tournament], state.population)
        offspring = breed(problem, mutate, words[:, loop.tournament :], parents)
        state = MapElitesState(
            survivors(loop, state.population, offspring),
            insert(state.archive, problem.axes, *offspring),
        )
        return state, Info(state.archive.fitness.min(), state.archive.filled.sum(dtype=jnp.int32))

    def elites(state: MapElitesState) -> Elites:
        return Elites(*state.archive, valid=state.archive.filled)

    return Optimizer(init, step, elites, loop.offspring)


def _uniform(words: Array, archive: Archive) -> Array:
    """Grids int8 ``[count, H, W]`` from filled niches, each equally likely, by words uint32 ``[count]``."""
    rank = jnp.cumsum(archive.filled)
    drawn = below(words, rank[-1])
    return archive.grids[jnp.searchsorted(rank, drawn, side="right")]
