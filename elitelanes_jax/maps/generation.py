"""From a specification to a folder of road maps, each with its picture, its masks and its metrics."""

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, many
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import output_folder, remove
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce, detail
from elitelanes_jax._util.records import record
from elitelanes_jax._util.types import AnyArray, Plain
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps._parts import ARCHIVE, RECORD, Evolved, join_parts
from elitelanes_jax.maps.folder import foreign_to_maps, write_maps
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.optimizers.loop import seed_keys
from elitelanes_jax.optimizers.presets import PRESETS
from elitelanes_jax.problem.qd_metrics import coverage, qd_score
from elitelanes_jax.search.evolution import evolve
from elitelanes_jax.search.like import difference_from
from elitelanes_jax.search.selection import Choice, describe_choice, describe_shortage, remedy
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

NEAREST = "difference_from_given"
"""The name of the figure that maps like given ones have: the share of cells in which they differ from the nearest."""

# The seconds between two checkpoints, and those of a search that is kept while maps are drawn.
_SECONDS_A_CHECKPOINT, _WORTH_KEEPING = 10, 10


def generate(spec: GenerateSpec, out: Path, *, force: bool = False) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    The same specification gives the same files, byte for byte, but for the times in ``run.json``. A search that was
    killed, or failed after ten seconds, goes on where it was when it is asked for again. Of a part of the seeds the
    archive and the record are written, and no maps.

    Args:
      spec: of the search and the folder.
      out: the folder, new or empty.
      force: whether a folder that an earlier run wrote, and nobody else wrote to, is replaced.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for constraints that no map can meet, a bad tile set, a folder that is not new, or one that another
        search or another process has begun.
      NotEnoughMapsError: if there are fewer valid and different maps than asked for; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    spec, out = check_named("spec", record(GenerateSpec), spec), check_named("out", path, out)
    search, tiles = check_drawable(spec)
    keys = seed_keys(spec.seed, spec.seeds)[np.array(spec.seed_numbers)]
    with output_folder(
        out, _identity(spec, search), inputs=inputs_of(spec), foreign=foreign_to_maps, force=force
    ) as work:
        aim = many(spec.maps, "map") if spec.part is None else "part {} of {} of a run for maps".format(*spec.part)
        announce(
            f"evolving {aim} of {spec.size[0]} x {spec.size[1]} tiles: {search.method}, {search.preset}, "
            f"{many(len(keys), 'run')} of {_budget(search)}"
        )
        began = time.perf_counter()
        result = evolve(keys, spec.size, spec=search, checkpoint=work.kept / "search", every=_SECONDS_A_CHECKPOINT)
        searched = result.history.seconds
        if searched < _WORTH_KEEPING:
            remove(work.kept / "search")
        seconds = max(time.perf_counter() - began, searched)  # a search that went on has had its seconds before
        speed = _median(result.history.evaluations_per_second)
        return _write_run(work.files, Evolved(spec, result, seconds, speed, jax.devices()[0].device_kind), tiles)


def _identity(spec: GenerateSpec, search: SearchSpec) -> dict[str, Plain]:
    """Returns what a search depends on except its budget."""
    settings = {name: value for name, value in search.to_plain().items() if name not in ("evaluations", "generations")}
    about = {"size": spec.size, "seeds": spec.seeds, "seed": spec.seed, "part": spec.part}
    return {"command": "generate", **about, "search": settings, "versions": installed_versions()}


def inputs_of(spec: GenerateSpec) -> list[Path]:
    return [spec.tiles] if spec.tiles else []


def merge(parts: Sequence[Path], out: Path, *, force: bool = False) -> list[RoadMap]:
    """Puts the parts of a run together, and writes the folder that `generate` writes without parts, byte for byte.

    In ``run.json`` the seconds of the parts are added up, and the speed is their median.

    Args:
      parts: folders, in any order.
      out: folder to write to, new or empty.
      force: whether a folder that an earlier run wrote, and nobody else wrote to, is replaced.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for folders that are not all the parts of one run; see `join_parts`.
      NotEnoughMapsError: if there are fewer valid and different maps than the parts' specification asks for.
      OSError: if the folder cannot be written.
    """
    with output_folder(out, {"command": "merge"}, inputs=parts, foreign=foreign_to_maps, force=force) as work:
        return write_joined(parts, work.files)


