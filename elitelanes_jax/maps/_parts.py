"""The parts of a run, each with some of its seeds, and how they are joined."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import first_difference, has_unfinished
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.types import Plain
from elitelanes_jax.maps.folder import ARCHIVE, RECORD
from elitelanes_jax.maps.run import Evolved, Run, describe_archive, plan_run
from elitelanes_jax.maps.spec import GenerateSpec, parse_part
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.spec import SearchSpec

_EXPECTED = "expected a part of a run, made by elitelanes generate --part"


def join_parts(folders: Sequence[Path]) -> Evolved:
    """Joins all parts of a run, in any order; the result has no state to continue from.

    Raises:
      InputError: for a folder that is not a part, a part of another run or tile set, or a part that comes twice or is
        missing.
    """
    records = [_read_record(folder) for folder in folders]
    settings = {**records[0]["settings"], "part": None}
    expected = {"versions": installed_versions(), "settings": settings, "tile_set": records[0]["tile_set"]}
    by_index: dict[int, Path] = {}
    count = records[0]["settings"]["part"][1]
    for folder, record in zip(folders, records, strict=True):
        index, parts = record["settings"]["part"]
        if parts != count:
            raise InputError(f"{folder}: expected one of {count} parts, as {folders[0]} is, got one of {parts}")
        got = {name: record[name] for name in expected} | {"settings": {**record["settings"], "part": None}}
        if (difference := first_difference(expected, got)) is not None:
            name, mine, found = difference
            raise InputError(f"{folder}: expected a part of a run with {name} {mine!r}, got {found!r}")
        if index in by_index:
            raise InputError(f"{folder}: expected each part once, got {index}/{count} again, after {by_index[index]}")
        by_index[index] = folder
    missing = [f"{index}/{count}" for index in range(1, count + 1) if index not in by_index]
    if missing:
        few = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise InputError(f"parts: expected all {count} parts, got all but {few}")
    run = plan_run(_read_spec(folders[0], settings))
    archives = {folder: record.get("archive") for folder, record in zip(folders, records, strict=True)}
    results = [_read_archive(by_index[index], run, (index, count), archives) for index in range(1, count + 1)]
    speeds = [record["times"]["evaluations_per_second"] for record in records]
    known = [speed for speed in speeds if speed is not None]
    return Evolved(
        run=run,
        result=_join(results),
        seconds=sum(record["times"]["seconds"]["evolve"] for record in records),
        speed=round(float(np.median(known))) if known else None,
        device=", ".join(sorted({record["device"] for record in records})),
    )


def _read_record(folder: Path) -> dict[str, Plain]:
    if not folder.exists() and has_unfinished(folder):
        raise InputError(f"{folder}: expected a complete part, got unfinished work; the same command completes it")
    try:
        record = read_json(folder / RECORD)
        part = record["settings"]["part"]
        times = record["times"]["seconds"]["evolve"], record["times"]["evaluations_per_second"], record["device"]
        complete = {"versions", "tile_set"} <= set(record) and len(times) == 3 and (part is None or parse_part(part))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # an InputError is a ValueError
        complete = False
    if not complete:
        raise InputError(f"{folder}: {_EXPECTED}, got {'another folder' if folder.exists() else 'none'}")
    if part is None:
        raise InputError(f"{folder}: {_EXPECTED}, got a whole run")
    return record


def _read_spec(folder: Path, settings: dict[str, Plain]) -> GenerateSpec:
    try:
        return GenerateSpec(**settings | {"search": SearchSpec.from_plain(settings["search"])})
    except (InputError, TypeError, KeyError) as error:
        raise InputError(f"{folder / RECORD}: expected settings of a run, got: {error}") from None


def _read_archive(folder: Path, run: Run, part: tuple[int, int], archives: dict[Path, Plain]) -> Result:
    file, (spec, search, tiles) = folder / ARCHIVE, run
    result = Result.load(file)
    if result.spec != search:
        if result.spec == search.replace(alphabet=result.spec.alphabet):
            raise InputError(f"{folder}: expected a part for the tile set {tiles.name!r}, got one for another set")
        raise InputError(f"{file}: expected the search in {RECORD} next to it, got another search")
    shape, expected = result.elites.grids.shape, (len(spec.replace(part=part).seed_indices), *spec.size)
    if shape[:-3] + shape[-2:] != expected:
        raise InputError("{}: expected {} seeds of {} x {}, got {}".format(file, *expected, shape))
    if describe_archive(result) != archives[folder]:
        raise InputError(f"{file}: expected the archive of the same run as {RECORD} next to it, got another one")
    return result


def _join(results: Sequence[Result]) -> Result:
    elites = jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *(result.elites for result in results))
    histories = [result.history for result in results]
    history = histories[0]._replace(
        best_fitness=np.concatenate([history.best_fitness for history in histories]),
        elite_count=np.concatenate([history.elite_count for history in histories]),
        refused=np.concatenate([history.refused for history in histories]),
    )
    first = results[0]
    return replace(first, elites=elites, history=history)
