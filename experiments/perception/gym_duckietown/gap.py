"""How much of a network's error is due to the tiles, to the camera, and to the light?

    python -m experiments.perception.gym_duckietown.gap WEIGHTS... --tiles DIR [--poses N] [--out FILE]

The same poses on the test maps without objects are drawn four times. Each drawing differs in one respect from the one
before: drawn tiles by our camera; photographed tiles, the set in DIR, by our camera; gym-duckietown's pictures of these
tiles; and its pictures in random light, which also vary its camera a little. `lab` makes the set of photographs.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax import load_tiles
from experiments.common import Parser, leave, run, table, whole, write
from experiments.perception.gym_duckietown.nets import find_poses, read_weights
from experiments.perception.gym_duckietown.pictures import TILE, our_views, shrink
from experiments.perception.gym_duckietown.world import World, random_poses, read_maps

__all__ = ["main"]

DRAWINGS = (
    "drawn tiles, our camera",
    "photographed tiles, our camera",
    "photographed tiles, gym-duckietown's camera",
    "the same, random light",
)

Images = UInt8[NDArray, "N 120 160 3"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("gap", __doc__)
    parser.add_argument("weights", nargs="+", type=Path, help="networks that find poses")
    parser.add_argument("--tiles", type=Path, required=True, metavar="DIR", help="tile set of the photographs")
    parser.add_argument("--poses", type=whole(1, 1000), default=12, metavar="N", help="on each map; default 12")
    out = Path("results/gap.md")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help=f"table; default {out}")
    options = parser.parse_args(arguments)
    return run("gap", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    sets = [load_tiles(), load_tiles(options.tiles)]
    maps = read_maps("test", "people")
    sides = np.max([place.codes.shape for place in maps], axis=0)
    images: list[list[Images]] = [[] for _ in DRAWINGS]
    lanes = []
    with World() as world:
        for index, place in enumerate(maps):
            if len(world.load(place)["objects"]):
                continue
            poses = random_poses(place.codes, options.poses, index)
            plain = world.ask("look", poses=poses)
            world.load(place, domain_rand=True)
            random = world.ask("look", poses=poses)
            # One size for all maps, so that one program draws them.
            codes = np.pad(place.codes, [(0, most - side) for most, side in zip(sides, place.codes.shape, strict=True)])
            drawn = [our_views(codes, poses, tiles) for tiles in sets]
            for parts, seen in zip(images, (*drawn, plain["image"], random["image"]), strict=True):
                parts.append(shrink(seen))
            lanes.append(plain["lane"] / (TILE, 1))
            print(f"{place.name}: {len(poses)} poses", flush=True)
    text = report({file.stem: file for file in options.weights}, images, np.concatenate(lanes))
    print(text)
    write(options.out, text)


def report(files: dict[str, Path], images: list[list[Images]], lanes: Float[NDArray, "N 2"]) -> str:
    """Returns a table of the medians of the errors of each network in each of the drawings.

    Poses where gym-duckietown finds no lane, NaN in `lanes`, are left out.
    """
    is_lane = np.isfinite(lanes).all(axis=1)
    rows = []
    for name, file in files.items():
        weights = read_weights(file, "pose")
        for words, parts in zip(DRAWINGS, images, strict=True):
            d, phi = (np.asarray(find_poses(weights, np.concatenate(parts)), float)[:, :2] - lanes)[is_lane].T
            turned = (phi + np.pi) % (2 * np.pi) - np.pi
            offset, angle = np.median(np.abs(d)) * TILE * 100, np.median(np.abs(turned))
            rows.append([name, words, str(is_lane.sum()), f"{offset:.3f}", f"{angle:.3f}"])
    return table(["network", "pictures", "poses", "offset, cm: median", "angle, rad: median"], rows, left=2)


if __name__ == "__main__":
    leave(main())
