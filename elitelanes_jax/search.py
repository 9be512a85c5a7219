"""One call from a key to evolved road networks."""

import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Int8, Int32, Key, UInt32

from elitelanes_jax._util.checks import check_named, is_whole, whole
from elitelanes_jax._util.config import Config
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.settings import record
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.counts import Metrics
from elitelanes_jax.network.metrics import unstack_counts
from elitelanes_jax.network.weights import Weights
from elitelanes_jax.optimizers.base import Info, Optimizer
from elitelanes_jax.optimizers.presets import PRESETS, find_preset, make_optimizer
from elitelanes_jax.optimizers.run import advance, seed_keys, start
from elitelanes_jax.problem.archive import VACANT
from elitelanes_jax.problem.constraints import Bounds, bounds_of, parse_ranges, satisfies
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor
from elitelanes_jax.problem.limits import check_ranges, find_limits
from elitelanes_jax.problem.road_problem import Problem, road_problem
from elitelanes_jax.problem.template import Template
from elitelanes_jax.selection import choose_maps
from elitelanes_jax.spec import GenerateSpec, SearchSpec

__all__ = ["History", "MeasuredElites", "Result", "RunState", "evolve"]

# Between two compiled calls the progress is shown and a run can be interrupted: the seconds that a call should take,
# and the most generations that it has.
_SECONDS_A_CALL = 0.2
_MOST = 256


class MeasuredElites(NamedTuple):
    """The grids that a run has found, in N places, some of which may be vacant.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``, lower is better; the largest int32 in a vacant place.
      descriptor: int32 ``[N, D]``, the values of the axes' metrics.
      valid: bool ``[N]``, which places hold a grid; the rest of a vacant place is meaningless.
      metrics: `Metrics` of arrays ``[N]``, the ones that the fitness is made of.
    """

    grids: Int8[Array, "*S N H W"]
    fitness: Int32[Array, "*S N"]
    descriptor: Int32[Array, "*S N D"]
    valid: Bool[Array, "*S N"]
    metrics: Metrics

    def __repr__(self) -> str:
        """Returns types and shapes in a line, as arrays would flood a notebook."""
        return _in_short(self)


class History(NamedTuple):
    """A run by generation, as NumPy arrays.

    Attributes:
      generation: int ``[G]``, counted from 1.
      evaluations: int ``[G]``, grids that one seed's steps have evaluated so far.
      best_fitness: int32 ``[G]``, the lowest among the elites.
      elite_count: int32 ``[G]``, the number of elites: filled niches, or the grids that the method keeps.
      evaluations_per_second: float ``[G]``, of all seeds together, measured.
    """

    generation: Int[np.ndarray, " G"]
    evaluations: Int[np.ndarray, " G"]
    best_fitness: Int32[np.ndarray, "*S G"]
    elite_count: Int32[np.ndarray, "*S G"]
    evaluations_per_second: Float[np.ndarray, " G"]

    def __repr__(self) -> str:
        """Returns types and shapes in a line, as arrays would flood a notebook."""
        return _in_short(self)


