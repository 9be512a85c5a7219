"""Runs whose seeds are searched in parts, which `merge` joins."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, none_or, path, path_exists, paths, real
from elitelanes_jax._util.errors import InputError, list_some, quote
from elitelanes_jax._util.folders import first_difference, has_unfinished, output_folder
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.types import OptionValue, Plain
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import (
    ARCHIVE,
    RECORD,
    RunRecord,
    foreign_to_maps,
    read_run_record,
)
from elitelanes_jax.maps.planning import PlannedRun, plan_run
from elitelanes_jax.maps.spec import GenerateSpec, parse_part
from elitelanes_jax.maps.writing import Evolved, describe_archive, median_speed, write_run
from elitelanes_jax.search.joining import join_parts_of_run
from elitelanes_jax.search.resolve import has_other_alphabet, spec_from_plain
from elitelanes_jax.search.result import Result

_EXPECTED = "a part of a run, made by elitelanes generate --part"


@name_wrong_arguments
def merge(
    parts: str | Path | Sequence[str | Path], out: str | Path, *, force: bool = False
) -> list[RoadMap]:
    """Joins the parts of a run, and writes the folder that `generate` writes without parts.

    The files are the same, byte for byte, except for the times: in ``run.json`` the seconds are the
    sum over the parts, and the speed is their median.

    Args:
      parts: folders, in any order.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for a folder that is not a part, a part of another run or tile set, or a part that
        comes twice or is missing.
      NotEnoughMapsError: if there are fewer valid and different maps than the parts' specification
        requests.
      OSError: if the folder cannot be written.
    """
    folders, out = check_named("parts", paths, parts), Path(check_named("out", path, out))
    with output_folder(
        out, {"command": "merge"}, inputs=folders, foreign=foreign_to_maps, force=force
    ) as work:
        return write_run(work.files, *_read_and_join_parts(folders))


def _read_and_join_parts(folders: Sequence[Path]) -> tuple[PlannedRun, Evolved]:
    """Joins all parts of a run, in any order; the result has no state to continue from.

    Raises `InputError`.
    """
    records = [_read_record(folder) for folder in folders]
    identities = [_identity(record) for record in records]
    # All parts must have the settings of the first one and the installed versions, because the run
    # is planned again here.
    expected = identities[0] | {"versions": installed_versions()}
    parts = [record["settings"]["part"] for record in records]
    by_index = order_parts(folders, parts, identities, expected)
    count = len(by_index)
    run = plan_run(_read_spec(folders[0], records[0]["settings"] | {"part": None}))
    # Folders may be in any order. Results are joined in the order of the parts.
    record_by_folder = dict(zip(folders, records, strict=True))
    results = []
    for index, folder in enumerate(by_index, start=1):
        archive = record_by_folder[folder].get("archive")
        results.append(_read_archive(folder, run, (index, count), archive))
    speeds = [record["times"]["evaluations_per_second"] for record in records]
    evolved = Evolved(
        result=join_parts_of_run(results),
        seconds=sum(record["times"]["seconds"]["evolve"] for record in records),
        # A part without generations has no speed.
        speed=median_speed([speed for speed in speeds if speed is not None]),
        device=", ".join(sorted({record["device"] for record in records})),
    )
    return run, evolved


def _identity(record: RunRecord) -> dict[str, Plain]:
    """Returns what a part depends on besides its index."""
    settings = record["settings"] | {"part": None}
    return {"versions": record["versions"], "settings": settings, "tile_set": record["tile_set"]}


def order_parts(
    folders: Sequence[Path],
    parts: Sequence[tuple[int, int]],
    identities: Sequence[Mapping[str, Plain]],
    expected: Mapping[str, Plain],
    whole: str = "run",
) -> list[Path]:
    """Returns the folders of all parts in the order of the parts.

    Args:
      folders: the folders of the parts, in any order.
      parts: the index of each, from 1, and the number of parts.
      identities: what each depends on beside its part.
      expected: what all depend on.
      whole: what they are parts of, for messages.

    Raises:
      InputError: for a part of something else, or one that comes twice or is missing.
    """
    by_index: dict[int, Path] = {}
    count = parts[0][1]
    for folder, (index, of), identity in zip(folders, parts, identities, strict=True):
        if of != count:
            raise InputError(folder, f"one of {count} parts, as {folders[0]} is", f"one of {of}")
        difference = first_difference(expected, identity)
        if difference is not None:
            name = difference.name
            value, got = quote(difference.value), quote(difference.other)
            raise InputError(folder, f"a part of a {whole} with {name} {value}", got)
        # Two parts may have the same index, if a folder is a copy of another one.
        if index in by_index:
            raise InputError(
                folder, "each part once", f"{index}/{count} again, after {by_index[index]}"
            )
        by_index[index] = folder
    missing = [f"{index}/{count}" for index in range(1, count + 1) if index not in by_index]
    if missing:
        raise InputError("parts", f"all {count} parts", f"all but {list_some(missing, 5)}")
    return [by_index[index] for index in range(1, count + 1)]


def _read_record(folder: Path) -> RunRecord:
    exists = path_exists(folder)
    # A part that was interrupted has only a hidden folder.
    if not exists and has_unfinished(folder):
        raise InputError(
            folder, "a complete part", "unfinished work", "the same command completes it"
        )
    try:
        record = read_run_record(folder)
        part = record["settings"]["part"]
        if part is not None:
            # JSON has a list here, and `parse_part` returns a tuple. Times are checked, because
            # they are added up.
            record["settings"]["part"] = parse_part(part)
        times = record["times"]
        times["seconds"]["evolve"] = real(0)(times["seconds"]["evolve"])
        times["evaluations_per_second"] = none_or(real(0))(times["evaluations_per_second"])
        complete = {"versions", "tile_set"} <= set(record) and isinstance(record["device"], str)
    # An `InputError` of the checks is a `ValueError` too.
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        complete = False
    if not complete:
        raise InputError(folder, _EXPECTED, "another folder" if exists else "none")
    if part is None:
        raise InputError(folder, _EXPECTED, "a whole run")
    return record


def _read_spec(folder: Path, settings: dict[str, OptionValue]) -> GenerateSpec:
    try:
        return GenerateSpec(**settings | {"search": spec_from_plain(settings["search"])})
    except InputError as error:
        raise error.within(folder / RECORD) from None
    except (TypeError, KeyError) as error:
        raise InputError(folder / RECORD, "settings of a run", error) from None


def _read_archive(folder: Path, run: PlannedRun, part: tuple[int, int], archive: Plain) -> Result:
    file = folder / ARCHIVE
    result = Result.load(file)
    # The record and the archive may come from different runs, if somebody copied one of them.
    if result.search != run.search:
        if has_other_alphabet(result.search, run.search):
            raise InputError(
                folder, f"a part for the tile set {run.tiles.name!r}", "one for another set"
            )
        raise InputError(file, f"the search in {RECORD} next to it", "another search")
    seeds = len(run.spec.replace(part=part).seed_indices)
    # Grids are `[seeds, elites, height, width]`. Any number of elites fits.
    shape, expected = result.elites.grids.shape, (seeds, *run.spec.size)
    if shape[:-3] + shape[-2:] != expected:
        raise InputError(file, "{} seeds of {} x {}".format(*expected), shape)
    # Runs of one search with different seeds almost always differ in these metrics.
    if describe_archive(result) != archive:
        raise InputError(file, f"the archive of the same run as {RECORD} next to it", "another one")
    return result
