"""Layouts of a dataset's folder for different training libraries."""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.sums import SUMS
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._coco import SHORT_NAMES, Records, Row, annotate, coco_rows
from elitelanes_jax.dataset._samples import Sample, layer_names
from elitelanes_jax.dataset._shards import OpenShard, open_parquet, open_tar
from elitelanes_jax.dataset.tables import DatasetRecord, SampleNote, SampleRecord
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.folder import foreign_to_record
from elitelanes_jax.maps.spec import SPLITS

RECORD = "dataset.json"
"""The file with the settings of a dataset."""

CROISSANT = "croissant.json"
"""The file that describes a dataset for programs."""

MAPS = "maps.jsonl"
"""The file with the maps of a dataset of shards, by which `--maps-from` reads them."""

PART = "part.jsonl"
"""The file with the records of the samples of a part, a line ``[split, record]`` for each."""

# The files of a dataset besides its pictures.
_DESCRIBING = (
    rf"README\.md|contact-sheet\.png|boxes\.png|{re.escape(RECORD)}|{re.escape(PART)}|{SUMS}"
    rf"|{re.escape(CROISSANT)}"
    r"|(train|validation|test)/metadata\.jsonl"
    r"|metadata/(train|val|test)\.jsonl|annotations/((objects|instances)_)?(train|val|test)\.json"
    r"|labels/(train|val|test)/\d{6,}\.txt|data\.yaml|maps\.jsonl"
)


class Layout(NamedTuple):
    """A layout.

    In texts, SPLIT is the name of a split, and SHORT its usual short name.

    Attributes:
      path: the path of a picture, with LAYER for its layer, and NUMBER for the sample; or the path
        of a shard, with SHARD for its number in the split, and COUNT for the number of shards.
      program: lines of Python that load a split from the folder ``DIR``.
      metadata: the file with a line of JSON for each sample of a split; None if shards have the
        metadata.
      rows: (folder, split, reader of the records of its samples in order) -> the lines; may write
        further files.
      open_shard: writes a shard; None for a file for each picture.
      arrays: lines of Python that load a split of shards as NumPy arrays, with TARGETS and VALUE
        for what they predict.
      folders: the names of folders that differ from the name of their layer, by layer.
      renamed: the entries of objects whose names differ from those in records, by the name there.
      note: sample -> additions to its record, for `rows`.
      needs: a package that writing it needs.
      about: text for the README about the files.
      about_objects: more of it for a dataset with objects.
      boxes: the file of a picture with the boxes of its objects, for this text.
    """

    path: str
    program: str
    metadata: str | None = None
    rows: Callable[[Path, int, Records], Iterable[Row]] = lambda folder, split, read: ()
    open_shard: OpenShard | None = None
    arrays: str = ""
    folders: Mapping[str, str] = {}
    renamed: Mapping[str, str] = {}
    note: Callable[[Sample], SampleNote] = lambda sample: {}
    needs: str | None = None
    about: str = ""
    about_objects: str = ""
    boxes: str | None = None

    def file(self, split: int, index: int, layer: str) -> str:
        """Returns the path of a picture in the folder."""
        # Numbers have six digits or more, so that files are in order by their names.
        path = _in_split(self.path, split).replace("NUMBER", f"{index:06d}")
        return path.replace("LAYER", self.folders.get(layer, layer))

    def shard_file(self, split: int, number: int, count: int) -> str:
        """Returns the path of a shard in the folder.

        `count` is the number of the split's shards.
        """
        # Numbers have leading zeros, so that shards are in order by their names.
        return (
            _in_split(self.path, split)
            .replace("SHARD", f"{number:05d}")
            .replace("COUNT", f"{count:05d}")
        )

    def data_files(self, splits: NDArray[np.int_]) -> dict[str, str]:
        """Returns a pattern of the shards of each split that has maps, by the split's name.

        The result is empty without shards.
        """
        if self.open_shard is None:
            return {}
        # Hugging Face finds the shards by a pattern, however many there are.
        return {SPLITS[split]: self.shards_pattern(split) for split in np.unique(splits).tolist()}

    def shards_pattern(self, split: int) -> str:
        """Returns a pattern of the paths of a split's shards."""
        return _in_split(re.sub("SHARD.*COUNT|SHARD", "*", self.path), split)

    def list_file(self, split: int) -> str:
        """Returns the path of the file with the metadata of a split."""
        assert self.metadata is not None
        return _in_split(self.metadata, split)

    def split_name(self, split: int) -> str:
        """Returns the name of a split in paths."""
        return SHORT_NAMES[split] if "SHORT" in self.path else SPLITS[split]

    def files_pattern(self) -> str:
        """Returns a regular expression of the paths of pictures or shards."""
        if self.open_shard is not None:
            # A path with zeros becomes a pattern: five digits or more stand in their place.
            patterns = [re.escape(self.shard_file(split, 0, 0)) for split in range(len(SPLITS))]
            return "|".join(patterns).replace("00000", r"\d{5,}")
        # The layers of objects are included, because a dataset may have been drawn with or without
        # them.
        layers = layer_names(has_objects=True)
        pictures = [self.file(split, 0, layer) for split in range(len(SPLITS)) for layer in layers]
        return "|".join(re.escape(picture).replace("000000", r"\d{6,}") for picture in pictures)

    def list_samples(self, folder: Path, split: int, read: Records) -> None:
        """Writes the files that list a split's samples."""
        # Shards have the metadata in themselves.
        if self.metadata is None:
            return
        # The rows are written while they are read, because all may not fit into memory.
        lines = (f"{json.dumps(row)}\n".encode() for row in self.rows(folder, split, read))
        write_atomic(folder / self.list_file(split), lines)

    def guide(self, split: int, *, objects: bool) -> str:
        """Returns text for the README about the files, with those of a split as examples."""
        return _in_split(self.about + (self.about_objects if objects else ""), split)

    def loading(self, split: int) -> str:
        """Returns a program that loads a split."""
        return _in_split(self.program, split)

    def loading_arrays(self, split: int, poses: bool) -> str:
        """Returns a program that loads a split as NumPy arrays, with poses or tile codes."""
        # Shards have a program of their own. All other layouts list their pictures in a file.
        if self.metadata is None:
            program = _in_split(self.arrays, split)
        else:
            # The program reads the numbers of the samples, and puts each into the path of its
            # pictures.
            metadata = _in_split(self.metadata, split)
            image, labels = (
                self.file(split, 0, layer).replace("000000", "{row['number']:06d}")
                for layer in ("image", "labels")
            )
            program = (
                "import json\nfrom pathlib import Path\n\nimport cv2\nimport numpy as np\n\n"
                f'rows = [json.loads(line) for line in Path("DIR/{metadata}").read_text().splitlines()]\n'
                f'images = [cv2.imread(f"DIR/{image}")[..., ::-1] for row in rows]  # RGB\n'
                f'labels = [cv2.imread(f"DIR/{labels}", cv2.IMREAD_GRAYSCALE) for row in rows]\n'
                "TARGETS = [np.array(VALUE) for row in rows]\n"
                "print(len(rows), images[0].shape, labels[0].shape, TARGETS[0].shape)"
            )
        # The examples predict the pose on the nearest lane with a camera, and the map without one.
        if poses:
            targets, value = "poses", "[row['nearest']['d'], row['nearest']['phi']]"
        else:
            targets, value = "codes", "row['codes']"
        return program.replace("TARGETS", targets).replace("VALUE", value)


