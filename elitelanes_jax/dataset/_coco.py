"""COCO's annotations of a dataset, and YOLO's text.

The classes of pixels are annotated as in COCO-Stuff: one annotation of a picture for each class,
run-length encoded. Objects are annotated as in COCO: one annotation for each object, with polygons.
No annotation is of a crowd, because pycocotools scores no crowds and most loaders skip them.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool
from numpy.typing import NDArray

from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._samples import Sample
from elitelanes_jax.dataset.tables import Outline, SampleNote, SampleRecord, SeenObject
from elitelanes_jax.formats.objects import OBJECT_KINDS, base_kind
from elitelanes_jax.tiles.rendering import LABELS

Row = dict[str, Plain]
"""A table that is only written: an annotation, a category, or a line of metadata."""

Records = Callable[[], Iterable[SampleRecord]]
"""Reads the records of a split's samples anew, one after another.

Therefore no file needs all records in memory.
"""

SHORT_NAMES = ("train", "val", "test")
"""The usual short names of the splits."""


def annotate(sample: Sample) -> SampleNote:
    """Returns the annotations of a sample's classes, and of its objects if it has any."""
    labels = sample.layers["labels"]
    # Label 0 is the background, which has no annotation.
    present = [label for label in range(1, len(LABELS)) if (labels == label).any()]
    note: SampleNote = {
        "classes": [{"category_id": label, **_runs(labels == label)} for label in present]
    }
    if "objects" in sample.record:
        instances = sample.layers["instances"]
        # The outlines are computed here, because pixels are no longer in memory when the split is
        # listed.
        note["outlines"] = [
            _polygons(instances == thing["instance"]) for thing in sample.record["objects"]
        ]
    return note


def coco_rows(folder: Path, split: int, read: Records) -> Iterator[Row]:
    """Writes the annotations of a split, and yields the lines of its metadata.

    Also writes YOLO's text if there are objects.
    """
    name, annotations = SHORT_NAMES[split], folder / "annotations"
    # COCO's categories count from 1, as the labels without the background do.
    classes: list[Row] = [
        {"id": label, "name": title} for label, title in enumerate(LABELS) if label
    ]
    table = read, _class_annotations, classes
    _write_coco(annotations / f"{name}.json", *table)
    if "outlines" in next(iter(read()), {}):
        # All records have outlines, or none has.
        kinds: list[Row] = [
            {"id": index, "name": kind} for index, kind in enumerate(OBJECT_KINDS, 1)
        ]
        table = read, _object_annotations, kinds
        _write_coco(annotations / f"objects_{name}.json", *table)
        for record in read():
            _write_yolo(folder / "labels" / name / f"{record['number']:06d}.txt", record)
        _write_data(folder)
    # Programs that import folders, such as datumaro, look for this name of COCO's.
    _write_coco(annotations / f"instances_{name}.json", *table)
    for record in read():
        yield {key: value for key, value in record.items() if key not in ("classes", "outlines")}


def _class_annotations(record: SampleRecord) -> list[Row]:
    return [
        {"image_id": _image_id(record), "iscrowd": 0, **annotation}
        for annotation in record["classes"]
    ]


def _object_annotations(record: SampleRecord) -> list[Row]:
    annotations: list[Row] = []
    for thing, outline in zip(record["objects"], record["outlines"], strict=True):
        annotation: Row = {
            "image_id": _image_id(record),
            "category_id": _kind_number(thing) + 1,
            "iscrowd": 0,
            "visible": thing["visible"],
        }
        if "distance" in thing:
            annotation["distance"] = thing["distance"]
        annotations.append({**annotation, **outline, "bbox": thing["box"]})
    return annotations


def _image_id(record: SampleRecord) -> int:
    """Returns the number of a sample from 1, because some readers take 0 for no image."""
    return record["number"] + 1


def _kind_number(thing: SeenObject) -> int:
    return list(OBJECT_KINDS).index(base_kind(thing["kind"]))


def _write_coco(
    file: Path,
    read: Records,
    annotations_of: Callable[[SampleRecord], list[Row]],
    categories: Sequence[Row],
) -> None:
    # Each table is written while its records are read, so that no table has to fit into memory.
    def images() -> Iterator[Row]:
        for record in read():
            height, width = record["pixels"]
            name = f"{record['number']:06d}.png"
            yield {"id": _image_id(record), "file_name": name, "height": height, "width": width}

    def annotations() -> Iterator[Row]:
        # Annotations are numbered from 1, because pycocotools takes 0 for no match.
        number = 0
        for record in read():
            for annotation in annotations_of(record):
                number += 1
                yield {"id": number, **annotation}

    def parts() -> Iterator[str]:
        # The module pycocotools asks for `info` when it loads results.
        yield '{"info": {"description": "Elite Lanes JAX"}, "licenses": [], "images": ['
        yield from _joined(images())
        yield '], "annotations": ['
        yield from _joined(annotations())
        yield f'], "categories": {json.dumps(categories)}}}\n'

    write_atomic(file, (part.encode() for part in parts()))


def _joined(rows: Iterable[Row]) -> Iterator[str]:
    # JSON has no comma before the first row, and none after the last one.
    separator = ""
    for row in rows:
        yield separator + json.dumps(row)
        separator = ", "


