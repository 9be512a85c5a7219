"""From a specification to a dataset's folder, drawn by several threads. A killed run is resumed."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance, path, whole
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import read_json, write_atomic, write_json
from elitelanes_jax._util.folders import Unfinished, compare_settings, output_folder, remove, settle
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._card import sample_sheet, write_card
from elitelanes_jax.dataset._layouts import RECORD, Layout, find_layout, foreign_to_dataset, write_sample
from elitelanes_jax.dataset._plan import evolve_maps, split_maps
from elitelanes_jax.dataset._samples import draw_sample
from elitelanes_jax.dataset.spec import DatasetSpec, maps_by_shape
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.furnishing.placing import furnish
from elitelanes_jax.maps.generation import drawable
from elitelanes_jax.maps.given import GivenMaps
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.movements import list_movements
from elitelanes_jax.tiles.object_set import ObjectSet, load_objects
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS, png_of
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

_ON_SHEET = 12


class _Drawing(NamedTuple):
    """The sources and the folders of the samples.

    Attributes:
      spec: of the dataset.
      maps: of the dataset.
      tiles: to draw them with.
      objects: whose pictures to draw the maps' objects with; None to leave them out.
      splits: int ``[samples]``, the split of each sample.
      files: the folder for the pictures.
      records: the folder for the records. A sample is complete when its record exists.
    """

    spec: DatasetSpec
    maps: Sequence[RoadMap]
    tiles: TileSet
    objects: ObjectSet | None
    splits: NDArray[np.int_]
    files: Path
    records: Path

    def record(self, index: int) -> Path:
        """Returns the file of a sample's record."""
        return self.records / f"{index // 1000:03d}" / f"{index:06d}.json"

    def draw(self, index: int) -> None:
        """Draws a sample, and writes its pictures, then its record."""
        spec, split, layout = self.spec, int(self.splits[index]), find_layout(self.spec.format)
        road_map = self.maps[index // spec.views]
        if spec.furnish is not None:
            seed = int(np.random.SeedSequence([spec.seed, index]).generate_state(1)[0])
            place = partial(furnish, spec=spec.furnish, seed=seed)
            road_map = check_named(f"furnish: map {index // spec.views}", place, road_map)
        sample = draw_sample(
            road_map,
            self.tiles,
            index,
            seed=spec.seed,
            tile_px=spec.pixels,
            transforms=spec.transforms,
            camera=spec.camera,
            objects=self.objects,
        )
        write_sample(sample, layout, split, self.files)
        write_atomic(self.record(index), json.dumps(sample.record | layout.note(sample)).encode())


def make_dataset(
    spec: DatasetSpec, out: str | Path, *, workers: int | None = None, force: bool = False
) -> dict[str, Plain]:
    """Evolves maps, draws them, and writes them as a dataset.

    The same specification gives the same files, byte for byte, with any number of workers. If a run was killed, the
    same call resumes it. If the dataset is complete, the call returns its record.

    Args:
      spec: of the dataset.
      out: the folder, new or empty.
      workers: threads that draw; by default one for each core (see `use_cores`).
      force: whether another dataset in the folder is replaced when this one is complete, if an earlier run wrote all
        files in it. Until then the disk needs room for both.

    Returns:
      The record in ``dataset.json``.

    Raises:
      InputError: for constraints that no map can meet, given maps that cannot be drawn, a bad tile set, or a folder
        with other files.
      NotEnoughMapsError: if the searches return too few maps.
      OSError: that names the file, if a file cannot be written. The same call resumes.
    """
    spec, out = check_named("spec", instance(DatasetSpec), spec), Path(check_named("out", path, out))
    workers = count_cores() if workers is None else check_named("workers", whole(1), workers)
    find_layout(spec.format)
    tiles = load_tiles(spec.tiles)
    search, own = drawable(spec.search, tiles), spec.maps_from
    if own is not None:
        _check_given(spec, own, tiles)
    else:
        spec.check_search()
        for shape in maps_by_shape(spec):
            search.check_maps(shape)
    objects = _objects_of(spec, own)
    identity = _identity(spec, tiles, own, objects)
    settle(out)
    if (out / RECORD).exists():
        try:
            compare_settings(out, out / RECORD, identity, "use another folder, or force=True to replace this one")
            return read_json(out / RECORD)
        except InputError:
            if not force:
                raise
    inputs: list[str | Path] = [*(own.paths if own else ()), *spec.inputs]
    with output_folder(
        out, _of_maps(identity), inputs=inputs, foreign=foreign_to_dataset, force=force, resume_files=True
    ) as work:
        try:
            first, last = ("{} x {}".format(*shape) for shape in (spec.shapes[0], spec.shapes[-1]))
            sizes = first if first == last else f"{first} to {last}"
            words = f"{pluralize(spec.maps, 'map')} of {sizes} tiles, {pluralize(spec.views, 'view')} each"
            announce(f"making a dataset of {words}")
            maps = evolve_maps(spec, search, work.kept) if own is None else own.maps
        except (InputError, NotEnoughMapsError):  # the next run has other settings
            remove(work.kept)
            raise
        _resume_pictures(out, work, identity, force)
        splits = np.repeat(split_maps(spec, maps), spec.views)
        drawing = _Drawing(spec, maps, tiles, objects, splits, work.files, work.kept / "records")
        waiting = [index for index in range(len(splits)) if not drawing.record(index).exists()]
        with Progress("drawing", len(splits), "pictures", done=len(splits) - len(waiting)) as bar:
            calls = (partial(drawing.draw, index) for index in waiting)
            try:
                with _one_thread_each():
                    side_by_side(calls, workers=workers, ended=lambda _: bar.count())
            except InputError as error:  # the objects do not fit
                _delete_pictures(work)
                if own is not None:
                    raise
                hint = "the maps are kept for the same command with other objects"
                raise InputError(f"{error}; {hint}") from None
        return _finish(drawing, identity)


def _check_given(spec: DatasetSpec, own: GivenMaps, tiles: TileSet) -> None:
    """Checks that the tiles can draw given maps, and that they have lanes for a camera."""
    for road_map, name in zip(own.maps, own.names, strict=True):
        if spec.camera is not None and not len(list_movements(road_map.codes)):
            raise InputError(f"maps_from: expected maps with lanes, for a camera, got none, {name}")
        if lacking := set(road_map.codes.flat) - set(tiles.rotations):
            got = " and ".join(kind for kind, members in KINDS.items() if lacking & set(members))
            raise InputError(f"maps_from: expected codes that the tile set has pictures for, got {got}, {name}")


def _objects_of(spec: DatasetSpec, own: GivenMaps | None) -> ObjectSet | None:
    """Loads the pictures of the maps' objects; None if there are no objects.

    Raises:
      InputError: if the set has no pictures of an object of the given maps.
    """
    things = [thing for road_map in (own.maps if own is not None else ()) for thing in road_map.objects or ()]
    objects = load_objects(spec.objects) if spec.furnish or things or spec.objects else None
    if objects is None or spec.furnish:
        return objects
    objects.choose(things)
    return objects if things else None


def _identity(spec: DatasetSpec, tiles: TileSet, own: GivenMaps | None, objects: ObjectSet | None) -> dict[str, Plain]:
    """Returns all that the files depend on, plain values for JSON."""
    plain = spec.to_plain() | {"tile_px": spec.pixels}
    del plain["tiles"], plain["objects"], plain["maps_from"]  # the pictures and the maps count, not their paths
    about = {name: getattr(tiles, name) for name in ("name", "licence", "blend")}
    identity = {
        "settings": plain,
        "given_maps": None if own is None else own.digest,
        "tile_set": about | {"tiles": tiles.digest},
        "versions": installed_versions(),
    }
    if objects is not None:
        identity["object_set"] = {"name": objects.name, "pictures": objects.digest}
    return json.loads(json.dumps(identity))


def _of_maps(identity: dict[str, Plain]) -> dict[str, Plain]:
    """Returns what an unfinished dataset has to have in common with the next run: all but the objects."""
    settings = {name: value for name, value in identity["settings"].items() if name != "furnish"}
    return {name: value for name, value in identity.items() if name != "object_set"} | {"settings": settings}


def _resume_pictures(out: Path, work: Unfinished, identity: dict[str, Plain], force: bool) -> None:
    """Checks that the pictures so far have the objects of this run; with `force` deletes others."""
    file = work.kept / "pictures.json"
    if not file.exists():
        _delete_pictures(work)  # which objects they show is not known
    else:
        try:
            hint = "use force=True to draw all pictures anew"
            compare_settings(out, file, identity | {"object_set": identity.get("object_set")}, hint)
        except InputError:
            if not force:
                raise
            _delete_pictures(work)
    write_json(file, identity)


def _delete_pictures(work: Unfinished) -> None:
    """Deletes the pictures so far, and keeps the maps. A picture with a record counts as drawn, so records go first."""
    for entry in (work.kept / "records", *work.files.iterdir(), work.kept / "pictures.json"):
        remove(entry)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Turns OpenCV's own threads off, because they slow the workers down."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


def _finish(drawing: _Drawing, identity: dict[str, Plain]) -> dict[str, Plain]:
    """Writes the files that describe the samples; returns the record of the dataset."""
    spec, splits, out = drawing.spec, drawing.splits, drawing.files
    layout = find_layout(spec.format)
    pixels = {name: np.zeros(len(LABELS), np.int64) for name in SPLITS}

    def read(index: int) -> dict[str, Plain]:
        return json.loads(drawing.record(index).read_text(encoding="utf-8"))

    def count_pixels(split: int) -> Iterator[dict[str, Plain]]:
        for one in map(read, np.flatnonzero(splits == split).tolist()):
            pixels[SPLITS[split]] += one["class_pixels"]
            yield one

    for split in np.unique(splits).tolist():
        layout.list_samples(out, split, count_pixels(split))
    about = identity | {
        "pictures": {name: int((splits == split).sum()) for split, name in enumerate(SPLITS)},
        "classes": [
            {"label": label, "name": name, "colour": colour}
            for label, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True))
        ],
        "class_pixels": {name: counts.tolist() for name, counts in pixels.items()},
    }
    first, count = int(splits.min()), min(_ON_SHEET, len(splits))
    programs = layout.loading(first), layout.loading_arrays(first, poses=spec.camera is not None)
    write_atomic(out / "README.md", write_card(about, *programs).encode())
    shown = [_on_sheet(read(row * len(splits) // count), splits, layout) for row in range(count)]
    shape = spec.camera.rows / spec.camera.columns if spec.camera else 1
    sheet = sample_sheet(out, shown, f"{count} of {len(splits)} pictures", shape)
    write_atomic(out / "contact-sheet.png", png_of(sheet))
    write_json(out / RECORD, about)
    return read_json(out / RECORD)


def _on_sheet(record: dict[str, Plain], splits: NDArray[np.int_], layout: Layout) -> tuple[str, str, tuple[str, ...]]:
    """Returns the files of a sample's image and labels, and its lines on the sheet."""
    index, metrics = record["number"], record.get("metrics", {})
    split, (height, width) = int(splits[index]), record["size"]
    image, labels = (layout.file(split, index, layer) for layer in ("image", "labels"))
    figures = ", ".join(f"{name} {metrics[name]}" for name in ("cyclomatic", "crossings", "bridges") if name in metrics)
    return image, labels, (f"{index:06d}, {SPLITS[split]}, {height} x {width} tiles", figures)
