"""The problem and the method of a search, from which its programs are made.

Static parts decide the programs, and numbers are their arguments.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key, UInt32

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Pytree, UserValue
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.network.metrics import unstack_metrics
from elitelanes_jax.network.records import Weights
from elitelanes_jax.optimizers.base import Info, Optimizer
from elitelanes_jax.optimizers.loop import advance, check_elites, over_seeds, start
from elitelanes_jax.optimizers.presets import Config, make_optimizer, user_moves
from elitelanes_jax.problem.archive import Population
from elitelanes_jax.problem.descriptor import compute_descriptor
from elitelanes_jax.problem.kernels import Fitness, Kernel
from elitelanes_jax.problem.problem import Problem
from elitelanes_jax.problem.ranges import range_limits
from elitelanes_jax.problem.road import RoadProblem, make_problem
from elitelanes_jax.search.records import MeasuredElites
from elitelanes_jax.search.resolve import Search

KeyData: TypeAlias = UInt32[Array | np.ndarray, "*S B"]
"""The data of random keys, which `jax.random.wrap_key_data` makes keys of."""

Factory: TypeAlias = Callable[[Problem], Optimizer]
"""An optimiser of the user."""

MOST_GENERATIONS = 256
"""The largest number of generations of one call."""

_STATIC = {"static": True}


@dataclass(frozen=True, kw_only=True)
class Extensions:
    """What a user adds to a search besides its options, checked.

    The fields are arguments of `evolve`.

    Attributes:
      config: a configuration in place of the preset's, or None.
      optimizer: a factory in place of a method, or None.
      kernels: the kernels of the user's features, by name.
      fitness: the fitness function of the user, or None.
      moves: the weights and moves of the user, by name, or None.
    """

    config: Config | None = None
    optimizer: Factory | None = None
    kernels: Mapping[str, Kernel] = field(default_factory=dict)
    fitness: Fitness | None = None
    moves: Mapping[str, UserValue] | None = None


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
            raise InputError("optimizer", "a function that returns an Optimizer", got)
        return optimizer

    def start(self, keys: KeyData) -> Pytree:
        """Returns the states before the first step, arrays ``[S, ...]``."""
        return start(self.make_optimizer(), self._wrap_keys(keys))

    def advance(
        self, keys: KeyData, states: Pytree, first: Int32[Array, ""], last: Int32[Array, ""]
    ) -> tuple[Pytree, Info]:
        """Runs the generations `first` to `last`, `MOST_GENERATIONS` or fewer.

        See `loop.advance`.
        """
        optimizer, keys = self.make_optimizer(), self._wrap_keys(keys)
        states, info = advance(optimizer, keys, states, first, last, most=MOST_GENERATIONS)
        # The info of a user's optimiser may have other fields too.
        return states, Info(*(getattr(info, name) for name in Info._fields))

    def collect(self, states: Pytree) -> MeasuredElites:
        """Returns the elites with their descriptor, metrics and features."""
        optimizer, problem = self.make_optimizer(), self.problem
        names = problem.feature_names

        def collect_one(state: Pytree) -> Population:
            return check_elites(optimizer.elites(state), problem.shape, len(names))

        grids, fitness, features = elites = over_seeds(collect_one, states)
        height, width = problem.shape
        return MeasuredElites(
            grids=grids,
            fitness=fitness,
            descriptor=compute_descriptor(features, names, problem.axes),
            valid=elites.valid,
            metrics=unstack_metrics(features, height * width),
            features={name: features[..., names.index(name)] for name in problem.measured},
        )

    def _wrap_keys(self, data: KeyData) -> Key[Array, "*S"]:
        return jax.random.wrap_key_data(jnp.asarray(data), impl=self.key_kind)

    def has_user_functions(self) -> bool:
        if self.factory is not None or self.problem.kernels or self.problem.fitness is not None:
            return True
        return self.config is not None and bool(user_moves(self.config))

    def describe(self) -> str:
        """Returns all that matters of the setup as a text.

        The names of the user's functions do not matter, and their digests do.
        """
        problem = replace(self.problem, kernels=(), fitness=None)
        numbers, structure = jax.tree.flatten(replace(self, factory=None, problem=problem))
        return repr((structure, [number.tolist() for number in numbers]))


def make_setup(
    search: Search, config: Config | None, key_kind: str, extensions: Extensions
) -> Setup:
    """Makes the setup of a resolved search; its numbers become arrays of NumPy.

    Args:
      search: resolved.
      config: the configuration of the method, with plain numbers and the user's moves; None for an
        optimiser of the user.
      key_kind: the implementation of the random keys.
      extensions: the user's optimiser, kernels and fitness.
    """
    feature_weights = limits = initial = None
    if search.feature_weights is not None:
        feature_weights = np.array(search.feature_weights, np.int32)
    if search.ranges:
        limits = range_limits(search.ranges, search.feature_names)
    if search.settings.initial:
        initial = np.array(search.settings.initial, np.int8)
    kernels = extensions.kernels
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
        fitness=extensions.fitness,
        weights=Weights(*(np.asarray(weight, np.int32) for weight in search.weights)),
        limits=limits,
        feature_weights=feature_weights,
        initial=initial,
    )
    numbers = jax.tree.map(_as_scalar, config)
    return Setup(problem=problem, config=numbers, factory=extensions.optimizer, key_kind=key_kind)


def _as_scalar(number: float) -> np.generic:
    # Programs are found by the dtypes of their numbers, which Python's numbers lack.
    return np.int32(number) if is_whole(number) else np.float32(number)
