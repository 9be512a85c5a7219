"""Runs a resolved search on the devices of this process.

`evolve_search` takes these steps:

1. `prepare_run` finds the three programs of the search, see `_programs`.
2. `_evolve` makes the states of generation 0, or takes those of an earlier result or checkpoint. It
   then runs the generations in compiled calls of about 0.2 seconds. Each call changes the states,
   and adds a piece to the history.
3. `_result` collects the elites from the states.

All arrays have an axis of seeds. `_result` alone removes it if there was one key.
"""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

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
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.optimizers.presets import Config, config_to_plain
from elitelanes_jax.search._checkpoint import Checkpoint
from elitelanes_jax.search._devices import choose_devices
from elitelanes_jax.search._programs import Parts, Programs, find_programs
from elitelanes_jax.search._result_file import check_can_save
from elitelanes_jax.search._setup import Extensions, KeyData, Setup, make_setup
from elitelanes_jax.search._user_functions import (
    check_extensions,
    digest_functions,
    find_config,
    record_method,
)
from elitelanes_jax.search.keys import SearchKeys
from elitelanes_jax.search.records import History, RunState
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.result import Result, SearchInterrupted

# With less free memory, in bytes, the compiler ends the whole process. At 12 x 12, 0.1 GB are too
# few, 0.3 GB enough.
_COMPILER = 200_000_000
# The seconds between two checkpoints by default.
_SECONDS_A_CHECKPOINT = 60.0


def evolve_search(
    search: Search,
    keys: SearchKeys,
    extensions: Extensions = Extensions(),
    *,
    state: RunState | None = None,
    checkpoint: str | Path | None = None,
    every: float | None = None,
    progress: bool | None = None,
    devices: int | Sequence[jax.Device] | None = None,
) -> Result:
    """Runs a resolved search. The other arguments, and the errors, are those of `evolve`."""
    check_named("progress", none_or(flag), progress)
    if every is not None:
        every = check_named("every", real(0), every)
        if checkpoint is None:
            raise InputError("every", "a checkpoint, the folder that is written to", "none")
    run = prepare_run(search, keys, extensions, choose_devices(devices))
    reached = None
    if state is not None:
        reached = _restore(run, state)
    # The budget counts from the user's state.
    last = run.steps + (0 if reached is None else reached.generation)
    if checkpoint is None:
        return _evolve(run, reached, last, None, progress)
    if every is None:
        every = _SECONDS_A_CHECKPOINT
    folder = Path(check_named("checkpoint", path, checkpoint))
    # A state that cannot be saved is refused here. The first checkpoint may be a minute away.
    check_can_save(jax.tree.leaves(run.programs.states))
    with locked(folder, folder):
        file = Checkpoint(folder, _identity(run, reached), every)
        earlier = file.load()
        if earlier is not None:
            # An earlier call with the same user's state wrote the checkpoint after that state,
            # therefore it replaces the user's state.
            reached = _restore(run, earlier.state, earlier.with_seed_axis().history)
            _check_budget(run, folder, reached.generation, last)
        return _evolve(run, reached, last, file, progress)


@runs_jax
def compile_search(search: Search, keys: SearchKeys) -> None:
    """Compiles what `evolve_search` with these arguments runs, so that it finds the programs.

    Call it in another thread, for instance.

    Raises:
      MemoryError: as `evolve`.
    """
    run = prepare_run(search, keys, Extensions(), choose_devices())
    _check_memory(run)
    # The generations are those that `_evolve` prepares for, because they decide how far the
    # programs are optimised. The evaluations are counted there, when they are made.
    run.programs.prepare(starts=True, generations=run.steps, counts=False)


@dataclass(frozen=True)
class Run:
    """A search that is ready to run.

    Attributes:
      search: the resolved search. Its method and preset say what makes the result.
      config: the configuration of the method; None for the user's own optimiser.
      keys: the keys of all seeds.
      functions: names and digests of the user's functions.
      fingerprint: a checksum of the setup and the keys, 32 bits. Only a state with the same one can
        be continued.
      setup: the setup of the programs, with its numbers on the default device.
      programs: the programs of the search.
      key_parts: the data of the keys of each part of the seeds.
    """

    search: Search
    config: Config | None
    keys: SearchKeys
    functions: tuple[tuple[str, str], ...]
    fingerprint: int
    setup: Setup
    programs: Programs
    key_parts: list[KeyData]

    @property
    def seeds(self) -> int:
        return len(self.keys.data)

    @property
    def steps(self) -> int:
        """The number of generations in the budget."""
        return self.search.steps(self.programs.facts.evaluations_per_step)


