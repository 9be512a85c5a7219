"""Collects the contents of the explorer: folders of runs, archives, maps, results in memory."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import TILE_PX, check_named
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.explorer._finds import (
    Finds,
    by_size,
    from_result,
    of_maps,
    read_archive,
    read_run,
    setting,
)
from elitelanes_jax.explorer._payload import Payload, pack
from elitelanes_jax.formats.dt_layers import is_layers
from elitelanes_jax.formats.road_map import RoadMap, as_maps, read_maps
from elitelanes_jax.tiles.tileset import TileSet, load_tiles


@name_wrong_arguments
def collect(
    what: UserValue,
    *,
    tiles: str | Path | TileSet | None = None,
    tile_px: int = 64,
) -> Payload:
    """Collects a result, maps, or files of runs and maps, to be shown.

    Args:
      what: a `Result`; a map or several, as `as_maps` takes them; a mapping from names to these, to show several side
        by side; or a path or several. A path is the folder of a run of `generate` or `pick`, a folder of such folders,
        an archive, or a file of maps.
      tiles: a tile set or its folder; by default the first run's. If it is not found, the package's own
        is used, with a line on standard error. A relative path in a run's record is searched from here, then from each
        folder above the run.
      tile_px: side of a tile's picture in pixels, 16 to 512.

    Raises:
      InputError: for anything else; for a file or folder that is missing, damaged, incomplete or of another kind, and
        for a bad tile set. The message names the file.
    """
    given: UserValue = what
    check_named("tile_px", TILE_PX, tile_px)
    if _is_result(given):
        given = {"result": given}
    if isinstance(given, RoadMap | str | Path):
        given = [given]
    if not isinstance(given, Iterable):
        raise InputError(f"what: expected a Result, maps, or paths of runs and maps, got {type(what).__name__}")
    listed = given if isinstance(given, Mapping) else list(given)
    if not listed:
        raise InputError("what: expected a Result, maps, or paths of runs and maps, got nothing")
    if not isinstance(listed, Mapping):
        if all(isinstance(one, str | Path) for one in listed):
            return _collect_files([Path(one) for one in listed], tiles, tile_px)
        if any(map(_is_result, listed)):
            raise InputError("what: expected one Result, or several by name, got a list of them")
        return pack(of_maps(check_named("what", as_maps, listed), ""), _load_tiles(tiles), tile_px, "")
    runs: list[Finds] = []
    for name, one in listed.items():
        found = check_named(f"what: {name}", as_maps, one) if not _is_result(one) else None
        runs += [from_result(one, name)] if found is None else of_maps(found, name)
    return pack(runs, _load_tiles(tiles), tile_px, runs[0].name if len(runs) == 1 else "")


def _is_result(value: UserValue) -> bool:
    return hasattr(value, "elites") and hasattr(value, "search")


def _collect_files(sources: Sequence[Path], tiles: str | Path | TileSet | None, tile_px: int) -> Payload:
    runs: list[Finds] = []
    maps: list[tuple[str, RoadMap]] = []
    own: Path | None = None
    for source in sources:
        if source.is_dir() and not is_layers(source):
            for folder in _run_folders(source):
                runs.append(read_run(folder))
                own = own or _find_tiles(folder, runs[-1])
        elif source.suffix == ".npz":
            runs.append(read_archive(source, source.stem))
        else:
            found = read_maps(source)
            names = [str(source)] if len(found) == 1 else [f"{source} {index}" for index in range(len(found))]
            maps += zip(names, found, strict=True)
    names = _distinct_names([run.name for run in runs])
    runs = [run._replace(name=name) for run, name in zip(runs, names, strict=True)]
    if tiles is None and own is None and (lost := next(filter(None, (setting(run, "tiles") for run in runs)), None)):
        announce(f"{lost}: expected the tile pictures of the run, got none; the package's own are shown; see --tiles")
    tile_set = _load_tiles(own if tiles is None else tiles)
    heading = runs[0].name if len(runs) == 1 and not maps else ""
    return pack([*runs, *by_size(maps)], tile_set, tile_px, heading)


def _load_tiles(tiles: str | Path | TileSet | None) -> TileSet:
    return tiles if isinstance(tiles, TileSet) else load_tiles(tiles)


def _run_folders(folder: Path) -> list[Path]:
    """Returns the folder of a run, or the folders of runs in a folder."""
    if (folder / "run.json").is_file() or (folder / "archive.npz").is_file():
        return [folder]
    found = sorted(file.parent for file in folder.glob("*/run.json"))
    if found:
        return found
    expected = f"{folder}: expected a folder that generate or pick wrote, or one of such folders"
    raise InputError(f"{expected}, got one without run.json")


def _find_tiles(folder: Path, run: Finds) -> Path | None:
    """Returns the folder of a run's tile set, or None if no folder has a set of the recorded name; see `collect`."""
    tiles, recorded = setting(run, "tiles"), run.record.get("tile_set")
    if not isinstance(tiles, str):
        return None
    name = recorded.get("name") if isinstance(recorded, dict) else None
    for parent in (Path(), *folder.absolute().parents):
        with suppress(InputError):  # another folder of this name
            if (parent / tiles).is_dir() and load_tiles(parent / tiles).name == name:
                return parent / tiles
    return None


def _distinct_names(names: Sequence[str]) -> list[str]:
    counts = [names[: index + 1].count(name) for index, name in enumerate(names)]
    return [name if count == 1 else f"{name} ({count})" for name, count in zip(names, counts, strict=True)]
