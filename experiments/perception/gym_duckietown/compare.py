"""How far apart are the lines in gym-duckietown's pictures and in ours, at the same poses on the same maps?

    python -m experiments.perception.gym_duckietown.compare [--poses N] [--out FILE]

The pictures have 640 x 480 pixels. The distance of a line is measured from each pixel of its edge to the nearest pixel
of the same line's edge in the other picture. The maps are development maps with other ground around the road.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from experiments.common import Parser, leave, run, table, whole, write
from experiments.perception.gym_duckietown.classical import find_lines
from experiments.perception.gym_duckietown.pictures import CLASSES, classes_of, our_views
from experiments.perception.gym_duckietown.world import World, random_poses, read_maps

__all__ = ["compare", "main"]

_MAPS = ("ETHZ_loop_bordered", "4way_bordered")


def _by_colour(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    lines = find_lines(image)
    return np.select([lines["red"], lines["yellow"], lines["white"]], [2, 3, 4]).astype(np.uint8)


def _edge_distances(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Returns the distance of each edge pixel of a mask from the nearest edge pixel of another mask."""
    edges = [cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((2, 2))) > 0 for mask in (one, other)]
    if not edges[1].any():
        return np.zeros(0, np.float32)
    away = cv2.distanceTransform((~edges[1]).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray(away[edges[0]], np.float32)


def compare(poses: int) -> str:
    """Returns the table of distances."""
    apart: dict[tuple[str, int], list[NDArray[np.float32]]] = {}
    with World() as world:
        for place in (one for one in read_maps("development", "people") if one.name in _MAPS):
            at = random_poses(place.codes, poses, 0)
            drawn, drawn_labels = our_views(place.codes, at)
            pictures = {}
            for style in ("labels", "synthetic", "photos"):
                world.load(place, style=style)
                pictures[style] = world.ask("look", poses=at)["image"]
            for index in range(poses):
                true = classes_of(pictures["labels"][index])
                own = np.where(_by_colour(drawn[index]) == 4, 4, drawn_labels[index])
                near = np.arange(480) >= 240  # beyond half a metre a line is thinner than a pixel or two
                for name, other in {
                    "synthetic": _by_colour(pictures["synthetic"][index]),
                    "photos": _by_colour(pictures["photos"][index]),
                    "ours": own,
                }.items():
                    for label in (2, 3, 4):
                        one, another = ((layer == label) & near[:, None] for layer in (true, other))
                        apart.setdefault((name, label), []).append(_edge_distances(one, another))
    rows = []
    for (name, label), parts in apart.items():
        all_of = np.concatenate(parts)
        figures = [f"{part:.1f}" for part in np.percentile(all_of, (50, 90))]
        rows.append([f"segmentation and {name}", CLASSES[label], *figures])
    return table(["pictures", "line", "median, pixels", "90 %"], rows, left=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("compare", __doc__)
    parser.add_argument("--poses", type=whole(1, 1000), default=20, metavar="N", help="on each map; default 20")
    parser.add_argument("--out", type=Path, metavar="FILE", help="where to write the table")
    options = parser.parse_args(arguments)
    return run("compare", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    text = compare(options.poses)
    print(text)
    if options.out:
        write(options.out, text)


if __name__ == "__main__":
    leave(main())
