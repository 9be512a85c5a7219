"""MAP-Elites: the evolutionary loop with an archive (paper, algorithm "Evolutionary Algorithm with MAP-Elites")."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
from chex import Array, PRNGKey

from elitelanes_jax.archive import Archive, empty_archive, insert
from elitelanes_jax.draws import below, random_words
from elitelanes_jax.errors import InputError
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
    """Settings; the defaults are the preset `paper`, with parents from the archive they are the preset `standard`.

    Attributes:
      loop: of the evolutionary loop.
      parents: "population" draws them by tournament from a population beside the archive, as the paper does;
        "archive" uniformly from the filled niches, as MAP-Elites is usually defined.
    """

    loop: EvolutionConfig = EvolutionConfig()
    parents: Literal["population", "archive"] = "population"

    def checked(self) -> "MapElitesConfig":
        """The settings with rates as floats.

        Raises:
          InputError: for a setting out of its range.
        """
        if self.parents not in ("population", "archive"):
            raise InputError(f"config: expected parents to be 'population' or 'archive', got {self.parents!r}")
        return self._replace(loop=self.loop.checked())


class MapElitesState(NamedTuple):
    """What is carried from step to step.

    Attributes:
      population: sorted, best first; where parents come from the archive, the first population and no other.
      archive: the best of all grids evaluated so far, by niche.
    """

    population: Population
    archive: Archive


def map_elites(problem: Problem, config: MapElitesConfig = MapElitesConfig()) -> Optimizer:  # noqa: B008
    """MAP-Elites on the problem's descriptor space. The first population enters the archive too.

    Args:
      problem: with a shape, an alphabet, a fitness and axes.
      config: the defaults are the preset `paper`.

    Raises:
      InputError: for a setting out of its range.
    """
    config = config.checked()
    loop = config.loop
    mutate = paper_mutation(problem.alphabet, loop.tile_rate, loop.crossing_rate)

    def store(archive: Archive, found: Population) -> Archive:
        return insert(archive, problem.axes, found.grids, found.fitness, found.counts)

    def init(key: PRNGKey) -> MapElitesState:
        population = random_population(problem, key, loop.population)
        return MapElitesState(population, store(empty_archive(problem.axes, problem.shape), population))

    def step(key: PRNGKey, state: MapElitesState) -> tuple[MapElitesState, Info]:
        population, archive = state
        words = random_words(key, (loop.offspring, loop.tournament + mutate.words))
        if config.parents == "archive":
            parents = _uniform(words[:, 0], archive)
        else:
            parents = tournament(words[:, : loop.tournament], population)
        offspring = breed(problem, mutate, words[:, loop.tournament :], parents)
        if config.parents == "population":
            population = survivors(loop, population, offspring)
        archive = store(archive, offspring)
        info = Info(best_fitness=archive.fitness.min(), elite_count=archive.filled.sum(dtype=jnp.int32))
        return MapElitesState(population, archive), info

    def elites(state: MapElitesState) -> Elites:
        archive = state.archive
        return Elites(archive.grids, archive.fitness, archive.counts, valid=archive.filled)

    return Optimizer(init, step, elites, evaluations_per_step=loop.offspring)


def _uniform(words: Array, archive: Archive) -> Array:
    """Grids int8 ``[count, H, W]`` from filled niches, each equally likely, by words uint32 ``[count]``."""
    rank = jnp.cumsum(archive.filled, dtype=jnp.int32)
    drawn = below(words, rank[-1])
    return archive.grids[jnp.searchsorted(rank, drawn, side="right")]
