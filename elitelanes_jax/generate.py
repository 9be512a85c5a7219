"""From settings to a folder of road maps, each with its picture, its masks and its figures."""

import json
import platform
import time
from pathlib import Path
from typing import Any, Literal, NamedTuple

import cv2
import jax
import jaxlib
import numpy as np

from elitelanes_jax.folders import check_new_folder, new_folder
from elitelanes_jax.optimizers import MapElitesConfig
from elitelanes_jax.overview import overview
from elitelanes_jax.render import choose_tiles, render, write_picture, write_png
from elitelanes_jax.roadmap import Drawn, RoadMap, to_json
from elitelanes_jax.search import Result, evolve
from elitelanes_jax.selection import Choice, choose_maps
from elitelanes_jax.tilesets import TileSet, load_tiles
from elitelanes_jax.version import __version__

__all__ = ["NotEnoughMapsError", "Settings", "generate"]

_OVERVIEW_PX = 24


class Settings(NamedTuple):
    """What to generate.

    size: (height, width) of the maps in tiles.
    method, preset, generations: see `evolve`.
    parents: of MAP-Elites, see `MapElitesConfig`.
    seeds: how many independent runs to choose from.
    maps: how many maps.
    seed: of everything random.
    tiles: folder of the tile set; the package's own by default.
    tile_px: side of a tile in pixels.
    """

    size: tuple[int, int] = (12, 12)
    method: str = "map-elites"
    preset: str = "paper"
    parents: Literal["population", "archive"] = "archive"
    generations: int = 2000
    seeds: int = 8
    maps: int = 16
    seed: int = 0
    tiles: Path | None = None
    tile_px: int = 64


class NotEnoughMapsError(Exception):
    """The settings yield fewer maps than were asked for; the message says how many, and what became of the rest."""


def generate(settings: Settings, out: Path) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    With the filling repair, as there are no pictures of dead ends and empty cells. The same settings give the same
    files, byte for byte, but for the times in ``run.json``.

    Returns:
      The maps, as they were written.

    Raises:
      ValueError: for settings out of their range, a bad tile set, or a folder that is not new.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for.
      OSError: if the folder cannot be written.
    """
    check_new_folder(out)
    tiles = load_tiles(settings.tiles)
    began = time.perf_counter()
    result = evolve(
        jax.vmap(lambda number: jax.random.fold_in(jax.random.key(settings.seed), number))(np.arange(settings.seeds)),
        settings.size,
        method=settings.method,
        preset=settings.preset,
        config=MapElitesConfig(parents=settings.parents) if settings.method == "map-elites" else None,
        generations=settings.generations,
        alphabet=tiles.alphabet,
        fill=True,
    )
    choice = choose_maps(result, settings.maps, settings.seed)
    if len(choice.maps) < settings.maps:
        raise NotEnoughMapsError(_shortage(choice, settings))
    evolved = time.perf_counter()

    maps = []
    with new_folder(out) as folder:
        small = []
        for number, plain in enumerate(choice.maps):
            chosen = choose_tiles(plain.codes, tiles, [settings.seed, number])
            road_map = plain._replace(
                drawn=Drawn(
                    tiles.name,
                    [[tiles.tiles[tile].name for tile, _ in row] for row in chosen],
                    chosen[..., 1].tolist(),
                )
            )
            place = folder / "maps" / f"{number:04d}"
            place.mkdir(parents=True)
            write_picture(place, render(plain.codes, tiles, tile_px=settings.tile_px, chosen=chosen))
            (place / "map.json").write_text(to_json(road_map))
            small.append(render(plain.codes, tiles, tile_px=_OVERVIEW_PX, chosen=chosen).image)
            maps.append(road_map)
        title = (
            f"{len(maps)} road maps of {settings.size[0]} x {settings.size[1]} tiles, {settings.method}, "
            f"{settings.seeds} seeds, {settings.generations:,} generations, seed {settings.seed}"
        )
        write_png(folder / "overview.png", overview(title, small, [_caption(*item) for item in enumerate(maps)]))
        _write_archive(folder / "archive.npz", result)
        seconds = {"evolve": evolved - began, "draw": time.perf_counter() - evolved}
        run = _run_record(settings, tiles, choice, seconds, result)
        (folder / "run.json").write_text(json.dumps(run, indent=2) + "\n")
    return maps


def _caption(number: int, road_map: RoadMap) -> tuple[str, ...]:
    figures = road_map.metrics or {}
    return (
        f"{number:04d}   fitness {road_map.fitness}",
        f"cyclomatic {figures['cyclomatic']}, crossings {figures['crossings']}, bridges {figures['bridges']}",
        f"adjacent: crossings {figures['adjacent_crossings']}, turns {figures['adjacent_turns']}; "
        f"straight {figures['straight_score']}",
    )


def _shortage(choice: Choice, settings: Settings) -> str:
    rejected = [f"{number} {reason}" for reason, number in choice.rejected.items()]
    if choice.alike:
        rejected.append(f"{choice.alike} like another when turned or mirrored")
    return (
        f"found {len(choice.maps)} of {settings.maps} maps among {choice.found} elites"
        + (f" ({', '.join(rejected)})" if rejected else "")
        + "; more seeds or generations find more"
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
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(array) for name, array in arrays.items()})


def _run_record(
    settings: Settings, tiles: TileSet, choice: Choice, seconds: dict[str, float], result: Result
) -> dict[str, Any]:
    return {
        "settings": settings._asdict() | {"tiles": settings.tiles and str(settings.tiles)},
        "tile_set": {"name": tiles.name, "licence": tiles.licence, "alphabet": tiles.alphabet},
        "axes": [axis._asdict() for axis in result.axes],
        "elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike},
        "versions": {
            "elitelanes_jax": __version__,
            "python": platform.python_version(),
            "jax": jax.__version__,
            "jaxlib": jaxlib.__version__,
            "numpy": np.__version__,
            "opencv": cv2.__version__,
        },
        "device": jax.devices()[0].device_kind,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": round(float(np.median(result.history.evaluations_per_second))),
        },
    }
