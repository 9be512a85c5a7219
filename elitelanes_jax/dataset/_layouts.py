"""Layouts of a dataset's folder for different training libraries."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.files import read_json, write_atomic
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._samples import Sample
from elitelanes_jax.formats.objects import OBJECT_KINDS, base_kind
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.rendering import LABELS, png_of

Record = dict[str, Plain]

RECORD = "dataset.json"
"""The file with the settings of a dataset."""

# The files of a dataset besides its pictures.
_DESCRIBING = (
    rf"README\.md|contact-sheet\.png|{re.escape(RECORD)}|(train|validation|test)/metadata\.jsonl"
    r"|metadata/(train|val|test)\.jsonl|annotations/(objects_)?(train|val|test)\.json"
    r"|labels/(train|val|test)/\d{6,}\.txt|data\.yaml"
)


class Layout(NamedTuple):
    """A layout.

    In `path`, `metadata` and `program` the words SPLIT and SHORT stand for a split's name and its usual short name.

    Attributes:
      path: of a picture, with LAYER for its layer, and NUMBER for the sample.
      program: lines of Python that load a split from the folder ``DIR``.
      metadata: the file with a line of JSON for each sample of a split.
      rows: (folder, split, records of its samples in order) -> the lines; may write further files.
      folders: of layers whose folder has another name.
      note: sample -> additions to its record, for `rows`.
      needs: a package that writing it needs.
    """

    path: str
    program: str
    metadata: str
    rows: Callable[[Path, int, Iterable[Record]], Iterable[Record]]
    folders: Mapping[str, str] = {}
    note: Callable[[Sample], Record] = lambda sample: {}
    needs: str | None = None

    def file(self, split: int, index: int, layer: str) -> str:
        """Returns the path of a picture in the folder."""
        path = _in_split(self.path, split).replace("NUMBER", f"{index:06d}")
        return path.replace("LAYER", self.folders.get(layer, layer))

    def list_samples(self, folder: Path, split: int, records: Iterable[Record]) -> None:
        """Writes the files that list a split's samples."""
        lines = (f"{json.dumps(row)}\n".encode() for row in self.rows(folder, split, records))
        write_atomic(folder / _in_split(self.metadata, split), lines)

    def loading(self, split: int) -> str:
        """Returns a program that loads a split."""
        return _in_split(self.program, split)

    def loading_arrays(self, split: int, poses: bool) -> str:
        """Returns a program that loads a split as NumPy arrays, with poses or tile codes."""
        metadata = _in_split(self.metadata, split)
        image, labels = (
            self.file(split, 0, layer).replace("000000", "{row['number']:06d}") for layer in ("image", "labels")
        )
        targets = ("poses", "[row['nearest']['d'], row['nearest']['phi']]") if poses else ("codes", "row['codes']")
        return (
            "import json\nfrom pathlib import Path\n\nimport cv2\nimport numpy as np\n\n"
            f'rows = [json.loads(line) for line in Path("DIR/{metadata}").read_text().splitlines()]\n'
            f'images = [cv2.imread(f"DIR/{image}")[..., ::-1] for row in rows]  # RGB\n'
            f'labels = [cv2.imread(f"DIR/{labels}", cv2.IMREAD_GRAYSCALE) for row in rows]\n'
            f"{targets[0]} = [np.array({targets[1]}) for row in rows]\n"
            f"print(len(rows), images[0].shape, labels[0].shape, {targets[0]}[0].shape)"
        )


def find_layout(name: str) -> Layout:
    """Returns a layout by its name; raises `MissingPackageError` if a package that it needs is not installed."""
    layout = LAYOUTS[name]
    if layout.needs is not None:
        import_optional(layout.needs, f"format: {name} needs {layout.needs}")
    return layout


def write_sample(sample: Sample, layout: Layout, split: int, out: Path) -> None:
    """Writes the pictures of a sample where a layout has them.

    Raises:
      OSError: that names the file, if one cannot be written.
    """
    for name, layer in sample.layers.items():
        write_atomic(out / layout.file(split, sample.record["number"], name), png_of(layer))


def foreign_to_dataset(folder: Path) -> str | None:
    """Returns the first file in a folder that is not of a dataset, or None."""
    try:
        about = read_json(folder / RECORD)
        layout = LAYOUTS[about["settings"]["format"]]
        if "elitelanes_jax" not in about["versions"]:
            return f"{RECORD} of another program"
    except FileNotFoundError:
        return f"no {RECORD}"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return f"{RECORD} of another program"
    layers = ("image", "labels", "instances")
    pictures = [layout.file(split, 0, layer) for split in range(len(SPLITS)) for layer in layers]
    patterns = (re.escape(picture).replace("000000", r"\d{6,}") for picture in pictures)
    return foreign_file(folder, re.compile("|".join([_DESCRIBING, *patterns])).fullmatch)


_SHORT = ("train", "val", "test")


def _in_split(text: str, split: int) -> str:
    return text.replace("SPLIT", SPLITS[split]).replace("SHORT", _SHORT[split])


