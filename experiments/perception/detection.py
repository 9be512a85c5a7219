"""Does a detector that is trained on furnished towns find objects in other drawings, and in gym-duckietown?

    python -m experiments.perception.detection [--steps N] [--seed N] [--out DIR]

A small detector is trained on what `elitelanes dataset --camera --furnish` writes, with the drawings in objects/. The
tests have other towns: with these drawings, with drawings held out, and in gym-duckietown on maps that people made. The
limit there is the same detector, trained on gym-duckietown's pictures of our towns. Both need `make gym-duckietown`
once, and are left out without. The folder of results keeps finished parts: after an interruption, the same command
continues.
"""

import argparse
import contextlib
import io
import json
import shutil
import subprocess
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from elitelanes_jax import SearchSpec, __version__
from elitelanes_jax.dataset import DatasetSpec, make_dataset
from elitelanes_jax.formats import RoadMap, to_duckietown
from elitelanes_jax.maps import furnish
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.search import use_compile_cache
from elitelanes_jax.tiles import default_objects
from experiments.common import Parser, kept, leave, open_results, require, run, save, table, whole, write
from experiments.perception.draw_objects import draw_all

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["KINDS", "SIZES", "average_precisions", "main"]

KINDS = ("duckie", "cone", "truck", "bus")
"""The kinds to find."""

COUNTED = "8 or more"
SIZES = {COUNTED: (8, 1e4), "4 to 8": (4, 8), "8 to 16": (8, 16), "16 to 32": (16, 32), "32 or more": (32, 1e4)}
"""Ranges of boxes' sizes by their words: the roots of the boxes' areas, in pixels. Results are of those `COUNTED`."""

# The maps of the list `test` in gym_duckietown/maps.toml that have objects of these kinds.
PEOPLE: tuple[str, ...] = (
    "loop_dyn_duckiebots",
    "loop_empty",
    "loop_obstacles",
    "loop_pedestrians",
    "udem1",
    "zigzag_dists",
)
PEOPLE += ("zigzag_dists_bordered",)

_FURNISHED = "all duckies=0.4 cones=0.4 buses=0.15 trucks=0.15 lane_duckies=3"
_BOXES = Path(__file__).parent / "gym_duckietown" / "boxes.py"
_PYTHON = Path(__file__).parents[2] / ".venv-gym-duckietown" / "bin" / "python"
_HELD_OUT = 5  # the first number of a drawing that no kind has in objects/


class Budget(NamedTuple):
    """The amount of work.

    Attributes:
      steps: steps of a training.
      batch: pictures a step.
      towns: that training has.
      views: pictures of each town; there are three times as many of people's maps.
      test_towns: that each test in our pictures has.
      evaluations: of each search for towns; 0 for maps without a search.
      rows: of a picture.
      columns: of a picture.
    """

    steps: int = 1500
    batch: int = 8
    towns: int = 100
    views: int = 16
    test_towns: int = 20
    evaluations: int = 20_000
    rows: int = 192
    columns: int = 256


_FULL = Budget()
_QUICK = Budget(2, 2, 3, 2, 1, 0, 64, 96)


class Pictures(NamedTuple):
    """Pictures and what they show.

    Attributes:
      image: uint8 ``[N, H, W, 3]``, RGB.
      truth: as a file of COCO, its annotations of `KINDS` alone: ``images``, ``annotations`` and ``categories``.
    """

    image: NDArray[np.uint8]
    truth: dict


