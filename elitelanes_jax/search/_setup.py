"""The problem and the method of a search, from which its programs are made.

Static parts decide the programs, and numbers are their arguments.
"""

import gc
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from threading import RLock
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Key, UInt32

from elitelanes_jax._util.checks import check_named, is_whole, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Pytree, Untyped
from elitelanes_jax.network.bits import THREEFRY, default_draws
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

START, ADVANCE, COLLECT = "start", "advance", "collect"
"""The names of the programs."""

Jitted: TypeAlias = Untyped
"""What `jax.jit` returns; JAX has no public name for its type."""

_STATIC = {"static": True}

# A thread that traces one thing may trace another on the way: a program needs the facts.
_tracing_lock = RLock()


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

    def without_functions(self) -> "Setup":
        """Returns the setup without the user's functions, whose names do not matter."""
        return replace(self, factory=None, problem=replace(self.problem, kernels=(), fitness=None))


_METHODS: dict[str, Callable[..., Pytree]] = {
    START: Setup.start,
    ADVANCE: Setup.advance,
    COLLECT: Setup.collect,
}


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


class SearchFacts(NamedTuple):
    """What is known of a search once its optimiser was traced.

    Attributes:
      evaluations_per_step: the evaluations of a generation of one seed.
      first_generation: the first generation after the start, see `Optimizer`.
      states: the shapes and dtypes of the states of a part.
    """

    evaluations_per_step: int
    first_generation: int
    states: Pytree


class TraceableSearch:
    """The programs of a setup as functions that JAX can trace, for arguments of given shapes.

    Args:
      setup: the setup; only its structure, and the shapes and dtypes of its numbers, matter.
      keys: the data of the keys of all seeds; only its shape and dtype matter.
      rows: the number of seeds of the programs that start and advance a search.
      facts: the facts of the search, if they are known.
      prefix: how the names of the programs begin.
    """

    def __init__(
        self,
        setup: Setup,
        keys: jax.ShapeDtypeStruct,
        rows: int,
        facts: SearchFacts | None,
        prefix: str,
    ) -> None:
        self._setup, self._seeds = setup, len(keys)
        self._keys = jax.ShapeDtypeStruct((rows, *keys.shape[1:]), keys.dtype)
        self._facts = facts
        # All programs keep unused arguments, so that they take the same numbers, whatever their
        # optimiser reads.
        self._programs: dict[str, Jitted] = {}
        for name, method in _METHODS.items():
            function: Untyped = partial(method)
            function.__name__ = prefix + name
            self._programs[name] = jax.jit(function, keep_unused=True)

    # Not a cached property, because Python 3.11 computes one cached property at a time, of whatever
    # object. A thread which traces and a thread which waits to trace would wait for each other.
    @property
    def facts(self) -> SearchFacts:
        """What is known of the search. Traces the optimiser if they were not given."""
        if self._facts is None:
            with _tracing():
                self._facts = self._trace_facts()
        return self._facts

    @property
    def states(self) -> Pytree:
        """The shapes and dtypes of the states of all seeds."""
        return jax.tree.map(
            lambda leaf: jax.ShapeDtypeStruct((self._seeds, *leaf.shape[1:]), leaf.dtype),
            self.facts.states,
        )

    def lower(self, program: str, sharding: jax.sharding.Sharding | None) -> jax.stages.Lowered:
        """Lowers a program for arguments of a sharding."""
        bind = partial(jax.ShapeDtypeStruct, sharding=sharding)
        arguments = jax.tree.map(
            lambda leaf: bind(leaf.shape, leaf.dtype), self._arguments(program)
        )
        with _tracing():
            return self._programs[program].lower(*arguments)

    def _arguments(self, program: str) -> tuple[Pytree, ...]:
        """Returns the shapes and dtypes of the arguments of a program."""
        if program == START:
            return self._setup, self._keys
        if program == COLLECT:
            return self._setup, self.states
        generation = jax.ShapeDtypeStruct((), jnp.int32)
        return self._setup, self._keys, self.facts.states, generation, generation

    def _trace_facts(self) -> SearchFacts:
        evaluations_per_step = first_generation = 0

        # An optimiser can only be made from numbers. This function is traced with their shapes
        # alone. The facts do not depend on numbers, and leave the function as variables.
        def read_optimizer(setup: Setup) -> None:
            nonlocal evaluations_per_step, first_generation
            optimizer = setup.make_optimizer()
            name = "optimizer: evaluations_per_step"
            evaluations_per_step = check_named(name, whole(1), optimizer.evaluations_per_step)
            first_generation = optimizer.first_generation

        jax.eval_shape(read_optimizer, self._setup)
        states = self._programs[START].eval_shape(*self._arguments(START))
        # JAX adds the devices, which differ between parts.
        states = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), states)
        return SearchFacts(evaluations_per_step, first_generation, states)


@contextmanager
def _tracing() -> Iterator[None]:
    """Lets one thread trace at a time, without Python's garbage collector.

    Threads that trace at once take turns, and all their programs come late. Tracing makes many
    lasting objects; the collector takes a tenth of the time to look through them. The user's
    functions draw as by default, so that a search can be continued under other settings of JAX.
    Without `jit` JAX would write every generation into the program, which then compiles for
    minutes.
    """
    with _tracing_lock, default_draws(), jax.disable_jit(False):
        collects = gc.isenabled()
        try:
            gc.disable()
            yield
        finally:
            if collects:
                gc.enable()
