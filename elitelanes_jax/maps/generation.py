"""From a specification to a folder of road maps.

The folder has the chosen maps of a search, their files, and the run's record.
"""

import time
from pathlib import Path

import jax
import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.engine import Engine, Pool, check_pool
from elitelanes_jax._util.errors import pluralize
from elitelanes_jax._util.folders import output_folder, remove
from elitelanes_jax._util.progress import announce
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import foreign_to_maps
from elitelanes_jax.maps.planning import PlannedRun, plan_run
from elitelanes_jax.maps.spec import GenerateSpec
from elitelanes_jax.maps.writing import Evolved, describe_budget, median_speed, write_run
from elitelanes_jax.search.keys import SearchKeys, keys_of_seeds
from elitelanes_jax.search.parts import evolve_parts, join_evolved_parts
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.running import evolve_search

# The seconds between two checkpoints, and the seconds of the shortest search whose checkpoint is
# kept while maps are drawn.
_SECONDS_A_CHECKPOINT, _WORTH_KEEPING = 10, 10


@name_wrong_arguments
def generate(
    spec: GenerateSpec,
    out: str | Path,
    *,
    force: bool = False,
    executor: Engine | None = None,
    parts: int | None = None,
) -> list[RoadMap]:
    """Evolves maps, chooses among them, and writes them to a new folder, whole or not at all.

    The same specification gives the same files, byte for byte, except for the times in
    ``run.json``. If a search was killed, or failed after ten seconds, the same call resumes it. For
    a part of the seeds only the archive and the record are written, no maps.

    Args:
      spec: the specification of the search and the folder.
      out: the folder, new or empty.
      force: whether the folder is replaced, if an earlier run wrote all files in it.
      executor: an executor, as in `evolve`; its workers need no access to the folder. If a run ends
        early, the same call evolves only the parts that did not return.
      parts: the number of parts that an executor's workers get; defaults to parts of up to 32
        seeds.

    Returns:
      The maps, as they were written.

    Raises:
      InputError: for constraints that no map can meet, a bad tile set, a folder with files in it, a
        folder that another search or another process uses, or a worker with other versions.
      NotEnoughMapsError: if there are fewer valid and different maps than requested; with
        `at_most`, if there is none.
      OSError: if the folder cannot be written; a `ConnectionError`, if the executor lost a part.
    """
    return generate_planned(plan_run(spec), out, force=force, pool=check_pool(executor, parts))


def generate_planned(
    run: PlannedRun, out: str | Path, *, force: bool = False, pool: Pool | None = None
) -> list[RoadMap]:
    """Evolves the maps of a planned run.

    The other arguments, and the errors, are those of `generate`.
    """
    out = Path(check_named("out", path, out))
    spec, search = run.spec, run.search
    # A folder that contains one of these files is not replaced.
    inputs = [*spec.inputs, *search.inputs]
    with output_folder(
        out, run.identity(), inputs=inputs, foreign=foreign_to_maps, force=force
    ) as work:
        _announce_search(spec, search)
        # The key of a seed depends on its index, so a part evolves the same elites as the whole
        # run.
        keys = keys_of_seeds(spec.seed, spec.seed_indices)
        if pool is None:
            evolved = _evolve(search, keys, work.kept / "search")
        else:
            evolved = _evolve_on(pool, search, keys, work.kept / "parts")
        return write_run(work.files, run, evolved)


def _announce_search(spec: GenerateSpec, search: Search) -> None:
    maps = pluralize(spec.maps, "map")
    if spec.part is not None:
        maps = "part {} of {} of a run for maps".format(*spec.part)
    runs = pluralize(len(spec.seed_indices), "run")
    announce(
        f"evolving {maps} of {spec.size[0]} x {spec.size[1]} tiles: {search.settings.method}, "
        f"{search.settings.preset}, {runs} of {describe_budget(search)}"
    )


def _evolve(search: Search, keys: SearchKeys, checkpoint: Path) -> Evolved:
    """Evolves a search, and keeps the checkpoint if it took long."""
    start = time.perf_counter()
    result = evolve_search(search, keys, checkpoint=checkpoint, every=_SECONDS_A_CHECKPOINT)
    # A short search is repeated instead of kept if the rest of the run fails.
    if result.history.seconds < _WORTH_KEEPING:
        remove(checkpoint)
    # The history also has the seconds before a search was resumed.
    seconds = max(time.perf_counter() - start, result.history.seconds)
    speed = median_speed(result.history.evaluations_per_second)
    return Evolved(result, seconds, speed, jax.devices()[0].device_kind)


def _evolve_on(pool: Pool, search: Search, keys: SearchKeys, folder: Path) -> Evolved:
    """Evolves a search on an executor's workers.

    The parts are kept if the search was long. The seconds are the sum over the parts, as in
    `merge`.
    """
    parts = evolve_parts(search, keys, pool, folder=folder)
    histories = [part.result.history for part in parts]
    seconds = sum(history.seconds for history in histories)
    if seconds < _WORTH_KEEPING:
        remove(folder)
    speeds = np.concatenate([history.evaluations_per_second for history in histories])
    device = ", ".join(sorted({part.device for part in parts}))
    return Evolved(join_evolved_parts(parts), seconds, median_speed(speeds), device)
