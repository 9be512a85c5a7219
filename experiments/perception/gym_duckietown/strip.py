"""A ride in gym-duckietown as a strip of pictures, above our camera's pictures at the same poses.

python -m experiments.perception.gym_duckietown.strip WEIGHTS MAP --out FILE [--seconds N] [--domain-rand] [--ours]

Duckietown's terms of use restrict gym-duckietown's pictures; with `--ours`, the strip has our pictures alone. They are
spread over the ride. A ride ends when the robot leaves the road or hits something.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from elitelanes_jax.tiles import png_of
from experiments.common import Parser, leave, run, whole, write
from experiments.perception.gym_duckietown.nets import read_weights
from experiments.perception.gym_duckietown.pictures import our_views, shrink
from experiments.perception.gym_duckietown.rides import ride_on_map, sees

__all__ = ["main"]

_SHOWN = 6


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("strip", __doc__)
    parser.add_argument("weights", type=Path)
    parser.add_argument("map", metavar="MAP", help="one of people's maps in maps.toml")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help=".png")
    parser.add_argument("--seconds", type=whole(_SHOWN, 600), default=30, metavar="N", help="default 30")
    parser.add_argument("--domain-rand", action="store_true", help="with gym-duckietown's random light and camera")
    parser.add_argument("--ours", action="store_true", help="without gym-duckietown's pictures")
    options = parser.parse_args(arguments)
    return run("strip", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    driver = sees(read_weights(options.weights, "pose"))
    codes, about, images, poses = ride_on_map(options.map, driver, options.seconds, domain_rand=options.domain_rand)
    shown = np.linspace(0, len(images) - 1, _SHOWN).round().astype(int)
    ours, _ = our_views(codes, np.stack(poses)[shown])
    pictures = [*(images[index] for index in shown), *ours]
    small = shrink(np.stack(pictures))
    rows = [np.concatenate(small[first : first + _SHOWN], axis=1) for first in (0, _SHOWN)[options.ours :]]
    write(options.out, png_of(np.concatenate(rows).astype(np.uint8)))
    print(about)


if __name__ == "__main__":
    leave(main())