def _imagefolder_rows(folder: Path, split: int, records: Iterable[Record]) -> Iterator[Record]:
    for record in records:
        names = {
            f"{layer}_file_name": f"{layer}/{record['number']:06d}.png"
            for layer in ("image", "labels", *(["instances"] if "objects" in record else []))
        }
        if "objects" in record:  # in columns, by the names that Hugging Face's guides have for boxes
            columns = {"id": "instance", "category": "kind", "bbox": "box"} | dict.fromkeys(("whole", "visible"))
            columns |= {"distance": None} if record.get("camera") else {}
            listed = {name: [one[key or name] for one in record["objects"]] for name, key in columns.items()}
            record = record | {"objects": listed}
        yield names | {key: value for key, value in record.items() if value != {}}


def _coco_note(sample: Sample) -> Record:
    labels = sample.layers["labels"]
    classes = [_runs(labels == label) | {"category_id": label, "iscrowd": 1} for label in range(1, len(LABELS))]
    found: Record = {"annotations": [one for one in classes if one["area"]]}
    if "objects" in sample.record:
        instances = sample.layers["instances"]
        found["object_runs"] = [_runs(instances == one["instance"]) for one in sample.record["objects"]]
    return found


def _runs(mask: NDArray[np.bool_]) -> Record:
    from pycocotools import mask as masks

    runs = masks.encode(np.asfortranarray(mask, np.uint8))
    counts = {"counts": runs["counts"].decode()}
    return {"segmentation": runs | counts, "area": int(masks.area(runs)), "bbox": masks.toBbox(runs).tolist()}


def _coco_rows(folder: Path, split: int, records: Iterable[Record]) -> Iterator[Record]:
    """Yields the records, then writes an annotation for each class of an image and for each object, and YOLO's text."""
    images: list[Record] = []
    annotations: list[Record] = []
    objects: list[Record] = []
    has_objects = False
    for record in records:
        index, found, runs = record["number"], record.pop("annotations"), record.pop("object_runs", None)
        height, width = record["pixels"]
        images.append({"id": index, "file_name": f"{index:06d}.png", "height": height, "width": width})
        annotations += [{"image_id": index} | one for one in found]
        if runs is not None:
            has_objects = True
            own = [_category(one) | shape for one, shape in zip(record["objects"], runs, strict=True)]
            objects += [{"image_id": index} | one for one in own]
            _write_yolo(folder / "labels" / _SHORT[split] / f"{index:06d}.txt", own, height, width)
        yield record
    categories = [{"id": index, "name": name} for index, name in enumerate(LABELS) if index]
    _write_coco(folder / "annotations" / f"{_SHORT[split]}.json", images, annotations, categories)
    if has_objects:
        categories = [{"id": index + 1, "name": name} for index, name in enumerate(OBJECT_KINDS)]
        _write_coco(folder / "annotations" / f"objects_{_SHORT[split]}.json", images, objects, categories)
        _write_data(folder)


def _write_coco(file: Path, images: list[Record], annotations: list[Record], categories: list[Record]) -> None:
    numbered = [{"id": index} | one for index, one in enumerate(annotations, 1)]
    table = {"images": images, "annotations": numbered, "categories": categories}
    write_atomic(file, json.dumps(table).encode() + b"\n")


def _category(one: Record) -> Record:
    about = {name: one[name] for name in ("visible", "distance") if name in one}
    return {"category_id": list(OBJECT_KINDS).index(base_kind(one["kind"])) + 1, "iscrowd": 0} | about


def _write_yolo(file: Path, objects: list[Record], height: int, width: int) -> None:
    """Writes a line for each object: its class from 0, and the middle and the size of its box as shares.

    Ultralytics looks for it in labels/ if the picture is in images/.
    """
    lines = []
    for one in objects:
        x, y, wide, high = one["bbox"]
        shares = (x + wide / 2) / width, (y + high / 2) / height, wide / width, high / height
        lines.append(" ".join([str(one["category_id"] - 1), *(f"{share:.6f}" for share in shares)]) + "\n")
    write_atomic(file, "".join(lines).encode())


def _write_data(folder: Path) -> None:
    """Writes the file that Ultralytics reads, with the splits that are there."""
    splits = [split for split in _SHORT if (folder / "images" / split).is_dir()]
    lines = ["path: .", *(f"{split}: images/{split}" for split in splits), "names:"]
    lines += [f"  {index}: {name}" for index, name in enumerate(OBJECT_KINDS)]
    write_atomic(folder / "data.yaml", "\n".join(lines).encode() + b"\n")


LAYOUTS = {
    "imagefolder": Layout(
        "SPLIT/LAYER/NUMBER.png",
        "# pip install datasets pillow\n"
        "from datasets import load_dataset\n\n"
        "# Each split alone, because their columns may differ. Alone, a split is called train.\n"
        'samples = load_dataset("imagefolder", data_dir="DIR/SPLIT", split="train")\n'
        "sample = samples[0]\n"
        'print(sample["image"].size, sample["labels"].getextrema())',
        "SPLIT/metadata.jsonl",
        _imagefolder_rows,
    ),
    "coco": Layout(
        "LAYER/SHORT/NUMBER.png",
        "from pycocotools.coco import COCO\n\n"
        'coco = COCO("DIR/annotations/SHORT.json")\n'
        "image = coco.loadImgs(coco.getImgIds()[:1])[0]\n"
        'masks = [coco.annToMask(one) for one in coco.loadAnns(coco.getAnnIds(image["id"]))]\n'
        'print(image["file_name"], len(masks))',
        "metadata/SHORT.jsonl",
        _coco_rows,
        folders={"image": "images"},
        note=_coco_note,
        needs="pycocotools",
    ),
}
"""The layouts, by the names that ``--format`` takes."""
