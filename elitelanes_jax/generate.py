"""From a specification to a folder of road maps, each with its picture, its masks and its metrics."""

import json
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.atomic_io import new_folder
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, many
from elitelanes_jax._util.progress import Progress, announce, detail
from elitelanes_jax._util.settings import record
from elitelanes_jax._util.version import installed_versions
from elitelanes_jax.archive_file import write_archive
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.map_folder import foreign_to_maps, write_maps
from elitelanes_jax.optimizers.presets import PRESETS
from elitelanes_jax.optimizers.run import seed_keys
from elitelanes_jax.problem.qd_metrics import coverage, qd_score
from elitelanes_jax.search import Result, evolve
from elitelanes_jax.selection import Choice, choose_maps, describe_choice, describe_shortage, remedy
from elitelanes_jax.spec import GenerateSpec, SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

__all__ = ["drawable", "generate"]


def generate(spec: GenerateSpec, out: Path, *, force: bool = False) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    The same specification gives the same files, byte for byte, but for the times in ``run.json``.

    Args:
      spec: of the search and the folder.
      out: the folder, new or empty.
      force: whether a folder that an earlier run wrote, and nobody else wrote to, is replaced.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for constraints that no map can meet, a bad tile set, or a folder that is not new.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    spec, out = check_named("spec", record(GenerateSpec), spec), check_named("out", path, out)
    tiles = load_tiles(spec.tiles)
    search = drawable(spec.search, tiles)
    search.count_maps(spec.size, 1 if spec.at_most else spec.maps)
    with new_folder(out, foreign=foreign_to_maps, force=force) as folder:
        announce(
            f"evolving {many(spec.maps, 'map')} of {spec.size[0]} x {spec.size[1]} tiles: {search.method}, "
            f"{search.preset}, {many(spec.seeds, 'run')} of {_budget(search)}"
        )
        began = time.perf_counter()
        result = evolve(seed_keys(spec.seed, spec.seeds), spec.size, spec=search)
        with Progress("choosing maps"):
            choice = choose_maps(result, spec.maps, spec.seed)
        detail(describe_choice(choice, spec.maps))
        if len(choice.maps) < (1 if spec.at_most else spec.maps):
            raise NotEnoughMapsError(describe_shortage(choice, spec.maps, remedy(choice, search.method, spec.size)))
        evolved = time.perf_counter()
        title = (
            f"{many(len(choice.maps), 'road map')} of {spec.size[0]} x {spec.size[1]} tiles, {search.method}, "
            f"{many(spec.seeds, 'seed')}, {_budget(search)}, seed {spec.seed}"
        )
        maps = write_maps(folder, choice.maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed)
        write_archive(folder / "archive.npz", result, spec.seed)
        seconds = {"evolve": evolved - began, "draw": time.perf_counter() - evolved}
        run = _run_record(spec, tiles, choice, seconds, result)
        (folder / "run.json").write_text(json.dumps(run, indent=2) + "\n", encoding="utf-8")
    return maps


def drawable(search: SearchSpec, tiles: TileSet) -> SearchSpec:
    """Returns a search whose maps a tile set can draw.

    Raises:
      InputError: for an alphabet that the set lacks tiles of.
    """
    missing = set(search.alphabet or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError(f"alphabet: expected codes of the tile set {tiles.name!r}, {codes}, got {min(missing)}")
    return search.but({"alphabet": search.alphabet or tiles.alphabet})


def _budget(search: SearchSpec) -> str:
    if search.generations is None:
        return f"{search.evaluations:,} evaluations"
    return f"{search.generations:,} generations"


def _run_record(
    spec: GenerateSpec, tiles: TileSet, choice: Choice, seconds: dict[str, float], result: Result
) -> dict[str, Any]:
    elites = result.elites
    return {
        "settings": spec.to_plain(),
        "config": _plain(PRESETS[spec.search.method, spec.search.preset]),
        "weights": spec.search.all_weights._asdict(),
        "tile_set": {name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "layers")},
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
