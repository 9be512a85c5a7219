"""From a specification to a folder of road maps: the search, the chosen maps, their files, and the run's record."""

import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Key

from elitelanes_jax._util.checks import check_named, instance, path
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import output_folder, remove
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.threads import start_thread
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import ARCHIVE, RECORD, foreign_to_maps, write_maps
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.optimizers.loop import seed_keys
from elitelanes_jax.optimizers.presets import config_to_plain
from elitelanes_jax.problem.archive import coverage, qd_score
from elitelanes_jax.search.evolution import compile_search, evolve
from elitelanes_jax.search.result import Result
from elitelanes_jax.search.selection import Choice
from elitelanes_jax.search.spec import SearchSpec
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

# The seconds between two checkpoints, and of the shortest search whose checkpoint is kept while maps are drawn.
_SECONDS_A_CHECKPOINT, _WORTH_KEEPING = 10, 10


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


def generate(spec: GenerateSpec, out: str | Path, *, force: bool = False) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    The same specification gives the same files, byte for byte, except for the times in ``run.json``. If a search was
    killed, or failed after ten seconds, the same call resumes it. For a part of the seeds only the archive and the
    record are written, no maps.

    Args:
      spec: of the search and the folder.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for constraints that no map can meet, a bad tile set, a folder with files in it, or a folder that
        another search or another process uses.
      NotEnoughMapsError: if there are fewer valid and different maps than requested; with `at_most`, if there is none.
      OSError: if the folder cannot be written.
    """
    spec, out = check_named("spec", instance(GenerateSpec), spec), Path(check_named("out", path, out))
    # Most tile sets have all codes. Then the programs are those of the search as specified: they load while tiles do.
    keys = seed_keys(spec.seed, spec.seed_indices)
    loaded = start_thread(partial(compile_search, keys, spec.size, spec.search, compiles=False))
    try:
        run = plan_run(spec)
    finally:
        loaded()
    with output_folder(out, run.identity(), inputs=spec.inputs, foreign=foreign_to_maps, force=force) as work:
        return write_run(work.files, _evolve(run, keys, work.kept / "search"))


def plan_run(spec: GenerateSpec) -> Run:
    """Loads the tiles of a run and checks its search; raises `InputError`."""
    tiles = load_tiles(spec.tiles)
    search = drawable(spec.search, tiles).on(spec.size)
    search.check_maps(spec.size)
    return Run(spec, search, tiles)


def drawable(search: SearchSpec, tiles: TileSet) -> SearchSpec:
    """Returns a search whose maps can be drawn with a tile set; raises `InputError` if its alphabet has other codes."""
    missing = set(search.alphabet or ()) - set(tiles.alphabet)
    if missing:
        codes = ", ".join(map(str, tiles.alphabet))
        raise InputError(f"alphabet: expected codes of the tile set {tiles.name!r}, {codes}, got {min(missing)}")
    return search.replace(alphabet=search.alphabet or tiles.alphabet)


def _evolve(run: Run, keys: Key[Array, " K"], checkpoint: Path) -> Evolved:
    """Evolves the seeds of a run, and keeps the checkpoint if the search was long."""
    spec, search, _ = run
    aim = pluralize(spec.maps, "map") if spec.part is None else "part {} of {} of a run for maps".format(*spec.part)
    announce(
        f"evolving {aim} of {spec.size[0]} x {spec.size[1]} tiles: {search.method}, {search.preset}, "
        f"{pluralize(len(spec.seed_indices), 'run')} of {_budget(search)}"
    )
    start = time.perf_counter()
    result = evolve(keys, spec.size, spec=search, checkpoint=checkpoint, every=_SECONDS_A_CHECKPOINT)
    if result.history.seconds < _WORTH_KEEPING:
        remove(checkpoint)
    seconds = max(time.perf_counter() - start, result.history.seconds)  # a resumed search has earlier seconds
    speeds = result.history.evaluations_per_second
    speed = round(float(np.median(speeds))) if speeds.size else None
    return Evolved(run, result, seconds, speed, jax.devices()[0].device_kind)


def write_run(folder: Path, evolved: Evolved) -> list[RoadMap]:
    """Chooses the maps of a run, and writes them, its archive and its record; returns the maps.

    For a part of a run, only the archive and the record are written. Raises `NotEnoughMapsError`.
    """
    (spec, search, tiles), result, start = evolved.run, evolved.result, time.perf_counter()
    choice = None if spec.part else choose_maps(result, spec.maps, spec.at_most, seed=spec.seed)
    chosen, maps = time.perf_counter(), []
    if choice:
        title = (
            f"{pluralize(len(choice.maps), 'road map')} of {spec.size[0]} x {spec.size[1]} tiles, {search.method}, "
            f"{pluralize(spec.seeds, 'seed')}, {_budget(search)}, seed {spec.seed}"
        )
        maps = write_maps(folder, choice.maps, title, tiles, tile_px=spec.tile_px, seed=spec.seed, furnish=spec.furnish)
    result.save(folder / ARCHIVE, state=False, seed=spec.seed)
    seconds = {"evolve": evolved.seconds + chosen - start, "draw": time.perf_counter() - chosen}
    about = {
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
    write_json(folder / RECORD, about)
    return maps


def describe_archive(result: Result) -> dict[str, list[float]]:
    """Returns two metrics of an archive, by seed. An elite worse than 0 does not count."""
    valid = result.elites.valid
    return {"coverage": coverage(valid).tolist(), "qd_score": qd_score(result.elites.fitness, valid, worst=0).tolist()}


def choose_maps(result: Result, count: int, at_most: bool, hint: str | None = None, **options: UserValue) -> Choice:
    """Chooses maps with the options of `Result.choose`; raises `NotEnoughMapsError`, also for none with `at_most`.

    The hint says what finds more; its default depends on the search.
    """
    with Progress("choosing maps"):
        choice = result.choose(count, **options)
    if len(choice.maps) < (1 if at_most else count):
        height, width = result.elites.grids.shape[-2:]
        hint = hint or choice.hint(result.spec.method, (height, width))
        raise NotEnoughMapsError(choice.describe_shortage(count, hint))
    return choice


def describe_source(tiles: TileSet, result: Result, choice: Choice | None) -> dict[str, Plain]:
    """Returns the entries that the records of all folders of maps share, plain values for JSON."""
    chosen = choice and {"elites": {"found": choice.found, "rejected": choice.rejected, "alike": choice.alike}}
    return {
        "config": result.config and config_to_plain(result.config),
        "tile_set": {name: getattr(tiles, name) for name in ("name", "licence", "alphabet", "blend")},
        "axes": [axis._asdict() for axis in result.axes],
        **(chosen or {}),
    }


def _budget(search: SearchSpec) -> str:
    evaluations = search.generations is None
    return f"{search.evaluations:,} evaluations" if evaluations else f"{search.generations:,} generations"