class _Reached(NamedTuple):
    """What a run has reached: one value, so that an interruption cannot split it.

    Attributes:
      generation: the number of generations so far.
      parts: the states of each part of the seeds.
      histories: the histories of this call, and of the checkpoint that it continues.
    """

    generation: int
    parts: Parts
    histories: tuple[History, ...] = ()


def prepare_run(
    search: Search, keys: SearchKeys, extensions: Extensions, devices: Sequence[jax.Device]
) -> Run:
    """Checks the user's functions, and finds the programs of a search. Compiles nothing."""
    check_extensions(search, extensions)
    config = find_config(search, extensions)
    recorded = record_method(search, config, extensions)
    setup = make_setup(search, config, keys.kind, extensions)
    # With the digests in its structure, the setup of an edited function finds other programs.
    digests = digest_functions(setup)
    functions = tuple((name, digest.digits) for name, digest in digests.items())
    setup = replace(setup, digests=functions)
    uses_floats = any(digest.uses_floats for digest in digests.values())
    programs = find_programs(setup, keys.data, devices, uses_floats)
    # The budget and the devices are not part of the fingerprint, so both may change when a run is
    # continued.
    return Run(
        search=recorded,
        config=config,
        keys=keys,
        functions=functions,
        fingerprint=zlib.crc32(setup.describe().encode() + keys.data.tobytes()),
        setup=jax.device_put(setup),
        programs=programs,
        key_parts=programs.divide(keys.data),
    )


def _evolve(
    run: Run,
    reached: _Reached | None,
    last: int,
    checkpoint: Checkpoint | None,
    progress: bool | None,
) -> Result:
    """Runs a search from the start, or from what it has reached, to generation `last`."""
    done = 0
    if reached is None:
        _check_memory(run)
    else:
        done = reached.generation
    # A complete checkpoint is not written again.
    is_kept = checkpoint is not None and checkpoint.kept and done == last
    height, width = run.search.shape
    label = f"{run.search.optimizer} {height}x{width}"
    with Progress(label, last, "generations", done=done, shown=progress) as bar:
        try:
            with bar.doing("compiling"):
                run.programs.prepare(starts=reached is None, generations=last - done)
                if reached is None:
                    reached = _Reached(0, run.programs.start_parts(run.setup, run.key_parts))
            calls = run.programs.advance_parts(
                run.setup, run.key_parts, reached.parts, reached.generation + 1, last
            )
            for parts, history in calls:
                generation = int(history.generation[-1])
                reached = _Reached(generation, parts, (*reached.histories, history))
                bar.update(generation, _describe_call(history))
                if checkpoint is not None and checkpoint.is_due():
                    result = _result(run, reached)
                    checkpoint.save(result)
            result = _result(run, reached)
            if checkpoint is not None and not is_kept:
                checkpoint.save(result)
        except KeyboardInterrupt:
            # Before generation 0 is evaluated, no grid is an elite.
            if reached is None:
                raise
            make_result = partial(_interrupted_result, run, reached)
            if checkpoint is not None and checkpoint.keeps_interrupted:
                checkpoint.save(make_result())
            message = f"at generation {reached.generation} of {last}"
            raise SearchInterrupted(message, make_result) from None
    _warn_of_refused(result)
    return result


@runs_jax
def _result(run: Run, reached: _Reached) -> Result:
    """Returns the result so far; for one key without the axis of seeds."""
    elites, states = run.programs.collect_parts(run.setup, reached.parts)
    # A search without generations has no histories, but its history has an axis of seeds too.
    history = History.joined([History.empty(run.seeds), *reached.histories])
    # The empty history has int32. Joined with it, a fitness of float32 becomes float64.
    history = history._replace(best_fitness=history.best_fitness.astype(elites.fitness.dtype))
    generation = np.array(reached.generation, np.int32)
    inner = tuple(jax.tree.leaves(states))
    state = RunState(generation, inner, np.array(run.fingerprint, np.uint32))
    result = Result(elites, history, state, run.search, run.config, run.functions)
    return result.without_seed_axis() if run.keys.single else result


