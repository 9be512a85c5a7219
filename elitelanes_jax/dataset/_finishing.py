"""Writes the files that describe the samples of a dataset, after its pictures are drawn."""

import json
from collections.abc import Iterator, Mapping, Set
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.files import write_atomic, write_json
from elitelanes_jax._util.sums import write_sums
from elitelanes_jax.dataset._card import draw_boxes, sample_sheet, write_card
from elitelanes_jax.dataset._croissant import describe_croissant
from elitelanes_jax.dataset._drawing import Drawing, draw_again
from elitelanes_jax.dataset._fields import Contents, add_metrics
from elitelanes_jax.dataset._layouts import (
    CROISSANT,
    LAYOUTS,
    MAPS,
    PART,
    RECORD,
    Layout,
    find_layout,
    write_maps,
)
from elitelanes_jax.dataset._records import Samples
from elitelanes_jax.dataset.tables import (
    DatasetClass,
    DatasetCounts,
    DatasetRecord,
    SampleRecord,
    read_dataset_record,
)
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.rendering import LABEL_COLOURS, LABELS, write_png

# The most pictures on the contact sheet.
_ON_SHEET = 12


def write_part(samples: Samples, about: DatasetRecord) -> DatasetRecord:
    """Writes the records of a part, the part's settings, and the checksums of all files.

    Each record of a sample has its split. Returns the settings.
    """

    def lines() -> Iterator[bytes]:
        for split in range(len(SPLITS)):
            for record in samples.read_split(split):
                yield f"{json.dumps([split, record])}\n".encode()

    write_atomic(samples.files / PART, lines())
    settings = about["settings"]
    contents = Contents({}, bool(settings["camera"]), "object_set" in about)
    counts = {
        name: sum(len(block.indices) for block in samples.blocks_of(split))
        for split, name in enumerate(SPLITS)
    }
    part = about["part"]
    assert part is not None
    croissant = describe_croissant(
        samples.files,
        about | {"pictures": counts, "classes": _list_classes()},
        contents,
        find_layout(settings["format"]),
        [split for split, name in enumerate(SPLITS) if counts[name]],
        introduction=f"Part {part[0]} of {part[1]} of a dataset, without the metadata of samples.",
    )
    write_json(samples.files / CROISSANT, croissant)
    write_json(samples.files / RECORD, about)
    # The checksums come last, because they are of all other files.
    write_sums(samples.files)
    return read_dataset_record(samples.files / RECORD)


def finish(
    samples: Samples, identity: DatasetRecord, drawing: Drawing | None = None
) -> DatasetRecord:
    """Writes the files that describe the samples of a whole dataset.

    Returns the record of the dataset. `drawing` is what the samples were drawn from; a dataset of
    shards needs it.
    """
    out, settings, has_objects = samples.files, identity["settings"], "object_set" in identity
    layout, camera = find_layout(settings["format"]), settings["camera"]
    count = min(_ON_SHEET, samples.total)
    # The pictures on the sheet are evenly spaced.
    on_sheet = [row * samples.total // count for row in range(count)]
    listed = _list_samples(samples, layout, {*on_sheet})
    about = identity | _counts(samples, listed.pixels)
    contents = Contents(listed.metrics, camera is not None, has_objects)
    # Examples in the card are of a split that has pictures.
    first = int(samples.splits.min())
    guide = layout.guide(first, objects=has_objects)
    programs = layout.loading(first), layout.loading_arrays(first, poses=camera is not None)
    card = write_card(about, contents, *programs, guide, layout.data_files(samples.splits))
    write_atomic(out / "README.md", card.encode())
    splits = np.unique(samples.splits).tolist()
    croissant = describe_croissant(out, about, contents, layout, splits, [*listed.names])
    write_json(out / CROISSANT, croissant)
    shown = [listed.records[index] for index in on_sheet]
    # The sheet is made from pictures in files.
    if layout.open_shard is None:
        pictures, pictures_layout = out, layout
    else:
        assert drawing is not None
        write_maps(out / MAPS, [*drawing.maps.values()], samples.views)
        # Pictures in shards are not files. Those on the sheet are drawn again as files.
        pictures, pictures_layout = samples.records / "sheet", LAYOUTS["imagefolder"]
        draw_again(drawing, on_sheet, samples, pictures_layout, pictures)
    entries = [_on_sheet(record, samples, pictures_layout) for record in shown]
    shape = camera["rows"] / camera["columns"] if camera else 1
    sheet = sample_sheet(pictures, entries, f"{count} of {samples.total} pictures", shape)
    write_png(out / "contact-sheet.png", sheet)
    if layout.boxes is not None and has_objects:
        # The picture with most objects explains the boxes best.
        fullest = max(shown, key=lambda record: len(record["objects"]))
        image, *_ = _on_sheet(fullest, samples, layout)
        write_png(out / layout.boxes, draw_boxes(out / image, fullest["objects"]))
    # The record is written last, because a folder with a record counts as complete.
    write_json(out / RECORD, about)
    return read_dataset_record(out / RECORD)


class _Listed(NamedTuple):
    """What the records of a dataset have.

    Attributes:
      pixels: the pixels of each class in each split.
      records: the records of the samples on the sheet, by index.
      metrics: see `Contents`.
      names: the names of the fields that some record has, as keys.
    """

    pixels: dict[str, NDArray[np.int64]]
    records: dict[int, SampleRecord]
    metrics: dict[str, bool]
    names: dict[str, None]


def _list_samples(samples: Samples, layout: Layout, wanted: Set[int]) -> _Listed:
    """Writes the layout's lists of samples, split by split."""
    pixels = {name: np.zeros(len(LABELS), np.int64) for name in SPLITS}
    listed = _Listed(pixels, {}, {}, {})
    for split in np.unique(samples.splits).tolist():
        # One pass over the records gives the sums and the records for the sheet.
        for record in samples.read_split(split):
            pixels[SPLITS[split]] += record["class_pixels"]
            add_metrics(listed.metrics, record["metrics"])
            listed.names.update(dict.fromkeys(record))
            if record["number"] in wanted:
                listed.records[record["number"]] = record
        layout.list_samples(samples.files, split, partial(samples.read_split, split))
    return listed


def _counts(samples: Samples, pixels: Mapping[str, NDArray[np.int64]]) -> DatasetCounts:
    """Returns the entries of the dataset's record that count pictures and pixels."""
    pictures = {}
    for split, name in enumerate(SPLITS):
        # Every map has the same number of views.
        pictures[name] = int((samples.splits == split).sum()) * samples.views
    class_pixels = {name: counts.tolist() for name, counts in pixels.items()}
    return {"pictures": pictures, "classes": _list_classes(), "class_pixels": class_pixels}


def _list_classes() -> list[DatasetClass]:
    return [
        {"label": label, "name": name, "colour": colour}
        for label, (name, colour) in enumerate(zip(LABELS, LABEL_COLOURS, strict=True))
    ]


def _on_sheet(
    record: SampleRecord, samples: Samples, layout: Layout
) -> tuple[str, str, tuple[str, ...]]:
    """Returns the files of a sample's image and labels, and its lines on the sheet."""
    index, metrics = record["number"], record["metrics"]
    split, (height, width) = samples.split_of(index), record["size"]
    image, labels = (layout.file(split, index, layer) for layer in ("image", "labels"))
    figures = ", ".join(
        f"{name} {metrics[name]}" for name in ("cyclomatic", "crossings", "bridges")
    )
    return image, labels, (f"{index:06d}, {SPLITS[split]}, {height} x {width} tiles", figures)
