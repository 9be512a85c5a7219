"""Layouts of a dataset's folder for different training libraries."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.files import read_json, write_atomic
from elitelanes_jax._util.folders import foreign_file
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.dataset._coco import SHORT_NAMES, Record, Records, annotate, coco_rows
from elitelanes_jax.dataset._samples import Sample
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.rendering import png_of

RECORD = "dataset.json"
"""The file with the settings of a dataset."""

# The files of a dataset besides its pictures.
_DESCRIBING = (
    rf"README\.md|contact-sheet\.png|boxes\.png|{re.escape(RECORD)}|(train|validation|test)/metadata\.jsonl"
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
      rows: (folder, split, reader of the records of its samples in order) -> the lines; may write further files.
      folders: of layers whose folder has another name.
      note: sample -> additions to its record, for `rows`.
      needs: a package that writing it needs.
      about: text for the README about the files.
      about_objects: more of it for a dataset with objects.
      boxes: the file of a picture with the boxes of its objects, for this text.
    """

    path: str
    program: str
    metadata: str
    rows: Callable[[Path, int, Records], Iterable[Record]]
    folders: Mapping[str, str] = {}
    note: Callable[[Sample], Record] = lambda sample: {}
    needs: str | None = None
    about: str = ""
    about_objects: str = ""
    boxes: str | None = None

    def file(self, split: int, index: int, layer: str) -> str:
        """Returns the path of a picture in the folder."""
        path = _in_split(self.path, split).replace("NUMBER", f"{index:06d}")
        return path.replace("LAYER", self.folders.get(layer, layer))

    def list_samples(self, folder: Path, split: int, read: Records) -> None:
        """Writes the files that list a split's samples."""
        lines = (f"{json.dumps(row)}\n".encode() for row in self.rows(folder, split, read))
        write_atomic(folder / _in_split(self.metadata, split), lines)

    def guide(self, split: int, *, objects: bool) -> str:
        """Returns text for the README about the files, with those of a split as examples."""
        return _in_split(self.about + (self.about_objects if objects else ""), split)

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


def _in_split(text: str, split: int) -> str:
    return text.replace("SPLIT", SPLITS[split]).replace("SHORT", SHORT_NAMES[split])


def _imagefolder_rows(folder: Path, split: int, read: Records) -> Iterator[Record]:
    for record in read():
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


_COCO = """
`annotations/SHORT.json` has an annotation for each class in a picture: all pixels of the class, run-length encoded as
in COCO-Stuff. An image's `id` is the `number` in the metadata plus 1. `iscrowd` is 0 in all annotations."""

_COCO_OBJECTS = r"""

## Objects for detectors

![A picture with the boxes of its objects](boxes.png)

`annotations/objects_SHORT.json` has an annotation for each object that is seen. pycocotools turns the polygons in
`segmentation` into exactly the object's pixels in `instances/SHORT`. An object that is hidden in part may have several
polygons.

For YOLO, `labels/SHORT` has a file of text for each picture in `images/SHORT`. A line of it is an object: the number of
its class in `data.yaml`, x and y of the middle of its box, and the width and the height of the box. These are shares of
the picture's width and height. Ultralytics reads them with this command:

```sh
yolo detect train data=DIR/data.yaml
```

If a split for training or validation is empty, `data.yaml` names another split instead, because Ultralytics needs both.
`yolo segment` needs outlines in place of boxes. This program writes them over the boxes:

```python
import json
from itertools import cycle
from pathlib import Path

for file in Path("DIR/annotations").glob("objects_*.json"):
    table = json.loads(file.read_text())
    lines = {image["id"]: "" for image in table["images"]}
    sides = {image["id"]: (image["width"], image["height"]) for image in table["images"]}
    for one in table["annotations"]:
        start, outline = one["segmentation"][0][:2], []
        for polygon in one["segmentation"]:  # joined by lines from the start to each and back
            outline += [*polygon, *polygon[:2], *start]
        shares = [f"{value / side:.6f}" for value, side in zip(outline, cycle(sides[one["image_id"]]))]
        lines[one["image_id"]] += " ".join([str(one["category_id"] - 1), *shares]) + "\n"
    for image in table["images"]:
        labels = Path("DIR/labels") / file.stem.removeprefix("objects_") / image["file_name"]
        labels.with_suffix(".txt").write_text(lines[image["id"]])
```"""

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
        coco_rows,
        folders={"image": "images"},
        note=annotate,
        needs="pycocotools",
        about=_COCO,
        about_objects=_COCO_OBJECTS,
        boxes="boxes.png",
    ),
}
"""The layouts, by the names that ``--format`` takes."""
