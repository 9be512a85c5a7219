"""Parts of a run, each with some of its seeds, that are put together again."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import read_json
from elitelanes_jax._util.folders import first_difference, has_unfinished
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.types import Plain
from elitelanes_jax.maps.spec import GenerateSpec, parse_part
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.spec import SearchSpec

ARCHIVE = "archive.npz"
"""The file of a run, or of a part, with all that its seeds have found."""

RECORD = "run.json"
"""The file with its settings."""


class Evolved(NamedTuple):
    """A search that is done, with what its record tells.

    Attributes:
      spec: of the run.
      result: of its seeds.
      seconds: that it took.
      speed: evaluations per second, the median; None without generations.
      device: that it ran on.
    """

    spec: GenerateSpec
    result: Result
    seconds: float
    speed: int | None
    device: str


def join_parts(folders: Sequence[Path]) -> Evolved:
    """Puts the parts of a run together, seed after seed.

    Args:
      folders: of the parts, in any order, all of them once.

    Returns:
      The whole run, without a state to continue from, and with the sum of the parts' seconds.

    Raises:
      InputError: for a folder that is no part, or not of the same run as the first, a part that comes twice or is
        missing.
    """
    records = [_read_record(folder) for folder in folders]
    settings = {**records[0]["settings"], "part": None}
    expected = {"versions": installed_versions(), "settings": settings, "tile_set": records[0]["tile_set"]}
    places: dict[int, Path] = {}
    count = records[0]["settings"]["part"][1]
    for folder, record in zip(folders, records, strict=True):
        number, parts = record["settings"]["part"]
        if parts != count:
            raise InputError(f"{folder}: expected one of {count} parts, as {folders[0]} is, got one of {parts}")
        got = {name: record[name] for name in expected} | {"settings": {**record["settings"], "part": None}}
        if (difference := first_difference(expected, got)) is not None:
            name, mine, found = difference
            raise InputError(f"{folder}: expected a part of a run with {name} {mine!r}, got {found!r}")
        if number in places:
            raise InputError(f"{folder}: expected each part once, got {number}/{count} again, after {places[number]}")
        places[number] = folder
    missing = [f"{number}/{count}" for number in range(1, count + 1) if number not in places]
    if missing:
        few = ", ".join(missing[:5]) + (f" and {len(missing) - 5} more" if len(missing) > 5 else "")
        raise InputError(f"parts: expected all {count}, got none of {few}")
    spec = _read_spec(folders[0], settings)
    results = [_read_archive(places[number], spec, number, count) for number in range(1, count + 1)]
    speeds = [record["times"]["evaluations_per_second"] for record in records]
    known = [speed for speed in speeds if speed is not None]
    return Evolved(
        spec=spec,
        result=_join(results),
        seconds=sum(record["times"]["seconds"]["evolve"] for record in records),
        speed=round(float(np.median(known))) if known else None,
        device=", ".join(sorted({record["device"] for record in records})),
    )


def _read_record(folder: Path) -> dict[str, Plain]:
    if not folder.exists() and has_unfinished(folder):
        raise InputError(f"{folder}: expected a part that is done, got one that the same command goes on with")
    try:
        record = read_json(folder / RECORD)
        part = record["settings"]["part"]
        times = record["times"]["seconds"]["evolve"], record["times"]["evaluations_per_second"], record["device"]
        whole = {"versions", "tile_set"} <= set(record) and len(times) == 3 and (part is None or parse_part(part))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # an InputError is a ValueError
        whole = False
    if not whole:
        raise InputError(f"{folder}: expected a part of a run, made by elitelanes generate --part, got another folder")
    if part is None:
        raise InputError(f"{folder}: expected a part of a run, made by elitelanes generate --part, got a whole one")
    return record


def _read_spec(folder: Path, settings: dict[str, Plain]) -> GenerateSpec:
    try:
        return GenerateSpec(**settings | {"search": SearchSpec(**settings["search"])})
    except (InputError, TypeError, KeyError) as error:
        raise InputError(f"{folder / RECORD}: expected settings of a run, got: {error}") from None


def _read_archive(folder: Path, spec: GenerateSpec, number: int, count: int) -> Result:
    result = Result.load(folder / ARCHIVE)
    seeds = len(spec.replace(part=(number, count)).seed_numbers)
    alphabet = spec.search.alphabet or result.spec.alphabet  # where none is given, the tile set has one
    got, expected = result.elites.grids.shape, (seeds, *spec.size)
    if result.spec.replace(alphabet=alphabet) != spec.search.on(spec.size).replace(alphabet=alphabet):
        raise InputError(f"{folder / ARCHIVE}: expected the search in {RECORD} beside it, got another")
    if got[:-3] + got[-2:] != expected:
        raise InputError(f"{folder / ARCHIVE}: expected {seeds} seeds of {spec.size[0]} x {spec.size[1]}, got {got}")
    return result


def _join(results: Sequence[Result]) -> Result:
    """Puts seeds beside seeds."""
    elites = jax.tree.map(lambda *arrays: jnp.concatenate(arrays), *(result.elites for result in results))
    histories = [result.history for result in results]
    history = histories[0]._replace(
        best_fitness=np.concatenate([one.best_fitness for one in histories]),
        elite_count=np.concatenate([one.elite_count for one in histories]),
    )
    first = results[0]
    return Result(elites, history, first.state, first.spec, first.axes)
