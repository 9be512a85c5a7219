"""The convention of all optimisers: a record of pure functions, no base class."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key, Real

from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.problem import Problem


class Info(NamedTuple):
    """What a step reports.

    It is not carried to the next step, because the state has what a step needs of the past.

    Attributes:
      best_fitness: the lowest fitness among the elites after the step.
      elite_count: int32, the number of elites: filled niches of an archive, or the grids that the
        method keeps. A refused grid is none.
      refused: int32, the number of grids of the step whose evaluation was out of range or not a
        number.
    """

    best_fitness: Real[Array, ""]
    elite_count: Int32[Array, ""]
    refused: Int32[Array, ""] = np.int32(0)  # type: ignore[assignment]


def check_arguments(problem: Problem, config: Record, kind: type[Record]) -> None:
    """Checks the arguments of a factory.

    The problem is a `Problem`. The configuration is of its kind and has single numbers instead of
    arrays.
    """
    check_named("problem", instance(Problem), problem)
    check_named("config", instance(kind), config)
    for path, value in jax.tree.leaves_with_path(config):
        if jnp.shape(value) != ():
            name = jax.tree_util.keystr(path).lstrip(".")
            got = f"shape {jnp.shape(value)}, which only jax.vmap maps over"
            raise InputError("config", f"one number as {name}", got)


def count_refused(evaluated: Population) -> Int32[Array, ""]:
    return (~evaluated.valid).sum(dtype=jnp.int32)


class Optimizer(NamedTuple):
    """One algorithm on one problem.

    Keys are consumed. A step is one generation and depends on its key and the state alone. Steps
    are therefore the body of a scan, and `jax.vmap` over keys runs many seeds at once. `run` does
    both::

        optimizer = ea(road_problem((12, 12)))

        def evolve_one(key):
            first, later = jax.random.split(key)
            state = optimizer.init(first)
            step = lambda state, key: optimizer.step(key, state)
            return jax.lax.scan(step, state, jax.random.split(later, 100))

        states, info = jax.vmap(evolve_one)(jax.random.split(jax.random.key(0), 8))

    Attributes:
      init: key -> state, a pytree of arrays.
      step: (key, state) -> (state, `Info`).
      elites: state -> `Population`, the grids that the optimiser has found; slots may be vacant.
      evaluations_per_step: int, the number of grids that a step evaluates.
      init_unevaluated: key -> state, or None. The grids of this state are not evaluated yet. A step
        from it evaluates them without using its key, and returns the state that `init` returns. So
        a search compiles the evaluation once, in the step, and not also in the start.
    """

    init: Callable[[Key[Array, ""]], Pytree]
    step: Callable[[Key[Array, ""], Pytree], tuple[Pytree, Info]]
    elites: Callable[[Pytree], Population]
    evaluations_per_step: int
    init_unevaluated: Callable[[Key[Array, ""]], Pytree] | None = None

    @staticmethod
    def of(
        init: Callable[..., Pytree],
        step: Callable[..., tuple[Pytree, Info]],
        elites: Callable[..., Population],
        *,
        evaluations_per_step: int,
        init_unevaluated: Callable[..., Pytree] | None = None,
    ) -> "Optimizer":
        """Makes an optimiser that runs under any settings of JAX.

        It also runs on sharded batches of seeds.
        """
        init, step, elites = (
            runs_jax(divide_batches(function)) for function in (init, step, elites)
        )
        return Optimizer(init, step, elites, evaluations_per_step, init_unevaluated)

    @property
    def first_generation(self) -> int:
        """The first generation that `start` leaves to a step.

        It is 0 if a step evaluates the initial grids, otherwise 1.
        """
        return 1 if self.init_unevaluated is None else 0
