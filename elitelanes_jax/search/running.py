"""Runs a resolved search on the devices of this process.

`evolve_search` takes these steps:

1. `prepare_search` finds the three programs of the search, see `_programs`, and divides the seeds
   among devices.
2. `_evolve` makes the states of generation 0, or takes those of an earlier result or checkpoint.
3. `_advance` runs the generations in compiled calls of about 0.2 seconds. Each call changes the
   states, and adds a piece to the history.
4. `PreparedSearch.result` collects the elites from the states.

Steps 2 and 3 keep the seeds in parts of equal size. Each part has a device, and a call of a program
runs one part. A device may have several parts. Step 4 joins the parts. The parts that workers of an
executor run are other ones, see `elitelanes_jax.search.parts`.
"""

import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32

from elitelanes_jax._util.checks import check_named, flag, none_or, path, real
from elitelanes_jax._util.errors import (
    InputError,
    NotEnoughMemoryError,
    pluralize,
    warn_user,
)
from elitelanes_jax._util.folders import locked
from elitelanes_jax._util.memory import free_memory, in_gigabytes
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.threads import side_by_side
from elitelanes_jax._util.types import Plain, Pytree
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.optimizers.presets import Config, config_to_plain
from elitelanes_jax.search._checkpoint import Checkpoint
from elitelanes_jax.search._devices import choose_devices, cut, device_of_each_part, join
from elitelanes_jax.search._programs import MOST_GENERATIONS, Programs, States, find_programs
from elitelanes_jax.search._setup import Setup, make_setup
from elitelanes_jax.search._user_functions import (
    Extensions,
    check_extensions,
    digest_functions,
    find_config,
    record_method,
)
from elitelanes_jax.search.keys import SearchKeys
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.result import (
    History,
    Result,
    RunState,
    SearchInterrupted,
    check_can_save,
)

T = TypeVar("T")

# The seconds that a compiled call should take. Between two calls the progress is shown and a run
# can be interrupted.
_SECONDS_A_CALL = 0.2

# With less free memory, in bytes, the compiler ends the whole process. At 12 x 12, 0.1 GB are too
# few, 0.3 GB enough.
_COMPILER = 200_000_000


def evolve_search(
    search: Search,
    keys: SearchKeys,
    extensions: Extensions = Extensions(),
    *,
    state: RunState | None = None,
    checkpoint: str | Path | None = None,
    every: float = 60.0,
    progress: bool | None = None,
    devices: int | Sequence[jax.Device] | None = None,
) -> Result:
    """Runs a resolved search. The other arguments, and the errors, are those of `evolve`."""
    check_named("progress", none_or(flag), progress)
    every = check_named("every", real(0), every)
    run = prepare_search(search, keys, extensions, choose_devices(devices))
    generation = 0
    states = None
    if state is not None:
        generation, states = _restore(state, run)
    if checkpoint is None:
        return _evolve(run, generation, states, None, progress)
    folder = Path(check_named("checkpoint", path, checkpoint))
    # A state that cannot be saved is refused here. The first checkpoint may be a minute away.
    check_can_save(run.programs.states)
    with locked(folder, folder):
        file = Checkpoint(folder, _identity(run, generation), every)
        return _evolve(run, generation, states, file, progress)


@runs_jax
def compile_search(search: Search, keys: SearchKeys) -> None:
    """Compiles what `evolve_search` with these arguments runs, so that it finds the programs.

    Call it in another thread, for instance.

    Raises:
      MemoryError: as `evolve`.
    """
    run = prepare_search(search, keys, Extensions(), choose_devices())
    facts = run.programs.facts
    _check_memory(run.programs.memory, len(keys.data), search.shape)
    # This is the number that `_evolve` prepares for, because it decides how far the programs are
    # optimised. The evaluations are counted there, when they are made.
    generations = search.steps(facts.evaluations_per_step) + 1 - facts.first_generation
    run.programs.prepare(starts=True, generations=generations, counts=False)


