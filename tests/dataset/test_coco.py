"""The layout `coco`: annotations as pycocotools and other readers take them, and the files for YOLO."""

import contextlib
import io
import json
import tracemalloc

import cv2
import numpy as np
import pytest
import yaml
from given_maps import small
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pages import blocks
from standing_oracle import TOWN

from elitelanes_jax import RoadMap, make_dataset
from elitelanes_jax.dataset._coco import _polygons, coco_rows
from elitelanes_jax.formats import OBJECT_KINDS

pytest.importorskip("pycocotools")
from pycocotools import mask as masks
from pycocotools.coco import COCO
from pycocotools.cocoeval import COCOeval

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pycocotools

RING = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]], np.int8)
CAMERA = ("rows=60", "columns=80")
FURNISHED = {"maps_from": [RoadMap(TOWN), RoadMap(RING)], "furnish": ["lane_duckies=9 lane_robots=3"], "tile_px": 32}
SPECS = {
    "classes from above": {"split": (0.5, 0.25, 0.25)},
    "classes from a robot": {"split": (0.5, 0, 0.5), "camera": CAMERA, "tile_px": 32},
    "objects from above": FURNISHED | {"split": (0.5, 0.5, 0), "views": 2},
    "objects from a robot": FURNISHED | {"split": (0.5, 0, 0.5), "views": 3, "camera": CAMERA},
    "one split": FURNISHED | {"split": (1, 0, 0)},
    "no training": FURNISHED | {"split": (0, 0, 1)},
}


@pytest.fixture(scope="module", params=SPECS)
def dataset(request, tmp_path_factory):
    """A dataset in the layout `coco`, and its specification."""
    out = tmp_path_factory.mktemp("coco") / "out"
    spec = small(format="coco", **SPECS[request.param])
    make_dataset(spec, out, workers=1)
    return out, spec


def load(file):
    with contextlib.redirect_stdout(io.StringIO()):
        return COCO(str(file))


def score(truth, kind):
    """Returns the average precision of annotations against themselves."""
    found = []
    for one in truth.dataset["annotations"]:
        shape = {"bbox": one["bbox"]} if kind == "bbox" else {"segmentation": truth.annToRLE(one)}
        found.append(shape | {name: one[name] for name in ("image_id", "category_id")} | {"score": 1.0})
    with contextlib.redirect_stdout(io.StringIO()):
        judge = COCOeval(truth, truth.loadRes(found), kind)
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    return judge.stats[0]


@pytest.mark.parametrize("kind", ["bbox", "segm"])
def test_the_truth_scores_one_against_itself(kind, dataset):
    out, spec = dataset
    splits = [file.stem for file in (out / "metadata").iterdir()]
    objects = [f"objects_{split}" for split in splits] if spec.furnish else []
    copies = [f"instances_{split}" for split in splits]
    files = {file.stem: load(file) for file in (out / "annotations").iterdir()}
    assert sorted(files) == sorted(splits + objects + copies)
    for copy, name in zip(copies, objects or splits, strict=True):
        assert files[copy].dataset == files[name].dataset
    for truth in files.values():
        assert score(truth, kind) == 1.0


def test_annotations_are_those_of_the_masks(dataset):
    out, _ = dataset
    for file in (out / "annotations").iterdir():
        if file.stem.startswith("instances_"):  # a copy
            continue
        split = file.stem.removeprefix("objects_")
        coco, of_objects = load(file), split != file.stem
        rows = [json.loads(line) for line in (out / "metadata" / f"{split}.jsonl").read_text().splitlines()]
        assert coco.getImgIds() == [row["number"] + 1 for row in rows] and min(coco.getImgIds()) >= 1
        assert [one["id"] for one in coco.dataset["annotations"]] == [*range(1, len(coco.getAnnIds()) + 1)]
        assert min(coco.getCatIds()) == 1 and set(coco.dataset) >= {"info", "licenses", "images", "categories"}
        for row, image in zip(rows, coco.loadImgs(coco.getImgIds()), strict=True):
            name = f"{row['number']:06d}.png"
            assert image["file_name"] == name and [image["height"], image["width"]] == row["pixels"]
            layer = "instances" if of_objects else "labels"
            pixels = cv2.imread(str(out / layer / split / name), cv2.IMREAD_UNCHANGED)
            values = [one["instance"] for one in row["objects"]] if of_objects else np.unique(pixels[pixels > 0])
            annotations = coco.loadAnns(coco.getAnnIds(image["id"]))
            for value, one in zip(values, annotations, strict=True):
                mask = pixels == value
                np.testing.assert_array_equal(coco.annToMask(one), mask)
                x, y, wide, high = cv2.boundingRect(mask.astype(np.uint8))
                assert one["bbox"] == [x, y, wide, high] and one["area"] == mask.sum() and one["iscrowd"] == 0
                assert isinstance(one["segmentation"], list) == of_objects
        if of_objects:
            assert len(coco.getAnnIds()) > 1


