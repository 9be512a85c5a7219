"""One call from a key to evolved road networks."""

import time
import zlib
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache, partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32, Key, UInt32

from elitelanes_jax._util.checks import check_named, is_whole, real, whole
from elitelanes_jax._util.errors import InputError, NotEnoughMemoryError, pluralize
from elitelanes_jax._util.memory import free_memory, in_gigabytes
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.records import Record, record
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Plain, Pytree, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.counts import COUNT_NAMES
from elitelanes_jax.network.metrics import unstack_counts
from elitelanes_jax.network.weights import Weights
from elitelanes_jax.optimizers.base import Elites, Info, Optimizer
from elitelanes_jax.optimizers.loop import advance, seed_keys, start
from elitelanes_jax.optimizers.presets import PRESETS, find_preset, make_optimizer
from elitelanes_jax.problem.constraints import Bounds, bounds_of
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor
from elitelanes_jax.problem.extras import Kernel, check_kernels
from elitelanes_jax.problem.limits import Limits, check_ranges, find_limits
from elitelanes_jax.problem.problem import Problem, road_problem
from elitelanes_jax.problem.template import Template
from elitelanes_jax.search._checkpoint import Checkpoint, open_checkpoint
from elitelanes_jax.search._devices import choose_devices, cut, join
from elitelanes_jax.search.elites import MeasuredElites
from elitelanes_jax.search.result import History, Result, RunState, SearchInterrupted
from elitelanes_jax.search.spec import SEEDS, SearchSpec, check_seeds

# Between two compiled calls the progress is shown and a run can be interrupted: the seconds that a call should take,
# and the most generations that it has.
_SECONDS_A_CALL = 0.2
_MOST = 256

# The bytes without which the compiler ends the whole process: 0.1 GB are too few at 12 x 12, 0.3 GB are enough.
_COMPILER = 200_000_000

# What was compiled before: threads would take longer than JAX does to find it again.
_KNOWN: set[tuple[Hashable, ...]] = set()

_OF_SEEDS = ("best_fitness", "elite_count")  # of a history


