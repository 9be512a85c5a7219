"""Layouts of a dataset's folder for different training libraries."""

import json
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import read_json, write_atomic
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._samples import Sample
from elitelanes_jax.formats.objects import OBJECT_KINDS, base_kind
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.rendering import LABELS, png_of
from elitelanes_jax.tiles.tileset import MASKS

Record = dict[str, Plain]

RECORD = "dataset.json"
"""The file with the settings of a dataset."""

# The files of a dataset besides its pictures.
_DESCRIBING = (
    rf"README\.md|contact-sheet\.png|{re.escape(RECORD)}|(train|validation|test)/metadata\.jsonl"
    r"|metadata/(train|val|test)\.jsonl|annotations/(objects_)?(train|val|test)\.json"
    r"|labels/(train|val|test)/\d{6,}\.txt|data\.yaml"
)


class Format(NamedTuple):
    """A layout.

    Attributes:
      layers: the layers beside image, labels and the further masks of the tile set.
      file: (split, index, layer) -> the path of a picture in the folder.
      note: sample -> additions to its record, for `list_samples`.
      list_samples: (folder, split, records in order) -> writes the files that list a split's samples.
      program: lines of Python that load a split, named SPLIT or SHORT, from the folder ``DIR``.
      needs: a package that writing it needs.
      metadata: the file with a line of JSON for each sample of a split.
    """

    layers: tuple[str, ...]
    file: Callable[[int, int, str], str]
    note: Callable[[Sample], Record]
    list_samples: Callable[[Path, int, Iterable[Record]], None]
    program: str
    needs: str | None = None
    metadata: str = "metadata/SHORT.jsonl"

    def loading(self, split: int) -> str:
        """Returns a program that loads a split."""
        return self.program.replace("SPLIT", SPLITS[split]).replace("SHORT", _SHORT[split])

    def loading_arrays(self, split: int, poses: bool) -> str:
        """Returns a program that loads a split as NumPy arrays, with poses or tile codes."""
        metadata = self.metadata.replace("SPLIT", SPLITS[split]).replace("SHORT", _SHORT[split])
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


def find_format(name: str) -> Format:
    """Returns a format by its name; raises `MissingPackageError` if a package that it needs is not installed."""
    layout = FORMATS[name]
    if layout.needs is not None:
        import_optional(layout.needs, f"format: {name} needs {layout.needs}")
    return layout


def write_sample(sample: Sample, layout: Format, split: int, out: Path) -> None:
    """Writes the pictures of a sample where a format has them.

    Raises:
      OSError: that names the file, if one cannot be written.
    """
    index = sample.record["number"]
    own = [*sample.record["layers"], *(["instances"] if "instances" in sample.layers else [])]
    for name in ("image", "labels", *layout.layers, *own):
        write_atomic(out / layout.file(split, index, name), png_of(sample.layers[name]))


def foreign_to_dataset(folder: Path) -> str | None:
    """Returns the first file in a folder that is not of a dataset, or None."""
    try:
        about = read_json(folder / RECORD)
        layers = ("image", "labels", *MASKS, "instances", *about["tile_set"]["layers"])
        layout = FORMATS[about["settings"]["format"]]
        if "elitelanes_jax" not in about["versions"]:
            return f"{RECORD} of another program"
    except FileNotFoundError:
        return f"no {RECORD}"
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return f"{RECORD} of another program"
    pictures = [layout.file(split, 0, layer) for split in range(len(SPLITS)) for layer in layers]
    patterns = (re.escape(picture).replace("000000", r"\d{6,}") for picture in pictures)
    return foreign_file(folder, re.compile("|".join([_DESCRIBING, *patterns])).fullmatch)


def check_pictures(folder: Path, about: Record) -> Record:
    """Returns the record of a complete dataset; raises `InputError` if pictures are missing."""
    for split, count in enumerate(about["pictures"].values()):
        for layer in ("image", "labels"):
            files = FORMATS[about["settings"]["format"]].file(split, 0, layer).replace("000000", "*")
            if (found := len(list(folder.glob(files)))) != count:
                raise InputError(f"{folder}: expected {count:,} files {files}, got {found:,}; force=True draws all")
    return about


_SHORT = ("train", "val", "test")

# The pictures of every dataset. Further masks of the tile set have their own folder next to them.
_USUAL = ("image", "labels", *MASKS, "instances")


def _write_lines(file: Path, rows: Iterable[Record]) -> None:
    write_atomic(file, (f"{json.dumps(row)}\n".encode() for row in rows))


# --- plain: a folder for each map, with all its masks


def _plain_file(split: int, index: int, layer: str) -> str:
    return f"{SPLITS[split]}/{index:06d}/{layer}.png"


def _plain_index(folder: Path, split: int, records: Iterable[Record]) -> None:
    rows = ({"folder": f"{record['number']:06d}"} | record for record in records)
    _write_lines(folder / SPLITS[split] / "metadata.jsonl", rows)


# --- imagefolder: Hugging Face datasets


def _imagefolder_file(split: int, index: int, layer: str) -> str:
    return f"{SPLITS[split]}/{_folder(layer)}/{index:06d}.png"


def _folder(layer: str) -> str:
    return layer if layer in _USUAL else f"layers/{layer}"