@dataclass(frozen=True)
class PreparedSearch:
    """A search that is ready to run: its programs, keys and devices.

    Attributes:
      search: the resolved search. Its method and preset say what makes the result.
      config: the configuration of the method; None for the user's own optimiser.
      setup: the setup of the programs.
      keys: the keys of all seeds.
      fingerprint: uint32, a checksum of the setup and the keys. Only a state with the same one can
        be continued.
      programs: the programs of the search.
      numbers: the numbers of the setup, on the default device.
      devices: the device of each part of the seeds; a device comes as often as it has parts.
      workers: the number of parts that run side by side.
    """

    search: Search
    config: Config | None
    setup: Setup
    keys: SearchKeys
    fingerprint: UInt32[np.ndarray, ""]
    programs: Programs
    numbers: tuple[Array, ...]
    devices: list[jax.Device]
    workers: int

    @property
    def seeds(self) -> int:
        return len(self.keys.data)

    def on_parts(
        self, program: Callable[..., T], arguments: Sequence[tuple[Pytree, ...]]
    ) -> list[T]:
        """Calls a program with the device and the arguments of each part.

        Returns the results in order.
        """
        calls = []
        # With fewer seeds than devices, there are fewer parts than devices.
        for device, part in zip(self.devices, arguments, strict=False):
            calls.append(partial(program, device, self.numbers, *part))
        return side_by_side(calls, workers=self.workers)

    def result(self, states: Sequence[States], histories: Sequence[History], first: int) -> Result:
        """Returns the result of the generations after `first`.

        There are states for each part, and a history for each compiled call.
        """
        elites, inner = self.programs.collect(self.numbers, join(states, self.seeds))
        # A search without generations has no histories, but its history has an axis of seeds too.
        history = History.joined([History.empty(self.seeds), *histories])
        # The empty history has int32. Joined with it, a fitness of float32 becomes float64.
        history = history._replace(best_fitness=history.best_fitness.astype(elites.fitness.dtype))
        generation = np.array(first + history.generation.size, np.int32)
        if self.keys.single:
            # `collect` has removed the axis of seeds from the other arrays.
            history = history._replace(
                best_fitness=history.best_fitness[0],
                elite_count=history.elite_count[0],
                refused=history.refused[0],
            )
        state = RunState(generation, inner, self.fingerprint)
        return Result(elites, history, state, self.search, self.config, self.setup.digests)


def prepare_search(
    search: Search, keys: SearchKeys, extensions: Extensions, devices: Sequence[jax.Device]
) -> PreparedSearch:
    """Checks the user's functions, and finds the programs of a search. Compiles nothing."""
    check_extensions(search, extensions)
    config = find_config(search, extensions)
    setup = make_setup(
        search,
        config,
        keys.kind,
        factory=extensions.optimizer,
        kernels=extensions.kernels,
        fitness=extensions.fitness,
    )
    # With the digests in its structure, the setup of an edited function finds other programs.
    digests = digest_functions(setup)
    digits = [(name, digest.digits) for name, digest in digests.items()]
    setup = replace(setup, digests=tuple(digits))
    uses_floats = any(digest.uses_floats for digest in digests.values())
    # Seeds can be divided only if a seed draws the same bits alone and among others. The bits of
    # keys of other kinds depend on the whole batch.
    is_one_part = len(keys.data) == 1 or keys.kind != THREEFRY
    if is_one_part:
        devices = [devices[0]]
        devices_of_parts = [devices[0]]
    else:
        devices_of_parts = device_of_each_part(devices, len(keys.data))
    programs = find_programs(setup, keys.data, keys.single, devices_of_parts, uses_floats)
    # The budget and the devices are not part of the fingerprint, so both may change when a run is
    # continued.
    fingerprint = zlib.crc32(_describe(setup).encode() + keys.data.tobytes())
    return PreparedSearch(
        search=record_method(search, config, extensions),
        config=config,
        setup=setup,
        keys=keys,
        fingerprint=np.array(fingerprint, np.uint32),
        programs=programs,
        numbers=programs.put_numbers(setup, fingerprint),
        devices=devices_of_parts,
        workers=len(devices),
    )


def _describe(setup: Setup) -> str:
    """Returns all that matters of a setup as a text; the names of the user's functions do not."""
    numbers, structure = jax.tree.flatten(setup.without_functions())
    return repr((structure, [number.tolist() for number in numbers]))


