"""From a specification to a dataset's folder, drawn by several threads. A killed run is resumed."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path, whole
from elitelanes_jax._util.engine import Engine, Pool, check_pool
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import write_json
from elitelanes_jax._util.folders import Unfinished, compare_settings, output_folder, remove, settle
from elitelanes_jax._util.progress import announce
from elitelanes_jax._util.threads import count_cores
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._drawing import Drawing, delete_pictures, draw_missing
from elitelanes_jax.dataset._finishing import finish, write_part
from elitelanes_jax.dataset._layouts import RECORD, foreign_to_dataset
from elitelanes_jax.dataset._plan import evolve_maps
from elitelanes_jax.dataset._records import Samples
from elitelanes_jax.dataset._splits import split_maps
from elitelanes_jax.dataset.planning import PlannedDataset, plan_dataset
from elitelanes_jax.dataset.spec import DatasetSpec, describe_sides
from elitelanes_jax.dataset.tables import DatasetRecord, read_dataset_record
from elitelanes_jax.drive.camera_options import sees_ground
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.faults import announce_without_room


@name_wrong_arguments
def make_dataset(
    spec: DatasetSpec,
    out: str | Path,
    *,
    workers: int | None = None,
    force: bool = False,
    executor: Engine | None = None,
    parts: int | None = None,
) -> DatasetRecord:
    """Evolves maps, draws them, and writes them as a dataset.

    The same specification gives the same files, byte for byte, with any number of workers. If a run
    was killed, the same call resumes it. If the dataset is complete, the call returns its record.

    Args:
      spec: the specification of the dataset.
      out: the folder, new or empty.
      workers: threads that draw; by default one for each core (see `use_cores`).
      force: whether another dataset in the folder is replaced when this one is complete, if an
        earlier run wrote all files in it. Until then the disk needs room for both.
      executor: an executor, as in `evolve`; its workers search and draw, and need no access to the
        folder. Pictures return through the executor, and are written here.
      parts: the number of parts in which an executor's workers draw; defaults to parts of up to 250
        pictures.

    Returns:
      The record in ``dataset.json``. That of a part says which part it is.

    Raises:
      InputError: for constraints that no map can meet, given maps that cannot be drawn, maps too
        alike to be split, a bad tile set, a folder with other files, or a worker with other
        versions.
      NotEnoughMapsError: if the searches return too few maps.
      OSError: that names the file, if a file cannot be written. The same call resumes.
      ConnectionError: if the executor lost a part. The same call resumes.
    """
    return make_planned(
        plan_dataset(spec), out, workers=workers, force=force, pool=check_pool(executor, parts)
    )


def make_planned(
    plan: PlannedDataset,
    out: str | Path,
    *,
    workers: int | None = None,
    force: bool = False,
    pool: Pool | None = None,
) -> DatasetRecord:
    """Makes a planned dataset; the other arguments, and the errors, are those of `make_dataset`."""
    spec, identity = plan.spec, plan.identity
    out = Path(check_named("out", path, out))
    workers = count_cores() if workers is None else check_named("workers", whole(1), workers)
    # A part has the settings of the whole dataset, and its own number.
    asked = identity | {"part": spec.part}
    # An earlier run may have been killed while it replaced the folder.
    settle(out)
    complete = _read_complete(out, asked, force)
    if complete is not None:
        return complete
    # The dataset must not replace its own inputs.
    inputs: list[str | Path] = [*spec.inputs, *spec.search.inputs]
    if spec.maps_from is not None:
        inputs += spec.maps_from.paths
    with output_folder(
        out,
        _of_maps(asked),
        inputs=inputs,
        foreign=foreign_to_dataset,
        force=force,
        resume_files=True,
    ) as work:
        # All parts need all maps, because the splits depend on all of them.
        maps, splits = _make_maps(plan, work, pool)
        _resume_pictures(out, work, identity, force)
        announce_without_room(maps, spec.furnish)
        drawing = Drawing.of_maps(plan, maps)
        samples = Samples(spec.views, splits, spec.map_indices, work.files, work.kept / "records")
        try:
            draw_missing(drawing, samples, work, workers, pool)
        except InputError as error:
            # Given maps are not kept, because they can be read again.
            if spec.maps_from is not None:
                raise
            hint = "the maps are kept for the same command with other objects"
            raise error.advise(hint) from None
        if spec.part is None:
            about = finish(samples, identity, drawing)
        else:
            about = write_part(samples, asked)
    # The line about maps that were left out comes last, where the user sees it.
    if spec.maps_from is not None:
        spec.maps_from.announce_left_out()
    return about


def _read_complete(out: Path, asked: DatasetRecord, force: bool) -> DatasetRecord | None:
    """Returns the record of the dataset in the folder.

    Returns None if the folder has no complete dataset, or if another one is replaced.
    """
    if not (out / RECORD).exists():
        return None
    hint = "use another folder, or force=True to replace this one"
    try:
        compare_settings(out, out / RECORD, asked, hint)
    except InputError:
        if force:
            return None
        raise
    # The same dataset is there already, so nothing is done.
    return read_dataset_record(out / RECORD)


def _make_maps(
    plan: PlannedDataset, work: Unfinished, pool: Pool | None
) -> tuple[Sequence[RoadMap], NDArray[np.int_]]:
    """Evolves the maps, or takes those that are given; returns them and the split of each."""
    spec = plan.spec
    sizes, views = describe_sides(spec.size), pluralize(spec.views, "view")
    made = f"making a dataset of {pluralize(spec.maps, 'map')} of {sizes} tiles, {views} each"
    if spec.maps_from is None:
        made += (
            "; first the maps are evolved, which may take many minutes, and fewer --maps take less"
        )
    announce(made)
    if spec.camera is not None and not sees_ground(spec.camera):
        announce("the camera looks above the horizon, so no picture shows the road")
    try:
        maps: Sequence[RoadMap]
        if spec.maps_from is None:
            maps = evolve_maps(plan, work.kept, pool)
        else:
            maps = spec.maps_from.maps
        # The maps are split before they are drawn, because a picture's path has its split.
        return maps, split_maps(spec, maps)
    except (InputError, NotEnoughMapsError):
        # Only other settings can help, for which these rounds are of no use.
        remove(work.kept)
        raise


def _of_maps(identity: DatasetRecord) -> dict[str, Plain]:
    """Returns what an unfinished dataset has to have in common with the next run.

    This is all of `identity` but the objects.
    """
    # Maps do not depend on objects, so the same maps serve other objects.
    settings = {name: value for name, value in identity["settings"].items() if name != "furnish"}
    maps = {name: value for name, value in identity.items() if name != "object_set"}
    # The command comes first, because it is the first difference from the work of another one.
    return {"command": "dataset"} | maps | {"settings": settings}


def _resume_pictures(out: Path, work: Unfinished, identity: DatasetRecord, force: bool) -> None:
    """Checks that the pictures so far have the objects of this run; with `force` deletes others."""
    file = work.kept / "pictures.json"
    if not file.exists():
        # Without this file, it is unknown which objects the pictures show.
        delete_pictures(work)
    else:
        try:
            hint = "use force=True to draw all pictures anew"
            compare_settings(out, file, identity, hint)
        except InputError:
            if not force:
                raise
            delete_pictures(work)
    # From here on, pictures have the objects of this run.
    write_json(file, identity)