def _imagefolder_index(folder: Path, split: int, records: Iterable[Record]) -> None:
    def row(record: Record) -> Record:
        names = {
            f"{_folder(layer).replace('/', '_')}_file_name": f"{_folder(layer)}/{record['number']:06d}.png"
            for layer in ("image", "labels", *record["layers"], *(["instances"] if "objects" in record else []))
        }
        if "objects" in record:  # in columns, by the names that Hugging Face's guides have for boxes
            columns = {"id": "instance", "category": "kind", "bbox": "box"} | dict.fromkeys(("whole", "visible"))
            columns |= {"distance": None} if record.get("camera") else {}
            listed = {name: [one[key or name] for one in record["objects"]] for name, key in columns.items()}
            record = record | {"objects": listed}
        return names | {key: value for key, value in record.items() if key != "layers" and value != {}}

    _write_lines(folder / SPLITS[split] / "metadata.jsonl", map(row, records))


# --- mmseg: MMSegmentation


def _mmseg_file(split: int, index: int, layer: str) -> str:
    folder = {"image": "img_dir", "labels": "ann_dir"}.get(layer, _folder(layer))
    return f"{folder}/{_SHORT[split]}/{index:06d}.png"


def _mmseg_index(folder: Path, split: int, records: Iterable[Record]) -> None:
    _write_lines(folder / "metadata" / f"{_SHORT[split]}.jsonl", records)


# --- coco: one annotation for each class of an image, run-length encoded


def _coco_file(split: int, index: int, layer: str) -> str:
    return f"{'images' if layer == 'image' else _folder(layer)}/{_SHORT[split]}/{index:06d}.png"


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


def _coco_index(folder: Path, split: int, records: Iterable[Record]) -> None:
    images: list[Record] = []
    annotations: list[Record] = []
    objects: list[Record] = []
    rows: list[Record] = []
    for record in records:
        index, found, runs = record["number"], record.pop("annotations"), record.pop("object_runs", None)
        height, width = record["pixels"]
        images.append({"id": index, "file_name": f"{index:06d}.png", "height": height, "width": width})
        annotations += [{"image_id": index} | one for one in found]
        if runs is not None:
            own = [_category(one) | shape for one, shape in zip(record["objects"], runs, strict=True)]
            objects += [{"image_id": index} | one for one in own]
            _write_yolo(folder / "labels" / _SHORT[split] / f"{index:06d}.txt", own, height, width)
        rows.append(record)
    categories = [{"id": index, "name": name} for index, name in enumerate(LABELS) if index]
    _write_coco(folder / "annotations" / f"{_SHORT[split]}.json", images, annotations, categories)
    if any("objects" in row for row in rows):
        categories = [{"id": index + 1, "name": name} for index, name in enumerate(OBJECT_KINDS)]
        _write_coco(folder / "annotations" / f"objects_{_SHORT[split]}.json", images, objects, categories)
        _write_data(folder)
    _write_lines(folder / "metadata" / f"{_SHORT[split]}.jsonl", rows)


def _write_coco(file: Path, images: list[Record], annotations: list[Record], categories: list[Record]) -> None:
    numbered = [{"id": index} | one for index, one in enumerate(annotations, 1)]
    table = {"images": images, "annotations": numbered, "categories": categories}
    write_atomic(file, json.dumps(table).encode() + b"\n")


def _category(one: Record) -> Record:
    about = {name: one[name] for name in ("visible", "distance") if name in one}
    return {"category_id": list(OBJECT_KINDS).index(base_kind(one["kind"])) + 1, "iscrowd": 0} | about


# YOLO's text lies where Ultralytics looks for it: in labels/ where the picture is in images/.


def _write_yolo(file: Path, objects: list[Record], height: int, width: int) -> None:
    """Writes a line for each object: its class from 0, and the middle and the size of its box as shares."""
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


def _no_note(sample: Sample) -> Record:
    return {}


FORMATS = {
    "imagefolder": Format(
        (),
        _imagefolder_file,
        _no_note,
        _imagefolder_index,
        "# pip install datasets pillow\n"
        "from datasets import load_dataset\n\n"
        'dataset = load_dataset("imagefolder", data_dir="DIR")\n'
        'sample = dataset["SPLIT"][0]\n'
        'print(sample["image"].size, sample["labels"].getextrema())',
        metadata="SPLIT/metadata.jsonl",
    ),
    "mmseg": Format(
        (),
        _mmseg_file,
        _no_note,
        _mmseg_index,
        "from mmseg.datasets import BaseSegDataset\n\n"
        f"metainfo = dict(classes={LABELS!r})\n"
        'prefix = dict(img_path="img_dir/SHORT", seg_map_path="ann_dir/SHORT")\n'
        'dataset = BaseSegDataset(data_root="DIR", img_suffix=".png", data_prefix=prefix, metainfo=metainfo)\n'
        "print(len(dataset))",
    ),
    "coco": Format(
        (),
        _coco_file,
        _coco_note,
        _coco_index,
        "from pycocotools.coco import COCO\n\n"
        'coco = COCO("DIR/annotations/SHORT.json")\n'
        "image = coco.loadImgs(coco.getImgIds()[:1])[0]\n"
        'masks = [coco.annToMask(one) for one in coco.loadAnns(coco.getAnnIds(image["id"]))]\n'
        'print(image["file_name"], len(masks))',
        needs="pycocotools",
    ),
    "plain": Format(
        MASKS,
        _plain_file,
        _no_note,
        _plain_index,
        "import json\nfrom pathlib import Path\n\nimport cv2\n\n"
        'folder = Path("DIR") / "SPLIT"\n'
        'rows = [json.loads(line) for line in (folder / "metadata.jsonl").open()]\n'
        'labels = cv2.imread(str(folder / rows[0]["folder"] / "labels.png"), cv2.IMREAD_UNCHANGED)\n'
        "print(len(rows), labels.shape)",
        metadata="SPLIT/metadata.jsonl",
    ),
}
"""The formats, by name."""