def evolve(
    key: int | Key[Array, "*S"] | UInt32[Array, "*S 2"] = 0,
    shape: tuple[int, int] = (12, 12),
    *,
    seeds: int | None = None,
    spec: SearchSpec = SearchSpec(),
    config: Record | None = None,
    optimizer: Callable[[Problem], Optimizer] | None = None,
    state: RunState | None = None,
    checkpoint: str | Path | None = None,
    every: float = 60.0,
    progress: bool | None = None,
    devices: int | Sequence[jax.Device] | None = None,
    features: Mapping[str, Kernel] | None = None,
    **options: UserValue,
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
      checkpoint: a folder that keeps the result so far, in ``result.npz`` for `Result.load`. Killed at any moment, the
        same call goes on from there and ends the same, bit for bit but for the measured speeds; one with a larger
        budget goes on further. One process at a time has the folder.
      every: seconds between two checkpoints, 0 for one after every compiled call. Writing takes at most a twentieth of
        the time.
      progress: whether to show a progress bar, off a terminal a line every 30 seconds; by default in a terminal or
        notebook, when a run takes over a second.
      devices: that the seeds are spread over, any of them more than once, or how many: of the processor's cores, GPUs
        or TPU cores; by default all local ones. The result is the same, bit for bit.
      features: measures of your own, by the name that `where`, `axes` and `weights` then take: functions from one grid,
        int8 ``[H, W]``, to an integer of JAX, 0 to 1,000,000. Pure: they are compiled with the search.
      **options: fields of `SearchSpec`, in place of those of `spec`.

    Raises:
      InputError: for an argument out of its range, a state or a checkpoint of a run with another key or other settings,
        or a checkpoint that another process is at work on.
      SearchInterrupted: at Ctrl-C, once there are first grids, a `KeyboardInterrupt` whose ``result`` is what was found
        until then. A checkpoint has it too, if the search took ten seconds.
      NotEnoughMemoryError: a `MemoryError`, where the search cannot fit into the memory that is free.
    """
    keys, single = check_keys(key, seeds)
    chosen = choose_devices(devices)
    shape = check_shape(shape, new=True)
    spec, config, program, numbers = prepare(spec, shape, config, optimizer, features, options)
    if keys.size == 1 or jax.random.key_impl(keys) != "threefry2x32":  # others' bits depend on the seeds beside them
        chosen = chosen[:1]
    search = _Search(program, numbers, keys, single, spec, _fingerprint(program, numbers, keys), chosen)
    done, inner = (0, None) if state is None else _restore(state, search)
    if checkpoint is None:
        return _evolve(search, done, inner, None, progress)
    identity = _identity(search, config, done)
    with open_checkpoint(checkpoint, identity, check_named("every", real(0), every)) as kept:
        return _evolve(search, done, inner, kept, progress)


def _evolve(search: "_Search", first: int, inner: Pytree, kept: Checkpoint | None, progress: bool | None) -> Result:
    """Runs a search from generation `first`, or from where its checkpoint is; `inner` is None at the very start."""
    per_step = int(_evaluations_per_step(search.program, search.numbers))
    spec, shape = search.spec, search.program.shape
    last = first + spec.steps(per_step)
    done, parts = first, []
    if kept is not None and (before := kept.load()) is not None:
        done, inner = _restore(before.state, search)
        if done > last:
            raise InputError(f"{kept.folder}: expected a search of {last} generations at most, got {done} done")
        seeded = {name: np.atleast_2d(getattr(before.history, name)) for name in _OF_SEEDS}
        parts.append(before.history._replace(**seeded))
    count = len(parts)
    resumed = bool(parts) and done == last
    with Progress(f"{spec.method} {shape[0]}x{shape[1]}", last, "generations", done=done, shown=progress) as bar:
        expected = search.states()
        if inner is None:
            _check_memory(expected, search.keys.size, shape)
        states = None if inner is None else cut(inner, search.devices)
        try:
            with bar.doing("compiling"):
                compiled = _compile(search, expected, starts=states is None, runs=done < last)
                if states is None:
                    states = cut(_start(search.program, search.numbers, search.keys), search.devices)
            for after, part in _run(search, compiled, states, done, last, per_step, bar):
                parts.append(part)
                states, count = after, count + 1  # in one: an interruption falls before it or after it
                if kept is not None and kept.due:
                    kept.save(search.result(states, parts, first))
        except KeyboardInterrupt:
            if states is None:  # nothing is found yet
                raise
            found = partial(search.result, states, parts[:count], first)
            if kept is not None and kept.worth_keeping:
                kept.save(found())
            generation = int(parts[count - 1].generation[-1]) if count else done
            raise SearchInterrupted(f"at generation {generation} of {last}", found) from None
        result = search.result(states, parts, first)
    if kept is not None and not resumed:
        kept.save(result)
    return result


def _check_memory(states: Pytree, seeds: int, shape: tuple[int, int]) -> None:
    """Checks that the compiler fits into the free memory, and the states twice: before and after a step."""
    stats = jax.local_devices()[0].memory_stats()  # of an accelerator
    free = stats["bytes_limit"] - stats["bytes_in_use"] if stats and "bytes_limit" in stats else free_memory()
    taken = 2 * sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(states))
    needed = taken + _COMPILER
    if needed <= free:
        return
    if free < _COMPILER:
        raise NotEnoughMemoryError(
            f"not enough memory: to compile a search takes {in_gigabytes(_COMPILER)}, and {in_gigabytes(free)} are free"
        )
    fitting = (free - _COMPILER) * seeds // taken
    fewer = f"{pluralize(fitting, 'seed')} at most" if fitting else "smaller maps or fewer niches"
    raise NotEnoughMemoryError(
        f"not enough memory: {pluralize(seeds, 'seed')} of {shape[0]} x {shape[1]} tiles take {in_gigabytes(needed)} "
        f"or more, and {in_gigabytes(free)} are free; {fewer} would fit"
    )


class Numbers(NamedTuple):
    """The settings that may change without a second compilation."""

    weights: Weights
    bounds: Bounds
    config: tuple[Pytree, ...]  # the leaves that are traced
    initial: Int8[np.ndarray, "N H W"] | None
    extra_weights: Int32[np.ndarray, " K"] | None


class Program(NamedTuple):
    """The settings that a compiled run is made for; hashable."""

    shape: tuple[int, int]
    axes: tuple[Axis, ...]
    alphabet: tuple[int, ...]
    fill: bool
    fix: Template | None
    bounded: bool
    config: Pytree  # the tree of the configuration; None for an optimiser of the user's
    factory: Callable[[Problem], Optimizer] | None
    extras: tuple[str, ...]
    kernels: tuple[tuple[str, Kernel], ...]  # those of the user's that are needed

    def optimizer(self, numbers: Numbers) -> Optimizer:
        problem = road_problem(
            self.shape,
            self.axes,
            alphabet=self.alphabet,
            weights=numbers.weights,
            fill=self.fill,
            bounds=numbers.bounds if self.bounded else None,
            extras=self.extras,
            extra_weights=numbers.extra_weights,
            features=dict(self.kernels),
            fix=self.fix,
            initial=numbers.initial,
        )
        if self.factory is not None:
            return self.factory(problem)
        return make_optimizer(problem, jax.tree.unflatten(self.config, numbers.config))


class _Search(NamedTuple):
    """One call of `evolve`, checked."""

    program: Program
    numbers: Numbers
    keys: Key[Array, " S"]
    single: bool
    spec: SearchSpec
    fingerprint: UInt32[np.ndarray, ""]
    devices: list[jax.Device]

    def states(self) -> Pytree:
        """Returns the shapes and dtypes of the states of all seeds."""
        return _start.eval_shape(self.program, self.numbers, self.keys)

    def result(self, states: Sequence[Pytree], parts: Sequence[History], first: int) -> Result:
        """Returns the result of the generations after `first`; states by device, the history in parts."""
        elites, inner = _collect(self.program, self.numbers, join(states, self.keys.size), self.single)
        history = History.joined([History.empty(self.keys.size), *parts])
        generation = np.array(first + history.generation.size, np.int32)
        if self.single:
            history = history._replace(**{name: getattr(history, name)[0] for name in _OF_SEEDS})
        return Result(elites, history, RunState(generation, inner, self.fingerprint), self.spec, self.program.axes)


def check_keys(key: UserValue, seeds: int | None) -> tuple[Key[Array, " S"], bool]:
    """Returns the keys as an array ``[S]``, and whether there was one key alone."""
    if is_whole(key):
        seeds = SEEDS if seeds is None else seeds
        return seed_keys(
            check_named("key", whole(0, 2**32 - 1), key),
            check_named("seeds", check_seeds, seeds),
        ), False
    if seeds is not None:
        raise InputError(f"seeds: expected it with a whole number as key, as keys say how many they are, got {seeds!r}")
    if isinstance(key, jax.Array) and key.dtype == jnp.uint32 and key.ndim and key.shape[-1] == 2:
        key = jax.random.wrap_key_data(key)
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise InputError(f"key: expected a whole number, a jax.random.key or an array of them, got {key!r}")
    if key.ndim > 1 or key.size == 0:
        raise InputError(f"key: expected one key or keys [S] with S at least 1, got shape {key.shape}")
    return jnp.atleast_1d(key), key.ndim == 0


def _resolve_config(spec: SearchSpec, config: Record | None, named: bool) -> tuple[SearchSpec, Record]:
    """Returns the specification and the configuration, each after the other: a configuration says which method."""
    if config is None:
        return spec, PRESETS[spec.method, spec.preset]
    method, preset = find_preset(config)
    if named and method != spec.method:
        raise InputError(f"config: expected settings of {spec.method}, got {type(config).__name__}")
    for leaf in jax.tree.leaves(config):
        if isinstance(leaf, jax.Array | np.ndarray):
            raise InputError(f"config: expected plain numbers, got an array of shape {leaf.shape}")
    return spec.replace(method=method, preset=preset), config


def prepare(
    spec: SearchSpec,
    shape: tuple[int, int],
    config: Record | None,
    factory: Callable[[Problem], Optimizer] | None,
    features: Mapping[str, Kernel] | None,
    options: Mapping[str, UserValue],
) -> tuple[SearchSpec, Record, Program, Numbers]:
    """Checks a search's settings, and parts them into those that a program is compiled for and those that it takes.

    Returns:
      The specification with the options in place, the configuration, and the two parts.
    """
    spec = check_named("spec", record(SearchSpec), spec)
    for option, argument in (("size", "shape"), ("seed", "key")):  # as the command calls them
        if option in options:
            raise InputError(f"{option}: expected it as {argument}={options[option]!r}, got {option}=")
    kernels = check_kernels(features, shape)
    given = dict(options) if features is None else {**options, "features": tuple(kernels)}
    spec, config = _resolve_config(spec.replace(**given).on(shape), config, "method" in options)
    spec.check_on(shape, "shape")
    unknown = [name for name in spec.features if name not in kernels]
    if unknown:
        raise InputError(
            f"features: expected the kernel of {unknown[0]}, as evolve(features={{name: kernel}}), got none"
        )
    if factory is None:  # one of the user's may make any grids
        check_ranges(spec.where, _limits(shape, spec.fills, spec.fix), f"repaired grids of {shape[0]} x {shape[1]}")
    leaves, tree = jax.tree.flatten(config)
    program = Program(
        shape=shape,
        axes=spec.axes_on(shape),
        alphabet=spec.alphabet or ROAD_ALPHABET,
        fill=spec.fills,
        fix=spec.fix,
        bounded=bool(spec.where),
        config=tree if factory is None else None,
        factory=factory,
        extras=spec.extras,
        kernels=tuple((name, kernels[name]) for name in spec.extras if name in kernels),
    )
    numbers = Numbers(
        weights=Weights(*(np.asarray(weight, np.int32) for weight in spec.all_weights)),
        bounds=bounds_of(spec.where, spec.extras),
        config=tuple((np.int32 if is_whole(leaf) else np.float32)(leaf) for leaf in leaves) if factory is None else (),
        initial=np.array(spec.initial, np.int8) if spec.initial else None,
        extra_weights=None if spec.extra_weights is None else np.array(spec.extra_weights, np.int32),
    )
    return spec, config, program, numbers


@lru_cache(maxsize=32)
def _limits(shape: tuple[int, int], fills: bool, fix: Template | None) -> Limits:
    """Finds the limits of the metrics of a search's grids; kept, as many searches have the same ones."""
    full = ("dead_ends", "empty_cells") if fills and fix is None else ()
    return find_limits(shape, certain=dict.fromkeys(full, 0), fix=fix)


def _fingerprint(program: Program, numbers: Numbers, keys: Key[Array, " S"]) -> UInt32[np.ndarray, ""]:
    factory = getattr(program.factory, "__qualname__", type(program.factory).__name__)
    said = repr(
        (
            program._replace(factory=None, kernels=()),
            factory,
            [leaf.tolist() for leaf in jax.tree.leaves(numbers)],
            str(keys.dtype),
        )
    )
    return np.array(zlib.crc32(said.encode() + np.asarray(jax.random.key_data(keys)).tobytes()), np.uint32)


def _identity(search: _Search, config: Record, first: int) -> dict[str, Plain]:
    """Returns all that a search depends on but its budget, plain values for JSON."""
    settings = search.spec.to_plain()
    del settings["evaluations"], settings["generations"]
    return {
        "search": settings,
        "size": search.program.shape,
        "config": asdict(config) if search.program.factory is None else None,  # type: ignore[call-overload]
        "seeds": search.keys.size,
        "keys": sha256(np.asarray(jax.random.key_data(search.keys)).tobytes()).hexdigest()[:16],
        "fingerprint": int(search.fingerprint),
        "after": first,
        "versions": installed_versions(),
    }


def _restore(state: Pytree, search: _Search) -> tuple[int, Pytree]:
    """Returns the generation and the optimiser's states of a `RunState`, with the seeds in front."""
    if not isinstance(state, RunState):
        raise InputError(f"state: expected the state of a result of evolve, got {type(state).__name__}")
    program, keys = search.program, search.keys
    arrays = [jnp.asarray(array)[None if search.single else ...] for array in jax.tree.leaves(state.inner)]
    leaves, tree = jax.tree.flatten(search.states())
    kinds = [[(leaf.shape, leaf.dtype) for leaf in those] for those in (arrays, leaves)]
    if int(state.fingerprint) != int(search.fingerprint) or kinds[0] != kinds[1]:
        raise InputError(
            f"state: expected one of this run ({program.shape[0]} x {program.shape[1]}, seeds: {keys.size}), "
            "got one of a run with another key or other settings"
        )
    return int(state.generation), jax.tree.unflatten(tree, arrays)


def _compile(search: _Search, states: Pytree, *, starts: bool, runs: bool) -> dict[jax.Device, Callable[..., Pytree]]:
    """Compiles all that a search calls, side by side; returns `_advance` by device. `states` are shapes and dtypes.

    Each is lowered in this thread, as JAX's settings may be those of this one alone. JAX keeps what was compiled of
    `_start` and `_collect` for their calls.
    """
    program, numbers = search.program, search.numbers
    advances: dict[jax.Device, jax.stages.Lowered] = {}

    def compilers() -> Iterator[Callable[[], Pytree]]:
        if starts:
            yield _start.lower(program, numbers, search.keys).compile
        yield _collect.lower(program, numbers, states, search.single).compile
        if runs:
            for keys, device in zip(cut(search.keys, search.devices), search.devices, strict=False):
                if device not in advances:
                    part = _on_device(states, keys.size, device)
                    advances[device] = _advance.lower(program, numbers, keys, part, np.int32(0), np.int32(0))
                    yield advances[device].compile

    known = (program, search.keys.size, search.single, *search.devices)
    # In threads, as an interruption does not wait for those.
    compiled = [compiler() for compiler in compilers()] if known in _KNOWN else side_by_side(compilers(), wait=False)
    _KNOWN.add(known)
    return dict(zip(advances, compiled[-len(advances) :], strict=True)) if advances else {}


def _on_device(states: Pytree, rows: int, device: jax.Device) -> Pytree:
    """Returns the shapes and dtypes of a part of `cut`, bound to its device but for the default."""
    bound = None if device == jax.local_devices()[0] else jax.sharding.SingleDeviceSharding(device)
    return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((rows, *leaf.shape[1:]), leaf.dtype, sharding=bound), states)


