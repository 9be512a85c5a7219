"""Collects the contents of the explorer: folders of runs, archives, maps, results in memory."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import TILE_PX, check_named, is_folder, paths
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.explorer._payload import Payload, make_payload
from elitelanes_jax.explorer._shown import (
    ShownRun,
    by_size,
    from_result,
    of_maps,
    read_archive,
    read_run,
    setting,
)
from elitelanes_jax.formats.dt_layers import is_layers
from elitelanes_jax.formats.road_map import RoadMap, as_maps, read_maps
from elitelanes_jax.tiles.rendering import describe_other_pictures, first_undrawn
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

if TYPE_CHECKING:
    from elitelanes_jax.search.result import Result


@name_wrong_arguments
def collect(
    what: UserValue,
    *,
    tiles: str | Path | TileSet | None = None,
    tile_px: int = 64,
) -> Payload:
    """Collects a result, maps, or files of runs and maps, to be shown.

    Args:
      what: a `Result`; a map or several, as `as_maps` takes them; a mapping from names to these, to
        show several side by side; or a path or several. A path is the folder of a run of `generate`
        or `pick`, a folder of such folders, an archive, or a file of maps.
      tiles: a tile set or its folder; by default that of the first run whose tiles are found. If
        there is none, the package's own is used, with a line on standard error. A relative path in
        a run's record is searched from here, then from each folder above the run.
      tile_px: side of a tile's picture in pixels, 16 to 512.

    Raises:
      InputError: for anything else; for a file or folder that is missing, damaged, incomplete or of
        another kind, and for a bad tile set. The message names the file.
    """
    check_named("tile_px", TILE_PX, tile_px)
    sources = _list_sources(what)
    if isinstance(sources, Mapping):
        runs = _collect_named(sources)
        # The page of a single run has the run's name as its title.
        heading = runs[0].name if len(runs) == 1 else ""
        return make_payload(runs, _load_tiles(tiles, runs), tile_px, heading)
    if all(isinstance(source, str | Path) for source in sources):
        return _collect_files(check_named("what", paths, sources), tiles, tile_px)
    # A list has no names, by which the page tells several results apart.
    if any(map(_is_result, sources)):
        raise InputError("what", "one Result, or several by name", "a list of them")
    runs = of_maps(check_named("what", as_maps, sources), "")
    return make_payload(runs, _load_tiles(tiles, runs), tile_px, "")


def _list_sources(what: UserValue) -> Mapping[str, UserValue] | list[UserValue]:
    """Returns what to collect: by name, or a list of maps or paths; at least one."""
    sources = what
    # A text can be iterated over too, so single sources are told apart from lists first.
    if _is_result(what):
        sources = {"result": what}
    elif isinstance(what, RoadMap | str | Path):
        sources = [what]
    expected = "a Result, maps, or paths of runs and maps"
    # An array without axes has the method of an iterable, and raises an error there.
    if not isinstance(sources, Iterable) or getattr(sources, "ndim", 1) == 0:
        raise InputError("what", expected, type(what).__name__)
    # The sources may be a generator, and they are read more than once.
    if not isinstance(sources, Mapping):
        sources = list(sources)
    if not sources:
        raise InputError("what", expected, "nothing")
    return sources


def _collect_named(sources: Mapping[str, UserValue]) -> list[ShownRun]:
    """Collects results and maps that have names."""
    runs: list[ShownRun] = []
    for name, source in sources.items():
        if not isinstance(name, str):
            raise InputError("what", "texts as names", quote(name))
        if _is_result(source):
            runs.append(from_result(source, name))
            continue
        maps = check_named(f"what: {name}", as_maps, source)
        # A page needs at least one grid for each name.
        if not maps:
            raise InputError(f"what: {name}", "a Result or maps", "nothing")
        runs += of_maps(maps, name)
    return _with_distinct_names(runs)


def _is_result(value: UserValue) -> TypeGuard["Result"]:
    # Asking for the class would load the search, which pages of maps do not need.
    return hasattr(value, "elites") and hasattr(value, "search")


def _collect_files(
    sources: Sequence[Path], tiles: str | Path | TileSet | None, tile_px: int
) -> Payload:
    runs: list[ShownRun] = []
    maps: list[tuple[str, RoadMap]] = []
    recorded_tiles: Path | None = None
    for source in sources:
        # A folder of layers is one map of Duckietown, and any other folder is of runs.
        if is_folder(source) and not is_layers(source):
            for folder in _run_folders(source):
                runs.append(read_run(folder))
                # The page has one tile set for all runs: the first that is found.
                recorded_tiles = recorded_tiles or _find_tiles(folder, runs[-1])
        elif source.suffix.lower() == ".npz":
            runs.append(read_archive(source, source.stem))
        else:
            # Maps of all files come together, because maps of one size are one run on the page.
            maps += _named_maps(source)
    if tiles is None and recorded_tiles is None:
        _announce_lost_tiles(runs)
    heading = runs[0].name if len(runs) == 1 and not maps else ""
    # The folder of a run may have the name of a group of maps, such as "maps".
    runs += by_size(maps)
    tile_set = _load_tiles(recorded_tiles if tiles is None else tiles, runs)
    return make_payload(_with_distinct_names(runs), tile_set, tile_px, heading)


def _named_maps(file: Path) -> list[tuple[str, RoadMap]]:
    """Reads the maps of a file, each with a name."""
    road_maps = read_maps(file)
    if len(road_maps) == 1:
        return [(str(file), road_maps[0])]
    # Maps of one file are told apart by their numbers.
    return [(f"{file} {index}", road_map) for index, road_map in enumerate(road_maps)]


def _announce_lost_tiles(runs: Sequence[ShownRun]) -> None:
    """Says that a tile set is not where the record of its run says.

    The run is the first one with a tile set of its own.
    """
    for run in runs:
        tiles = setting(run, "tiles")
        if tiles:
            expected = f"{tiles}: expected the tile pictures of the run"
            announce(f"{expected}, got none; the package's own are shown; see --tiles")
            # One line is enough, because the page has one tile set.
            return


def _load_tiles(tiles: str | Path | TileSet | None, runs: Sequence[ShownRun]) -> TileSet:
    """Loads the tile set of the page, and announces what it does not show of the chosen maps.

    Other elites are not looked at. A search also keeps invalid maps, which may have any codes.
    """
    tile_set = tiles if isinstance(tiles, TileSet) else load_tiles(tiles)
    for describe in (_describe_undrawn, describe_other_pictures):
        _announce_first(runs, partial(describe, tiles=tile_set))
    return tile_set


def _announce_first(runs: Sequence[ShownRun], describe: Callable[[RoadMap], str]) -> None:
    """Announces the line about the first chosen map that has one."""
    for run in runs:
        for _, name, road_map in run.maps:
            if line := describe(road_map):
                # The chosen maps of a run are in its folder.
                announce(f"{run.name}/maps/{name}: {line}" if run.record else f"{name}: {line}")
                return


def _describe_undrawn(road_map: RoadMap, tiles: TileSet) -> str:
    """Returns a line about the first cell of a map that a tile set has no picture of, or ""."""
    undrawn = first_undrawn(road_map.codes, tiles)
    if undrawn is None:
        return ""
    return f"the tile set {tiles.name!r} has no picture of {undrawn[1]}; such cells stay empty"


def _run_folders(folder: Path) -> list[Path]:
    """Returns the folder of a run, or the folders of runs in a folder."""
    # An unfinished or damaged run lacks run.json. Its archive shows that it is a run, and the error
    # of `read_run` says what is missing.
    if (folder / "run.json").is_file() or (folder / "archive.npz").is_file():
        return [folder]
    folders = sorted(file.parent for file in folder.glob("*/run.json"))
    if folders:
        return folders
    expected = "a folder that generate or pick wrote, or one of such folders"
    raise InputError(folder, expected, "one without run.json")


def _find_tiles(folder: Path, run: ShownRun) -> Path | None:
    """Returns the folder of a run's tile set, see `collect`.

    Returns None if no folder has a set of the recorded name.
    """
    tiles, recorded = setting(run, "tiles"), run.record.get("tile_set")
    if not isinstance(tiles, str):
        return None
    # A run whose record names no set accepts no folder.
    name = recorded.get("name") if isinstance(recorded, dict) else None
    # A run may have been moved together with the folders around it, or be shown from elsewhere.
    for parent in (Path(), *folder.absolute().parents):
        with suppress(InputError):
            # Another folder of this name may be no tile set.
            if is_folder(parent / tiles) and load_tiles(parent / tiles).name == name:
                return parent / tiles
    return None


def _with_distinct_names(runs: Sequence[ShownRun]) -> list[ShownRun]:
    """Returns runs with names by which the page tells them apart."""
    names = _distinct_names([run.name for run in runs])
    return [run._replace(name=name) for run, name in zip(runs, names, strict=True)]


def _distinct_names(names: Sequence[str]) -> list[str]:
    """Numbers the names that occur again, from the second on.

    The numbered names differ from all other names.
    """
    distinct: list[str] = []
    for name in names:
        numbered = name
        number = 1
        # A later name that is numbered already, such as "run (2)", keeps its number.
        while numbered in distinct or (number > 1 and numbered in names):
            number += 1
            numbered = f"{name} ({number})"
        distinct.append(numbered)
    return distinct