def write_joined(parts: Sequence[Path], folder: Path) -> list[RoadMap]:
    """Writes the files of the run whose parts these are to a folder that is there; returns its maps."""
    joined = join_parts(parts)
    tiles = load_tiles(joined.spec.tiles, blend=joined.spec.blend)
    if joined.result.spec != drawable(joined.spec.search, tiles).on(joined.spec.size):
        raise InputError(f"{parts[0]}: expected a part for the tile set {tiles.name!r}, got one for another")
    return _write_run(folder, joined, tiles)


def _write_run(folder: Path, run: Evolved, tiles: TileSet) -> list[RoadMap]:
    """Writes the files of a run, or of a part of one; returns its maps."""
    spec, search, began = run.spec, run.result.spec, time.perf_counter()
    choice, maps, chosen = None, [], began
    if spec.part is None:
        with Progress("choosing maps"):
            choice = run.result.choose(spec.maps, spec.seed)
        detail(describe_choice(choice, spec.maps))
        if len(choice.maps) < (1 if spec.at_most else spec.maps):
            words = remedy(choice, search.method, spec.size)
            raise NotEnoughMapsError(describe_shortage(choice, spec.maps, words))
        chosen = time.perf_counter()
        title = (
            f"{many(len(choice.maps), 'road map')} of {spec.size[0]} x {spec.size[1]} tiles, {search.method}, "
            f"{many(spec.seeds, 'seed')}, {_budget(search)}, seed {spec.seed}"
        )
        if search.like:
            choice = choice._replace(maps=[_with_difference(one, search.like) for one in choice.maps])
        maps = write_maps(folder, choice.maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed)
    run.result.save(folder / ARCHIVE, state=False, seed=spec.seed)
    seconds = {"evolve": run.seconds + chosen - began, "draw": time.perf_counter() - chosen}
    write_json(folder / RECORD, _run_record(run, tiles, choice, seconds))
    return maps


def check_drawable(spec: GenerateSpec) -> tuple[SearchSpec, TileSet]:
    """Returns a run's search, with the tile set's alphabet, and its tile set.

    Raises:
      InputError: for a bad tile set, an alphabet that it lacks tiles of, or constraints that too few maps can meet.
    """
    tiles = load_tiles(spec.tiles, blend=spec.blend)
    search = drawable(spec.search, tiles).on(spec.size)
    search.count_maps(spec.size, 1 if spec.at_most else spec.maps)
    return search, tiles


def _with_difference(road_map: RoadMap, given: Sequence[AnyArray]) -> RoadMap:
    difference = round(difference_from(road_map.codes, given), 3)
    return replace(road_map, metrics={**(road_map.metrics or {}), NEAREST: difference})


def drawable(search: SearchSpec, tiles: TileSet) -> SearchSpec:
    """Returns a search whose maps a tile set can draw.

    Raises:
      InputError: for an alphabet that the set lacks tiles of.
    """
    missing = set(search.alphabet or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError(f"alphabet: expected codes of the tile set {tiles.name!r}, {codes}, got {min(missing)}")
    return search.replace(alphabet=search.alphabet or tiles.alphabet)


def _budget(search: SearchSpec) -> str:
    if search.generations is None:
        return f"{search.evaluations:,} evaluations"
    return f"{search.generations:,} generations"


def _run_record(run: Evolved, tiles: TileSet, choice: Choice | None, seconds: dict[str, float]) -> dict[str, Plain]:
    spec, search, elites = run.spec, run.result.spec, run.result.elites
    chosen = choice and {"elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike}}
    return {
        "settings": spec.to_plain(),
        "config": _plain(PRESETS[search.method, search.preset]),
        "weights": search.all_weights._asdict(),
        "tile_set": {name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "layers", "blend")},
        "axes": [axis._asdict() for axis in run.result.axes],
        **(chosen or {}),
        # By seed; an elite worse than 0 is worth nothing.
        "archive": {
            "coverage": coverage(elites.valid).tolist(),
            "qd_score": qd_score(elites.fitness, elites.valid, worst=0).tolist(),
        },
        "versions": installed_versions(),
        "device": run.device,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": run.speed,
        },
    }


def _median(speeds: NDArray[np.float64]) -> int | None:
    return round(float(np.median(speeds))) if speeds.size else None


def _plain(record: Plain) -> Plain:
    """Returns records within records as tables within tables."""
    return {name: _plain(value) for name, value in vars(record).items()} if hasattr(record, "__dict__") else record
