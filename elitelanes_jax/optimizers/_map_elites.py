"""MAP-Elites: the evolutionary loop with an archive (paper, algorithm "Evolutionary Algorithm with MAP-Elites")."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Int8, UInt32

from elitelanes_jax._util.checks import one_of
from elitelanes_jax._util.pytrees import pytree, static
from elitelanes_jax._util.records import Record, nested
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.optimizers._mutations import paper_mutation
from elitelanes_jax.optimizers._population import (
    EvolutionConfig,
    Population,
    breed,
    random_population,
    select,
    survivors,
    tournament,
)
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.problem.archive import Archive, empty_archive, insert
from elitelanes_jax.problem.problem import Problem


@pytree
@dataclass(frozen=True)
class MapElitesConfig(Record):
    """Settings; the defaults are the preset `paper`, with parents from the archive they are `standard`. A pytree.

    Attributes:
      loop: of the evolutionary loop.
      parents: "population" draws them by tournament from a population beside the archive, as the paper does;
        "archive" uniformly from the filled niches, as MAP-Elites is usually defined; static, it chooses the program.
    """

    loop: EvolutionConfig = nested(EvolutionConfig())
    parents: Literal["population", "archive"] = static("population", one_of("population", "archive"))


class MapElitesState(NamedTuple):
    """The state that is carried from step to step.

    Attributes:
      population: sorted, best first; where parents come from the archive, the first population and no other.
      archive: the best of all grids evaluated so far, by niche.
    """

    population: Population
    archive: Archive


def map_elites(problem: Problem, config: MapElitesConfig = MapElitesConfig()) -> Optimizer:
    """Makes MAP-Elites on the problem's descriptor space. The first population enters the archive too.

    Args:
      problem: with a shape, an alphabet, a fitness and axes.
      config: the defaults are the preset `paper`.
    """
    loop = config.loop
    mutation = paper_mutation(problem.alphabet, loop.tile_rate, loop.crossing_rate)

    def init(key: Array) -> MapElitesState:
        population = random_population(problem, key, loop.population)
        vacant = empty_archive(problem.axes, problem.shape, columns=problem.columns)
        archive = insert(vacant, problem.axes, *population)
        return MapElitesState(population, archive)

    def step(key: Array, state: MapElitesState) -> tuple[MapElitesState, Info]:
        population, archive = state
        bits = random_bits(key, (loop.offspring, loop.tournament + mutation.bits))
        if config.parents == "archive":
            parents = _draw_elites(bits[:, 0], archive)
        else:
            parents = tournament(bits[:, : loop.tournament], population)
        offspring = breed(problem, mutation, bits[:, loop.tournament :], parents)
        if config.parents == "population":
            population = survivors(loop, population, offspring)
        archive = insert(archive, problem.axes, *offspring)
        info = Info(best_fitness=archive.fitness.min(), elite_count=archive.valid.sum(dtype=jnp.int32))
        return MapElitesState(population, archive), info

    def elites(state: MapElitesState) -> Elites:
        return Elites(*state.archive, valid=state.archive.valid)

    def receive(state: MapElitesState, found: Elites) -> MapElitesState:
        better = found.fitness < state.archive.fitness
        return state._replace(archive=select(better, Archive(*found[:3]), state.archive))

    return Optimizer(init, step, elites, evaluations_per_step=loop.offspring, receive=receive)


def _draw_elites(bits: UInt32[Array, " count"], archive: Archive) -> Int8[Array, "count H W"]:
    """Draws grids from filled niches, each equally likely."""
    rank = jnp.cumsum(archive.valid, dtype=jnp.int32)
    drawn = randint(bits, rank[-1])
    return archive.grids[jnp.searchsorted(rank, drawn, side="right")]