def find_layout(name: str) -> Layout:
    """Returns a layout by its name.

    Raises `InputError` if a package that the layout needs is not installed.
    """
    layout = LAYOUTS[name]
    # A missing package is an error before work is done for this layout.
    if layout.needs is not None:
        import_optional(layout.needs, f"format: {name} needs {layout.needs}")
    return layout


def write_sample(sample: Sample, layout: Layout, split: int, out: Path) -> int:
    """Writes the pictures of a sample where a layout has them; returns the checksum of all.

    Raises:
      OSError: that names the file, if one cannot be written.
    """
    checksum = 0
    for name, content in sample.pictures().items():
        _write_new(out / layout.file(split, sample.record["number"], name), content)
        checksum = crc32(content, checksum)
    return checksum


def _write_new(file: Path, content: bytes) -> None:
    """Writes a file that an interrupted run may leave in part.

    This does no harm, because a sample counts when its record is written, which comes later. It
    takes a third of the time of `write_atomic`.
    """
    try:
        try:
            stream = file.open("wb")
        except FileNotFoundError:
            # The first picture of a folder makes it, so that the others need no check.
            file.parent.mkdir(parents=True, exist_ok=True)
            stream = file.open("wb")
        with stream:
            stream.write(content)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(file)) from None


def write_maps(file: Path, maps: Sequence[RoadMap], views: int) -> None:
    """Writes a line for each map.

    A line has the map's codes, metrics, fitness and niche, and the number of its first sample.
    """

    def lines() -> Iterator[bytes]:
        for index, road_map in enumerate(maps):
            # `--maps-from` reads this file, because it reads no shards.
            about = {name: getattr(road_map, name) for name in ("metrics", "fitness", "niche")}
            yield f"{json.dumps({'number': index * views, 'codes': road_map.codes.tolist()} | about)}\n".encode()

    write_atomic(file, lines())


def foreign_to_dataset(folder: Path) -> str | None:
    """Returns the first file in a folder that is not of a dataset, or None."""

    def written(about: DatasetRecord) -> str:
        # The record says the layout, by which the paths of pictures are known.
        return f"{_DESCRIBING}|{LAYOUTS[about['settings']['format']].files_pattern()}"

    return foreign_to_record(folder, RECORD, written)


def _in_split(text: str, split: int) -> str:
    return text.replace("SPLIT", SPLITS[split]).replace("SHORT", SHORT_NAMES[split])


