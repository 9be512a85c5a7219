"""Measures how fast datasets are drawn, and the shares of the steps.

    python -m experiments.perception.throughput [--maps N] [--tile-px N]

One thread draws maps of 12 x 12 tiles, step by step. Then all processors draw as `elitelanes dataset` does. Then they
only pack the same pictures as PNG: no dataset can be made faster than that.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from elitelanes_jax.dataset import STANDARD, DatasetSpec, Transforms, draw_sample, make_dataset
from elitelanes_jax.formats import RoadMap
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.tiles import load_tiles, png_of, render
from experiments.common import Parser, leave, run, table, whole

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("throughput", __doc__)
    parser.add_argument("--maps", type=whole(8), default=1000, metavar="N", help="number of maps; default 1000")
    parser.add_argument("--tile-px", type=whole(16, 512), default=64, metavar="N", help="pixels a tile; default 64")
    options = parser.parse_args(arguments)
    return run("throughput", lambda: _measure(options))


def _measure(options: argparse.Namespace) -> None:
    grids = generate_batch(np.random.default_rng(0), options.maps, (12, 12), border="closed").grid
    maps, tile_px = [RoadMap(grid, niche=[0]) for grid in grids], options.tile_px
    print(_one_thread(maps[:100], tile_px))
    with TemporaryDirectory() as folder:
        began = time.perf_counter()
        spec = DatasetSpec(tile_px=tile_px).replace(maps_from=maps)
        make_dataset(spec, Path(folder) / "dataset")
        drawn = time.perf_counter() - began
    tiles = load_tiles()
    samples = [
        draw_sample(road_map, tiles, index, tile_px=tile_px, transforms=STANDARD).layers
        for index, road_map in enumerate(maps[:32])
    ]
    pictures = [samples[index % 32][name] for index in range(len(maps)) for name in ("image", "labels")]
    cv2.setNumThreads(1)
    began = time.perf_counter()
    with ThreadPoolExecutor() as pool:
        list(pool.map(png_of, pictures))
    packed = time.perf_counter() - began
    print(f"{len(maps)} maps, all processors: {drawn:.1f} s as a dataset, {packed:.1f} s for packing PNG alone")


def _one_thread(maps: Sequence[RoadMap], tile_px: int) -> str:
    """Makes a table of the processor time of each step of a map: views are what a sample costs more with them."""
    tiles = load_tiles()
    cv2.setNumThreads(1)

    def sample(index: int, transforms: Transforms) -> list[np.ndarray]:
        layers = draw_sample(maps[index], tiles, index, tile_px=tile_px, transforms=transforms).layers
        return [layers["image"], layers["labels"]]

    drawn = [sample(index, STANDARD) for index in range(len(maps))]  # also scales the tiles, once
    steps: dict[str, Callable[[int], object]] = {
        "lay out tiles": lambda index: render(maps[index], tiles, tile_px=tile_px),
        "plain": lambda index: sample(index, Transforms()),
        "view": lambda index: sample(index, STANDARD),
        "pack image and labels as PNG": lambda index: [png_of(picture) for picture in drawn[index]],
    }
    spent = dict.fromkeys(steps, 0.0)
    for index in range(len(maps)):
        for name, step in steps.items():
            began = time.thread_time()
            step(index)
            spent[name] += 1000 * (time.thread_time() - began) / len(maps)
    plain, view = spent.pop("plain"), spent.pop("view")
    spent |= {"warp, light, blur, noise": view - plain, "all else": plain - spent["lay out tiles"]}
    total = sum(spent.values())
    rows = [[name, f"{value:.1f}", f"{value / total:.0%}"] for name, value in spent.items()]
    return table(["one thread", "ms a map", "share"], [*rows, ["all", f"{total:.1f}", "100%"]])


if __name__ == "__main__":
    leave(main())
