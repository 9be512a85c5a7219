"""From a specification to a dataset's folder, drawn by several threads. A killed run is resumed."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance, path, whole
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError, pluralize
from elitelanes_jax._util.files import new_file, read_json, write_atomic, write_json
from elitelanes_jax._util.folders import Unfinished, compare_settings, output_folder, remove, settle
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import Progress, announce
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._card import draw_boxes, sample_sheet, write_card
from elitelanes_jax.dataset._layouts import (
    LAYOUTS,
    MAPS,
    RECORD,
    Layout,
    find_layout,
    foreign_to_dataset,
    write_maps,
    write_sample,
)
from elitelanes_jax.dataset._plan import evolve_maps
from elitelanes_jax.dataset._samples import Sample, draw_sample
from elitelanes_jax.dataset._shards import ShardSample, encode_sample, shard_fields
from elitelanes_jax.dataset._splits import split_maps
from elitelanes_jax.dataset.planning import PlannedDataset, plan_dataset
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.maps.furnishing.placing import furnish
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.object_set import ObjectSet
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS, png_of
from elitelanes_jax.tiles.tileset import TileSet

_ON_SHEET = 12
_BLOCK = 1000  # samples that are listed at once, and that share a file of records or a shard


class _Drawing(NamedTuple):
    """The sources and the folders of the samples.

    Attributes:
      spec: of the dataset.
      maps: of the dataset.
      tiles: to draw them with.
      objects: whose pictures to draw the maps' objects with; None to leave them out.
      splits: int ``[maps]``, the split of each map.
      files: the folder for the pictures.
      records: the folder for the records.
    """

    spec: DatasetSpec
    maps: Sequence[RoadMap]
    tiles: TileSet
    objects: ObjectSet | None
    splits: NDArray[np.int_]
    files: Path
    records: Path

    @property
    def total(self) -> int:
        """The number of samples."""
        return len(self.maps) * self.spec.views

    def blocks(self) -> Iterator["_Block"]:
        """Yields the samples, some at a time: a list of all may not fit into memory."""
        for split in np.unique(self.splits).tolist():
            yield from self.blocks_of(split)

    def blocks_of(self, split: int) -> Iterator["_Block"]:
        """Yields the samples of a split, in order."""
        maps, views = np.flatnonzero(self.splits == split), self.spec.views
        count = len(maps) * views
        for number, first in enumerate(range(0, count, _BLOCK)):
            positions = range(first, min(first + _BLOCK, count))
            indices = [int(maps[position // views]) * views + position % views for position in positions]
            yield _Block(split, number, -(-count // _BLOCK), indices, self.records / f"{SPLITS[split]}-{number}.jsonl")

    def read_split(self, split: int) -> Iterator[dict[str, Plain]]:
        """Reads the records of a split's samples, in order."""
        for block in self.blocks_of(split):
            records = block.read_records()
            for index in block.indices:
                yield json.loads(records[index])

    def count_drawn(self) -> int:
        """Counts the samples that an earlier run has drawn."""
        return sum(file.read_bytes().count(b"\n") for file in self.records.glob("*.jsonl"))

    def draw(self, index: int) -> Sample:
        """Draws a sample."""
        spec, road_map = self.spec, self.maps[index // self.spec.views]
        if spec.furnish is not None:
            seed = int(np.random.SeedSequence([spec.seed, index]).generate_state(1)[0])
            place = partial(furnish, spec=spec.furnish, seed=seed)
            road_map = check_named(f"furnish: map {index // spec.views}", place, road_map)
        return draw_sample(
            road_map,
            self.tiles,
            index,
            seed=spec.seed,
            tile_px=spec.pixels,
            transforms=spec.transforms,
            camera=spec.camera,
            objects=self.objects,
        )

    def draw_files(self, index: int) -> bytes:
        """Draws a sample, and writes its pictures; returns the line of its record."""
        layout = find_layout(self.spec.format)
        sample = self.draw(index)
        write_sample(sample, layout, int(self.splits[index // self.spec.views]), self.files)
        return _line(index, sample.record | layout.note(sample))


class _Block(NamedTuple):
    """At most `_BLOCK` samples of one split.

    Attributes:
      split: an index in `SPLITS`.
      number: of the block in its split, from 0.
      total: the number of blocks in the split.
      indices: of the samples, in order.
      records: the file with a line for each sample: its index, a tab, and its record. A sample is complete when its
        line is written. A run that is killed may leave a part of a line at the end.
    """

    split: int
    number: int
    total: int
    indices: list[int]
    records: Path

    def read_records(self) -> dict[int, bytes]:
        """Reads the records so far, of JSON, by the samples' indices."""
        if not self.records.exists():
            return {}
        *lines, _ = self.records.read_bytes().split(b"\n")
        pairs = (line.split(b"\t", 1) for line in lines)
        return {int(index): record for index, record in pairs}

    def missing(self) -> list[int]:
        """Returns the indices of the samples that are not drawn yet, and removes a part of a line."""
        if not self.records.exists():
            return self.indices
        content = self.records.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            write_atomic(self.records, whole)
        drawn = self.read_records()
        return [index for index in self.indices if index not in drawn]


def _line(index: int, record: dict[str, Plain]) -> bytes:
    return f"{index}\t{json.dumps(record)}\n".encode()


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
      InputError: for constraints that no map can meet, given maps that cannot be drawn, maps too alike to be split, a
        bad tile set, or a folder with other files.
      NotEnoughMapsError: if the searches return too few maps.
      OSError: that names the file, if a file cannot be written. The same call resumes.
    """
    spec = check_named("spec", instance(DatasetSpec), spec)
    return make_planned(plan_dataset(spec), out, workers=workers, force=force)


def make_planned(
    plan: PlannedDataset, out: str | Path, *, workers: int | None = None, force: bool = False
) -> dict[str, Plain]:
    """Makes a planned dataset; the other arguments, and the errors, are those of `make_dataset`."""
    spec, tiles, _, objects = plan
    out = Path(check_named("out", path, out))
    workers = count_cores() if workers is None else check_named("workers", whole(1), workers)
    given = spec.maps_from
    layout = find_layout(spec.format)
    identity = _identity(spec, tiles, objects)
    settle(out)
    if (out / RECORD).exists():
        try:
            compare_settings(out, out / RECORD, identity, "use another folder, or force=True to replace this one")
            return read_json(out / RECORD)
        except InputError:
            if not force:
                raise
    inputs: list[str | Path] = [*(given.paths if given else ()), *spec.inputs, *spec.search.inputs]
    with output_folder(
        out, _of_maps(identity), inputs=inputs, foreign=foreign_to_dataset, force=force, resume_files=True
    ) as work:
        try:
            first, last = ("{} x {}".format(*shape) for shape in (spec.shapes[0], spec.shapes[-1]))
            sizes = first if first == last else f"{first} to {last}"
            words = f"{pluralize(spec.maps, 'map')} of {sizes} tiles, {pluralize(spec.views, 'view')} each"
            announce(f"making a dataset of {words}")
            maps = evolve_maps(spec, plan.searches, work.kept) if given is None else given.maps
            splits = split_maps(spec, maps)
        except (InputError, NotEnoughMapsError):  # the next run has other settings
            remove(work.kept)
            raise
        _resume_pictures(out, work, identity, force)
        draw_block = _draw_block if layout.open_shard is None else _draw_shard
        drawing = _Drawing(spec, maps, tiles, objects, splits, work.files, work.kept / "records")
        with Progress("drawing", drawing.total, "pictures", done=drawing.count_drawn()) as bar:
            try:
                with _one_thread_each():
                    for block in drawing.blocks():
                        if indices := block.missing():
                            draw_block(drawing, block, indices, workers, bar)
            except InputError as error:  # the objects do not fit
                _delete_pictures(work)
                if given is not None:
                    raise
                hint = "the maps are kept for the same command with other objects"
                raise InputError(f"{error}; {hint}") from None
        about = _finish(drawing, identity)
    if given is not None:
        given.announce_left_out()
    return about


def _identity(spec: DatasetSpec, tiles: TileSet, objects: ObjectSet | None) -> dict[str, Plain]:
    """Returns all that the files depend on, plain values for JSON."""
    plain = spec.to_plain() | {"tile_px": spec.pixels}
    del plain["tiles"], plain["objects"], plain["maps_from"]  # the pictures and the maps count, not their paths
    about = {name: getattr(tiles, name) for name in ("name", "licence", "blend")}
    if tiles.lane_offset != LANE_OFFSET:
        about["lane_offset"] = tiles.lane_offset
    versions = installed_versions()
    if spec.format == "parquet":
        versions["pyarrow"] = version("pyarrow")
    identity = {
        "settings": plain,
        "given_maps": None if spec.maps_from is None else spec.maps_from.digest,
        "tile_set": about | {"tiles": tiles.digest},
        "versions": versions,
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


def _draw_block(drawing: _Drawing, block: _Block, indices: list[int], workers: int, bar: Progress) -> None:
    """Draws samples of a block as files."""
    block.records.parent.mkdir(exist_ok=True)
    with block.records.open("ab") as records:

        def complete(line: bytes) -> None:
            records.write(line)
            bar.count()

        calls = (partial(drawing.draw_files, index) for index in indices)
        side_by_side(calls, workers=workers, ended=complete)


def _draw_shard(drawing: _Drawing, block: _Block, indices: list[int], workers: int, bar: Progress) -> None:
    """Draws a block as a shard, which is written whole or not at all. The records of its samples are written last."""
    layout, lines = find_layout(drawing.spec.format), []
    assert layout.open_shard is not None
    # Samples that are drawn before an earlier one of the shard. They are about as many as workers.
    waiting: dict[int, ShardSample] = {}
    following = iter(indices)

    def draw(index: int) -> None:
        waiting[index] = encode_sample(drawing.draw(index))

    with new_file(drawing.files / layout.shard_file(block.split, block.number, block.total)) as part:
        part.parent.mkdir(parents=True, exist_ok=True)
        with layout.open_shard(part, shard_fields(drawing.spec, drawing.maps, drawing.objects)) as write:
            due = next(following)

            def complete(_: None) -> None:
                nonlocal due
                while due in waiting:
                    sample = waiting.pop(due)
                    write(sample)
                    lines.append(_line(due, sample.record))
                    bar.count()
                    due = next(following, -1)

            side_by_side((partial(draw, index) for index in indices), workers=workers, ended=complete)
    write_atomic(block.records, lines)


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
    count = min(_ON_SHEET, drawing.total)
    on_sheet = [row * drawing.total // count for row in range(count)]
    records: dict[int, dict[str, Plain]] = {}
    for split in np.unique(splits).tolist():
        for record in drawing.read_split(split):
            pixels[SPLITS[split]] += record["class_pixels"]
            if record["number"] in on_sheet:
                records[record["number"]] = record
        layout.list_samples(out, split, partial(drawing.read_split, split))
    if layout.open_shard is not None:
        write_maps(out / MAPS, drawing.maps, spec.views)
    about = identity | {
        "pictures": {name: int((splits == split).sum()) * spec.views for split, name in enumerate(SPLITS)},
        "classes": [
            {"label": label, "name": name, "colour": colour}
            for label, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True))
        ],
        "class_pixels": {name: counts.tolist() for name, counts in pixels.items()},
    }
    first, shown = int(splits.min()), [records[index] for index in on_sheet]
    guide = layout.guide(first, objects=drawing.objects is not None)
    programs = layout.loading(first), layout.loading_arrays(first, poses=spec.camera is not None)
    write_atomic(out / "README.md", write_card(about, *programs, guide, layout.data_files(splits)).encode())
    pictures, pictures_layout = out, layout
    if layout.open_shard is not None:
        # The sheet reads files of pictures. A few samples are drawn again for it.
        pictures, pictures_layout = drawing.records / "sheet", LAYOUTS["imagefolder"]
        for record in shown:
            split = int(splits[record["number"] // spec.views])
            write_sample(drawing.draw(record["number"]), pictures_layout, split, pictures)
    entries = [_on_sheet(record, drawing, pictures_layout) for record in shown]
    shape = spec.camera.rows / spec.camera.columns if spec.camera else 1
    sheet = sample_sheet(pictures, entries, f"{count} of {drawing.total} pictures", shape)
    write_atomic(out / "contact-sheet.png", png_of(sheet))
    if layout.boxes is not None and drawing.objects is not None:
        fullest = max(shown, key=lambda record: len(record["objects"]))
        image, *_ = _on_sheet(fullest, drawing, layout)
        write_atomic(out / layout.boxes, png_of(draw_boxes(out / image, fullest["objects"])))
    write_json(out / RECORD, about)
    return read_json(out / RECORD)


def _on_sheet(record: dict[str, Plain], drawing: _Drawing, layout: Layout) -> tuple[str, str, tuple[str, ...]]:
    """Returns the files of a sample's image and labels, and its lines on the sheet."""
    index, metrics = record["number"], record.get("metrics", {})
    split, (height, width) = int(drawing.splits[index // drawing.spec.views]), record["size"]
    image, labels = (layout.file(split, index, layer) for layer in ("image", "labels"))
    figures = ", ".join(f"{name} {metrics[name]}" for name in ("cyclomatic", "crossings", "bridges") if name in metrics)
    return image, labels, (f"{index:06d}, {SPLITS[split]}, {height} x {width} tiles", figures)
