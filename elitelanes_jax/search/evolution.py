"""One call from a key to evolved road networks."""

import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from hashlib import sha256
from inspect import unwrap
from pathlib import Path
from typing import NamedTuple, TypeVar, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key, UInt32

from elitelanes_jax._util.checks import SEED, check_named, flag, instance, is_whole, none_or, real
from elitelanes_jax._util.errors import InputError, NotEnoughMemoryError, pluralize, shorten
from elitelanes_jax._util.folders import locked
from elitelanes_jax._util.memory import free_memory, in_gigabytes
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Plain, Pytree, UserValue
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.records import METRIC_NAMES, Weights
from elitelanes_jax.optimizers.base import Optimizer
from elitelanes_jax.optimizers.loop import check_state, seed_key_data
from elitelanes_jax.optimizers.presets import (
    PRESETS,
    Config,
    config_to_plain,
    find_preset,
    user_moves,
    with_moves,
)
from elitelanes_jax.problem.bounds import check_ranges, find_bounds
from elitelanes_jax.problem.kernels import Fitness, Kernel, apply_fitness, check_fitness, check_kernels, digest
from elitelanes_jax.problem.problem import Problem
from elitelanes_jax.problem.ranges import Range, range_limits
from elitelanes_jax.search._checkpoint import Checkpoint
from elitelanes_jax.search._devices import choose_devices, cut, divide, join
from elitelanes_jax.search._programs import MOST, Programs, States, Static, Traced, find_programs
from elitelanes_jax.search.result import History, Result, RunState, SearchInterrupted, check_can_save
from elitelanes_jax.search.spec import CUSTOM, METHODS, SEEDS, SearchOptions, SearchSpec, check_seeds

T = TypeVar("T")

# The seconds that a compiled call should take. Between two calls the progress is shown and a run can be interrupted.
_SECONDS_A_CALL = 0.2

# With less free memory, in bytes, the compiler ends the whole process. At 12 x 12, 0.1 GB are too few, 0.3 GB enough.
_COMPILER = 200_000_000

_OF_SEEDS = ("best_fitness", "elite_count", "refused")  # the arrays of a history with an axis of seeds


