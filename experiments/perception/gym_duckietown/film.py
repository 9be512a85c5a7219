"""Films a ride in gym-duckietown beside our drawing of the map from the same poses.

    python -m experiments.perception.gym_duckietown.film WEIGHTS MAP --out FILE.mp4 [--policy] [--seconds N]

Duckietown's terms of use restrict gym-duckietown's pictures, so the film is made here and not kept in the repository.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from experiments.common import Parser, leave, run, whole
from experiments.perception.gym_duckietown.nets import read_weights
from experiments.perception.gym_duckietown.pictures import our_views
from experiments.perception.gym_duckietown.rides import chooses, ride_on_map, sees

__all__ = ["main"]

_RATE = 15  # pictures a second, each that the network sees
_TOGETHER = 60  # pictures that are drawn at once


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("film", __doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("map", metavar="MAP", help="one of people's maps in maps.toml")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".mp4")
    parser.add_argument("--policy", action="store_true", help="the weights are those of a policy")
    parser.add_argument("--seconds", type=whole(1, 600), default=30, metavar="N", help="default 30")
    options = parser.parse_args(arguments)
    return run("film", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    weights = read_weights(options.weights, "policy" if options.policy else "pose")
    driver = (chooses if options.policy else sees)(weights)
    codes, about, images, poses = ride_on_map(options.map, driver, options.seconds, pause=1)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(options.out), cv2.VideoWriter.fourcc(*"mp4v"), _RATE, (1280, 480))
    for first in range(0, len(images), _TOGETHER):
        ours, _ = our_views(codes, np.stack(poses[first : first + _TOGETHER]))
        for pair in zip(images[first : first + _TOGETHER], ours, strict=True):
            writer.write(np.ascontiguousarray(np.concatenate(pair, axis=1)[..., ::-1]))
    writer.release()
    print(f"{len(images)} pictures in {options.out}: {about}")


if __name__ == "__main__":
    leave(main())