def _imagefolder_rows(folder: Path, split: int, read: Records) -> Iterator[Row]:
    for record in read():
        has_objects = "objects" in record
        # Hugging Face loads the files of columns whose names end in `_file_name`.
        file_names = {
            f"{layer}_file_name": f"{layer}/{record['number']:06d}.png"
            for layer in layer_names(has_objects=has_objects)
        }
        row: Row = {**file_names, **record}
        if has_objects:
            row["objects"] = _object_columns(record)
        yield row


# The names are those that Hugging Face's guides have for boxes.
_OBJECT_COLUMNS = {"instance": "id", "kind": "category", "box": "bbox"}


def _object_columns(record: SampleRecord) -> dict[str, list[Plain]]:
    """Returns the objects of a sample in columns."""
    entries = ["instance", "kind", "box", "whole", "visible"]
    # Only views from a robot have distances.
    if record.get("camera"):
        entries.append("distance")
    objects: list[Mapping[str, Plain]] = [*record["objects"]]
    return {
        _OBJECT_COLUMNS.get(entry, entry): [thing[entry] for thing in objects] for entry in entries
    }


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

_SHARDS = """
Each shard has at most 1000 samples of one split, in order. `maps.jsonl` has the maps."""

_TAR_ARRAYS = """import json
import tarfile
from pathlib import Path

import cv2
import numpy as np

rows, images, labels = [], [], []
for shard in sorted(Path("DIR/SPLIT").glob("*.tar")):
    with tarfile.open(shard) as archive:
        files = {name: archive.extractfile(name).read() for name in archive.getnames()}
    for name in files:
        if name.endswith(".json"):
            key = name.removesuffix(".json")
            image, label = (np.frombuffer(files[f"{key}.{layer}.png"], np.uint8) for layer in ("image", "labels"))
            rows.append(json.loads(files[name]))
            images.append(cv2.imdecode(image, cv2.IMREAD_COLOR)[..., ::-1])  # RGB
            labels.append(cv2.imdecode(label, cv2.IMREAD_GRAYSCALE))
TARGETS = [np.array(VALUE) for row in rows]
print(len(rows), images[0].shape, labels[0].shape, TARGETS[0].shape)"""

_PARQUET_ARRAYS = """from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet

rows, images, labels = [], [], []
for shard in sorted(Path("DIR/data").glob("SPLIT-*.parquet")):
    for row in pyarrow.parquet.read_table(shard).to_pylist():
        image, label = (np.frombuffer(row.pop(layer)["bytes"], np.uint8) for layer in ("image", "labels"))
        rows.append(row)
        images.append(cv2.imdecode(image, cv2.IMREAD_COLOR)[..., ::-1])  # RGB
        labels.append(cv2.imdecode(label, cv2.IMREAD_GRAYSCALE))
TARGETS = [np.array(VALUE) for row in rows]
print(len(rows), images[0].shape, labels[0].shape, TARGETS[0].shape)"""

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
        renamed=_OBJECT_COLUMNS,
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
    "webdataset": Layout(
        "SPLIT/SHARD.tar",
        "# pip install webdataset pillow\n"
        "import io\n"
        "from pathlib import Path\n\n"
        "import numpy as np\n"
        "import webdataset\n"
        "from PIL import Image\n\n\n"
        "def decode(name, content):\n"
        '    if name.endswith(".png"):  # webdataset itself would turn labels into colours\n'
        "        return np.array(Image.open(io.BytesIO(content)))\n\n\n"
        'shards = sorted(map(str, Path("DIR/SPLIT").glob("*.tar")))\n'
        "samples = webdataset.WebDataset(shards, shardshuffle=False).decode(decode)\n"
        "sample = next(iter(samples))\n"
        'print(sample["image.png"].shape, sample["labels.png"].max(), sample["json"]["number"])',
        open_shard=open_tar,
        arrays=_TAR_ARRAYS,
        about=f"""{_SHARDS} A sample in `SPLIT/00000.tar` has the files `NUMBER.image.png`,
`NUMBER.labels.png` and `NUMBER.json`, the metadata.""",
        about_objects=" Its instances are in `NUMBER.instances.png`.",
    ),
    "parquet": Layout(
        "data/SPLIT-SHARD-of-COUNT.parquet",
        "# pip install datasets pillow\n"
        "from datasets import load_dataset\n\n"
        "# Streaming reads samples when they are used. Without streaming=True, "
        "samples[0] is the first one.\n"
        'samples = load_dataset("DIR", split="SPLIT", streaming=True)\n'
        "sample = next(iter(samples))\n"
        'print(sample["image"].size, sample["labels"].getextrema())',
        open_shard=open_parquet,
        arrays=_PARQUET_ARRAYS,
        needs="pyarrow",
        about=(
            f"{_SHARDS} The columns `image` and `labels` have files of PNG. "
            "The other columns have the metadata."
        ),
        about_objects=" The column `instances` has the mask of instances, of 16 bits per pixel.",
    ),
}
"""The layouts, by the names that ``--format`` takes."""