def evolve(
    key: int | Key[Array, "*S"] = 0,
    shape: tuple[int, int] = (12, 12),
    *,
    seeds: int | None = None,
    spec: SearchSpec = SearchSpec(),
    config: Config | None = None,
    optimizer: Callable[[Problem], Optimizer] | None = None,
    state: RunState | None = None,
    checkpoint: str | Path | None = None,
    every: float = 60.0,
    progress: bool | None = None,
    devices: int | Sequence[jax.Device] | None = None,
    features: Mapping[str, Kernel] | None = None,
    fitness: Fitness | None = None,
    moves: Mapping[str, UserValue] | None = None,
    **options: Unpack[SearchOptions],
) -> Result:
    """Evolves road networks.

    Args:
      key: one `jax.random.key`; or an array of keys ``[S]``, to run many seeds in one compiled call; or a whole number,
        which is the command's ``--seed``. With an array or a number, all arrays of the result have a leading seed axis
        ``[S, ...]``, except the counts and the speed in the history. With JAX's default kind of key, each seed gives
        the same result alone and among others, bit for bit.
      shape: (height, width) of the grids, each at least 2.
      seeds: the number of runs, if `key` is a whole number; defaults to 8, as in the command.
      spec: the search.
      config: a configuration of a method, instead of a preset; its type determines the method.
      optimizer: your own factory, `Problem` -> `Optimizer`, instead of a method.
      state: of an earlier result, to continue from. 100 generations and 100 more equal 200, bit for bit.
      checkpoint: a folder for the result so far, in ``result.npz`` for `Result.load`. If the process is killed, the
        same call resumes and returns the same result, bit for bit except for the measured speeds. A larger budget
        extends the search. Only one process at a time can use the folder.
      every: seconds between two checkpoints; 0 writes one after every compiled call. Writing takes at most a twentieth
        of the time.
      progress: whether to show progress, in a terminal a line that changes, elsewhere a line every 30 seconds. By
        default it is shown in a terminal or notebook, if a run takes over a second.
      devices: the devices that share the seeds (processor cores, GPUs or TPU cores; a device may be repeated), or their
        number; defaults to all local ones. The result is the same, bit for bit.
      features: your own features by name: functions of one grid, int8 ``[H, W]``, that return an integer scalar, less
        than 2**30 in size. `where`, `axes` and `weights` can use their names. They are compiled, so they must be pure.
      fitness: your own fitness: a function of any of the arguments ``metrics``, ``features``, ``grid`` and ``usual``,
        that returns a scalar; see `Fitness`. ``lambda usual, metrics: usual + 50 * metrics.turns`` adds to the usual
        fitness. Ranges in `where` add their penalty to it. A grid with a feature or a fitness that is out of range, or
        not a number, becomes no elite; the history counts these grids.
      moves: other weights of moves, such as ``{"mirror": 0}``, and your own moves with their weights, such as
        ``{"zigzag": (4, zigzag)}``; see `MoveWeights.with_moves`. For the tuned methods.
      **options: options of `SearchSpec`, which override those of `spec`.

    Raises:
      InputError: for an argument out of its range, a state or a checkpoint of a run with another key or other options,
        or a checkpoint that another process uses.
      SearchInterrupted: at Ctrl-C, after the first generation; a `KeyboardInterrupt` whose ``result`` is the result so
        far. A checkpoint has this result too, if the search took ten seconds.
      NotEnoughMemoryError: a `MemoryError`, if the search does not fit into the free memory.
    """
    extensions = {"features": features, "fitness": fitness, "moves": moves, "config": config, "optimizer": optimizer}
    search = _check(key, shape, spec, options, seeds=seeds, devices=devices, **extensions)
    done, inner = (0, None) if state is None else _restore(state, search)
    check_named("progress", none_or(flag), progress)
    every = check_named("every", real(0), every)
    if checkpoint is None:
        return _evolve(search, done, inner, None, progress)
    folder = Path(checkpoint)
    check_can_save(search.programs.states)
    with locked(folder, folder):
        return _evolve(search, done, inner, Checkpoint(folder, _identity(search, done), every), progress)


def compile_search(key: Key[Array, " S"], shape: tuple[int, int], spec: SearchSpec, *, compiles: bool = True) -> None:
    """Prepares what `evolve` with these arguments runs, so that it finds the programs; in another thread, for instance.

    Without `compiles`, programs on disk are loaded, and nothing is traced or compiled.

    Raises:
      NotEnoughMemoryError: as `evolve`.
    """
    search = _check(key, shape, spec, {})
    programs = search.programs
    if compiles or programs.kept:
        _check_memory(programs.memory, len(search.keys), shape)
        generations = spec.steps(programs.evaluations_per_step) + 1 - programs.first_generation
        programs.prepare(starts=True, generations=generations, runs=False, compiles=compiles)


def _check(
    key: UserValue,
    shape: tuple[int, int],
    spec: SearchSpec,
    options: Mapping[str, UserValue],
    *,
    seeds: int | None = None,
    devices: int | Sequence[jax.Device] | None = None,
    **extensions: UserValue,
) -> "_Search":
    """Checks the arguments of `evolve`, and finds the programs of the search."""
    keys, impl, single = _check_keys(key, seeds)
    shape = check_shape(shape, new=True)
    chosen = choose_devices(devices)
    if len(keys) == 1 or impl != "threefry2x32":  # the bits of other keys depend on the whole batch
        chosen = parts = chosen[:1]
    else:
        parts = divide(chosen, len(keys))
    spec, config, static, traced = prepare(spec, shape, options, **extensions)
    static = static._replace(impl=impl)
    digests = _digests(static, traced)
    static = static._replace(digests=tuple((name, digits) for name, (digits, _) in digests.items()))
    # The names of the user's functions do not count.
    numbers = [leaf.tolist() for leaf in jax.tree.leaves(traced)]
    said = repr((static._replace(factory=None, kernels=(), fitness=None), numbers))
    fingerprint = np.array(zlib.crc32(said.encode() + keys.tobytes()), np.uint32)
    programs = find_programs(static, traced, keys, single, parts, any(floats for _, floats in digests.values()))
    traced = programs.put(traced, said)
    return _Search(static, traced, keys, single, spec, config, fingerprint, parts, len(chosen), programs)