class Row(NamedTuple):
    """The outcome of a training in a test.

    Attributes:
      training: its pictures, in words.
      test: its pictures, in words.
      precisions: of each of `SIZES`, the average precision of each of `KINDS`; -1 without boxes.
    """

    training: str
    test: str
    precisions: dict[str, list[float]]

    def mean(self, size: str = COUNTED) -> float:
        """Returns the mean over the kinds that the test has; NaN without any."""
        there = [one for one in self.precisions[size] if one >= 0]
        return float(np.mean(there)) if there else float("nan")


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("detection", __doc__)
    parser.add_argument("--steps", type=whole(1), metavar="N", help=f"of a training; default {_FULL.steps}")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of everything random; default 0")
    out = Path("results/detection")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument(
        "--quick", action="store_true", help="tiny budgets, without gym-duckietown, to test the program"
    )
    options = parser.parse_args(arguments)
    return run("detection", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    require("average precision needs", "pycocotools")
    budget = _QUICK if options.quick else _FULL
    budget = budget._replace(steps=options.steps or budget.steps)
    trainings, tests = {"ours": "our pictures"}, {"seen": "drawings trained on", "held-out": "drawings held out"}
    if _PYTHON.exists() and not options.quick:
        trainings["theirs"], tests["people"] = "gym-duckietown's pictures", "gym-duckietown"
    settings = {"program": "detection", "version": __version__, "seed": options.seed, "tests": list(tests)}
    open_results(options.out, settings | budget._asdict())
    use_compile_cache()
    _make_pictures(options.out / "data", budget, options.seed)
    if "theirs" in trainings:
        _make_their_pictures(options.out / "data", budget, options.seed)
    shown = {test: read(options.out / "data" / test) for test in tests}
    rows, drawn = [], []
    for training, words in trainings.items():
        file = options.out / "runs" / f"{training}.json"
        found = kept(file, partial(_train_and_find, options, training, budget, shown))
        for test, pictures in shown.items():
            boxes = np.array(found[test])
            rows.append(Row(words, tests[test], average_precisions(pictures.truth, boxes)))
            print(f"trained on {words}, tested on {tests[test]}: mAP50 {rows[-1].mean():.3f}", flush=True)
            if training == "ours" and test != "seen":
                drawn.append((tests[test], pictures, boxes))
    write(options.out / "detection.md", _tables(rows))
    save(_plot(drawn), options.out / "detection.png", dpi=100)


def _make_pictures(folder: Path, budget: Budget, seed: int) -> None:
    """Makes the datasets of the training and of the tests in our pictures, as `elitelanes dataset` does."""
    objects = folder / "objects"
    if not objects.exists():
        part = folder / ".objects"
        shutil.rmtree(part, ignore_errors=True)
        shutil.copytree(default_objects(), part, ignore=shutil.ignore_patterns(*(f"{kind}_?" for kind in KINDS)))
        draw_all(part, KINDS, first=_HELD_OUT)
        part.rename(objects)
    usual = DatasetSpec(search=SearchSpec(style="town", evaluations=budget.evaluations), format="coco", tile_px=128)
    camera = (f"rows={budget.rows}", f"columns={budget.columns}", "heading=90")
    usual = usual.replace(furnish=_FURNISHED, camera=camera)
    train = usual.replace(maps=budget.towns, size="6..8", views=budget.views, split=(1, 0, 0), seed=2 * seed)
    test = usual.replace(maps=budget.test_towns, size="9", views=budget.views, split=(0, 0, 1), seed=2 * seed + 1)
    for name, spec in (("ours", train), ("seen", test), ("held-out", test.replace(objects=objects))):
        make_dataset(spec, folder / name, maps=None if budget.evaluations else _any_maps(spec))


def _any_maps(spec: DatasetSpec) -> list[RoadMap]:
    """Makes a map of each size without a search."""
    rng = np.random.default_rng(spec.seed)
    return [RoadMap(generate_batch(rng, 1, shape, border="closed").grid[0]) for shape in spec.shapes]


def _make_their_pictures(folder: Path, budget: Budget, seed: int) -> None:
    """Makes gym-duckietown's pictures of maps that people made, and of our towns for its own training."""
    lines = (folder / "ours" / "metadata" / "train.jsonl").read_text(encoding="utf-8").splitlines()
    towns = []
    for index, line in enumerate(lines[:: budget.views]):
        town = furnish(np.array(json.loads(line)["codes"]), _FURNISHED, seed=index)
        towns.append(folder / "towns" / f"{index:03d}.yaml")
        write(towns[-1], to_duckietown(town.codes, objects=town.objects))
    for name, count, maps in (("people", 3 * budget.views, PEOPLE), ("theirs", budget.views, towns)):
        numbers = (count, budget.rows, budget.columns, seed)
        subprocess.run([_PYTHON, _BOXES, folder / name, *map(str, numbers), *maps], check=True)


def read(folder: Path) -> Pictures:
    """Reads all datasets of the layout `coco` in a folder, or in folders within it, as one."""
    pictures, images, boxes = [], list[dict](), list[dict]()
    for file in sorted(folder.glob("**/annotations/objects_*.json")):
        about, first = json.loads(file.read_text(encoding="utf-8")), len(images)
        place = file.parents[1] / "images" / file.stem.removeprefix("objects_")
        numbers = {one["id"]: first + index for index, one in enumerate(about["images"])}
        kinds = {one["id"]: KINDS.index(one["name"]) + 1 for one in about["categories"] if one["name"] in KINDS}
        images += [one | {"id": numbers[one["id"]]} for one in about["images"]]
        pictures += [np.asarray(Image.open(place / one["file_name"])) for one in about["images"]]
        for one in about["annotations"]:
            if one["category_id"] in kinds:
                own = {"id": len(boxes) + 1, "image_id": numbers[one["image_id"]], "bbox": one["bbox"], "iscrowd": 0}
                area = one["bbox"][2] * one["bbox"][3]
                boxes.append(own | {"category_id": kinds[one["category_id"]], "area": area})
    categories = [{"id": index, "name": name} for index, name in enumerate(KINDS, 1)]
    return Pictures(np.stack(pictures), {"images": images, "annotations": boxes, "categories": categories})


def boxes_of(truth: dict) -> tuple[NDArray[np.float32], NDArray[np.int_]]:
    """Returns boxes ``[N, M, 4]`` and kinds ``[N, M]`` as training takes them; kind -1 for boxes that do not count."""
    by_image: list[list[dict]] = [[] for _ in truth["images"]]
    for one in truth["annotations"]:
        by_image[one["image_id"]].append(one)
    most, least = max(map(len, by_image)), SIZES[COUNTED][0] ** 2
    boxes, kinds = np.zeros((len(by_image), most, 4), np.float32), np.full((len(by_image), most), -1)
    for index, own in enumerate(by_image):
        for place, one in enumerate(own):
            boxes[index, place] = one["bbox"]
            kinds[index, place] = one["category_id"] - 1 if one["area"] >= least else -1
    return boxes, kinds


def _train_and_find(
    options: argparse.Namespace, training: str, budget: Budget, tests: Mapping[str, Pictures]
) -> dict[str, list]:
    """Trains a detector; returns the boxes that it finds in each test."""
    from experiments.perception.centernet import detect, train

    pictures, began = read(options.out / "data" / training), time.perf_counter()

    def report(step: int, loss: float) -> None:
        spent = time.perf_counter() - began
        print(f"{training}: step {step} of {budget.steps}, loss {loss:.3f}, {spent:.0f} s", flush=True)

    weights = train(
        pictures.image,
        *boxes_of(pictures.truth),
        len(KINDS),
        options.seed,
        steps=budget.steps,
        batch=budget.batch,
        file=options.out / "runs" / f".{training}.msgpack",
        report=report,
    )
    return {test: detect(weights, shown.image, len(KINDS)).round(4).tolist() for test, shown in tests.items()}


def average_precisions(truth: dict, found: NDArray[np.floating]) -> dict[str, list[float]]:
    """Computes average precisions at an IoU of 0.5, for each of `SIZES` and `KINDS`; -1 without boxes.

    Args:
      truth: as a file of COCO has it.
      found: ``[N, P, 6]``: x, y, width, height, score and kind of the boxes found in each picture.
    """
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    number = np.repeat([one["id"] for one in truth["images"]], found.shape[1])
    boxes = found.reshape(-1, 6) + np.eye(6)[5]  # COCO's categories begin at 1
    with contextlib.redirect_stdout(io.StringIO()):
        coco = COCO()
        coco.dataset = truth | {"info": {}}
        coco.createIndex()
        judge = COCOeval(coco, coco.loadRes(np.column_stack([number, boxes])), "bbox")
        judge.params.iouThrs = np.array([0.5])
        judge.params.areaRng = [[low**2, high**2] for low, high in SIZES.values()]
        judge.params.areaRngLbl, judge.params.maxDets = list(SIZES), [100]
        judge.evaluate()
        judge.accumulate()
    precision = judge.eval["precision"][0, :, :, :, 0].mean(axis=0)  # kinds x sizes
    return dict(zip(SIZES, precision.T.tolist(), strict=True))


def _tables(rows: Sequence[Row]) -> str:
    def cells(values: Sequence[float]) -> list[str]:
        return [f"{value:.3f}" if value >= 0 else "" for value in values]

    kinds = [[row.training, row.test, f"**{row.mean():.3f}**", *cells(row.precisions[COUNTED])] for row in rows]
    sizes = [[row.training, row.test, *cells([row.mean(size) for size in SIZES])] for row in rows]
    return "\n".join(
        [
            f"Average precision at an IoU of 0.5. Boxes count if they are as large as {COUNTED} pixels squared.\n",
            table(["trained on", "tested on", "mAP50", *KINDS], kinds, left=2),
            "mAP50 by the size of boxes: the root of their area in pixels.\n",
            table(["trained on", "tested on", *SIZES], sizes, left=2),
        ]
    )


def _plot(tests: Sequence[tuple[str, Pictures, NDArray[np.floating]]]) -> "Figure":
    """Draws boxes found, in colour, and true ones, dotted, in some pictures of each test with several objects."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    colours = dict(zip(KINDS, ("#ff3b30", "#ff5cff", "#00e5ff", "#2962ff"), strict=True))
    columns, least = 4, SIZES[COUNTED][0] ** 2
    figure, axes = plt.subplots(2 * len(tests), columns, figsize=(13, 5 * len(tests)), layout="constrained")
    for block, (words, pictures, found) in enumerate(tests):
        boxes = pictures.truth["annotations"]
        several = [
            one["id"]
            for one in pictures.truth["images"]
            if sum(b["image_id"] == one["id"] and b["area"] >= least for b in boxes) > 1
        ]
        chosen = [several[index * len(several) // 8] for index in range(8)] if several else [0] * 8
        for number, ax in zip(chosen, axes[2 * block : 2 * block + 2].flat, strict=True):
            ax.imshow(pictures.image[number])
            ax.set_axis_off()
            for one in boxes:
                if one["image_id"] == number and one["area"] >= least:
                    x, y, wide, high = one["bbox"]
                    ax.add_patch(Rectangle((x - 0.5, y - 0.5), wide, high, fill=False, color="white", linestyle=":"))
            for x, y, wide, high, score, kind in found[number]:
                if score >= 0.3:
                    name = KINDS[int(kind)]
                    ax.add_patch(Rectangle((x - 0.5, y - 0.5), wide, high, fill=False, color=colours[name]))
                    ax.text(x, y - 2, f"{name} {score:.2f}", color=colours[name], fontsize=7)
        axes[2 * block, 0].set_title(words, loc="left", fontsize=10)
    return figure


if __name__ == "__main__":
    leave(main())