def _run(
    search: _Search,
    compiled: Mapping[jax.Device, Callable[..., Pytree]],
    states: list[Pytree],
    done: int,
    last: int,
    per_step: int,
    bar: Progress,
) -> Iterator[tuple[list[Pytree], History]]:
    """Runs the generations after `done` call by call; yields the states by device, and the history, seeds in front."""
    numbers, seeds = search.numbers, search.keys.size
    keys, devices = cut(search.keys, search.devices), search.devices[: len(states)]
    stretch = _MOST // 2

    def advance_part(part: int, first: int, last: int) -> tuple[Pytree, Info]:
        run = compiled[devices[part]]
        return jax.block_until_ready(run(numbers, keys[part], states[part], np.int32(first), np.int32(last)))

    while done < last:
        count = min(stretch, last - done)
        began = time.perf_counter()
        ran = side_by_side([partial(advance_part, part, done + 1, done + count) for part in range(len(states))])
        states, infos = [list(each) for each in zip(*ran, strict=True)]
        best, elites = (
            np.concatenate([getattr(info, name) for info in infos], axis=1)[:count, :seeds]
            for name in ("best_fitness", "elite_count")
        )
        seconds = time.perf_counter() - began
        generation = np.arange(done + 1, done + count + 1)
        speeds = np.full(count, count * per_step * seeds / seconds)
        done += count
        bar.update(done, f"best {best[-1].min():,}, {elites[-1].mean():,.0f} elites, {speeds[-1]:,.0f} evaluations/s")
        yield states, History(generation, generation * per_step, best.T, elites.T, speeds)
        stretch = int(min(max(count * _SECONDS_A_CALL / seconds, 1), 2 * stretch, _MOST))