def _evolve(
    search: "_Search", first: int, inner: States | None, kept: Checkpoint | None, progress: bool | None
) -> Result:
    """Runs a search from generation `first`, or from its checkpoint; `inner` is None at generation 0."""
    spec, shape = search.spec, search.static.shape
    per_step = search.programs.evaluations_per_step
    last = first + spec.steps(per_step)
    done, parts = first, []
    if kept is not None and (before := kept.load()) is not None:
        done, inner = _restore(before.state, search)
        if done > last:
            expected, got = (f"{steps * per_step:,} evaluations ({steps} generations)" for steps in (done, last))
            raise InputError(f"{kept.folder}: expected {expected} or more, as many as are done, got {got}")
        seeded = {name: np.atleast_2d(getattr(before.history, name)) for name in _OF_SEEDS}
        parts.append(before.history._replace(**seeded))
    count = len(parts)
    resumed = bool(parts) and done == last
    with Progress(f"{spec.optimizer} {shape[0]}x{shape[1]}", last, "generations", done=done, shown=progress) as bar:
        if inner is None:
            _check_memory(search.programs.memory, len(search.keys), shape)
            done = search.programs.first_generation - 1  # -1 if the first step is generation 0
        states = None if inner is None else cut(inner, search.devices)
        try:
            with bar.doing("compiling"):
                search.programs.prepare(starts=states is None, generations=last - done)
                if states is None:
                    keys = cut(search.keys, search.devices)
                    states = search.on_parts(search.programs.start, [(search.traced, part) for part in keys])
            for after, part in _run(search, states, done, last, bar):
                parts.append(part)
                states, count = after, count + 1  # one statement, so that an interruption cannot split it
                if kept is not None and kept.due:
                    kept.save(search.result(states, parts, first))
        except KeyboardInterrupt:
            if states is None or (done < 0 and not count):
                raise
            found = partial(search.result, states, parts[:count], first)
            if kept is not None and kept.keeps_interrupted:
                kept.save(found())
            generation = first + sum(part.generation.size for part in parts[:count])
            raise SearchInterrupted(f"at generation {generation} of {last}", found) from None
        result = search.result(states, parts, first)
    if kept is not None and not resumed:
        kept.save(result)
    return result


def _check_memory(states: int, seeds: int, shape: tuple[int, int]) -> None:
    """Checks that the compiler, and the states before and after a step, fit into the free memory."""
    stats = jax.local_devices()[0].memory_stats()  # of an accelerator
    free = stats["bytes_limit"] - stats["bytes_in_use"] if stats and "bytes_limit" in stats else free_memory()
    needed = 2 * states + _COMPILER
    if needed <= free:
        return
    fitting = max(free - _COMPILER, 0) * seeds // (2 * states)
    fewer = f"{pluralize(fitting, 'seed')} at most" if fitting else "smaller maps or fewer niches"
    raise NotEnoughMemoryError(
        f"not enough memory: {pluralize(seeds, 'seed')} of {shape[0]} x {shape[1]} tiles take {in_gigabytes(needed)} "
        f"or more, and {in_gigabytes(free)} are free; {fewer} would fit"
    )