class RunState(NamedTuple):
    """The state that a run continues from, beside its key and settings; arrays only.

    Attributes:
      generation: int32, generations done.
      inner: the optimiser's own state.
      fingerprint: uint32, of the key and the settings, against continuing with others by mistake.
    """

    generation: Int32[Array | np.ndarray, ""]
    inner: Any
    fingerprint: UInt32[Array | np.ndarray, ""]

    def __repr__(self) -> str:
        """Returns types and shapes in a line, as arrays would flood a notebook."""
        return _in_short(self)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Result:
    """The result of `evolve`; a pytree.

    Attributes:
      elites: the grids found, with their metrics.
      history: of the generations of this call.
      state: to continue from.
      spec: of the search.
      axes: of the descriptor.
    """

    elites: MeasuredElites
    history: History
    state: RunState
    spec: SearchSpec = field(metadata={"static": True})
    axes: tuple[Axis, ...] = field(metadata={"static": True})

    def best(self) -> Int8[Array, "*S H W"]:
        """Returns the grid of lowest fitness, int8 ``[H, W]``; among equals the one in the first place."""
        ranked = jnp.where(self.elites.valid, self.elites.fitness, VACANT)
        place = jnp.argmin(ranked, axis=-1)[..., None, None, None]
        return jnp.take_along_axis(self.elites.grids, place, axis=-3)[..., 0, :, :]

    def satisfies(self) -> Bool[np.ndarray, "*S N"]:
        """Tells which elites are in all the ranges of the specification, exactly."""
        metrics = {name: np.asarray(values) for name, values in self.elites.metrics._asdict().items()}
        return np.asarray(self.elites.valid) & satisfies(metrics, self.spec.where)

    def maps(self, count: int = 16, *, where: Any = (), seed: int = 0) -> list[RoadMap]:
        """Chooses maps that are valid, different and spread over the niches, as the command ``generate`` does.

        Args:
          count: the most maps; fewer are returned where there are no more.
          where: ranges that the maps are in, as `evolve` takes them, beside those of the search; one of a feature that
            the search has a range of takes its place.
          seed: of the run, to be noted in the maps.

        Returns:
          Maps with their metrics, sorted by niche, within one by fitness; see `choose_maps`.

        Raises:
          InputError: for a bad count or range.
        """
        ranges = {item.name: item for item in (*self.spec.where, *parse_ranges(where))}
        elites = self.elites
        if elites.valid.ndim == 1:
            elites = jax.tree.map(lambda array: array[None], elites)
        result = replace(self, elites=elites, spec=self.spec.but({"where": tuple(ranges.values())}))
        return choose_maps(result, check_named("count", whole(1), count), seed).maps

    def __repr__(self) -> str:
        """Returns what was searched for and what was found, in a few lines."""
        fitness, (height, width) = self.elites.fitness, self.elites.grids.shape[-2:]
        if not hasattr(fitness, "__array__") or isinstance(fitness, jax.core.Tracer):
            return f"Result(elites={self.elites!r}, spec={self.spec!r})"
        valid, seeds = np.asarray(self.elites.valid), 1 if fitness.ndim == 1 else len(fitness)
        best = f"the best with fitness {np.asarray(fitness)[valid].min()}" if valid.any() else "none valid"
        spent = self.history.evaluations[-1] if len(self.history.evaluations) else 0
        axes = " ".join(f"{axis.metric}:{axis.bins}:{axis.width}" for axis in self.axes)
        where = " ".join(map(str, self.spec.where))
        return "\n".join(
            [
                f"Result of {self.spec.method}, preset {self.spec.preset}: {height} x {width} tiles, "
                f"{seeds} {'seed' if seeds == 1 else 'seeds'}, {spent:,} evaluations each",
                f"  elites   {valid.sum():,} in {valid.size:,} places, {best}",
                f"  axes     {axes}",
                *([f"  where    {where}"] if where else []),
                "  fields   elites, history, state, spec, axes",
                "  methods  best(): the fittest grid; maps(count, where=...): chosen maps; satisfies()",
            ]
        )