@partial(jax.jit, static_argnames="program")
def _evaluations_per_step(program: Program, numbers: Numbers) -> int:
    return program.optimizer(numbers).evaluations_per_step


# What runs once, before and after the generations: to compile it twice as fast is worth more than to run it.
_ONCE = {"xla_backend_optimization_level": 0}


@partial(jax.jit, static_argnames="program", compiler_options=_ONCE)
def _start(program: Program, numbers: Numbers, keys: Array) -> Pytree:
    return start(program.optimizer(numbers), keys)


@partial(jax.jit, static_argnames="program")
def _advance(
    program: Program, numbers: Numbers, keys: Array, states: Pytree, first: int | Array, last: int | Array
) -> tuple[Pytree, Info]:
    return advance(program.optimizer(numbers), keys, states, first, last, most=_MOST)


@partial(jax.jit, static_argnames=("program", "single"), compiler_options=_ONCE)
def _collect(program: Program, numbers: Numbers, states: Pytree, single: bool) -> tuple[MeasuredElites, Pytree]:
    """Returns the elites and the states; where there was one key alone, both without the axis of seeds."""
    measured = as_measured(program, jax.vmap(program.optimizer(numbers).elites)(states))
    return jax.tree.map(lambda array: array[0], (measured, states)) if single else (measured, states)


def as_measured(program: Program, elites: Elites) -> MeasuredElites:
    """Returns elites with their descriptor, metrics and features."""
    return MeasuredElites(
        grids=elites.grids,
        fitness=elites.fitness,
        descriptor=compute_descriptor(elites.counts, program.axes),
        valid=elites.valid,
        metrics=unstack_counts(elites.counts, program.shape[0] * program.shape[1]),
        features={name: elites.counts[..., place] for place, name in enumerate(program.extras, start=len(COUNT_NAMES))},
    )
