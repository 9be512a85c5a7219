"""From a specification to a folder of road maps, each with its picture, its masks and its metrics."""

import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.atomic_io import new_folder
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError
from elitelanes_jax._util.progress import Progress, announce, detail
from elitelanes_jax._util.version import installed_versions
from elitelanes_jax.formats.road_map import Drawn, RoadMap, map_to_json
from elitelanes_jax.optimizers.presets import PRESETS
from elitelanes_jax.optimizers.run import seed_keys
from elitelanes_jax.problem.qd_metrics import coverage, qd_score
from elitelanes_jax.search import Result, evolve
from elitelanes_jax.selection import Choice, choose_maps, describe_choice, describe_shortage, refuse_impossible
from elitelanes_jax.spec import GenerateSpec, SearchSpec
from elitelanes_jax.tiles.contact_sheet import contact_sheet
from elitelanes_jax.tiles.render import choose_tiles, render, write_picture, write_png
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

__all__ = ["drawable", "generate"]

# A map's longer side on the contact sheet, in pixels, and the limits of a tile's.
_SHEET_PX, _SHEET_TILE_PX = 288, (16, 96)


def generate(spec: GenerateSpec, out: Path) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    The same specification gives the same files, byte for byte, but for the times in ``run.json``.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for constraints that no map can meet, a bad tile set, or a folder that is not new.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for.
      OSError: if the folder cannot be written.
    """
    tiles = load_tiles(spec.tiles)
    search = drawable(spec.search, tiles)
    with new_folder(out) as folder:
        announce(
            f"evolving {spec.maps} maps of {spec.size[0]} x {spec.size[1]} tiles: {search.method}, {search.preset}, "
            f"{spec.seeds} runs of {_budget(search)}"
        )
        began = time.perf_counter()
        result = evolve(seed_keys(spec.seed, spec.seeds), spec.size, spec=search)
        with Progress(f"choosing {spec.maps} maps"):
            choice = choose_maps(result, spec.maps, spec.seed)
        detail(describe_choice(choice, spec.maps))
        if len(choice.maps) < spec.maps:
            raise NotEnoughMapsError(describe_shortage(choice, spec.maps, search.method, spec.size))
        evolved = time.perf_counter()
        with Progress("drawing", len(choice.maps), "maps") as bar:
            maps = _write_maps(folder, choice, spec, tiles, bar)
        _write_archive(folder / "archive.npz", result)
        seconds = {"evolve": evolved - began, "draw": time.perf_counter() - evolved}
        run = _run_record(spec, tiles, choice, seconds, result)
        (folder / "run.json").write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
    return maps


def drawable(search: SearchSpec, tiles: TileSet) -> SearchSpec:
    """Returns a search whose maps a tile set can draw.

    Raises:
      InputError: for constraints that no map can meet, or an alphabet that the set lacks tiles of.
    """
    missing = set(search.alphabet or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError(f"alphabet: expected codes of the tile set {tiles.name!r}, {codes}, got {min(missing)}")
    refuse_impossible(search)
    return search.but({"alphabet": search.alphabet or tiles.alphabet})


def _write_maps(folder: Path, choice: Choice, spec: GenerateSpec, tiles: TileSet, bar: Progress) -> list[RoadMap]:
    """Writes each map in a folder of its own, and the contact sheet; returns the maps as drawn."""
    sheet_px = int(np.clip(_SHEET_PX // max(spec.size), *_SHEET_TILE_PX))
    maps, small = [], []
    for number, plain in enumerate(choice.maps):
        chosen = choose_tiles(plain.codes, tiles, [spec.seed, number])
        names = [[tiles.pictures[tile].name for tile, _ in row] for row in chosen]
        road_map = plain._replace(drawn=Drawn(tiles.name, names, chosen[..., 1].tolist()))
        place = folder / "maps" / f"{number:04d}"
        place.mkdir(parents=True)
        write_picture(place, render(plain.codes, tiles, tile_px=spec.tile_px, chosen=chosen))
        (place / "map.json").write_text(map_to_json(road_map), encoding="utf-8")
        small.append(render(plain.codes, tiles, tile_px=sheet_px, chosen=chosen).image)
        maps.append(road_map)
        bar.count()
    title = (
        f"{len(maps)} road maps of {spec.size[0]} x {spec.size[1]} tiles, {spec.search.method}, "
        f"{spec.seeds} seeds, {_budget(spec.search)}, seed {spec.seed}"
    )
    sheet = contact_sheet(title, small, [_caption(number, road_map) for number, road_map in enumerate(maps)])
    write_png(folder / "contact-sheet.png", sheet)
    return maps


def _budget(search: SearchSpec) -> str:
    if search.generations is None:
        return f"{search.evaluations:,} evaluations"
    return f"{search.generations:,} generations"


def _caption(number: int, road_map: RoadMap) -> tuple[str, ...]:
    figures = road_map.metrics or {}
    return (
        f"{number:04d}   fitness {road_map.fitness}",
        f"cyclomatic {figures['cyclomatic']}, crossings {figures['crossings']}, bridges {figures['bridges']}",
        f"adjacent: crossings {figures['adjacent_crossings']}, turns {figures['adjacent_turns']}; "
        f"straight {figures['straight_score']}",
    )


def _write_archive(file: Path, result: Result) -> None:
    """Writes all elites of all seeds, and the history, as arrays with the seeds in front."""
    elites = result.elites._asdict()
    arrays = {f"metrics.{name}": values for name, values in elites.pop("metrics")._asdict().items()} | elites
    for name, values in result.history._asdict().items():
        if name != "evaluations_per_second":  # the one thing that is not the same every time
            arrays[f"history.{name}"] = values
    arrays["axes"] = np.array([axis.metric for axis in result.axes])
    with file.open("wb") as stream:
        np.savez_compressed(stream, **{name: np.asarray(array) for name, array in arrays.items()})  # type: ignore[arg-type]


def _run_record(
    spec: GenerateSpec, tiles: TileSet, choice: Choice, seconds: dict[str, float], result: Result
) -> dict[str, Any]:
    elites = result.elites
    return {
        "settings": spec.to_plain(),
        "config": _plain(PRESETS[spec.search.method, spec.search.preset]),
        "weights": spec.search.all_weights._asdict(),
        "tile_set": {"name": tiles.name, "licence": tiles.licence, "alphabet": tiles.alphabet},
        "axes": [axis._asdict() for axis in result.axes],
        "elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike},
        # By seed; an elite worse than 0 is worth nothing.
        "archive": {
            "coverage": coverage(elites.valid).tolist(),
            "qd_score": qd_score(elites.fitness, elites.valid, worst=0).tolist(),
        },
        "versions": installed_versions(),
        "device": jax.devices()[0].device_kind,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": _median(result.history.evaluations_per_second),
        },
    }


def _median(speeds: NDArray[np.float64]) -> int | None:
    return round(float(np.median(speeds))) if speeds.size else None


def _plain(record: Any) -> Any:
    """Returns records within records as tables within tables."""
    return {name: _plain(value) for name, value in vars(record).items()} if hasattr(record, "__dict__") else record