def evolve(
    key: int | Key[Array, "*S"] | UInt32[Array, "*S 2"] = 0,
    shape: tuple[int, int] = (12, 12),
    *,
    seeds: int | None = None,
    spec: SearchSpec = SearchSpec(),
    config: Config | None = None,
    optimizer: Callable[[Problem], Optimizer] | None = None,
    state: RunState | None = None,
    progress: bool | None = None,
    **options: Any,
) -> Result:
    """Evolves road networks.

    Args:
      key: one `jax.random.key`, or an array of keys ``[S]``: many seeds in one compiled call, and a leading seed axis
        ``[S, ...]`` in everything that is returned, but for the counts and the speed in the history. With JAX's default
        kind of key a seed gives the same result alone and among others, bit for bit. Or a whole number, the command's
        ``--seed``.
      shape: (height, width) of the grids, each at least 2.
      seeds: how many runs, where `key` is a whole number; by default 8, as the command makes.
      spec: the search.
      config: settings of a method in place of a preset's; its type says which method.
      optimizer: a factory of your own, `Problem` -> `Optimizer`, in place of a method's.
      state: of an earlier result, to continue from. 100 generations and 100 more are 200, bit for bit.
      progress: whether to show a progress bar, off a terminal a line every 30 seconds; by default in a terminal or
        notebook, when a run takes over a second.
      **options: fields of `SearchSpec`, in place of those of `spec`.

    Raises:
      InputError: for an argument out of its range, or a state of a run with another key or other settings.
    """
    keys, single = _check_keys(key, seeds)
    shape = check_shape(shape, new=True)
    spec = check_named("spec", record(SearchSpec), spec)
    spec, config = _resolve_config(spec.but(options), config, "method" in options)
    program, numbers = _prepare(spec, shape, config, optimizer)
    fingerprint = _fingerprint(program, numbers, keys)
    done, inner = 0, None
    if state is not None:
        done, inner = _restore(state, program, numbers, keys, fingerprint, single)
    per_step = program.optimizer(numbers).evaluations_per_step
    last = done + (-(-spec.evaluations // per_step) if spec.generations is None else spec.generations)
    with Progress(f"{spec.method} {shape[0]}x{shape[1]}", last, "generations", done=done, shown=progress) as bar:
        if state is None:
            with bar.doing("compiling"):
                inner = _start(program, numbers, keys)
        inner, history = _run(program, numbers, keys, inner, done, last, per_step, bar)
        with bar.doing("compiling"):
            elites, inner = _collect(program, numbers, inner, single)
    if single:
        history = history._replace(best_fitness=history.best_fitness[0], elite_count=history.elite_count[0])
    return Result(elites, history, RunState(np.array(last, np.int32), inner, fingerprint), spec, program.axes)


def _in_short(record: Any) -> str:
    """Returns the fields of a record of arrays, each with its type and shape, in a line."""
    fields = (
        f"{name} {value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else f"{name} {type(value).__name__}"
        for name, value in record._asdict().items()
    )
    return f"{type(record).__name__}({', '.join(fields)})"


class _Numbers(NamedTuple):
    """The settings that may change without a second compilation."""

    weights: Weights
    bounds: Bounds
    config: tuple[Any, ...]  # the leaves that are traced
    initial: Int8[np.ndarray, "N H W"] | None


class _Program(NamedTuple):
    """The settings that a compiled run is made for; hashable."""

    shape: tuple[int, int]
    axes: tuple[Axis, ...]
    alphabet: tuple[int, ...]
    fill: bool
    fix: Template | None
    bounded: bool
    config: Any  # the tree of the configuration; None for an optimiser of the user's
    factory: Callable[[Problem], Optimizer] | None

    def optimizer(self, numbers: _Numbers) -> Optimizer:
        problem = road_problem(
            self.shape,
            self.axes,
            alphabet=self.alphabet,
            weights=numbers.weights,
            fill=self.fill,
            bounds=numbers.bounds if self.bounded else None,
            fix=self.fix,
            initial=numbers.initial,
        )
        if self.factory is not None:
            return self.factory(problem)
        return make_optimizer(problem, jax.tree.unflatten(self.config, numbers.config))


def _check_keys(key: Any, seeds: int | None) -> tuple[Key[Array, " S"], bool]:
    """Returns the keys as an array ``[S]``, and whether there was one key alone."""
    if is_whole(key):
        seeds = GenerateSpec.seeds if seeds is None else seeds
        return seed_keys(check_named("key", whole(0, 2**32 - 1), key), check_named("seeds", whole(1), seeds)), False
    if seeds is not None:
        raise InputError(f"seeds: expected it with a whole number as key, as keys say how many they are, got {seeds!r}")
    if isinstance(key, jax.Array) and key.dtype == jnp.uint32 and key.ndim and key.shape[-1] == 2:
        key = jax.random.wrap_key_data(key)
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise InputError(f"key: expected a jax.random.key or an array of them, got {key!r}")
    if key.ndim > 1 or key.size == 0:
        raise InputError(f"key: expected one key or keys [S] with S at least 1, got shape {key.shape}")
    return jnp.atleast_1d(key), key.ndim == 0


def _resolve_config(spec: SearchSpec, config: Config | None, named: bool) -> tuple[SearchSpec, Config]:
    """Returns the specification and the configuration, each after the other: a configuration says which method."""
    if config is None:
        return spec, PRESETS[spec.method, spec.preset]
    method, preset = find_preset(config)
    if named and method != spec.method:
        raise InputError(f"config: expected settings of {spec.method}, got {type(config).__name__}")
    config = config.checked()
    for leaf in jax.tree.leaves(config):
        if isinstance(leaf, jax.Array | np.ndarray):
            raise InputError(f"config: expected plain numbers, got an array of shape {leaf.shape}")
    return spec.but({"method": method, "preset": preset}), config


def _prepare(
    spec: SearchSpec, shape: tuple[int, int], config: Config, factory: Callable[[Problem], Optimizer] | None
) -> tuple[_Program, _Numbers]:
    """Parts a search's settings into those that a program is compiled for and those that it takes."""
    spec.check_on(shape, "shape")
    if factory is None:  # one of the user's may make any grids
        full = ("dead_ends", "empty_cells") if spec.fills and spec.fix is None else ()
        limits = find_limits(shape, certain=dict.fromkeys(full, 0), fix=spec.fix)
        check_ranges(spec.where, limits, f"repaired grids of {shape[0]} x {shape[1]}")
    leaves, tree = jax.tree.flatten(config)
    program = _Program(
        shape=shape,
        axes=spec.axes_on(shape),
        alphabet=spec.alphabet or ROAD_ALPHABET,
        fill=spec.fills,
        fix=spec.fix,
        bounded=bool(spec.where),
        config=tree if factory is None else None,
        factory=factory,
    )
    numbers = _Numbers(
        weights=Weights(*(np.asarray(weight, np.int32) for weight in spec.all_weights)),
        bounds=bounds_of(spec.where),
        config=tuple((np.int32 if is_whole(leaf) else np.float32)(leaf) for leaf in leaves) if factory is None else (),
        initial=np.array(spec.initial, np.int8) if spec.initial else None,
    )
    return program, numbers


def _fingerprint(program: _Program, numbers: _Numbers, keys: Key[Array, " S"]) -> UInt32[np.ndarray, ""]:
    factory = getattr(program.factory, "__qualname__", type(program.factory).__name__)
    said = repr(
        (program._replace(factory=None), factory, [leaf.tolist() for leaf in jax.tree.leaves(numbers)], str(keys.dtype))
    )
    return np.array(zlib.crc32(said.encode() + np.asarray(jax.random.key_data(keys)).tobytes()), np.uint32)


def _restore(
    state: Any, program: _Program, numbers: _Numbers, keys: Key[Array, " S"], fingerprint: Any, single: bool
) -> tuple[int, Any]:
    """Returns the generation and the optimiser's states of a `RunState`, with the seeds in front."""
    if not isinstance(state, RunState):
        raise InputError(f"state: expected the state of a result of evolve, got {type(state).__name__}")
    inner = jax.tree.map(lambda array: jnp.asarray(array)[None], state.inner) if single else state.inner
    expected = _start.eval_shape(program, numbers, keys)
    kinds = [
        [(leaf.shape, leaf.dtype) for leaf in jax.tree.leaves(tree)] + [jax.tree.structure(tree)]
        for tree in (inner, expected)
    ]
    if int(state.fingerprint) != int(fingerprint) or kinds[0] != kinds[1]:
        raise InputError(
            f"state: expected one of this run ({program.shape[0]} x {program.shape[1]}, seeds: {keys.size}), "
            "got one of a run with another key or other settings"
        )
    return int(state.generation), inner


def _run(
    program: _Program,
    numbers: _Numbers,
    keys: Key[Array, " S"],
    states: Any,
    done: int,
    last: int,
    per_step: int,
    bar: Progress,
) -> tuple[Any, History]:
    """Runs the generations after `done` call by call; returns the states and the history with the seeds in front."""
    generation = np.arange(done + 1, last + 1)
    best, counts = [np.zeros((0, keys.size), np.int32)], [np.zeros((0, keys.size), np.int32)]
    speeds: list[float] = []
    stretch = _MOST // 2
    if done < last:
        with bar.doing("compiling"):
            jax.block_until_ready(_advance(program, numbers, keys, states, done + 1, done))  # runs nothing
    while done < last:
        count = min(stretch, last - done)
        began = time.perf_counter()
        states, info = _advance(program, numbers, keys, states, done + 1, done + count)
        best.append(np.asarray(info.best_fitness)[:count])
        counts.append(np.asarray(info.elite_count)[:count])
        seconds = time.perf_counter() - began
        done += count
        speeds += [count * per_step * keys.size / seconds] * count
        elites = float(counts[-1][-1].mean())
        bar.update(done, f"best {best[-1][-1].min():,}, {elites:,.0f} elites, {speeds[-1]:,.0f} evaluations/s")
        stretch = int(min(max(count * _SECONDS_A_CALL / seconds, 1), 2 * stretch, _MOST))
    evaluations = generation * per_step
    return states, History(generation, evaluations, np.concatenate(best).T, np.concatenate(counts).T, np.array(speeds))


# The first populations are made once: to compile that twice as fast is worth more than to run it.
@partial(jax.jit, static_argnames="program", compiler_options={"xla_backend_optimization_level": 0})
def _start(program: _Program, numbers: _Numbers, keys: Array) -> Any:
    return start(program.optimizer(numbers), keys)


@partial(jax.jit, static_argnames="program")
def _advance(
    program: _Program, numbers: _Numbers, keys: Array, states: Any, first: int | Array, last: int | Array
) -> tuple[Any, Info]:
    return advance(program.optimizer(numbers), keys, states, first, last, most=_MOST)


@partial(jax.jit, static_argnames=("program", "single"))
def _collect(program: _Program, numbers: _Numbers, states: Any, single: bool) -> tuple[MeasuredElites, Any]:
    """Returns the elites and the states; where there was one key alone, both without the axis of seeds."""
    elites = jax.vmap(program.optimizer(numbers).elites)(states)
    measured = MeasuredElites(
        grids=elites.grids,
        fitness=elites.fitness,
        descriptor=compute_descriptor(elites.counts, program.axes),
        valid=elites.valid,
        metrics=unstack_counts(elites.counts, program.shape[0] * program.shape[1]),
    )
    return jax.tree.map(lambda array: array[0], (measured, states)) if single else (measured, states)
