"""How well do networks see in gym-duckietown's pictures? Beside them: colour thresholds, and a constant.

    python -m experiments.perception.gym_duckietown.evaluate PICTURES... --pose FILE... --labels FILE... --out FILE

PICTURES are files of `pictures`; the weights are files of `train`.
"""

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax.tiles import LABELS
from experiments.common import Parser, leave, run, table, write
from experiments.perception.gym_duckietown.classical import find_lane, find_lines
from experiments.perception.gym_duckietown.nets import find_labels, find_poses, read_weights
from experiments.perception.gym_duckietown.pictures import KINDS, TILE, Pictures, read_pictures
from experiments.perception.gym_duckietown.train import Views
from experiments.perception.unet import confusion, ious

__all__ = ["Finder", "LabelScores", "errors_of", "label_table", "main", "pose_table", "score_labels"]

_RESAMPLES = 1000
_BAND = 4  # pixels

Finder = Callable[[UInt8[NDArray, "N 120 160 3"]], NDArray[np.generic]]
"""Returns what a method finds in pictures: lane poses or labels."""


def _classical_poses(images: UInt8[NDArray, "N 120 160 3"]) -> Float[NDArray, "N 2"]:
    return np.array([find_lane(image) for image in images])


def _classical_labels(images: UInt8[NDArray, "N 120 160 3"]) -> UInt8[NDArray, "N 120 160"]:
    """Labels lines by their colour, and nothing else, because a colour does not tell the road from what is beyond."""
    found = np.zeros(images.shape[:3], np.uint8)
    for one, image in zip(found, images, strict=True):
        lines = find_lines(image)
        one[lines["red"]], one[lines["yellow"]] = LABELS.index("stop line"), LABELS.index("lane separator")
    return found


def errors_of(pictures: Pictures | Views, found: Float[NDArray, "N 2"]) -> Float[NDArray, "N 2"]:
    """Returns the errors in centimetres and radians."""
    d, phi = (found[:, :2] - pictures.lanes[:, :2]).T
    return np.abs(np.column_stack([d * TILE * 100, (phi + np.pi) % (2 * np.pi) - np.pi]))


def _interval(errors: Float[NDArray, " N"]) -> str:
    """Returns the median with its 95 % interval, by resampling."""
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(errors, (_RESAMPLES, len(errors))), axis=1)
    low, high = np.percentile(medians, (2.5, 97.5))
    return f"{np.median(errors):.3g} ({low:.3g} to {high:.3g})"


def pose_table(pictures: dict[str, Pictures], finders: dict[str, Finder]) -> str:
    """Returns a table of errors against gym-duckietown's lane pose."""
    rows = []
    for style, shown in pictures.items():
        found = {name: np.asarray(find(shown.images), float) for name, find in finders.items()}
        for name, lanes in {**found, "our lane pose": shown.ours}.items():
            errors = errors_of(shown, lanes)
            parts = {"all": np.ones(len(errors), bool)} | {kind: shown.kinds == k for k, kind in enumerate(KINDS)}
            for part, which in parts.items():
                if part == "all" or name in list(finders)[:1]:
                    d, phi = errors[which].T
                    far, turned = f"{np.percentile(d, 90):.3g}", f"{np.percentile(phi, 90):.3g}"
                    rows.append([style, name, part, str(which.sum()), _interval(d), far, _interval(phi), turned])
    head = ["style", "method", "tiles", "pictures", "offset, cm: median", "90 %", "angle, rad: median", "90 %"]
    return table(head, rows, left=3)


class LabelScores(NamedTuple):
    """The IoUs of found labels, 0 to 1.

    Attributes:
      classes: of each class of `LABELS`; NaN for a class that neither side has.
      paved: of road, stop lines and lane separators together.
      paved_elsewhere: the same, without the pixels within `_BAND` of a white line.
    """

    classes: Float[NDArray, "4"]
    paved: float
    paved_elsewhere: float


def score_labels(
    true: UInt8[NDArray, "N 120 160"], white: Bool[NDArray, "N 120 160"], found: UInt8[NDArray, "N 120 160"]
) -> LabelScores:
    """Compares found labels with true ones, whose white lines are `white`."""
    widened = [cv2.dilate(lines.astype(np.uint8), np.ones((2 * _BAND + 1,) * 2)) for lines in white]
    elsewhere = np.stack(widened) == 0
    paved, found_paved = true.clip(0, 1), found.clip(0, 1)
    return LabelScores(
        ious(confusion(true, found, len(LABELS))),
        float(ious(confusion(paved, found_paved, 2))[1]),
        float(ious(confusion(paved[elsewhere], found_paved[elsewhere], 2))[1]),
    )


def label_table(pictures: dict[str, Pictures], finders: dict[str, Finder]) -> str:
    """Returns a table of each class's IoU on maps without objects.

    It measures against labels that fit the pictures, and against gym-duckietown's labels, which do not fit its
    photographs. The last row of each style compares both labels.
    """
    rows = []
    for style, shown in pictures.items():
        without = ~shown.objects
        kinds = {"fitting": (shown.fitting, shown.fitting_white), "gym-duckietown's": (shown.labels, shown.white)}
        found = {name: np.asarray(find(shown.images[without]), np.uint8) for name, find in finders.items()}
        compared = [(words, name) for name in finders for words in kinds] + [("gym-duckietown's", "fitting labels")]
        found["fitting labels"] = shown.fitting[without]
        for words, name in compared:
            true, white = kinds[words]
            scores = score_labels(true[without], white[without], found[name])
            figures = [*scores.classes, scores.paved, scores.paved_elsewhere]
            rows.append([style, words, name, *(f"{figure:.3f}" for figure in figures)])
    head = ["style", "labels", "method", *LABELS, "paved", "paved, not beside white lines"]
    return table(head, rows, left=3)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("evaluate", __doc__)
    parser.add_argument("pictures", nargs="+", type=Path, metavar="PICTURES")
    parser.add_argument("--pose", nargs="*", type=Path, default=[], metavar="FILE", help="weights for lane poses")
    parser.add_argument("--labels", nargs="*", type=Path, default=[], metavar="FILE", help="weights for labels")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="tables, .md")
    options = parser.parse_args(arguments)
    return run("evaluate", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    pictures = {file.stem: read_pictures(file) for file in options.pictures}
    poses: dict[str, Finder] = {file.stem: partial(find_poses, read_weights(file, "pose")) for file in options.pose}
    labels: dict[str, Finder] = {
        file.stem: partial(find_labels, read_weights(file, "labels")) for file in options.labels
    }
    poses |= {"colours and votes": _classical_poses, "a constant": lambda images: np.zeros((len(images), 2))}
    text = pose_table(pictures, poses) + "\n" + label_table(pictures, labels | {"colours": _classical_labels})
    print(text)
    write(options.out, text)


if __name__ == "__main__":
    leave(main())
