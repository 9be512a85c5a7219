"""From a specification to a folder of road maps, each with its picture, its masks and its metrics."""

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Array, Key

from elitelanes_jax._util.checks import check_named, path, paths
from elitelanes_jax._util.errors import pluralize
from elitelanes_jax._util.folders import output_folder, remove
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.records import record
from elitelanes_jax._util.threads import start_thread
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps._parts import join_parts
from elitelanes_jax.maps.folder import foreign_to_maps
from elitelanes_jax.maps.run import Evolved, Run, describe_budget, plan_run, write_run
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.optimizers.loop import seed_keys
from elitelanes_jax.search.evolution import compile_search, evolve

# The seconds between two checkpoints, and of the shortest search whose checkpoint is kept while maps are drawn.
_SECONDS_A_CHECKPOINT, _WORTH_KEEPING = 10, 10


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
    spec, out = check_named("spec", record(GenerateSpec), spec), Path(check_named("out", path, out))
    # Most tile sets have all codes. Then the programs are those of the search as specified: they load while tiles do.
    keys = seed_keys(spec.seed, spec.seed_indices)
    loaded = start_thread(partial(compile_search, keys, spec.size, spec.search, compiles=False))
    try:
        run = plan_run(spec)
    finally:
        loaded()
    inputs = [spec.tiles] if spec.tiles else []
    with output_folder(out, run.identity(), inputs=inputs, foreign=foreign_to_maps, force=force) as work:
        return write_run(work.files, _evolve(run, keys, work.kept / "search"))


def merge(parts: str | Path | Sequence[str | Path], out: str | Path, *, force: bool = False) -> list[RoadMap]:
    """Joins the parts of a run, and writes the folder that `generate` writes without parts, byte for byte.

    In ``run.json`` the seconds are the sum over the parts, and the speed is their median.

    Args:
      parts: folders, in any order.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for folders that are not all the parts of one run; see `join_parts`.
      NotEnoughMapsError: if there are fewer valid and different maps than the parts' specification requests.
      OSError: if the folder cannot be written.
    """
    folders, out = check_named("parts", paths, parts), Path(check_named("out", path, out))
    with output_folder(out, {"command": "merge"}, inputs=folders, foreign=foreign_to_maps, force=force) as work:
        return write_run(work.files, join_parts(folders))


def _evolve(run: Run, keys: Key[Array, " K"], checkpoint: Path) -> Evolved:
    """Evolves the seeds of a run, and keeps the checkpoint if the search was long."""
    spec, search, _ = run
    aim = pluralize(spec.maps, "map") if spec.part is None else "part {} of {} of a run for maps".format(*spec.part)
    announce(
        f"evolving {aim} of {spec.size[0]} x {spec.size[1]} tiles: {search.method}, {search.preset}, "
        f"{pluralize(len(spec.seed_indices), 'run')} of {describe_budget(search)}"
    )
    start = time.perf_counter()
    result = evolve(keys, spec.size, spec=search, checkpoint=checkpoint, every=_SECONDS_A_CHECKPOINT)
    if result.history.seconds < _WORTH_KEEPING:
        remove(checkpoint)
    seconds = max(time.perf_counter() - start, result.history.seconds)  # a resumed search has earlier seconds
    speeds = result.history.evaluations_per_second
    speed = round(float(np.median(speeds))) if speeds.size else None
    return Evolved(run, result, seconds, speed, jax.devices()[0].device_kind)