class _Search(NamedTuple):
    """One call of `evolve`, checked."""

    static: Static
    traced: Traced
    keys: UInt32[np.ndarray, "S B"]
    single: bool
    spec: SearchSpec
    config: Config | None
    fingerprint: UInt32[np.ndarray, ""]
    devices: list[jax.Device]  # of the parts
    workers: int  # the number of parts that run side by side
    programs: Programs

    def on_parts(self, program: Callable[..., T], arguments: Sequence[tuple[Pytree, ...]]) -> list[T]:
        """Calls a program with the device and the arguments of each part; returns the results in order."""
        calls = [partial(program, device, *each) for device, each in zip(self.devices, arguments, strict=False)]
        return side_by_side(calls, workers=self.workers)

    def result(self, states: Sequence[States], parts: Sequence[History], first: int) -> Result:
        """Returns the result of the generations after `first`; states by device, the history in parts."""
        seeds = len(self.keys)
        elites, inner = self.programs.collect(self.traced, join(states, seeds))
        history = History.joined([History.empty(seeds), *parts])
        history = history._replace(best_fitness=history.best_fitness.astype(elites.fitness.dtype))
        generation = np.array(first + history.generation.size, np.int32)
        if self.single:
            history = history._replace(**{name: getattr(history, name)[0] for name in _OF_SEEDS})
        state = RunState(generation, inner, self.fingerprint)
        return Result(elites, history, state, self.spec, self.static.axes, self.config, self.static.digests)


def _check_keys(key: UserValue, seeds: int | None) -> tuple[UInt32[np.ndarray, "S B"], str, bool]:
    """Returns the data of the keys, their implementation, and whether there was one key alone."""
    if is_whole(key):
        key = check_named("key", SEED, key)
        count = check_named("seeds", check_seeds, SEEDS if seeds is None else seeds)
        return seed_key_data(key, np.arange(count)), THREEFRY, False
    if not isinstance(key, jax.Array) or not jnp.issubdtype(key.dtype, jax.dtypes.prng_key):
        raise InputError(f"key: expected a whole number, a jax.random.key or an array of them, got {key!r}")
    if seeds is not None:
        raise InputError(f"seeds: expected none with keys, because each key is a seed, got {seeds!r}")
    if key.ndim > 1 or key.size == 0:
        raise InputError(f"key: expected one key or keys [S] with S at least 1, got shape {key.shape}")
    data = np.asarray(jax.random.key_data(key))
    return data.reshape(-1, data.shape[-1]), str(jax.random.key_impl(key)), key.ndim == 0


def prepare(
    spec: SearchSpec,
    shape: tuple[int, int],
    options: Mapping[str, UserValue],
    *,
    config: Config | None = None,
    optimizer: Callable[[Problem], Optimizer] | None = None,
    features: Mapping[str, Kernel] | None = None,
    fitness: Fitness | None = None,
    moves: Mapping[str, UserValue] | None = None,
) -> tuple[SearchSpec, Config | None, Static, Traced]:
    """Checks the options of a search, and divides them into static and traced arguments of its programs.

    Returns:
      The specification, which says what makes the result; the configuration, None for an optimizer; and both arguments.
    """
    spec = check_named("spec", instance(SearchSpec), spec)
    for option, argument in (("size", "shape"), ("seed", "key")):  # as the command calls them
        if option in options:
            raise InputError(f"{option}: expected it as {argument}={options[option]!r}, got {option}=")
    kernels = check_kernels(features, shape)
    given = dict(options) if features is None else {**options, "features": tuple(kernels)}
    spec = (spec.replace(**given) if given else spec).on(shape)
    exact = True
    if optimizer is not None:
        if not callable(optimizer):
            expected = "a function from a problem to an Optimizer (method= takes names)"
            raise InputError(f"optimizer: expected {expected}, got {shorten(repr(optimizer))}")
        if config is not None:
            raise InputError(f"config: expected none with an optimizer, got {shorten(repr(config), 60)}")
        spec = spec if spec.method in METHODS else spec.replace(method="map-elites", preset="tuned")
    elif config is not None:
        if any(isinstance(leaf, jax.Array | np.ndarray) for leaf in jax.tree.leaves(config)):
            raise InputError(f"config: expected plain numbers, got an array in {config}")
        method, preset, exact = find_preset(config)
        if "method" in options and method != spec.method:
            raise InputError(f"config: expected one of {spec.method}, got {type(config).__name__}")
        spec = spec.replace(method=method, preset=preset)
    spec.check_on(shape, "shape")
    config = None if optimizer is not None else config or PRESETS[spec.method, spec.preset]
    unknown = [name for name in spec.features if name not in kernels]
    if unknown:
        raise InputError(
            f"features: expected the kernel of {unknown[0]}, as evolve(features={{name: kernel}}), got none"
        )
    if optimizer is None:  # a user's optimiser may make any grids
        with spec.naming_origins():
            _check_ranges(spec.where, shape, spec.repair_fills and spec.fix is None)
    for name, function in [("optimizer", optimizer), ("fitness", fitness), *kernels.items()]:
        if not _is_hashable(function):
            raise InputError(f"{name}: expected a function with a hash, got {shorten(repr(function))}")
    if fitness is not None:
        check_fitness(fitness, shape, (*METRIC_NAMES, *spec.measured))
    if moves is not None:
        if config is None:
            raise InputError("moves: expected a method with moves, such as preset tuned, got an optimizer")
        config = with_moves(config, moves)
        exact = exact and find_preset(config)[2]
    leaves, structure = jax.tree.flatten(config)
    static = Static(
        shape=shape,
        axes=spec.axes_on(shape),
        alphabet=spec.alphabet or ROAD_ALPHABET,
        fill=spec.repair_fills,
        fix=spec.fix,
        bounded=bool(spec.where),
        config=None if config is None else structure,
        factory=optimizer,
        measured=spec.measured,
        kernels=tuple((name, kernels[name]) for name in spec.measured if name in kernels),
        fitness=fitness,
    )
    traced = Traced(
        weights=Weights(*(np.asarray(weight, np.int32) for weight in spec.all_weights)),
        limits=range_limits(spec.where, (*METRIC_NAMES, *spec.measured)),
        config=tuple((np.int32 if is_whole(leaf) else np.float32)(leaf) for leaf in leaves),
        initial=np.array(spec.initial, np.int8) if spec.initial else None,
        feature_weights=None if spec.feature_weights is None else np.array(spec.feature_weights, np.int32),
    )
    if optimizer is not None:
        spec = spec.replace(method=CUSTOM, preset=_name_of(optimizer), axes=static.axes)
    elif not exact:
        spec = spec.replace(preset=CUSTOM, axes=static.axes)
    return spec, config, static, traced