def _interrupted_result(run: Run, reached: _Reached) -> Result:
    # The program that collects the elites is missing if the compiler was interrupted.
    run.programs.prepare(starts=False, generations=0)
    return _result(run, reached)


def _warn_of_refused(result: Result) -> None:
    """Warns the user if no grid became an elite because grids were refused."""
    refused = int(result.history.refused.sum())
    if refused and not np.asarray(result.elites.valid).any():
        reason = "their fitness or a feature is not a finite number or is too large"
        warn_user(f"the result has no elites: {refused:,} grids were refused, because {reason}")


def _check_budget(run: Run, folder: Path, generation: int, last: int) -> None:
    """Raises `InputError` if a checkpoint has more generations than the budget."""
    if generation <= last:
        return
    per_step = run.programs.facts.evaluations_per_step
    expected = f"{generation * per_step:,} evaluations ({generation} generations)"
    got = f"{last * per_step:,} evaluations ({last} generations)"
    raise InputError(folder, f"{expected} or more, as many as are done", got)


def _check_memory(run: Run) -> None:
    """Checks that a search fits into the free memory.

    It needs room for the compiler, and for the states before and after a step.
    """
    free = _free_memory_of_device()
    states = 2 * run.programs.memory
    needed = states + _COMPILER
    if needed <= free:
        return
    height, width = run.search.shape
    search = f"{pluralize(run.seeds, 'seed')} of {height} x {width} tiles"
    fitting_seeds = max(free - _COMPILER, 0) * run.seeds // states
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


def _identity(run: Run, reached: _Reached | None) -> dict[str, Plain]:
    """Returns all that a search depends on except its budget, plain values for JSON."""
    options = run.search.to_plain()
    # A larger budget extends a search. The options of a style are in the others, so its name does
    # not matter.
    del options["evaluations"], options["generations"], options["style"]
    return {
        "search": options,
        "size": run.search.shape,
        "config": run.config and config_to_plain(run.config),
        "functions": dict(run.functions),
        "seeds": run.seeds,
        "keys": sha256(run.keys.data.tobytes()).hexdigest()[:16],
        "fingerprint": run.fingerprint,
        "after": 0 if reached is None else reached.generation,
        "versions": installed_versions(),
    }


def _restore(run: Run, state: UserValue, *histories: History) -> _Reached:
    """Returns what an earlier result has reached, by its `RunState`."""
    if not isinstance(state, RunState):
        raise InputError("state", "the state of a result of evolve", type(state).__name__)
    if not jax.tree.leaves(state.inner):
        raise InputError(
            "state",
            "one to continue from",
            "that of a result that was joined or saved without its state",
        )
    arrays = [jnp.asarray(leaf) for leaf in jax.tree.leaves(state.inner)]
    if run.keys.single:
        arrays = [array[None] for array in arrays]
    leaves, structure = jax.tree.flatten(run.programs.states)
    # The fingerprint alone would accept a state whose arrays were cut or converted.
    state_kinds = [(array.shape, array.dtype) for array in arrays]
    run_kinds = [(leaf.shape, leaf.dtype) for leaf in leaves]
    if int(state.fingerprint) != run.fingerprint or state_kinds != run_kinds:
        rows, columns = run.search.shape
        expected = f"one of this run ({rows} x {columns}, seeds: {run.seeds})"
        got = "one of a run with another key, other options or functions"
        raise InputError("state", expected, got)
    parts = run.programs.divide(jax.tree.unflatten(structure, arrays))
    return _Reached(int(state.generation), parts, histories)


def _describe_call(history: History) -> str:
    best = history.best_fitness[:, -1].min()
    elites = history.elite_count[:, -1].mean()
    refused = history.refused[:, -1].sum()
    speed = history.evaluations_per_second[-1]
    words = f"best {best:,}, {elites:,.0f} elites, {speed:,.0f} evaluations/s"
    if refused:
        words += f", {refused:,} refused"
    return words
