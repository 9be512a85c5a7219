"""The convention that all optimisers share: a record of three pure functions, no base class."""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int8, Int32, Key

from elitelanes_jax._util.types import Pytree
from elitelanes_jax.optimizers._population import Population


class Info(NamedTuple):
    """The report of a step. It is not carried on: what a step needs of its past is in the state.

    Attributes:
      best_fitness: int32, the lowest among the elites after the step.
      elite_count: int32, how many elites there are: filled niches of an archive, or all grids that the method keeps.
    """

    best_fitness: Int32[Array, ""]
    elite_count: Int32[Array, ""]


class Elites(NamedTuple):
    """The grids that an optimiser has found, in places some of which may be vacant.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``.
      counts: int32 ``[N, M]``, the metrics as `stack_counts` orders them.
      valid: bool ``[N]``, which places hold a grid; the rest of a vacant place is meaningless.
    """

    grids: Int8[Array, "N H W"]
    fitness: Int32[Array, " N"]
    counts: Int32[Array, "N M"]
    valid: Bool[Array, " N"]


def as_elites(population: Population) -> Elites:
    """Returns all grids of a population as elites."""
    return Elites(*population, valid=jnp.ones(population.fitness.shape, bool))


class Optimizer(NamedTuple):
    """One algorithm on one problem.

    Keys are consumed. A step takes one generation; all it does follows from its key and the state, so that steps can
    be the body of `jax.lax.scan`, and `jax.vmap` over keys runs many seeds at once. `elitelanes_jax.optimizers.loop`
    does both.

    Attributes:
      init: key -> state, a pytree of arrays.
      step: (key, state) -> (state, `Info`).
      elites: state -> `Elites`.
      evaluations_per_step: int, how many grids a step evaluates.
      migrate: (state, `Elites`) -> state that has taken over what is better, place by place; only where there is an
        archive.
    """

    init: Callable[[Key[Array, ""]], Pytree]
    step: Callable[[Key[Array, ""], Pytree], tuple[Pytree, Info]]
    elites: Callable[[Pytree], Elites]
    evaluations_per_step: int
    migrate: Callable[[Pytree, Elites], Pytree] | None = None
