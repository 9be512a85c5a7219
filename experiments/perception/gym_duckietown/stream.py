"""Trains the networks of `train` on views that are drawn while it trains: no picture twice, and no disk.

    python -m experiments.perception.gym_duckietown.stream {pose,labels} MAPS... --out FILE [--tiles DIR] [--steps N]

MAPS are files of maps, such as those of `elitelanes generate`. Views of the package's own tiles have shifted white
lines, because tiles differ between labs. Views of other tiles do not. An interrupted training continues with the same
command.
"""

import argparse
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from elitelanes_jax import load_tiles
from elitelanes_jax.drive import Camera, Variation, make_scenes, stream_views
from experiments.common import Parser, Pytree, leave, run, whole
from experiments.perception.gym_duckietown.nets import COLUMNS, ROWS
from experiments.perception.gym_duckietown.train import BATCH, STEPS, Views, shares_of, train_on, write_trained

__all__ = ["LINES", "TILE_PX", "main", "stream"]

_CAMERA = Camera(rows=ROWS, columns=COLUMNS)
_VARIATION = Variation.varied().replace(blur=0.5)
LINES = 0.07
"""The largest stretch of drawn tiles at their white lines, in tiles."""

TILE_PX = 256
"""The side of the largest pictures of tiles in pixels."""


def stream(task: str, scenes: Pytree, seed: int, lines: float | None, first: int) -> Iterator[Views]:
    """Yields batches of new views without end, from the batch of index `first` on.

    White lines are shifted by up to `lines` tiles. None does not shift them.
    """
    variation = _VARIATION.replace(lines=lines)
    for views in stream_views(seed, scenes, BATCH[task], camera=_CAMERA, variation=variation, first=first):
        yield Views(*(np.asarray(part) for part in views[:3]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("stream", __doc__)
    parser.add_argument("task", choices=STEPS)
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights, .npz")
    parser.add_argument("--tiles", type=Path, metavar="DIR", help="tile set; by default the package's own")
    defaults = " and ".join(f"{2 * steps} for {task}" for task, steps in STEPS.items())
    parser.add_argument("--steps", type=whole(1), metavar="N", help=f"by default {defaults}")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of first weights and views; default 0")
    options = parser.parse_args(arguments)
    return run("stream", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    scenes = make_scenes(options.maps, load_tiles(options.tiles), tile_px=TILE_PX)
    steps = options.steps or 2 * STEPS[options.task]
    lines = LINES if options.tiles is None else None
    batches = partial(stream, options.task, scenes, options.seed, lines)
    shares = shares_of(next(batches(0)).labels)
    write_trained(options.out, partial(train_on, options.task, batches, shares, steps, options.seed))


if __name__ == "__main__":
    leave(main())
