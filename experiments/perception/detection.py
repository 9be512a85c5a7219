"""Does a detector that is trained on furnished towns find objects in other drawings, and in gym-duckietown?

    python -m experiments.perception.detection [--steps N] [--seed N] [--out DIR]

A small detector is trained on what `elitelanes dataset --camera --furnish` writes, with the drawings in objects/. The
tests have other towns: with these drawings, with drawings held out, and in gym-duckietown on maps that people made. The
last needs `make gym-duckietown` once, and is left out without it. The folder of results keeps finished parts and the
training's checkpoint: after an interruption, the same command continues.
"""

import argparse
import contextlib
import io
import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from elitelanes_jax import SearchSpec, __version__
from elitelanes_jax.dataset import DatasetSpec, make_dataset
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, open_results, require, run, table, whole, write
from experiments.perception.draw_objects import draw_all
from experiments.perception.gym_duckietown.world import PYTHON, World, random_poses, read_maps

__all__ = ["KINDS", "SIZES", "average_precisions", "main"]

KINDS = ("duckie", "cone", "truck", "bus")
"""The kinds to find."""

SIZES = {
    "8 or more": (8, 1e4),
    "all": (0, 1e4),
    "4 to 8": (4, 8),
    "8 to 16": (8, 16),
    "16 to 32": (16, 32),
    "32 or more": (32, 1e4),
}
"""Ranges of boxes' sizes by their words: the roots of the boxes' areas, in pixels. The first one is the main result."""

_REPOSITORY = Path(__file__).parents[2]
_ROWS, _COLUMNS = 192, 256
_BATCH = 4  # pictures a step
_LEARNED = 4  # the least size of boxes in training
_FURNISHED = "all duckies=0.6 cones=0.6 buses=0.25 trucks=0.25 lane_duckies=3"
_SEEN = 0.25  # the least share of objects in the second figure
_SHOWN, _COLOURS = 0.3, ((48, 59, 255), (255, 92, 255), (255, 229, 0), (255, 98, 41))  # the least score; BGR
# Numbers of drawings, four from each. Those from 1 are in objects/.
_TRAINED, _HELD_OUT = (1, 9, 13, 17, 21, 25), (5,)


class Budget(NamedTuple):
    """The amount of work.

    Attributes:
      steps: steps of the training.
      towns: of the training.
      test_towns: of each test in our pictures.
      views: pictures of each town; each map that people made has twice as many.
      drawings: of each kind, for the training.
    """

    steps: int = 8000
    towns: int = 200
    test_towns: int = 20
    views: int = 16
    drawings: int = 24


_FULL, _QUICK = Budget(), Budget(2, 1, 1, 2, 4)


