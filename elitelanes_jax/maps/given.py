"""Maps that a dataset uses instead of evolving maps; without JAX and OpenCV."""

from collections import Counter
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.checks import is_folder, is_whole, path
from elitelanes_jax._util.errors import InputError, list_some, pluralize, shorten
from elitelanes_jax._util.files import MIB, parse_json, read_input
from elitelanes_jax._util.progress import announce, announce_at_end
from elitelanes_jax._util.types import OptionValue, UserValue
from elitelanes_jax.formats.dt_layers import is_layers
from elitelanes_jax.formats.road_map import (
    RoadMap,
    as_maps,
    map_to_json,
    read_maps,
    refresh,
)
from elitelanes_jax.maps.faults import warn_of_faults
from elitelanes_jax.network.likeness import road_forms
from elitelanes_jax.network.plain_metrics import plain_measure

_LEFT_OUT_BECAUSE = "the same as another one when moved, rotated or mirrored"


@dataclass(frozen=True)
class GivenMaps:
    """The maps that a user provides for a dataset; equal if their digests are.

    Attributes:
      maps: the maps, at least one, each with its metrics.
      digest: the digest of all fields of all maps.
      paths: the files and folders they were read from.
      names: the names of the maps in messages: the index, and the file if there is one.
      left_out: the number of other maps, whose roads are those of one of these, see `road_forms`.
    """

    maps: tuple[RoadMap, ...] = field(compare=False, repr=False)
    digest: str
    paths: tuple[Path, ...] = field(default=(), compare=False, repr=False)
    names: tuple[str, ...] = field(default=(), compare=False, repr=False)
    left_out: int = field(default=0, compare=False, repr=False)

    def announce_left_out(self) -> None:
        """Says how many maps were left out, if any."""
        if self.left_out:
            total = pluralize(len(self.maps) + self.left_out, "map")
            announce(f"{self.left_out} of {total} left out: {_LEFT_OUT_BECAUSE}")

    def describe_left_out(self) -> str:
        """Returns the end of a message about too few maps; empty if no map was left out."""
        if not self.left_out:
            return ""
        return f" and {self.left_out} left out, {_LEFT_OUT_BECAUSE}"

    @property
    def sizes(self) -> list[tuple[int, int]]:
        """(height, width) of the maps, each once, in order."""
        return sorted(
            {(road_map.codes.shape[0], road_map.codes.shape[1]) for road_map in self.maps}
        )


def parse_given(sources: UserValue) -> GivenMaps:
    """Reads maps, and measures metrics that are missing.

    Raises `InputError`, which names a bad file or folder.

    The sources are one map or several, as `as_maps` takes them, or folders. The maps of a folder
    are those of a dataset or a pack, or else all files ``map.json`` in it. Without these they are
    the files ``.json``, ``.yaml`` and ``.yml`` and the folders of Duckietown's layers right in it.
    Of maps whose roads are the same when moved, rotated or mirrored, the first one is used, so that
    no two splits have the same network.
    """
    if isinstance(sources, GivenMaps):
        return sources
    paths, source_maps = _read_sources(sources)
    if not source_maps:
        raise InputError("", "at least one map", "none")
    # `setdefault` keeps the first map of each form.
    distinct: dict[bytes, _SourceMap] = {}
    forms = road_forms([source_map.road_map.codes for source_map in source_maps])
    for form, source_map in zip(forms, source_maps, strict=True):
        distinct.setdefault(form, source_map)
    maps_in_file = Counter(source_map.file for source_map in distinct.values())
    names = []
    measured = []
    for index, (file, road_map) in enumerate(distinct.values()):
        name = f"map {index}, in {file}" if file else f"map {index}"
        # A command names a map by its file, as for a single map, if no other map is from this file.
        label = file if file and maps_in_file[file] == 1 else name
        names.append(name)
        measured.append(_measured(road_map, label))
    digest = sha256("".join(map(map_to_json, measured)).encode()).hexdigest()[:16]
    left_out = len(source_maps) - len(distinct)
    return GivenMaps(tuple(measured), digest, tuple(paths), tuple(names), left_out)


class _SourceMap(NamedTuple):
    """A map, and the file that it was read from; "" without one."""

    file: str
    road_map: RoadMap


def _read_sources(sources: UserValue) -> tuple[list[Path], list[_SourceMap]]:
    """Reads all maps of the sources; returns the paths among the sources, and the maps."""
    if isinstance(sources, str | Path):
        sources = [sources]
    # An array of grids, or a single map, has no paths.
    if not isinstance(sources, list | tuple):
        return [], [_SourceMap("", road_map) for road_map in as_maps(sources)]
    paths = []
    files: list[str] = []
    values: list[UserValue] = []
    for source in sources:
        if isinstance(source, str | Path):
            paths.append(Path(source))
            for file, road_map in _read_path(path(source)):
                files.append(file)
                values.append(road_map)
        else:
            files.append("")
            values.append(source)
    # All maps are checked together, because a message has the index of a map among all.
    road_maps = as_maps(values)
    # Rows of numbers are one grid. There are more values than maps then, and no files.
    are_rows_of_one_grid = len(road_maps) != len(values)
    if are_rows_of_one_grid:
        files = [""] * len(road_maps)
    return paths, [
        _SourceMap(file, road_map) for file, road_map in zip(files, road_maps, strict=True)
    ]


