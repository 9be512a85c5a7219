"""From settings to a folder of road maps, each with its picture, its masks and its figures."""

import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.errors import NotEnoughMapsError
from elitelanes_jax.folders import new_folder
from elitelanes_jax.illumination import coverage, qd_score
from elitelanes_jax.overview import overview
from elitelanes_jax.render import choose_tiles, render, write_picture, write_png
from elitelanes_jax.roadmap import Drawn, RoadMap, read_map, to_json
from elitelanes_jax.search import Result, preset_config, seed_keys
from elitelanes_jax.selection import Choice, choose_maps, shortage
from elitelanes_jax.tilesets import TileSet, load_tiles
from elitelanes_jax.versions import versions
from elitelanes_jax.wishes import Wishes, search, weights_of

__all__ = ["Settings", "generate"]

# A map's longer side on the overview, in pixels, and the limits of a tile's.
_OVERVIEW_PX, _OVERVIEW_TILE_PX = 288, (16, 96)


class Settings(NamedTuple):
    """What to generate.

    Attributes:
      size: (height, width) of the maps in tiles.
      seeds: how many independent runs to choose from.
      maps: how many maps.
      seed: of everything random.
      tiles: folder of the tile set; the package's own by default.
      tile_px: side of a tile in pixels.
      initial: files of maps that every run begins with, see `read_map`.
      wishes: what to evolve.
    """

    size: tuple[int, int] = (12, 12)
    seeds: int = 8
    maps: int = 16
    seed: int = 0
    tiles: Path | None = None
    tile_px: int = 64
    initial: tuple[Path, ...] = ()
    wishes: Wishes = Wishes()


def generate(settings: Settings, out: Path) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    With the filling repair, but where rules leave cells empty. The same settings give the same files, byte for byte,
    but for the times in ``run.json``.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for settings out of their range, a bad tile set, or a folder that is not new.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for.
      OSError: if the folder cannot be written.
    """
    tiles = load_tiles(settings.tiles)
    with new_folder(out) as folder:
        began = time.perf_counter()
        initial = [read_map(file).codes for file in settings.initial]
        keys = seed_keys(settings.seed, settings.seeds)
        result = search(settings.wishes, keys, settings.size, tiles.alphabet, initial=initial or None)
        choice = choose_maps(result, settings.maps, settings.seed)
        if len(choice.maps) < settings.maps:
            raise NotEnoughMapsError(shortage(choice, settings.maps, settings.wishes.method, settings.size))
        evolved = time.perf_counter()
        maps = _write_maps(folder, choice, settings, tiles)
        _write_archive(folder / "archive.npz", result)
        seconds = {"evolve": evolved - began, "draw": time.perf_counter() - evolved}
        run = _run_record(settings, tiles, choice, seconds, result)
        (folder / "run.json").write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
    return maps


def _write_maps(folder: Path, choice: Choice, settings: Settings, tiles: TileSet) -> list[RoadMap]:
    """Writes each map in a folder of its own, and the overview; returns them as drawn."""
    overview_px = int(np.clip(_OVERVIEW_PX // max(settings.size), *_OVERVIEW_TILE_PX))
    maps, small = [], []
    for number, plain in enumerate(choice.maps):
        chosen = choose_tiles(plain.codes, tiles, [settings.seed, number])
        names = [[tiles.pictures[tile].name for tile, _ in row] for row in chosen]
        road_map = plain._replace(drawn=Drawn(tiles.name, names, chosen[..., 1].tolist()))
        place = folder / "maps" / f"{number:04d}"
        place.mkdir(parents=True)
        write_picture(place, render(plain.codes, tiles, tile_px=settings.tile_px, chosen=chosen))
        (place / "map.json").write_text(to_json(road_map), encoding="utf-8")
        small.append(render(plain.codes, tiles, tile_px=overview_px, chosen=chosen).image)
        maps.append(road_map)
    title = (
        f"{len(maps)} road maps of {settings.size[0]} x {settings.size[1]} tiles, {settings.wishes.method}, "
        f"{settings.seeds} seeds, {_budget(settings)}, seed {settings.seed}"
    )
    write_png(folder / "overview.png", overview(title, small, [_caption(*item) for item in enumerate(maps)]))
    return maps


def _budget(settings: Settings) -> str:
    wishes = settings.wishes
    if wishes.generations is None:
        return f"{wishes.evaluations:,} evaluations"
    return f"{wishes.generations:,} generations"


def _caption(number: int, road_map: RoadMap) -> tuple[str, ...]:
    figures = road_map.metrics or {}
    return (
        f"{number:04d}   fitness {road_map.fitness}",
        f"cyclomatic {figures['cyclomatic']}, crossings {figures['crossings']}, bridges {figures['bridges']}",
        f"adjacent: crossings {figures['adjacent_crossings']}, turns {figures['adjacent_turns']}; "
        f"straight {figures['straight_score']}",
    )


def _write_archive(file: Path, result: Result) -> None:
    """All elites of all seeds, and the history, as arrays with the seeds in front."""
    elites = result.elites._asdict()
    arrays = {f"metrics.{name}": values for name, values in elites.pop("metrics")._asdict().items()} | elites
    for name, values in result.history._asdict().items():
        if name != "evaluations_per_second":  # the one thing that is not the same every time
            arrays[f"history.{name}"] = values
    arrays["axes"] = np.array([axis.metric for axis in result.axes])
    with file.open("wb") as stream:
        np.savez_compressed(stream, **{name: np.asarray(array) for name, array in arrays.items()})  # type: ignore[arg-type]


def _run_record(
    settings: Settings, tiles: TileSet, choice: Choice, seconds: dict[str, float], result: Result
) -> dict[str, Any]:
    elites = result.elites
    return {
        "settings": _plain_settings(settings),
        "config": _plain(preset_config(settings.wishes.method, settings.wishes.preset)),
        "weights": weights_of(settings.wishes)._asdict(),
        "tile_set": {"name": tiles.name, "licence": tiles.licence, "alphabet": tiles.alphabet},
        "axes": [axis._asdict() for axis in result.axes],
        "elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike},
        # By seed; an elite worse than 0 is worth nothing.
        "archive": {
            "coverage": coverage(elites.valid).tolist(),
            "qd_score": qd_score(elites.fitness, elites.valid, worst=0).tolist(),
        },
        "versions": versions(),
        "device": jax.devices()[0].device_kind,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": _median(result.history.evaluations_per_second),
        },
    }


def _plain_settings(settings: Settings) -> dict[str, Any]:
    values = settings._asdict() | settings.wishes._asdict() | {"initial": [str(file) for file in settings.initial]}
    del values["wishes"]
    return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


def _median(speeds: NDArray[np.float64]) -> int | None:
    return round(float(np.median(speeds))) if speeds.size else None


def _plain(record: Any) -> Any:
    """Records within records as tables within tables."""
    if hasattr(record, "_asdict"):
        return {name: _plain(value) for name, value in record._asdict().items()}
    return record
