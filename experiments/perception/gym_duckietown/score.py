"""Scores a network of `train` or `stream` on a split of a dataset that its training has not seen.

    python -m experiments.perception.gym_duckietown.score {pose,labels} WEIGHTS DATASET [--split NAME]

DATASET is a folder of `elitelanes dataset --camera rows=120 columns=160`, or a file of `pictures`. For poses it prints
the errors of the offset and the angle, for tiles of 0.585 m, and for labels the IoU of each class.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from elitelanes_jax.tiles import LABELS
from experiments.common import Parser, Pytree, leave, run
from experiments.perception.gym_duckietown.evaluate import errors_of
from experiments.perception.gym_duckietown.nets import find_labels, find_poses, read_weights
from experiments.perception.gym_duckietown.train import STEPS, Views, read_views
from experiments.perception.unet import confusion, ious

__all__ = ["label_ious", "main"]

_SPLITS = ("train", "validation", "test")


def label_ious(weights: Pytree, views: Views) -> Float[NDArray, "4"]:
    """Returns the IoU of each class of `LABELS` over all pixels; NaN for a class that neither side has."""
    return ious(confusion(views.labels, find_labels(weights, views.images), len(LABELS)))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("score", __doc__)
    parser.add_argument("task", choices=STEPS)
    parser.add_argument("weights", type=Path)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--split", choices=_SPLITS, default="test", help="of the dataset; default test")
    options = parser.parse_args(arguments)
    return run("score", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    weights = read_weights(options.weights, options.task)
    views = read_views(options.dataset, options.split)
    if options.task == "labels":
        for name, share in zip(LABELS, label_ious(weights, views), strict=True):
            print(f"{name:14}  {share:.3f}")
        return
    errors = errors_of(views, find_poses(weights, views.images))
    print(f"{len(errors)} pictures   median    90 %")
    for name, part in zip(("offset, cm", "angle, rad"), errors.T, strict=True):
        print(f"{name}    {np.median(part):9.3f} {np.percentile(part, 90):7.3f}")


if __name__ == "__main__":
    leave(main())