class Pictures(NamedTuple):
    """Pictures and the boxes of their objects.

    Attributes:
      image: uint8 ``[N, H, W, 3]``, RGB.
      boxes: float32 ``[N, M, 4]``: x, y, width and height in pixels.
      kinds: int ``[N, M]``, indices in `KINDS`; -1 pads the list.
      visible: float32 ``[N, M]``, the share of each object that is seen; 1 in gym-duckietown, which does not tell it.
    """

    image: NDArray[np.uint8]
    boxes: NDArray[np.float32]
    kinds: NDArray[np.int_]
    visible: NDArray[np.float32]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("detection", __doc__)
    parser.add_argument("--steps", type=whole(1), metavar="N", help=f"of the training; default {_FULL.steps}")
    parser.add_argument("--seed", type=whole(0, 10**6), default=0, metavar="N", help="of everything random; default 0")
    out = Path("results/detection")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets without gym-duckietown, to test the program")
    options = parser.parse_args(arguments)
    return run("detection", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    require("average precision needs", "pycocotools")
    from experiments.perception.centernet import detect, train

    budget = _QUICK if options.quick else _FULL
    budget = budget._replace(steps=options.steps or budget.steps)
    there = PYTHON.exists() and not options.quick
    settings = {"program": "detection", "version": __version__, "seed": options.seed, "gym-duckietown": there}
    open_results(options.out, settings | budget._asdict())
    use_compile_cache()
    shown = _make_pictures(options.out / "data", budget, options.seed)
    ours, tests = shown.pop("train"), shown
    began = time.perf_counter()

    def report(step: int, loss: float) -> None:
        print(f"step {step} of {budget.steps}, loss {loss:.3f}, {time.perf_counter() - began:.0f} s", flush=True)

    kinds = np.where(ours.boxes[..., 2:].prod(axis=-1) >= _LEARNED**2, ours.kinds, -1)
    work = {"steps": budget.steps, "batch": _BATCH, "file": options.out / ".training.msgpack", "report": report}
    shows = (kinds >= 0).any(axis=1)
    weights = train(ours.image[shows], ours.boxes[shows], kinds[shows], len(KINDS), options.seed, **work)
    if there:
        tests["gym-duckietown"] = _their_pictures(options.out / "data", budget, options.seed)
    found = {test: detect(weights, pictures.image, len(KINDS)) for test, pictures in tests.items()}
    lines = [_line(test, pictures, found[test]) for test, pictures in tests.items()]
    head = ["pictures", "mAP50", "a quarter seen", *KINDS, *(f"{words} px" for words in list(SIZES)[1:])]
    write(options.out / "detection.md", table(head, lines))
    sheet = np.vstack([_sheet(pictures, found[test]) for test, pictures in tests.items()])
    write(options.out / "detection.jpg", cv2.imencode(".jpg", sheet, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())
    print(table(head, lines))


def _make_pictures(folder: Path, budget: Budget, seed: int) -> dict[str, Pictures]:
    """Makes the datasets of the training and of the tests, as `elitelanes dataset` does, and reads them."""
    usual = DatasetSpec(search=SearchSpec(style="town", where="crossings=0..", evaluations=20_000))
    usual = usual.replace(format="coco", tile_px=128)
    camera = (f"rows={_ROWS}", f"columns={_COLUMNS}", "heading=90")
    usual = usual.replace(furnish=_FURNISHED, camera=camera, views=budget.views)
    train = usual.replace(maps=budget.towns, size="7", split=(1, 0, 0), seed=2 * seed)
    train = train.replace(objects=_draw(folder / "objects", _TRAINED[: budget.drawings // 4]))
    test = usual.replace(maps=budget.test_towns, size="8", split=(0, 0, 1), seed=2 * seed + 1)
    held_out = test.replace(objects=_draw(folder / "objects-held-out", _HELD_OUT))
    specs = {"train": train, "seen": test, "held out": held_out}
    for name, spec in specs.items():
        make_dataset(spec, folder / name)
    return {name: read(folder / name) for name in specs}


def _draw(folder: Path, firsts: Sequence[int]) -> Path:
    """Makes an object set as objects/, with other drawings of `KINDS`; returns its folder."""
    if not folder.exists():
        part = folder.with_name(f".{folder.name}")
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(_REPOSITORY / "objects", part, ignore=shutil.ignore_patterns(*(f"{kind}_?" for kind in KINDS)))
        for first in firsts:
            draw_all(part, KINDS, first)
        part.rename(folder)
    return folder


def _their_pictures(folder: Path, budget: Budget, seed: int) -> Pictures:
    """Makes gym-duckietown's pictures of the maps of the list `test` that people made and that have objects to find.

    A box is around the pixels of an object that no nearer object hides.
    """
    file = folder / "gym-duckietown.npz"
    if not file.exists():
        images, boxes = [], []
        with World() as world:
            for place in read_maps("test", "people"):
                names = world.load(place)["objects"].tolist()
                if not set(names) & set(KINDS):
                    continue
                for pose in random_poses(place.codes, 2 * budget.views, seed):
                    seen = world.ask("instances", poses=pose[None])
                    image, owners = seen["image"][0], seen["instances"][0]
                    share = np.tile([_COLUMNS / image.shape[1], _ROWS / image.shape[0]], 2)
                    images.append(cv2.resize(image, (_COLUMNS, _ROWS), interpolation=cv2.INTER_AREA))
                    mine = [index for index in np.unique(owners)[1:] if names[index - 1] in KINDS]
                    around = [cv2.boundingRect((owners == index).astype(np.uint8)) * share for index in mine]
                    kinds = [KINDS.index(names[index - 1]) for index in mine]
                    boxes.append([[*box, kind, 1] for box, kind in zip(around, kinds, strict=True)])
                print(f"{place.name}: {len(images)} pictures of gym-duckietown", flush=True)
        content = io.BytesIO()
        np.savez_compressed(content, **_pictures(images, boxes)._asdict())
        write(file, content.getvalue())
    with np.load(file) as kept:
        return Pictures(**kept)


def read(folder: Path) -> Pictures:
    """Reads a dataset of one split in the layout `coco`."""
    (file,) = folder.glob("annotations/objects_*.json")
    about, place = json.loads(file.read_text(encoding="utf-8")), folder / "images" / file.stem.removeprefix("objects_")
    names = {one["id"]: one["name"] for one in about["categories"]}
    boxes: dict[int, list[list[float]]] = {one["id"]: [] for one in about["images"]}
    for one in about["annotations"]:
        if names[one["category_id"]] in KINDS:
            boxes[one["image_id"]].append([*one["bbox"], KINDS.index(names[one["category_id"]]), one["visible"]])
    images = [np.asarray(Image.open(place / one["file_name"])) for one in about["images"]]
    return _pictures(images, list(boxes.values()))


def _pictures(images: Sequence[NDArray[np.uint8]], boxes: Sequence[Sequence[Sequence[float]]]) -> Pictures:
    most = max(1, *map(len, boxes))
    padded = np.array([[*own, *[[0, 0, 0, 0, -1, 0]] * (most - len(own))] for own in boxes], np.float32)
    return Pictures(np.stack(images), padded[..., :4], padded[..., 4].astype(int), padded[..., 5])


def average_precisions(
    pictures: Pictures, found: NDArray[np.floating], least_visible: float = 0.0
) -> NDArray[np.float64]:
    """Computes average precisions at an IoU of 0.5, for each of `SIZES` and `KINDS`, ``[S, K]``; NaN without boxes.

    Args:
      pictures: with the true boxes.
      found: ``[N, P, 6]``: x, y, width, height, score and kind of the boxes found in each picture.
      least_visible: objects of which a smaller share is seen do not count, whether they are found or not.
    """
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    coco, areas = COCO(), np.where(pictures.visible >= least_visible, pictures.boxes[..., 2:].prod(axis=-1), -1)
    annotations = [
        {"image_id": int(i), "category_id": int(pictures.kinds[i, m]), "bbox": pictures.boxes[i, m].tolist()}
        | {"id": number, "iscrowd": 0, "area": float(areas[i, m])}
        for number, (i, m) in enumerate(np.argwhere(pictures.kinds >= 0), 1)
    ]
    images, categories = ([{"id": index} for index in range(count)] for count in (len(found), len(KINDS)))
    coco.dataset = {"info": {}, "images": images, "categories": categories, "annotations": annotations}
    numbers = np.repeat(np.arange(len(found)), found.shape[1])
    with contextlib.redirect_stdout(io.StringIO()):
        coco.createIndex()
        judge = COCOeval(coco, coco.loadRes(np.column_stack([numbers, found.reshape(-1, 6)])), "bbox")
        judge.params.iouThrs, judge.params.maxDets = np.array([0.5]), [100]
        judge.params.areaRng = [[low**2, high**2] for low, high in SIZES.values()]
        judge.params.areaRngLbl = list(SIZES)
        judge.evaluate()
        judge.accumulate()
    precision: NDArray[np.float64] = judge.eval["precision"][0, :, :, :, 0].mean(axis=0).T
    return np.where(precision < 0, np.nan, precision)


def _line(test: str, pictures: Pictures, found: NDArray[np.floating]) -> list[str]:
    precisions = average_precisions(pictures, found)
    clear = average_precisions(pictures, found, _SEEN)[:1]
    means = [np.nanmean(row) if np.isfinite(row).any() else np.nan for row in (*precisions, *clear)]
    cells = ["" if np.isnan(value) else f"{value:.3f}" for value in (means[-1], *precisions[0], *means[1:-1])]
    return [test, f"**{means[0]:.3f}**", *cells]


def _sheet(pictures: Pictures, found: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Draws the boxes found, uint8 ``[H, W, 3]``, in BGR, in five pictures that have several objects."""
    large = (pictures.kinds >= 0) & (pictures.boxes[..., 2:].prod(axis=-1) >= SIZES["8 or more"][0] ** 2)
    sheet = []
    for index in np.argsort(-np.minimum(large.sum(axis=1), 3), kind="stable")[:200:40]:
        image = cv2.cvtColor(pictures.image[index].repeat(2, axis=0).repeat(2, axis=1), cv2.COLOR_RGB2BGR)
        for *box, score, kind in found[index][found[index, :, 4] >= _SHOWN].tolist():
            (x, y, wide, high), colour = (round(2 * side) for side in box), _COLOURS[int(kind)]
            cv2.rectangle(image, (x, y, wide, high), colour)
            words, font = f"{KINDS[int(kind)]} {score:.2f}", cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(image, words, (x, y - 3), font, 0.4, colour, 1, cv2.LINE_AA)
        sheet.append(image)
    return np.hstack(sheet)


if __name__ == "__main__":
    leave(main())
