"""What the programs of a search are made from: static parts and numbers.

The static parts decide the programs, and the numbers are their arguments.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, UInt32

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.network.records import Weights
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.optimizers.presets import Config, make_optimizer, user_moves
from elitelanes_jax.problem.kernels import Fitness, Kernel
from elitelanes_jax.problem.problem import Problem
from elitelanes_jax.problem.ranges import range_limits
from elitelanes_jax.problem.road import RoadProblem, make_problem
from elitelanes_jax.search.resolve import Search

KeyData: TypeAlias = UInt32[Array | np.ndarray, "*S B"]
"""The data of random keys, which `jax.random.wrap_key_data` makes keys of."""

Factory: TypeAlias = Callable[[Problem], Optimizer]
"""An optimiser of the user."""

_STATIC = {"static": True}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Setup:
    """The problem and the method of a search; a pytree.

    Searches of equal structure share compiled programs.

    Attributes:
      problem: the problem of the search.
      config: the configuration of the method; None for the user's own optimiser.
      factory: the user's own optimiser, or None.
      key_kind: the implementation of the random keys.
      digests: the digests of what the user's functions compute, by name. An edited function keeps
        its name.
    """

    problem: RoadProblem
    config: Config | None
    factory: Factory | None = field(default=None, metadata=_STATIC)
    key_kind: str = field(default=THREEFRY, metadata=_STATIC)
    digests: tuple[tuple[str, str], ...] = field(default=(), metadata=_STATIC)

    def make_optimizer(self) -> Optimizer:
        """Makes the optimiser, while a program is traced."""
        problem = make_problem(self.problem)
        if self.factory is None:
            assert self.config is not None
            return make_optimizer(problem, self.config)
        optimizer = self.factory(problem)
        if not isinstance(optimizer, Optimizer):
            got = type(optimizer).__name__
            raise InputError(f"optimizer: expected a function that returns an Optimizer, got {got}")
        return optimizer

    def wrap_keys(self, data: KeyData) -> Key[Array, "*S"]:
        return jax.random.wrap_key_data(jnp.asarray(data), impl=self.key_kind)

    def has_user_functions(self) -> bool:
        if self.factory is not None or self.problem.kernels or self.problem.fitness is not None:
            return True
        return self.config is not None and bool(user_moves(self.config))

    def without_functions(self) -> "Setup":
        """Returns the setup without the user's functions, whose names do not matter."""
        return replace(self, factory=None, problem=replace(self.problem, kernels=(), fitness=None))


def make_setup(
    search: Search,
    config: Config | None,
    key_kind: str,
    *,
    factory: Factory | None,
    kernels: Mapping[str, Kernel],
    fitness: Fitness | None,
) -> Setup:
    """Makes the setup of a resolved search; its numbers become arrays of NumPy.

    Args:
      search: resolved.
      config: the configuration of the method, with plain numbers; None for `factory`.
      key_kind: the implementation of the random keys.
      factory: the user's own optimiser, or None.
      kernels: the kernels of the user's features, by name.
      fitness: the fitness function of the user, or None.
    """
    feature_weights = limits = initial = None
    if search.feature_weights is not None:
        feature_weights = np.array(search.feature_weights, np.int32)
    if search.ranges:
        limits = range_limits(search.ranges, search.feature_names)
    if search.settings.initial:
        initial = np.array(search.settings.initial, np.int8)
    measured_kernels = [(name, kernels[name]) for name in search.measured if name in kernels]
    problem = RoadProblem(
        shape=search.shape,
        axes=search.axes,
        feature_names=search.feature_names,
        alphabet=search.alphabet,
        fill=search.fills,
        fix=search.settings.fix,
        measured=search.measured,
        kernels=tuple(measured_kernels),
        fitness=fitness,
        weights=Weights(*(np.asarray(weight, np.int32) for weight in search.weights)),
        limits=limits,
        feature_weights=feature_weights,
        initial=initial,
    )
    numbers = jax.tree.map(_as_scalar, config)
    return Setup(problem=problem, config=numbers, factory=factory, key_kind=key_kind)


def _as_scalar(number: float) -> np.generic:
    # Programs are found by the dtypes of their numbers, which Python's numbers lack.
    return np.int32(number) if is_whole(number) else np.float32(number)
