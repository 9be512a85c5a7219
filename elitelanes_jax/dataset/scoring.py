"""Scores of a network's predictions on a dataset."""

import json
import math
import operator
import sys
from collections.abc import Collection, Container, Iterable, Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_real, is_whole, one_of, path
from elitelanes_jax._util.errors import InputError, brief
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.dataset._layouts import LAYOUTS, PART, RECORD, Layout
from elitelanes_jax.dataset.tables import DatasetRecord, SampleRecord, read_dataset_record
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.tiles.rendering import LABELS

if TYPE_CHECKING:
    from pycocotools.coco import COCO

# The fields of an entry of COCO's results.
_RESULT = ("image_id", "category_id", "bbox", "score")
# The fields of a lane pose.
_POSE = ("d", "phi")


@name_wrong_arguments
def score_predictions(
    dataset: str | Path, predictions: str | Path, *, split: str = "test"
) -> dict[str, float]:
    """Scores predictions of labels, of objects or of lane poses on a split of a dataset.

    Args:
      dataset: the folder of the dataset, in the layout imagefolder or coco.
      predictions: a folder with a label map for each picture, named by the sample, such as
        ``000012.png``; a file of results in COCO's format, for the objects of the layout coco; or a
        file ``*.jsonl`` of lane poses, for views of a robot. It has a line for each picture, such
        as ``{"number": 12, "d": 0.02, "phi": -0.1}``, in tiles and radians.
      split: train, validation or test.

    Returns:
      The intersection over union (IoU) of each class, by its name, and their `mean`, over all
      pixels of the split. A class that neither labels nor predictions have is NaN, and is left out
      of the mean. For objects, COCO's average precisions of boxes: `AP`, `AP50` and `AP75`. They are
      NaN if no picture of the split shows an object. For lane poses, the median absolute errors
      against `nearest` of the dataset: `offset_cm`, in centimetres for tiles of 0.585 m, and
      `angle_rad`. `offset_cm_90` and `angle_rad_90` are 90th percentiles. `offset_cm_constant` and
      `angle_rad_constant` are the median errors of the split's median pose, which needs no picture.

    Raises:
      InputError: for a folder that is no such dataset, a missing or wrong prediction, or a package
        that is not installed. The message names the missing file, or the index and the field of a
        wrong result.
      OSError: that names the file, if the dataset's list of the split's pictures cannot be read.
    """
    folder = Path(check_named("dataset", path, dataset))
    predicted = Path(check_named("predictions", path, predictions))
    index = SPLITS.index(check_named("split", one_of(*SPLITS), split))
    layout, about = _read_dataset(folder)
    if not predicted.exists():
        raise InputError(
            "predictions",
            "a folder, or a file of COCO's results or lane poses",
            f"none, {predicted}",
        )
    count = about["pictures"][split]
    if not count:
        raise InputError("split", f"one that has pictures in {folder}", split)
    # The layouts with metadata have a list of the pictures of each split.
    rows = _read_rows(folder / layout.list_file(index), count)
    if predicted.is_dir():
        return _score_labels(folder, predicted, layout, index, rows)
    if predicted.suffix.lower() == ".jsonl":
        return _score_poses(folder, predicted, split, rows)
    return _score_boxes(folder, predicted, layout, index)


def _read_dataset(folder: Path) -> tuple[Layout, DatasetRecord]:
    if (folder / PART).exists():
        raise InputError(folder, "a whole dataset", "a part", "elitelanes merge joins the parts")
    try:
        about = read_dataset_record(folder / RECORD)
        layout = LAYOUTS[about["settings"]["format"]]
        complete = all(is_whole(about["pictures"][split]) for split in SPLITS)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        complete = False
    if not complete:
        got = "another one" if folder.exists() else "none"
        raise InputError(folder, "a folder of elitelanes dataset", got)
    if layout.metadata is None:
        name = about["settings"]["format"]
        raise InputError(folder, "a dataset of the layout imagefolder or coco", name)
    return layout, about


