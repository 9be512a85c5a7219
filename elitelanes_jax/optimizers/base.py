"""The convention that all optimisers share: a record of three pure functions, no base class."""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from chex import Array, PRNGKey

from elitelanes_jax.evolution import Population

__all__ = ["Elites", "Info", "Optimizer", "all_of"]


class Info(NamedTuple):
    """What a step reports. It is not carried on: what a step needs of its past is in the state.

    Attributes:
      best_fitness: int32, the lowest among the elites after the step.
      elite_count: int32, how many there are: niches filled for an archive, else as many as the method keeps.
    """

    best_fitness: Array
    elite_count: Array


class Elites(NamedTuple):
    """What an optimiser has found, in places some of which may be vacant.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``.
      counts: int32 ``[N, M]``, the `counts_of` metrics.
      valid: bool ``[N]``, which places hold a grid; the rest of a vacant place is meaningless.
    """

    grids: Array
    fitness: Array
    counts: Array
    valid: Array


def all_of(population: Population) -> Elites:
    """All of a population as elites."""
    return Elites(
        population.grids, population.fitness, population.counts, valid=jnp.ones(population.fitness.shape, bool)
    )


class Optimizer(NamedTuple):
    """One algorithm on one problem.

    Keys are consumed. A step takes one generation; all it does follows from its key and the state, so that steps can
    be the body of `jax.lax.scan`, and `jax.vmap` over keys runs many seeds at once.

    Attributes:
      init: key -> state.
      step: (key, state) -> (state, `Info`).
      elites: state -> `Elites`.
      evaluations_per_step: int, how many grids a step evaluates.
    """

    init: Callable[[PRNGKey], Any]
    step: Callable[[PRNGKey, Any], tuple[Any, Info]]
    elites: Callable[[Any], Elites]
    evaluations_per_step: int
