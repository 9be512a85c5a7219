"""From a specification to a dataset's folder, drawn by several threads. A killed run is resumed."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, path, whole
from elitelanes_jax._util.engine import Engine, Pool, check_pool
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import read_json, write_atomic, write_json
from elitelanes_jax._util.folders import Unfinished, compare_settings, output_folder, remove, settle
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.sums import write_sums
from elitelanes_jax._util.threads import count_cores
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._card import draw_boxes, sample_sheet, write_card
from elitelanes_jax.dataset._drawing import Drawing, Samples, draw_here, draw_on
from elitelanes_jax.dataset._layouts import (
    LAYOUTS,
    MAPS,
    PART,
    RECORD,
    Layout,
    find_layout,
    foreign_to_dataset,
    write_maps,
    write_sample,
)
from elitelanes_jax.dataset._plan import evolve_maps
from elitelanes_jax.dataset._shards import shard_fields
from elitelanes_jax.dataset._splits import split_maps
from elitelanes_jax.dataset.planning import PlannedDataset, plan_dataset
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.object_set import ObjectSet
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS, png_of
from elitelanes_jax.tiles.tileset import TileSet

# The most pictures on the contact sheet.
_ON_SHEET = 12


@name_wrong_arguments
def make_dataset(
    spec: DatasetSpec,
    out: str | Path,
    *,
    workers: int | None = None,
    force: bool = False,
    executor: Engine | None = None,
    parts: int | None = None,
) -> dict[str, Plain]:
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
    spec = check_named("spec", instance(DatasetSpec), spec)
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
) -> dict[str, Plain]:
    """Makes a planned dataset; the other arguments, and the errors, are those of `make_dataset`."""
    spec, tiles, _, objects = plan
    out = Path(check_named("out", path, out))
    workers = count_cores() if workers is None else check_named("workers", whole(1), workers)
    # A missing package is an error before the search, not after it.
    find_layout(spec.format)
    identity = _identity(spec, tiles, objects)
    # A part has the settings of the whole dataset, and its own number.
    asked = identity | {"part": spec.part}
    # An earlier run may have been killed while it replaced the folder.
    settle(out)
    complete = _read_complete(out, asked, force)
    if complete is not None:
        return complete
    with output_folder(
        out,
        _of_maps(asked),
        inputs=_inputs(spec),
        foreign=foreign_to_dataset,
        force=force,
        resume_files=True,
    ) as work:
        # All parts need all maps, because the splits depend on all of them.
        maps, splits = _make_maps(plan, work, pool)
        _resume_pictures(out, work, identity, force)
        fields = shard_fields(spec, maps, objects)
        drawing = Drawing(spec, dict(enumerate(maps)), tiles, objects, fields)
        samples = Samples(spec.views, splits, spec.map_indices, work.files, work.kept / "records")
        _draw_samples(drawing, samples, work, workers, pool)
        if spec.part is None:
            about = finish(samples, identity, drawing)
        else:
            about = write_part(samples, asked)
    # The line about maps that were left out comes last, where the user sees it.
    if spec.maps_from is not None:
        spec.maps_from.announce_left_out()
    return about


def _read_complete(out: Path, asked: dict[str, Plain], force: bool) -> dict[str, Plain] | None:
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
    return read_json(out / RECORD)


def _inputs(spec: DatasetSpec) -> list[str | Path]:
    """Returns the files that the dataset is made from, which it must not replace."""
    maps = () if spec.maps_from is None else spec.maps_from.paths
    return [*maps, *spec.inputs, *spec.search.inputs]


def _make_maps(
    plan: PlannedDataset, work: Unfinished, pool: Pool | None
) -> tuple[Sequence[RoadMap], NDArray[np.int_]]:
    """Evolves the maps, or takes those that are given; returns them and the split of each."""
    spec = plan.spec
    smallest, largest = ("{} x {}".format(*shape) for shape in (spec.shapes[0], spec.shapes[-1]))
    sizes = smallest if smallest == largest else f"{smallest} to {largest}"
    views = pluralize(spec.views, "view")
    made = f"making a dataset of {pluralize(spec.maps, 'map')} of {sizes} tiles, {views} each"
    if spec.maps_from is None:
        made += (
            "; first the maps are evolved, which may take many minutes, and fewer --maps take less"
        )
    announce(made)
    try:
        maps: Sequence[RoadMap]
        if spec.maps_from is None:
            maps = evolve_maps(spec, plan.searches, work.kept, pool)
        else:
            maps = spec.maps_from.maps
        # The maps are split before they are drawn, because a picture's path has its split.
        return maps, split_maps(spec, maps)
    except (InputError, NotEnoughMapsError):
        # Only other settings can help, for which these rounds are of no use.
        remove(work.kept)
        raise


def _draw_samples(
    drawing: Drawing, samples: Samples, work: Unfinished, workers: int, pool: Pool | None
) -> None:
    """Draws the samples that no earlier run has drawn, here or on the pool."""
    with Progress("drawing", samples.total, "pictures", done=samples.count_drawn()) as bar:
        try:
            if pool is None:
                draw_here(drawing, samples, workers, bar.count)
            else:
                draw_on(pool, drawing, samples, bar.count)
        except InputError as error:
            # The objects do not fit the maps, which can be drawn with other objects.
            _delete_pictures(work)
            # Given maps are not kept, because they can be read again.
            if drawing.spec.maps_from is not None:
                raise
            hint = "the maps are kept for the same command with other objects"
            raise InputError(f"{error}; {hint}") from None


def _identity(spec: DatasetSpec, tiles: TileSet, objects: ObjectSet | None) -> dict[str, Plain]:
    """Returns all that the files depend on, plain values for JSON."""
    plain = spec.to_plain() | {"tile_px": spec.pixels}
    # The pictures and the maps count, not their paths.
    del plain["tiles"], plain["objects"], plain["maps_from"]
    versions = installed_versions()
    # The bytes of Parquet depend on the version of pyarrow.
    if spec.format == "parquet":
        versions["pyarrow"] = version("pyarrow")
    identity = {
        "settings": plain,
        "given_maps": None if spec.maps_from is None else spec.maps_from.digest,
        "tile_set": tiles.to_plain(),
        "versions": versions,
    }
    if objects is not None:
        identity["object_set"] = {"name": objects.name, "pictures": objects.digest}
    # Tuples become lists here, as in a record that is read from its file.
    return json.loads(json.dumps(identity))


def _of_maps(identity: dict[str, Plain]) -> dict[str, Plain]:
    """Returns what an unfinished dataset has to have in common with the next run.

    This is all of `identity` but the objects.
    """
    # Maps do not depend on objects, so the same maps serve other objects.
    settings = {name: value for name, value in identity["settings"].items() if name != "furnish"}
    return {name: value for name, value in identity.items() if name != "object_set"} | {
        "settings": settings
    }


def _resume_pictures(out: Path, work: Unfinished, identity: dict[str, Plain], force: bool) -> None:
    """Checks that the pictures so far have the objects of this run; with `force` deletes others."""
    file = work.kept / "pictures.json"
    if not file.exists():
        # Without this file, it is unknown which objects the pictures show.
        _delete_pictures(work)
    else:
        try:
            hint = "use force=True to draw all pictures anew"
            compare_settings(out, file, identity, hint)
        except InputError:
            if not force:
                raise
            _delete_pictures(work)
    # From here on, pictures have the objects of this run.
    write_json(file, identity)


def _delete_pictures(work: Unfinished) -> None:
    """Deletes the pictures so far, and keeps the maps.

    A picture with a record counts as drawn, so records go first.
    """
    for entry in (work.kept / "records", *work.files.iterdir(), work.kept / "pictures.json"):
        remove(entry)


def write_part(samples: Samples, about: dict[str, Plain]) -> dict[str, Plain]:
    """Writes the records of a part, the part's settings, and the checksums of all files.

    Each record of a sample has its split. Returns the settings.
    """

    def lines() -> Iterator[bytes]:
        for split in range(len(SPLITS)):
            for record in samples.read_split(split):
                yield f"{json.dumps([split, record])}\n".encode()

    write_atomic(samples.files / PART, lines())
    write_json(samples.files / RECORD, about)
    # The checksums come last, because they are of all other files.
    write_sums(samples.files)
    return read_json(samples.files / RECORD)


def finish(
    samples: Samples, identity: dict[str, Plain], drawing: Drawing | None = None
) -> dict[str, Plain]:
    """Writes the files that describe the samples of a whole dataset.

    Returns the record of the dataset. `drawing` is what the samples were drawn from; a dataset of
    shards needs it.
    """
    out, settings, has_objects = samples.files, identity["settings"], "object_set" in identity
    layout, camera = find_layout(settings["format"]), settings["camera"]
    count = min(_ON_SHEET, samples.total)
    # The pictures on the sheet are evenly spaced.
    on_sheet = [row * samples.total // count for row in range(count)]
    pixels, records = _list_samples(samples, layout, {*on_sheet})
    about = identity | _counts(samples, pixels)
    # Examples in the card are of a split that has pictures.
    first = int(samples.splits.min())
    guide = layout.guide(first, objects=has_objects)
    programs = layout.loading(first), layout.loading_arrays(first, poses=camera is not None)
    card = write_card(about, *programs, guide, layout.data_files(samples.splits))
    write_atomic(out / "README.md", card.encode())
    shown = [records[index] for index in on_sheet]
    # The sheet is made from pictures in files.
    if layout.open_shard is None:
        pictures, pictures_layout = out, layout
    else:
        assert drawing is not None
        write_maps(out / MAPS, [*drawing.maps.values()], samples.views)
        # Pictures in shards are not files. Those on the sheet are drawn again as files.
        pictures, pictures_layout = samples.records / "sheet", LAYOUTS["imagefolder"]
        _draw_again(shown, drawing, samples, pictures_layout, pictures)
    entries = [_on_sheet(record, samples, pictures_layout) for record in shown]
    shape = camera["rows"] / camera["columns"] if camera else 1
    sheet = sample_sheet(pictures, entries, f"{count} of {samples.total} pictures", shape)
    write_atomic(out / "contact-sheet.png", png_of(sheet))
    if layout.boxes is not None and has_objects:
        # The picture with most objects explains the boxes best.
        fullest = max(shown, key=lambda record: len(record["objects"]))
        image, *_ = _on_sheet(fullest, samples, layout)
        write_atomic(out / layout.boxes, png_of(draw_boxes(out / image, fullest["objects"])))
    # The record is written last, because a folder with a record counts as complete.
    write_json(out / RECORD, about)
    return read_json(out / RECORD)


def _list_samples(
    samples: Samples, layout: Layout, wanted: Set[int]
) -> tuple[dict[str, NDArray[np.int64]], dict[int, dict[str, Plain]]]:
    """Writes the layout's lists of samples, split by split.

    Returns the pixels of each class in each split, and the records of the wanted samples by index.
    """
    pixels = {name: np.zeros(len(LABELS), np.int64) for name in SPLITS}
    records: dict[int, dict[str, Plain]] = {}
    for split in np.unique(samples.splits).tolist():
        # One pass over the records gives the sums and the records for the sheet.
        for record in samples.read_split(split):
            pixels[SPLITS[split]] += record["class_pixels"]
            if record["number"] in wanted:
                records[record["number"]] = record
        layout.list_samples(samples.files, split, partial(samples.read_split, split))
    return pixels, records


def _counts(samples: Samples, pixels: Mapping[str, NDArray[np.int64]]) -> dict[str, Plain]:
    """Returns the entries of the dataset's record that count pictures and pixels."""
    pictures = {}
    for split, name in enumerate(SPLITS):
        # Every map has the same number of views.
        pictures[name] = int((samples.splits == split).sum()) * samples.views
    classes: list[Plain] = []
    for label, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True)):
        classes.append({"label": label, "name": name, "colour": colour})
    class_pixels = {name: counts.tolist() for name, counts in pixels.items()}
    return {"pictures": pictures, "classes": classes, "class_pixels": class_pixels}


def _draw_again(
    records: Iterable[dict[str, Plain]],
    drawing: Drawing,
    samples: Samples,
    layout: Layout,
    folder: Path,
) -> None:
    """Draws samples of shards again as files, from which the contact sheet is made."""
    for group in drawing.groups([record["number"] for record in records]):
        for index, sample in zip(group, drawing.draw(group), strict=True):
            write_sample(sample, layout, samples.split_of(index), folder)


def _on_sheet(
    record: dict[str, Plain], samples: Samples, layout: Layout
) -> tuple[str, str, tuple[str, ...]]:
    """Returns the files of a sample's image and labels, and its lines on the sheet."""
    index, metrics = record["number"], record.get("metrics", {})
    split, (height, width) = samples.split_of(index), record["size"]
    image, labels = (layout.file(split, index, layer) for layer in ("image", "labels"))
    # Given maps may have no metrics.
    figures = ", ".join(
        f"{name} {metrics[name]}"
        for name in ("cyclomatic", "crossings", "bridges")
        if name in metrics
    )
    return image, labels, (f"{index:06d}, {SPLITS[split]}, {height} x {width} tiles", figures)