def _read_rows(file: Path, count: int) -> dict[int, dict[str, float] | None]:
    """Reads the list of a split's pictures: the lane pose of each, by its number.

    Without a camera, pictures have no lane pose. `count` is the number of pictures in the record of
    the dataset.
    """
    rows = {}
    with file.open("rb") as lines:
        try:
            for line in lines:
                row: SampleRecord = json.loads(line)
                pose = row.get("nearest")
                if pose is not None:
                    pose = {name: float(pose[name]) for name in _POSE}
                rows[operator.index(row["number"])] = pose
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            raise InputError(file, "the list of a split's pictures", "another file") from None
    if len(rows) != count:
        raise InputError(file, f"{count:,} pictures, as {RECORD} says", f"{len(rows):,}")
    return rows


def _score_labels(
    folder: Path, predictions: Path, layout: Layout, split: int, numbers: Iterable[int]
) -> dict[str, float]:
    """Returns the IoU of each class, and their mean."""
    # Rows have the labels of the dataset, and columns those of the predictions.
    counts = np.zeros((len(LABELS), len(LABELS)), np.int64)
    for number in numbers:
        of_dataset = folder / layout.file(split, number, "labels")
        expected = check_named(str(of_dataset), _read_labels, of_dataset)
        file = predictions / f"{number:06d}.png"
        predicted = check_named(f"predictions: {file.name}", _read_labels, file)
        if predicted.shape != expected.shape:
            size = f"{list(expected.shape)} pixels, as the dataset has them"
            raise InputError(f"predictions: {file.name}", size, list(predicted.shape))
        pairs = expected * len(LABELS) + predicted
        counts += np.bincount(pairs.ravel(), minlength=counts.size).reshape(counts.shape)
    both, either = counts.diagonal(), counts.sum(axis=0) + counts.sum(axis=1) - counts.diagonal()
    # A class without pixels has no score.
    shares = np.where(either > 0, both / np.maximum(either, 1), np.nan)
    return dict(zip(LABELS, shares.tolist(), strict=True)) | {"mean": float(np.nanmean(shares))}


def _read_labels(file: Path) -> NDArray[np.int64]:
    expected = f"a grey PNG file of labels, 0 to {len(LABELS) - 1}"
    if not file.is_file():
        raise InputError("", expected, "none")
    labels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    if labels is None or labels.ndim != 2:
        got = "another file" if labels is None else "a picture in colours"
        raise InputError("", expected, got)
    if labels.max() >= len(LABELS):
        raise InputError("", expected, f"label {labels.max()}")
    # A file of 16 bits is not cut to 8, because that would make label 256 the background.
    return labels.astype(np.int64)


def _score_poses(
    folder: Path, predictions: Path, split: str, rows: Mapping[int, dict[str, float] | None]
) -> dict[str, float]:
    """Returns the errors of lane poses."""
    poses = {number: nearest for number, nearest in rows.items() if nearest is not None}
    if len(poses) < len(rows):
        raise InputError(folder, "a dataset of robots' views, made with --camera", "another one")
    found = _read_poses(predictions, poses, split)
    expected = np.array([[nearest[name] for name in _POSE] for nearest in poses.values()])
    given = np.array([[found[number][name] for name in _POSE] for number in poses])
    errors = _pose_errors(given, expected)
    constant = _pose_errors(np.median(expected, axis=0), expected)
    scores = {}
    for index, name in enumerate(("offset_cm", "angle_rad")):
        scores[name] = float(np.median(errors[:, index]))
        scores[f"{name}_90"] = float(np.percentile(errors[:, index], 90))
        scores[f"{name}_constant"] = float(np.median(constant[:, index]))
    return scores