def _read_path(source: Path) -> list[_SourceMap]:
    """Reads the maps of a file or a folder."""
    if is_folder(source) and (source / "dataset.json").is_file():
        return _read_dataset(source)
    source_maps = []
    for file in map_files(source):
        for road_map in read_maps(file):
            source_maps.append(_SourceMap(str(file), road_map))
    return source_maps


def map_files(source: Path) -> list[Path]:
    """Returns the files of maps in a folder, as `parse_given` finds them.

    For a file, returns the file itself. Raises `InputError` for a folder without maps.
    """
    # A folder of layers is one map itself.
    if not is_folder(source) or is_layers(source):
        return [source]
    if (source / "pack.json").is_file():
        return sorted((source / "maps").rglob("*.json"))
    files = sorted(source.rglob("map.json"))
    # A folder of `generate` has JSON files that are no maps, such as its record.
    if not files and not (source / "run.json").exists():
        files = [entry for entry in sorted(source.iterdir()) if _may_be_map(entry)]
    if not files:
        # Folders right below may have maps. The message names up to three of them.
        folders = []
        for entry in sorted(source.iterdir()):
            if entry.is_dir() and _may_have_maps(entry):
                folders.append(str(entry))
        hint = f"name {list_some(folders, 3)}" if folders else ""
        expected = "a folder with map.json or other files of maps in it"
        raise InputError(source, expected, "one without", hint)
    if not (source / "run.json").exists():
        _announce_unread(source, files)
    return files


def _may_be_map(entry: Path) -> bool:
    return entry.suffix.lower() in (".json", ".yaml", ".yml") or is_layers(entry)


def _may_have_maps(entry: Path) -> bool:
    try:
        return _may_be_map(entry) or (entry.is_dir() and any(map(_may_be_map, entry.iterdir())))
    except PermissionError:
        # A folder that cannot be read is not named.
        return False


def _announce_unread(source: Path, files: list[Path]) -> None:
    """Says which entries of a folder may have maps too, and were not read."""
    read_paths = {*files}
    for file in files:
        read_paths.update(file.parents)
    unread = []
    for entry in sorted(source.iterdir()):
        # Hidden folders of editors and version control have JSON files that are no maps.
        if entry in read_paths or entry.name.startswith("."):
            continue
        if _may_have_maps(entry):
            unread.append(entry.name)
    if unread:
        names = list_some(unread, 5)
        announce_at_end(str(source), f"not read: {names}; name each, to use its maps too")


def _read_dataset(folder: Path) -> list[_SourceMap]:
    """Reads the maps of a dataset in the metadata of its samples, in the order of their numbers.

    Further views of a map repeat its codes, and are left out.
    """
    if (folder / "part.jsonl").exists():
        raise InputError(folder, "a whole dataset", "a part", "elitelanes merge joins the parts")
    # Splits and shards divide the samples over files, so they are put back in order.
    by_number: dict[int, _SourceMap] = {}
    files: list[Path] = []
    # Each layout has the metadata in other files. A user may add files with the same suffix, such
    # as predictions.
    for pattern in ("maps.jsonl", "*/metadata.jsonl", "metadata/*.jsonl"):
        files += folder.glob(pattern)
    for file in sorted(files):
        lines = read_input(file, 1024 * MIB, "JSON").splitlines()
        try:
            for line in lines:
                number, road_map = _read_sample(line)
                by_number[number] = _SourceMap(str(file), road_map)
        except InputError as error:
            raise error.within(file) from None
        except (ValueError, RecursionError) as error:
            raise InputError(file, "the metadata of a dataset", error) from None
    # The shape is part of the key, because grids of different shapes may have the same bytes.
    by_codes: dict[tuple[tuple[int, ...], bytes], _SourceMap] = {}
    for number in sorted(by_number):
        codes = by_number[number].road_map.codes
        by_codes.setdefault((codes.shape, codes.tobytes()), by_number[number])
    return list(by_codes.values())


def _read_sample(line: str) -> tuple[int, RoadMap]:
    """Reads the number and the map of a sample in a line of metadata.

    Raises `ValueError` for other lines.
    """
    sample = parse_json(line)
    if not isinstance(sample, dict) or not is_whole(sample.get("number")):
        raise InputError("", "a sample with a number", shorten(line))
    values: dict[str, OptionValue] = {
        name: sample.get(name) for name in ("codes", "metrics", "fitness", "niche")
    }
    return sample["number"], RoadMap(**values)


def _measured(road_map: RoadMap, name: str) -> RoadMap:
    """Returns a map with all metrics of its codes.

    A command says in a line what does not fit in it.
    """
    refreshed = refresh(road_map, name)
    warn_of_faults(name, refreshed)
    stored, measured = refreshed.metrics or {}, plain_measure(refreshed.codes)
    if measured.keys() <= stored.keys():
        return refreshed
    # Stored metrics stay. After `refresh` they agree with the codes.
    return replace(refreshed, metrics=measured | dict(stored))