def _is_hashable(value: UserValue) -> bool:
    try:
        hash(value)
    except TypeError:
        return False
    return True


def _name_of(factory: Callable[..., Optimizer]) -> str:
    """Returns the module and the name of a function, or of the type of a callable object."""
    while isinstance(factory, partial):
        factory = factory.func
    named = unwrap(factory) if hasattr(factory, "__qualname__") else type(factory)
    return f"{named.__module__}.{named.__qualname__}"


@lru_cache(maxsize=32)
def _check_ranges(where: tuple[Range, ...], shape: tuple[int, int], filled: bool) -> None:
    """Checks ranges against the bounds of the metrics of a search's grids; raises `InputError`."""
    limits = find_bounds(shape, dict.fromkeys(("dead_ends", "empty_cells") if filled else (), 0))
    check_ranges(where, limits, f"repaired grids of {shape[0]} x {shape[1]}")


def _digests(static: Static, traced: Traced) -> dict[str, tuple[str, bool]]:
    """Returns what `digest` finds of the user's functions, by name, because an edited function keeps its name.

    They are traced at every call, because a global or an attribute that a function reads may have changed.
    """
    if static.factory is not None:
        leaves, structure = jax.tree.flatten(traced)
        numbers = tuple(jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves)
        return {"optimizer": _digest_optimizer(static, structure, numbers)}
    grid = jax.ShapeDtypeStruct(static.shape, jnp.int8)
    found = {name: digest(kernel, grid) for name, kernel in static.kernels}
    if static.fitness is not None:
        names = (*METRIC_NAMES, *static.measured)
        kinds = [(static.shape, jnp.int8), ((len(names),), jnp.int32), ((), jnp.int32)]
        arguments = [jax.ShapeDtypeStruct((1, *shape), dtype) for shape, dtype in kinds]
        found["fitness"] = digest(partial(apply_fitness, static.fitness, names), *arguments)
    for name, move in user_moves(jax.tree.unflatten(static.config, traced.config)).items():
        found[name] = digest(move.apply, jax.ShapeDtypeStruct((move.bits,), jnp.uint32), grid, grid)
    return found