def _write_yolo(file: Path, record: SampleRecord) -> None:
    """Writes a line for each object, as YOLO reads it.

    A line has the class, from 0, and the middle and the size of the box as shares. Ultralytics
    looks for it in labels/ if the picture is in images/.
    """
    height, width = record["pixels"]
    lines = []
    for thing in record["objects"]:
        x, y, wide, high = thing["box"]
        # YOLO's boxes have their middle and their size, and COCO's have their corner and their
        # size.
        shares = (x + wide / 2) / width, (y + high / 2) / height, wide / width, high / height
        lines.append(
            " ".join([str(_kind_number(thing)), *(f"{share:.6f}" for share in shares)]) + "\n"
        )
    write_atomic(file, "".join(lines).encode())


def _write_data(folder: Path) -> None:
    """Writes the file that Ultralytics reads.

    Paths in the file are relative to it, because it names no other folder. Ultralytics asks for
    `train` and `val`. Without pictures of its own, each has those of another split.
    """
    splits = [name for name in SHORT_NAMES if (folder / "images" / name).is_dir()]
    lines = []
    for name in SHORT_NAMES:
        if name in splits:
            lines.append(f"{name}: images/{name}")
        elif name != "test":
            # Ultralytics does not need a split for tests.
            lines.append(f"{name}: images/{splits[0]} # this split is empty")
    lines += ["names:", *(f"  {index}: {name}" for index, name in enumerate(OBJECT_KINDS))]
    write_atomic(folder / "data.yaml", "\n".join(lines).encode() + b"\n")


def _runs(mask: Bool[NDArray, "h w"]) -> Row:
    from pycocotools import mask as masks

    # The encoder of pycocotools reads columns, and takes arrays in Fortran's order alone.
    runs = masks.encode(np.asfortranarray(mask, np.uint8))
    # JSON has no bytes.
    counts = {"counts": runs["counts"].decode()}
    return {
        "segmentation": runs | counts,
        "area": int(masks.area(runs)),
        "bbox": masks.toBbox(runs).tolist(),
    }


def _polygons(mask: Bool[NDArray, "h w"]) -> Outline:
    """Returns polygons that cover exactly the pixels of a mask, and their area.

    Each piece of pixels with common sides has a polygon along the pixels' sides. COCO's polygons
    have no holes, so the polygon visits each hole along a line to it and back, which encloses
    nothing.
    """
    # With four neighbours, pixels that touch at a corner alone are not connected.
    count, pieces, boxes, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=4
    )
    polygons = []
    for piece in range(1, count):
        left, top, wide, high = boxes[piece, :4]
        # The box of a piece is searched alone, which is less than the whole picture.
        outline, *holes = _loops(pieces[top : top + high, left : left + wide] == piece)
        # Each hole is visited from the start of the outline and back to it.
        start = outline[0]
        for hole in holes:
            outline += [start, *hole, hole[0]]
        polygons.append(np.add(outline, (left, top)).ravel().tolist())
    return {"segmentation": polygons, "area": int(mask.sum())}


def _loops(mask: Bool[NDArray, "h w"]) -> list[list[list[int]]]:
    """Returns the borders of one piece of pixels: loops of corners (x, y), the outer one first.

    A border turns at a corner of pixels if one or three of the four pixels around it are in the
    mask. It turns twice, in two visits, if two opposite ones are. Along each row and each column of
    corners, the first turn is joined with the second, the third with the fourth, and so on.
    """
    # With a border of one pixel, each corner has four pixels around it, also at the edge of the
    # mask.
    padded = np.pad(mask, 1)
    northwest, northeast = padded[:-1, :-1], padded[:-1, 1:]
    southwest, southeast = padded[1:, :-1], padded[1:, 1:]
    # An odd number of the four pixels means one turn, and opposite pixels mean two turns.
    once = northwest ^ northeast ^ southwest ^ southeast
    twice = (northwest == southeast) & (northeast == southwest) & (northwest != northeast)
    row, column = np.nonzero(once | twice)
    # A corner with two turns has two entries, one after the other, the second one marked.
    corner = np.repeat(np.arange(len(row)), 1 + twice[row, column])
    second = np.append(False, corner[1:] == corner[:-1])
    # One of two visits leads up and the other one down. Otherwise pixels that touch at a corner
    # alone would be joined there.
    rises = (twice & northeast)[row, column][corner]
    by_column = np.lexsort((second ^ rises, row[corner], column[corner]))
    # In this order, turns 0 and 1, 2 and 3, and so on are joined.
    neighbour = np.arange(len(corner)) ^ 1
    # Row by row is the order of `np.nonzero` already, so only the columns need sorting.
    across, down = neighbour.tolist(), np.empty(len(corner), int)
    down[by_column] = by_column[neighbour]
    points = np.column_stack([column, row])[corner].tolist()
    # Every turn that no earlier loop has passed starts a loop. The first turn is the top left one,
    # on the outer border.
    loops, visited = [], np.zeros(len(corner), bool)
    for first in range(len(corner)):
        loop, turn = [], first
        while not visited[turn]:
            # A border goes along a row, then along a column, until it is back at its first turn.
            ahead = across[turn]
            visited[turn] = visited[ahead] = True
            loop += [points[turn], points[ahead]]
            turn = down[ahead]
        if loop:
            loops.append(loop)
    return loops