def _evolve(
    run: PreparedSearch,
    first: int,
    inner: States | None,
    checkpoint: Checkpoint | None,
    progress: bool | None,
) -> Result:
    """Runs a search from generation `first`, or from its checkpoint.

    `inner` is None at generation 0.
    """
    # The budget counts from the user's state. A checkpoint is an earlier part of the same budget.
    last = first + run.search.steps(run.programs.facts.evaluations_per_step)
    # `first` is the generation of the user's state, or 0. The next generation to run is always
    # `generation` + 1.
    generation = first
    histories: list[History] = []
    if checkpoint is not None:
        earlier = checkpoint.load()
        if earlier is not None:
            # An earlier call with the same user's state wrote the checkpoint after that state,
            # therefore it replaces the user's state.
            generation, inner = _restore(earlier.state, run)
            _check_budget(run, checkpoint, generation, last)
            histories.append(_with_seed_axis(earlier.history))
    # A complete checkpoint is not written again.
    was_complete = bool(histories) and generation == last
    # The number of histories that belong to `states`. An interruption may come after a history was
    # added and before its states are assigned.
    complete = len(histories)
    height, width = run.search.shape
    label = f"{run.search.optimizer} {height}x{width}"
    with Progress(label, last, "generations", done=generation, shown=progress) as bar:
        states: list[States] | None = None
        if inner is None:
            _check_memory(run.programs.memory, run.seeds, run.search.shape)
            # This is -1 if generation 0 is a step of its own, which evaluates the initial grids.
            generation = run.programs.facts.first_generation - 1
        else:
            states = cut(inner, run.devices)
        try:
            with bar.doing("compiling"):
                run.programs.prepare(starts=states is None, generations=last - generation)
                if states is None:
                    states = _start(run)
            for later_states, history in _advance(run, states, generation, last, bar):
                histories.append(history)
                # One statement, so that an interruption cannot split it.
                states, complete = later_states, complete + 1
                if checkpoint is not None and checkpoint.is_due():
                    checkpoint.save(run.result(states, histories, first))
            result = run.result(states, histories, first)
            if checkpoint is not None and not was_complete:
                checkpoint.save(result)
        except KeyboardInterrupt:
            # Before its evaluation in generation 0, no grid is an elite.
            has_no_grids = generation < 0 and not complete
            if states is None or has_no_grids:
                raise
            raise _interrupted(run, states, histories[:complete], first, last, checkpoint) from None
    _warn_of_refused(result)
    return result


def _with_seed_axis(history: History) -> History:
    """Returns a history with an axis of seeds, which the history of one key lacks."""
    return history._replace(
        best_fitness=np.atleast_2d(history.best_fitness),
        elite_count=np.atleast_2d(history.elite_count),
        refused=np.atleast_2d(history.refused),
    )


def _start(run: PreparedSearch) -> list[States]:
    """Returns the first states of all seeds, by part."""
    keys_by_part = cut(run.keys.data, run.devices)
    return run.on_parts(run.programs.start, [(keys,) for keys in keys_by_part])


def _interrupted(
    run: PreparedSearch,
    states: Sequence[States],
    histories: Sequence[History],
    first: int,
    last: int,
    checkpoint: Checkpoint | None,
) -> SearchInterrupted:
    """Returns what an interrupted search raises; a long one has written its checkpoint before."""
    make_result = partial(run.result, states, histories, first)
    if checkpoint is not None and checkpoint.keeps_interrupted:
        checkpoint.save(make_result())
    generation = first + sum(history.generation.size for history in histories)
    return SearchInterrupted(f"at generation {generation} of {last}", make_result)


def _warn_of_refused(result: Result) -> None:
    """Warns the user if no grid became an elite because grids were refused."""
    refused = int(result.history.refused.sum())
    if refused and not np.asarray(result.elites.valid).any():
        reason = "their fitness or a feature is not a finite number or is too large"
        warn_user(f"the result has no elites: {refused:,} grids were refused, because {reason}")


def _check_budget(run: PreparedSearch, checkpoint: Checkpoint, generation: int, last: int) -> None:
    """Raises `InputError` if a checkpoint has more generations than the budget."""
    if generation <= last:
        return
    per_step = run.programs.facts.evaluations_per_step
    expected = f"{generation * per_step:,} evaluations ({generation} generations)"
    got = f"{last * per_step:,} evaluations ({last} generations)"
    raise InputError(
        f"{checkpoint.folder}: expected {expected} or more, as many as are done, got {got}"
    )


def _check_memory(states: int, seeds: int, shape: tuple[int, int]) -> None:
    """Checks that a search fits into the free memory.

    It needs room for the compiler, and for the states before and after a step.
    """
    free = _free_memory_of_device()
    needed = 2 * states + _COMPILER
    if needed <= free:
        return
    height, width = shape
    search = f"{pluralize(seeds, 'seed')} of {height} x {width} tiles"
    fitting_seeds = max(free - _COMPILER, 0) * seeds // (2 * states)
    hint = "smaller maps or fewer niches would fit"
    if fitting_seeds:
        hint = f"{pluralize(fitting_seeds, 'seed')} at most would fit"
    figures = f"{search} take {in_gigabytes(needed)} or more, and {in_gigabytes(free)} are free"
    raise NotEnoughMemoryError(f"not enough memory: {figures}; {hint}")


def _free_memory_of_device() -> int:
    """Returns the free bytes of the default device.

    An accelerator has its own memory. Otherwise the memory is the machine's.
    """
    stats = jax.local_devices()[0].memory_stats()
    if stats and "bytes_limit" in stats:
        return stats["bytes_limit"] - stats["bytes_in_use"]
    return free_memory()