@lru_cache(maxsize=32)
def _digest_optimizer(static: Static, structure: Pytree, numbers: tuple[jax.ShapeDtypeStruct, ...]) -> tuple[str, bool]:
    """Returns what `digest` finds of the user's optimiser, which takes up to a second to trace.

    `structure` and `numbers` are the structure, shapes and dtypes of the program's other arguments.
    """
    traced = jax.tree.unflatten(structure, numbers)
    key = jax.eval_shape(partial(jax.random.key, impl=static.impl), 0)
    return digest(partial(_call_all, static), traced, key)


def _call_all(static: Static, traced: Traced, key: Array) -> Pytree:
    optimizer = static.optimizer(traced)
    state = check_state(optimizer.init(key))
    return optimizer.step(key, state), optimizer.elites(state), optimizer.evaluations_per_step


def _identity(search: _Search, first: int) -> dict[str, Plain]:
    """Returns all that a search depends on except its budget, plain values for JSON."""
    options = search.spec.to_plain()
    del options["evaluations"], options["generations"], options["style"]
    return {
        "search": options,
        "size": search.static.shape,
        "config": None if search.config is None else config_to_plain(search.config),
        "functions": dict(search.static.digests),
        "seeds": len(search.keys),
        "keys": sha256(search.keys.tobytes()).hexdigest()[:16],
        "fingerprint": int(search.fingerprint),
        "after": first,
        "versions": installed_versions(),
    }


def _restore(state: Pytree, search: _Search) -> tuple[int, States]:
    """Returns the generation and the optimiser's states of a `RunState`, with an axis of seeds."""
    if not isinstance(state, RunState):
        raise InputError(f"state: expected the state of a result of evolve, got {type(state).__name__}")
    if not jax.tree.leaves(state.inner):
        raise InputError("state: expected one to continue from, got that of a result that was saved without its state")
    arrays = tuple(jnp.asarray(array)[None if search.single else ...] for array in jax.tree.leaves(state.inner))
    kinds = [[(leaf.shape, leaf.dtype) for leaf in those] for those in (arrays, search.programs.states)]
    if int(state.fingerprint) != int(search.fingerprint) or kinds[0] != kinds[1]:
        rows, columns = search.static.shape
        raise InputError(
            f"state: expected one of this run ({rows} x {columns}, seeds: {len(search.keys)}), "
            "got one of a run with another key, other options or functions"
        )
    return int(state.generation), arrays


def _run(
    search: _Search, states: list[States], done: int, last: int, bar: Progress
) -> Iterator[tuple[list[States], History]]:
    """Runs the generations after `done` call by call; yields the states by device and the history, seeds first."""
    seeds, keys, stretch = len(search.keys), cut(search.keys, search.devices), MOST // 2
    per_step, advance = search.programs.evaluations_per_step, search.programs.advance

    while done < last:
        count = min(stretch, last - done)
        began = time.perf_counter()
        span = done + 1, done + count
        parts = [(search.traced, key, state, *span) for key, state in zip(keys, states, strict=True)]
        states, infos = [list(each) for each in zip(*search.on_parts(advance, parts), strict=True)]
        best, elites, refused = (
            np.concatenate([getattr(info, name) for info in infos], axis=1)[:count, :seeds] for name in _OF_SEEDS
        )
        seconds = time.perf_counter() - began
        generation = np.arange(done + 1, done + count + 1)
        speeds = np.full(count, count * per_step * seeds / seconds)
        done += count
        words = f"best {best[-1].min():,}, {elites[-1].mean():,.0f} elites, {speeds[-1]:,.0f} evaluations/s"
        bar.update(done, words + (f", {refused[-1].sum():,} refused" if refused[-1].any() else ""))
        rows = (generation, generation * per_step, best, elites, speeds, refused)
        yield states, History(*(each[generation > 0].T for each in rows))
        stretch = int(min(max(count * _SECONDS_A_CALL / seconds, 1), 2 * stretch, MOST))
