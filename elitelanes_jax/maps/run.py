"""One run of `generate`: its search and tiles, its result, and the files that describe it."""

import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, detail
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import ARCHIVE, RECORD, write_maps
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.optimizers.presets import config_to_plain
from elitelanes_jax.problem.qd_metrics import coverage, qd_score
from elitelanes_jax.search.like import difference_from
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.selection import Choice
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

DIFFERENCE = "difference_from_examples"
"""The metric of maps like example maps: the share of cells in which a map differs from the nearest example map."""


class Run(NamedTuple):
    """A specification, with its search and its tiles. The search has the alphabet of the tiles."""

    spec: GenerateSpec
    search: SearchSpec
    tiles: TileSet

    def identity(self) -> dict[str, Plain]:
        """Returns what the search depends on except its budget, plain values for JSON."""
        search = self.search.to_plain()
        del search["evaluations"], search["generations"]
        about = {name: getattr(self.spec, name) for name in ("size", "seeds", "seed", "part")}
        return {"command": "generate", **about, "search": search, "versions": installed_versions()}


class Evolved(NamedTuple):
    """A run with its result, and the figures of the search for its record."""

    run: Run
    result: Result
    seconds: float
    speed: int | None  # the median of the evaluations per second; None without generations
    device: str


def plan_run(spec: GenerateSpec) -> Run:
    """Loads the tiles of a run and checks its search.

    Raises:
      InputError: for a bad tile set, an alphabet with codes that it has no tiles for, or constraints that too few maps
        can satisfy.
    """
    tiles = load_tiles(spec.tiles, blend=spec.blend)
    search = drawable(spec.search, tiles).on(spec.size)
    search.check_maps(spec.size, 1 if spec.at_most else spec.maps, exhaustive=True)
    return Run(spec, search, tiles)


def drawable(search: SearchSpec, tiles: TileSet) -> SearchSpec:
    """Returns a search whose maps can be drawn with a tile set; raises `InputError` if its alphabet has other codes."""
    missing = set(search.alphabet or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError(f"alphabet: expected codes of the tile set {tiles.name!r}, {codes}, got {min(missing)}")
    return search.replace(alphabet=search.alphabet or tiles.alphabet)


def write_run(folder: Path, evolved: Evolved) -> list[RoadMap]:
    """Chooses the maps of a run, and writes them, its archive and its record; returns the maps.

    For a part of a run, only the archive and the record are written. Raises `NotEnoughMapsError`.
    """
    (spec, search, tiles), result, start = evolved.run, evolved.result, time.perf_counter()
    choice, maps = None, []
    if spec.part is None:
        choice = choose_maps(result, spec.maps, spec.at_most, seed=spec.seed)
    chosen = time.perf_counter()
    if choice is not None:
        title = (
            f"{pluralize(len(choice.maps), 'road map')} of {spec.size[0]} x {spec.size[1]} tiles, {search.method}, "
            f"{pluralize(spec.seeds, 'seed')}, {describe_budget(search)}, seed {spec.seed}"
        )
        maps = [_with_difference(road_map, search) for road_map in choice.maps]
        maps = write_maps(folder, maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed, furnish=spec.furnish)
    result.save(folder / ARCHIVE, state=False, seed=spec.seed)
    seconds = {"evolve": evolved.seconds + chosen - start, "draw": time.perf_counter() - chosen}
    record = {
        "settings": spec.to_plain(),
        "weights": search.all_weights._asdict(),
        **describe_source(tiles, result, choice),
        "archive": describe_archive(result),
        "versions": installed_versions(),
        "device": evolved.device,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": evolved.speed,
        },
    }
    write_json(folder / RECORD, record)
    return maps


def describe_archive(result: Result) -> dict[str, list[float]]:
    """Returns two metrics of an archive, by seed. An elite worse than 0 does not count."""
    valid = result.elites.valid
    return {"coverage": coverage(valid).tolist(), "qd_score": qd_score(result.elites.fitness, valid, worst=0).tolist()}


def choose_maps(result: Result, count: int, at_most: bool, hint: str | None = None, **options: UserValue) -> Choice:
    """Chooses maps with the options of `Result.choose`, fewer than `count` only if `at_most` is set.

    Raises:
      NotEnoughMapsError: if there are too few, or none. The hint says what finds more; its default depends on the
        search.
    """
    with Progress("choosing maps"):
        choice = result.choose(count, **options)
    detail(choice.describe(count))
    if len(choice.maps) < (1 if at_most else count):
        height, width = result.elites.grids.shape[-2:]
        hint = hint or choice.hint(result.spec.method, (height, width))
        raise NotEnoughMapsError(choice.describe_shortage(count, hint))
    return choice


def describe_budget(search: SearchSpec) -> str:
    if search.generations is None:
        return f"{search.evaluations:,} evaluations"
    return f"{search.generations:,} generations"


def describe_source(tiles: TileSet, result: Result, choice: Choice | None) -> dict[str, Plain]:
    """Returns the entries that the records of all folders of maps share, plain values for JSON."""
    chosen = choice and {"elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike}}
    return {
        "config": result.config and config_to_plain(result.config),
        "tile_set": {name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "layers", "blend")},
        "axes": [axis._asdict() for axis in result.axes],
        **(chosen or {}),
    }


def _with_difference(road_map: RoadMap, search: SearchSpec) -> RoadMap:
    if not search.like:
        return road_map
    difference = round(difference_from(road_map.codes, search.like), 3)
    return replace(road_map, metrics={**(road_map.metrics or {}), DIFFERENCE: difference})
