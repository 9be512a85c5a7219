"""Films a ride in gym-duckietown beside our drawing of the map from the same poses, or shows six of its pictures.

    python -m experiments.perception.gym_duckietown.film WEIGHTS MAP --out FILE [--policy] [--seconds N] [--ours]

FILE is a film, .mp4, or a picture, .png, with pictures spread over the ride. A ride ends when the robot leaves the road
or hits something. Duckietown's terms of use restrict gym-duckietown's pictures; `--ours` leaves them out.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from elitelanes_jax.tiles import write_png
from experiments.common import Parser, leave, run, whole
from experiments.perception.gym_duckietown.pictures import our_views, shrink
from experiments.perception.gym_duckietown.rides import read_driver, ride_on_map

__all__ = ["main"]

_RATE = 15  # pictures a second, each that the network sees
_TOGETHER = 60  # pictures that are drawn at once
_SHOWN = 6


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("film", __doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("map", metavar="MAP", help="one of people's maps in maps.toml")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".mp4 or .png")
    parser.add_argument("--policy", action="store_true", help="the weights are those of a policy")
    parser.add_argument("--seconds", type=whole(_SHOWN, 600), default=30, metavar="N", help="default 30")
    parser.add_argument("--ours", action="store_true", help="without gym-duckietown's pictures")
    options = parser.parse_args(arguments)
    return run("film", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    driver, film = read_driver(options.weights, policy=options.policy), options.out.suffix == ".mp4"
    codes, about, images, poses = ride_on_map(options.map, driver, options.seconds, 1 if film else _RATE)
    if film:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        size = (640 if options.ours else 1280, 480)
        writer = cv2.VideoWriter(str(options.out), cv2.VideoWriter.fourcc(*"mp4v"), _RATE, size)
        for first in range(0, len(images), _TOGETHER):
            ours = our_views(codes, np.stack(poses[first : first + _TOGETHER]))
            for pair in zip(images[first : first + _TOGETHER], ours, strict=True):
                writer.write(np.ascontiguousarray(np.concatenate(pair[options.ours :], axis=1)[..., ::-1]))
        writer.release()
    else:
        shown = np.linspace(0, len(images) - 1, _SHOWN).round().astype(int)
        rows = [np.stack(images)[shown], our_views(codes, np.stack(poses)[shown])][options.ours :]
        sheet = np.concatenate([np.concatenate(shrink(row), axis=1) for row in rows])
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_png(options.out, sheet.astype(np.uint8))
    print(f"{options.out}: {about}")


if __name__ == "__main__":
    leave(main())