def _pose_errors(given: NDArray[np.float64], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the absolute errors of lane poses ``[N, 2]``, in centimetres and radians."""
    offset, angle = np.moveaxis(given - expected, -1, 0)
    angle = (angle + np.pi) % (2 * np.pi) - np.pi
    return np.abs(np.stack([offset * TILE_SIZE * 100, angle], axis=-1))


def _read_poses(file: Path, numbers: Collection[int], split: str) -> dict[int, dict[str, float]]:
    """Reads the lane pose of each picture of a split, by the picture's number."""
    found: dict[int, dict[str, float]] = {}
    with file.open("rb") as lines:
        for index, line in enumerate(lines, start=1):
            # An editor may leave an empty line at the end.
            if not line.strip():
                continue
            pose = check_named(f"predictions: line {index}", _check_pose, line, numbers, split)
            if pose["number"] in found:
                number = int(pose["number"])
                raise InputError(
                    "predictions", "each picture once", f"{number} again in line {index}"
                )
            found[int(pose["number"])] = pose
    if missing := sorted(set(numbers) - found.keys()):
        raise InputError(
            "predictions", f"a line for each picture of the split {split}", f"none for {missing[0]}"
        )
    return found


def _check_pose(line: bytes, numbers: Container[int], split: str) -> dict[str, float]:
    expected = f"JSON with number, {' and '.join(_POSE)}"
    try:
        pose = json.loads(line)
    except (ValueError, RecursionError):
        raise InputError("", expected, "another text") from None
    if not isinstance(pose, dict) or not pose.keys() >= {"number", *_POSE}:
        raise InputError("", expected, brief(pose, 40))
    if not is_real(pose["number"]) or pose["number"] not in numbers:
        expected = f"that of a picture of the split {split}"
        raise InputError("number", expected, brief(pose["number"], 40))
    for name in _POSE:
        if not _is_finite(pose[name]):
            raise InputError(name, "a finite number", brief(pose[name], 40))
    return pose


def _score_boxes(folder: Path, predictions: Path, layout: Layout, split: int) -> dict[str, float]:
    """Returns COCO's average precisions of boxes."""
    file = folder / "annotations" / f"objects_{layout.split_name(split)}.json"
    if not file.is_file():
        raise InputError(
            "predictions",
            "a folder of labels, a .jsonl file of lane poses, or a dataset of coco with objects",
            predictions,
        )
    import_optional("pycocotools", "predictions: the score of objects needs pycocotools")
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    # The package prints what it does.
    with redirect_stdout(StringIO()):
        try:
            expected = COCO(str(file))
        except (ValueError, KeyError, TypeError, AssertionError, RecursionError):
            raise InputError(
                file, "the objects of a split as COCO has them", "another file"
            ) from None
        found = COCO()
        found.dataset = expected.dataset | {
            "annotations": check_named("predictions", _read_results, predictions, expected)
        }
        # The method `loadRes` refuses an empty list, which is the result of a network that finds
        # nothing.
        found.createIndex()
        judge = COCOeval(expected, found, "bbox")
        judge.evaluate()
        judge.accumulate()
        judge.summarize()
    # The package says -1 if the split has no object.
    precisions = [value if value >= 0 else math.nan for value in judge.stats[:3].tolist()]
    return dict(zip(("AP", "AP50", "AP75"), precisions, strict=True))


def _read_results(file: Path, expected: "COCO") -> list[Plain]:
    """Reads COCO's results for the pictures and the classes of a split, as annotations."""
    try:
        results = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        raise InputError("", "a folder, or a file of COCO's results", file) from None
    if not isinstance(results, list):
        raise InputError("", "a list of COCO's results", brief(results, 40))
    pictures, classes = set(expected.getImgIds()), set(expected.getCatIds())
    return [
        check_named(f"entry {index}", _check_result, result, pictures, classes)
        | {"id": index + 1, "iscrowd": 0}
        for index, result in enumerate(results)
    ]


def _check_result(
    result: UserValue, pictures: Container[int], classes: Container[int]
) -> dict[str, Plain]:
    """Returns an entry of COCO's results, with the area of its box."""
    expected = f"a table with {', '.join(_RESULT)}"
    if not isinstance(result, dict):
        raise InputError("", expected, brief(result, 40))
    for name in _RESULT:
        if name not in result:
            raise InputError("", expected, f"one without {name}")
    image, kind, box, score = (result[name] for name in _RESULT)
    if not is_real(image) or image not in pictures:
        raise InputError("image_id", "the id of a picture of the split", brief(image, 40))
    if not is_real(kind) or kind not in classes:
        raise InputError("category_id", "the id of a class of the dataset", brief(kind, 40))
    if not isinstance(box, list) or len(box) != 4 or not all(map(_is_finite, box)):
        raise InputError("bbox", "x, y, width and height", brief(box))
    if min(box[2:]) < 0:
        raise InputError("bbox", "a width and a height of 0 or more", brief(box))
    if not _is_finite(score):
        raise InputError("score", "a finite number", brief(score, 40))
    x, y, width, height = map(float, box)
    values = image, kind, [x, y, width, height], float(score)
    return dict(zip(_RESULT, values, strict=True)) | {"area": width * height}


def _is_finite(value: UserValue) -> bool:
    return is_real(value) and abs(value) <= sys.float_info.max
