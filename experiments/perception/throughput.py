"""The speed at which datasets are drawn, and the shares of its steps.

python -m experiments.perception.throughput [--maps N] [--tile-px N]

One thread draws maps of 12 x 12 tiles, and the processor time of each step is measured. Then all processors draw as
`elitelanes dataset` does, and only pack the same pictures: no dataset can be made faster than that.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from elitelanes_jax._util.checks import whole
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.dataset import FORMATS, STANDARD, DatasetSpec, make_dataset
from elitelanes_jax.dataset import _samples as drawing
from elitelanes_jax.formats import RoadMap
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.tiles import load_tiles, png_of

__all__ = ["main"]

# The functions that make a sample, with words for them.
_STEPS = {
    "png_of": "pack pictures and labels as PNG",
    "warp": "warp",
    "photograph": "light, blur, noise",
    "write_atomic": "write files",
    "render": "lay out tiles",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="throughput.py", description="Measures how fast datasets are drawn.")
    parser.add_argument(
        "--maps", type=checked_by(whole(8)), default=1000, metavar="N", help="number of maps; by default 1000"
    )
    parser.add_argument(
        "--tile-px",
        type=checked_by(whole(16, 512)),
        default=64,
        metavar="N",
        help="side of a tile in pixels; by default 64",
    )
    options = parser.parse_args(arguments)
    return guarded("throughput", lambda: _measure(options), interrupted="nothing was measured")


def _measure(options: argparse.Namespace) -> int:
    grids = generate_batch(np.random.default_rng(0), options.maps, (12, 12), border="closed").grid
    maps = [RoadMap(grid, niche=[0]) for grid in grids]
    say(_one_thread(maps[:100], options.tile_px))
    with TemporaryDirectory() as folder:
        began = time.perf_counter()
        spec = DatasetSpec(maps=len(maps), size=((12, 12),), tile_px=options.tile_px)
        make_dataset(spec, Path(folder) / "dataset", maps=maps)
        drawn = time.perf_counter() - began
    images = [_sample(road_map, number, options.tile_px).layers for number, road_map in enumerate(maps[:32])]
    cv2.setNumThreads(1)
    began = time.perf_counter()
    with ThreadPoolExecutor() as pool:
        jobs = [pool.submit(png_of, images[n % 32][name]) for n in range(len(maps)) for name in ("image", "labels")]
        for job in jobs:
            job.result()
    packed = time.perf_counter() - began
    say(f"{len(maps)} maps, all processors: {drawn:.1f} s as a dataset, {packed:.1f} s for packing PNG alone")
    return 0


def _sample(road_map: RoadMap, number: int, tile_px: int) -> drawing.Sample:
    return drawing.draw_sample(road_map, load_tiles(), number, tile_px=tile_px, transforms=STANDARD, layers=())


def _one_thread(maps: Sequence[RoadMap], tile_px: int) -> str:
    """Makes a table of the milliseconds of processor time of each step of a map."""
    spent = dict.fromkeys(_STEPS, 0.0)

    def timed(name: str) -> Callable[..., Any]:
        step = getattr(drawing, name)

        def run(*arguments: Any, **others: Any) -> Any:
            began = time.thread_time()
            try:
                return step(*arguments, **others)
            finally:
                spent[name] += time.thread_time() - began

        return run

    tiles = load_tiles()
    cv2.setNumThreads(1)
    with TemporaryDirectory() as folder:
        # The first sample scales the tiles, once.
        drawing.draw_sample(maps[0], tiles, 0, tile_px=tile_px, transforms=STANDARD, layers=())
        steps: dict[str, Any] = {name: timed(name) for name in _STEPS}
        began = time.thread_time()
        with patch.multiple(drawing, **steps):
            for number, road_map in enumerate(maps):
                sample = drawing.draw_sample(road_map, tiles, number, tile_px=tile_px, transforms=STANDARD, layers=())
                drawing.write_sample(sample, FORMATS["imagefolder"], 0, Path(folder))
                json.dumps(sample.record)
        total = time.thread_time() - began
    rows = [*((words, spent[name]) for name, words in _STEPS.items()), ("all else", total - sum(spent.values()))]
    lines = [f"| {words} | {1000 * seconds / len(maps):.1f} | {seconds / total:.0%} |" for words, seconds in rows]
    head = ["| one thread | ms a map | share |", "|---|---:|---:|"]
    return "\n".join([*head, *lines, f"| all | {1000 * total / len(maps):.1f} | 100% |"])


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
