"""Searches whose seeds are divided among the workers of an executor."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np

from elitelanes_jax._util.checks import check_named, flag, instance, none_or
from elitelanes_jax._util.engine import Pool, call_on_workers, part_of
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import read_json, write_json
from elitelanes_jax._util.progress import Progress
from elitelanes_jax.network.bits import THREEFRY
from elitelanes_jax.search._devices import choose_devices
from elitelanes_jax.search._setup import Extensions
from elitelanes_jax.search.compile_cache import use_compile_cache
from elitelanes_jax.search.joining import join_parts_of_run, without_state
from elitelanes_jax.search.keys import SearchKeys
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.running import evolve_search, prepare_run

# A core advances up to 32 seeds together, and a worker compiles for seconds: parts with fewer seeds
# do not pay.
_SEEDS_A_PART = 32


class EvolvedPart(NamedTuple):
    """The result of some seeds of a search, and where they ran.

    Attributes:
      result: the result, without a state to continue from.
      device: the kind of the device.
    """

    result: Result
    device: str


def evolve_on_workers(
    search: Search,
    keys: SearchKeys,
    pool: Pool,
    extensions: Extensions,
    *,
    progress: bool | None,
) -> Result:
    """Evolves a search on the workers of an executor, as `evolve` does."""
    check_named("progress", none_or(flag), progress)
    # Preparing a search of one seed checks the user's functions here, before they travel. Workers
    # compare their functions with the digests.
    first_key = keys._replace(data=keys.data[:1])
    functions = prepare_run(search, first_key, extensions, choose_devices(1)).functions
    # Workers get the resolved search, therefore they read no files of the user.
    parts = evolve_parts(search, keys, pool, extensions, functions=functions, progress=progress)
    return join_evolved_parts(parts)


def evolve_parts(
    search: Search,
    keys: SearchKeys,
    pool: Pool,
    extensions: Extensions = Extensions(),
    *,
    functions: Sequence[tuple[str, str]] = (),
    folder: Path | None = None,
    progress: bool | None = None,
) -> list[EvolvedPart]:
    """Evolves a search in parts on the workers of an executor.

    Returns the parts in the order of the keys.

    Args:
      search: resolved.
      keys: the keys of all seeds.
      pool: the executor, and the number of parts; by default parts have up to 32 seeds.
      extensions: the extensions of the search.
      functions: the name and the digest of each function in `extensions`, in this process.
      folder: keeps complete parts, so that the next call with an equal search evolves the others
        alone.
      progress: whether to show progress, as in `evolve`.

    Raises:
      InputError: for one key alone, keys of another kind than JAX's default, a worker whose
        functions are others, or what `call_on_workers` refuses.
      ConnectionError: if the executor lost a part.
    """
    if keys.single:
        raise InputError(
            "key", "several keys or a whole number, to be divided among workers", "one key"
        )
    if keys.kind != THREEFRY:
        # The bits of other keys depend on the whole batch.
        raise InputError("key", f"keys of {THREEFRY}, to be divided among workers", keys.kind)
    seeds = len(keys.data)
    count = pool.parts_for(-(-seeds // _SEEDS_A_PART), seeds)
    slices = [part_of(seeds, index, count) for index in range(count)]
    # The name of a part has the number of parts, because other divisions give it other seeds.
    parts: dict[int, EvolvedPart] = {}
    for index in range(count):
        kept = None if folder is None else _load(folder / f"{index + 1}-of-{count}", search)
        if kept is not None:
            parts[index] = kept
    waiting = [index for index in range(count) if index not in parts]
    tasks = [
        (search, keys._replace(data=keys.data[slices[index].start : slices[index].stop]))
        for index in waiting
    ]
    done = sum(len(slices[index]) for index in parts)
    with Progress(
        f"evolving in {pluralize(count, 'part')}", seeds, "seeds", done=done, shown=progress
    ) as bar:
        for position, part in evolve_each(tasks, pool, extensions):
            index = waiting[position]
            _check_functions(part.result.functions, functions)
            parts[index] = part
            if folder is not None:
                _save(folder / f"{index + 1}-of-{count}", part)
            bar.count(len(slices[index]))
    return [parts[index] for index in range(count)]


def _check_functions(got: Sequence[tuple[str, str]], expected: Sequence[tuple[str, str]]) -> None:
    """Checks the digests of a worker's functions.

    The worker may have imported a module before the module was edited.
    """
    for (name, digest), (_, ours) in zip(got, expected, strict=True):
        if digest != ours:
            raise InputError(
                "executor",
                f"the function {name!r} as it is here",
                "another one from a worker",
                (
                    "start workers anew after a change of a module, with the same settings of JAX "
                    "as here"
                ),
            )


def evolve_each(
    tasks: Sequence[tuple[Search, SearchKeys]], pool: Pool, extensions: Extensions = Extensions()
) -> Iterator[tuple[int, EvolvedPart]]:
    """Evolves searches on the workers of an executor.

    Yields the index and the result of each search as it ends.
    """
    caches = bool(jax.config.values.get("jax_compilation_cache_dir"))
    return call_on_workers(pool.executor, partial(_evolve_task, extensions, caches), tasks)


def join_evolved_parts(parts: Sequence[EvolvedPart]) -> Result:
    """Joins the results of all parts, in their order."""
    return join_parts_of_run([part.result for part in parts])


def _evolve_task(
    extensions: Extensions, caches: bool, task: tuple[Search, SearchKeys]
) -> EvolvedPart:
    """Runs on a worker, which keeps compiled programs on disk if the caller does."""
    if caches:
        use_compile_cache()
    result = evolve_search(*task, extensions, progress=False)
    # Arrays of NumPy can travel to a process with other devices.
    arrays = jax.tree.map(np.asarray, without_state(result))
    return EvolvedPart(arrays, jax.devices()[0].device_kind)


def _save(path: Path, part: EvolvedPart) -> None:
    """Writes a part and then its device, so that a part with a device is complete."""
    path.parent.mkdir(exist_ok=True)
    part.result.save(path.with_suffix(".npz"))
    write_json(path.with_suffix(".json"), part.device)


def _load(path: Path, search: Search) -> EvolvedPart | None:
    """Returns a complete part of an equal search, or None."""
    try:
        device = instance(str)(read_json(path.with_suffix(".json")))
        result = Result.load(path.with_suffix(".npz"))
    # An `InputError` of the check is a `ValueError` too.
    except (OSError, ValueError, RecursionError):
        # The part is missing or damaged, so it is evolved again.
        return None
    # The folder may hold parts of an earlier search, such as one with another budget.
    if result.search != search:
        return None
    # `Search.inputs` is not saved, so the search of the caller is taken.
    return EvolvedPart(replace(result, search=search), device)