def test_yolo_has_both_splits_that_it_needs(dataset):
    out, spec = dataset
    assert (out / "data.yaml").exists() == (out / "boxes.png").exists() == bool(spec.furnish)
    if spec.furnish:
        data = yaml.safe_load((out / "data.yaml").read_text())
        assert "path" not in data and list(data["names"].values()) == list(OBJECT_KINDS)
        present = {folder.name for folder in (out / "images").iterdir()}
        other = "train" if "train" in present else min(present)
        assert set(data) - {"names"} == {"train", "val"} | (present & {"test"})
        for split in set(data) - {"names"}:
            assert data[split] == f"images/{split if split in present else other}"
        picture = cv2.imread(str(out / "boxes.png"))
        assert max(picture.shape) >= 640 and (picture == (200, 0, 255)).all(axis=-1).sum() > 100


def test_the_readme_replaces_boxes_by_outlines(dataset, monkeypatch):
    out, spec = dataset
    card = (out / "README.md").read_text()
    assert "`iscrowd` is 0" in card and ("yolo detect" in card) == bool(spec.furnish)
    if not spec.furnish:
        return
    monkeypatch.chdir(out.parent)
    (program,) = [text for _, text in blocks(card, "python") if "outline" in text]
    exec(program.replace("DIR", "out"), {})
    for file in (out / "annotations").glob("objects_*"):
        coco, split = load(file), file.stem.removeprefix("objects_")
        for image in coco.dataset["images"]:
            text = (out / "labels" / split / image["file_name"]).with_suffix(".txt").read_text()
            annotations = coco.loadAnns(coco.getAnnIds(image["id"]))
            for line, one in zip(text.splitlines(), annotations, strict=True):
                kind, *shares = line.split()
                points = np.array(shares, float) * np.resize([image["width"], image["height"]], len(shares))
                assert int(kind) == one["category_id"] - 1
                runs = masks.frPyObjects([points.round().tolist()], image["height"], image["width"])
                np.testing.assert_array_equal(masks.decode(runs)[..., 0], coco.annToMask(one))


def records(count):
    note = {"classes": [{"category_id": 1, "area": 1, "bbox": [0, 0, 1, 1], "segmentation": {"counts": "0" * 500}}]}
    for number in range(count):
        yield {"number": number, "pixels": [8, 8], "codes": [[0] * 20] * 20} | note


def test_annotations_of_many_pictures_take_no_more_memory(tmp_path):
    peaks = []
    for count in (100, 3000):
        tracemalloc.start()
        assert sum(1 for _ in coco_rows(tmp_path, 0, lambda count=count: records(count))) == count
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(json.loads((tmp_path / "annotations/train.json").read_text())["annotations"]) == count
    assert peaks[1] < peaks[0] + 100_000


@settings(max_examples=200, deadline=None)
@given(arrays(bool, st.tuples(*[st.integers(1, 9)] * 2)))
def test_polygons_cover_exactly_the_pixels(mask):
    shape = _polygons(mask)
    assert shape["area"] == mask.sum() and bool(shape["segmentation"]) == mask.any()
    if mask.any():
        runs = masks.merge(masks.frPyObjects(shape["segmentation"], *mask.shape))
        np.testing.assert_array_equal(masks.decode(runs), mask)
        count, _ = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
        assert len(shape["segmentation"]) == count - 1