def _identity(run: PreparedSearch, first: int) -> dict[str, Plain]:
    """Returns all that a search depends on except its budget, plain values for JSON."""
    options = run.search.to_plain()
    # A larger budget extends a search. The options of a style are in the others, so its name does
    # not matter.
    del options["evaluations"], options["generations"], options["style"]
    config = None
    if run.config is not None:
        config = config_to_plain(run.config)
    return {
        "search": options,
        "size": run.search.shape,
        "config": config,
        "functions": dict(run.setup.digests),
        "seeds": run.seeds,
        "keys": sha256(run.keys.data.tobytes()).hexdigest()[:16],
        "fingerprint": int(run.fingerprint),
        "after": first,
        "versions": installed_versions(),
    }


def _restore(state: Pytree, run: PreparedSearch) -> tuple[int, States]:
    """Returns the generation and the optimiser's states of a `RunState`, with an axis of seeds."""
    if not isinstance(state, RunState):
        raise InputError(
            f"state: expected the state of a result of evolve, got {type(state).__name__}"
        )
    if not jax.tree.leaves(state.inner):
        raise InputError(
            "state: expected one to continue from, "
            "got that of a result that was joined or saved without its state"
        )
    arrays = [jnp.asarray(leaf) for leaf in jax.tree.leaves(state.inner)]
    if run.keys.single:
        arrays = [array[None] for array in arrays]
    # The fingerprint alone would accept a state whose arrays were cut or converted.
    state_kinds = [(array.shape, array.dtype) for array in arrays]
    run_kinds = [(leaf.shape, leaf.dtype) for leaf in run.programs.states]
    if int(state.fingerprint) != int(run.fingerprint) or state_kinds != run_kinds:
        rows, columns = run.search.shape
        expected = f"one of this run ({rows} x {columns}, seeds: {run.seeds})"
        got = "one of a run with another key, other options or functions"
        raise InputError(f"state: expected {expected}, got {got}")
    return int(state.generation), tuple(arrays)


class _Rows(NamedTuple):
    """What the generations of one call report, generations first: arrays ``[G, S]``."""

    best_fitness: np.ndarray
    elite_count: np.ndarray
    refused: np.ndarray


def _advance(
    run: PreparedSearch, states: list[States], generation: int, last: int, bar: Progress
) -> Iterator[tuple[list[States], History]]:
    """Runs the generations after `generation` call by call.

    Yields the states by part, and the history with the axis of seeds first.
    """
    keys_by_part = cut(run.keys.data, run.devices)
    per_step = run.programs.facts.evaluations_per_step
    # The number of generations of a call. The first call measures the speed. Each later call has as
    # many generations as fit into `_SECONDS_A_CALL`.
    stretch = MOST_GENERATIONS // 2
    while generation < last:
        count = min(stretch, last - generation)
        arguments = []
        for keys, part_states in zip(keys_by_part, states, strict=True):
            arguments.append((keys, part_states, generation + 1, generation + count))
        # `Programs.advance` waits for its results, so this is the time of the generations.
        began = time.perf_counter()
        advanced = run.on_parts(run.programs.advance, arguments)
        seconds = time.perf_counter() - began
        states = [part_states for part_states, _ in advanced]
        infos = [info for _, info in advanced]
        rows = _join_rows(infos, count, run.seeds)
        numbers = np.arange(generation + 1, generation + count + 1)
        speed = count * per_step * run.seeds / seconds
        generation += count
        bar.update(generation, _describe_rows(rows, speed))
        # Generation 0 evaluates the initial grids, and is no part of a history.
        is_counted = numbers > 0
        history = History(
            generation=numbers[is_counted],
            evaluations=numbers[is_counted] * per_step,
            best_fitness=rows.best_fitness[is_counted].T,
            elite_count=rows.elite_count[is_counted].T,
            evaluations_per_second=np.full(is_counted.sum(), speed),
            refused=rows.refused[is_counted].T,
        )
        yield states, history
        fitting = count * _SECONDS_A_CALL / seconds
        # A call that was fast by chance may no more than double the next one.
        stretch = int(min(max(fitting, 1), 2 * stretch, MOST_GENERATIONS))


def _join_rows(infos: Sequence[Pytree], count: int, seeds: int) -> _Rows:
    """Joins the reports of all parts.

    The last parts may repeat a seed, and calls have room for more generations.
    """
    fields = []
    for name in _Rows._fields:
        rows = np.concatenate([getattr(info, name) for info in infos], axis=1)
        fields.append(rows[:count, :seeds])
    return _Rows._make(fields)


def _describe_rows(rows: _Rows, speed: float) -> str:
    best = rows.best_fitness[-1].min()
    elites = rows.elite_count[-1].mean()
    refused = rows.refused[-1].sum()
    words = f"best {best:,}, {elites:,.0f} elites, {speed:,.0f} evaluations/s"
    if refused:
        words += f", {refused:,} refused"
    return words
