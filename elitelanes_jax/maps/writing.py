"""From a result to a folder: chooses maps, and writes them with the archive and the record."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8
from numpy.typing import NDArray

from elitelanes_jax._util.errors import NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress
from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import ARCHIVE, RECORD, Drawing, write_maps
from elitelanes_jax.maps.planning import PlannedRun
from elitelanes_jax.optimizers.presets import config_to_plain
from elitelanes_jax.problem.archive import coverage, qd_score
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.selection import Choice
from elitelanes_jax.tiles.tileset import TileSet


class Evolved(NamedTuple):
    """The result of a run's search, and the figures for its record.

    Attributes:
      result: the result.
      seconds: the seconds that the search took.
      speed: the median of the evaluations per second; None without generations.
      device: the kind of the device.
    """

    result: Result
    seconds: float
    speed: int | None
    device: str


def choose_enough(
    result: Result,
    count: int,
    *,
    at_most: bool,
    seed: int = 0,
    exclude: Sequence[Int8[np.ndarray, "_ _"]] = (),
    hint: str | None = None,
) -> Choice:
    """Chooses maps as `Result.choose` does, and fails if there are too few.

    Args:
      result: the result of a search.
      count: the number of maps.
      at_most: whether fewer maps are enough.
      seed: the seed of the run; it is noted in the maps.
      exclude: grids that no chosen map may equal.
      hint: what finds more; by default it depends on the search.

    Raises:
      NotEnoughMapsError: for fewer maps than `count`; with `at_most`, for none.
    """
    with Progress("choosing maps"):
        choice = result.choose(count, seed, exclude=exclude)
    enough = 1 if at_most else count
    if len(choice.maps) < enough:
        if hint is None:
            hint = choice.hint(result.search)
        raise NotEnoughMapsError(choice.describe_shortage(count, hint))
    return choice


def describe_archive(result: Result) -> dict[str, list[float]]:
    """Returns two metrics of an archive, by seed. An elite worse than 0 does not count."""
    valid = result.elites.valid
    score = qd_score(result.elites.fitness, valid, worst=0)
    return {"coverage": coverage(valid).tolist(), "qd_score": score.tolist()}


def describe_source(tiles: TileSet, result: Result, choice: Choice | None) -> dict[str, Plain]:
    """Returns the entries that the records of all folders of maps share, plain values for JSON."""
    record: dict[str, Plain] = {
        "config": result.config and config_to_plain(result.config),
        "tile_set": {
            name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "blend")
        },
        "axes": [axis._asdict() for axis in result.search.axes],
    }
    if choice is not None:
        record["elites"] = {
            "found": choice.found,
            "rejected": choice.rejected,
            "alike": choice.alike,
        }
    return record


def median_speed(speeds: Sequence[float] | NDArray[np.float64]) -> int | None:
    """Returns the median of speeds as the record has it; None without any."""
    return round(float(np.median(speeds))) if len(speeds) else None


def write_run(folder: Path, run: PlannedRun, evolved: Evolved) -> list[RoadMap]:
    """Chooses the maps of a run, and writes them, its archive and its record; returns the maps.

    For a part of a run, only the archive and the record are written. Raises `NotEnoughMapsError`.
    """
    spec, search, tiles = run
    start = time.perf_counter()
    # A part lacks the elites of other seeds. `merge` chooses among those of all parts.
    choice = None
    if spec.part is None:
        choice = choose_enough(evolved.result, spec.maps, at_most=spec.at_most, seed=spec.seed)
    chosen = time.perf_counter()
    maps: list[RoadMap] = []
    if choice is not None:
        title = (
            f"{pluralize(len(choice.maps), 'road map')} of {spec.size[0]} x {spec.size[1]} tiles, "
            f"{search.settings.method}, {pluralize(spec.seeds, 'seed')}, {describe_budget(search)}, "
            f"seed {spec.seed}"
        )
        drawing = Drawing(tiles, tile_px=spec.tile_px, seed=spec.seed, furnish=spec.furnish)
        maps = write_maps(folder, choice.maps, title, drawing)
    # The state is left out, because a run is not continued from its folder.
    evolved.result.save(folder / ARCHIVE, state=False, seed=spec.seed)
    # The choice counts as a part of the search.
    seconds = {"evolve": evolved.seconds + chosen - start, "draw": time.perf_counter() - chosen}
    record = {
        "settings": spec.to_plain(),
        "weights": search.weights._asdict(),
        **describe_source(tiles, evolved.result, choice),
        "archive": describe_archive(evolved.result),
        "versions": installed_versions(),
        "device": evolved.device,
        "times": {
            "seconds": {name: round(value, 3) for name, value in seconds.items()},
            "evaluations_per_second": evolved.speed,
        },
    }
    write_json(folder / RECORD, record)
    return maps


def describe_budget(search: Search) -> str:
    """Returns the evaluations or the generations of each run, in words."""
    if search.settings.generations is None:
        return f"{search.settings.evaluations:,} evaluations"
    return f"{search.settings.generations:,} generations"
