"""Measures the parts of a run on a cluster, and computes what a million maps and ten million pictures cost.

    python -m experiments.search.cluster [--hosts N] [--cores N] [--quick]

Figures are processor seconds of one core. The search and the drawing are divided among the hosts. The choice of maps,
and receiving and writing pictures, are the work of one core of the host that calls.
"""

import pickle
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np

from elitelanes_jax import DatasetSpec, RoadMap, evolve, make_dataset, use_cores
from elitelanes_jax.network.wfc import generate_batch
from experiments.common import Parser, Pytree, leave, run, table, whole

T = TypeVar("T")

MAPS, PICTURES = 1_000_000, 10_000_000
_PART = 250  # the pictures of a part, as `make_dataset` chooses
_SHAPE, _SEEDS, _EVALUATIONS, _ROUND = (10, 10), 16, 100_000, 512  # of a round of a dataset

_DRAWN: Pytree = {"transforms": "varied", "split": (1, 0, 0), "camera": {"rows": 120, "columns": 160}}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("cluster", __doc__)
    parser.add_argument("--hosts", type=whole(1), default=100, metavar="N", help="default 100")
    parser.add_argument("--cores", type=whole(1), default=16, metavar="N", help="of each host; default 16")
    parser.add_argument("--quick", action="store_true", help="few evaluations and pictures, to see that it runs")
    options = parser.parse_args(arguments)
    return run("cluster", lambda: _measure(options.hosts * options.cores, options.quick))


def _measure(cores: int, quick: bool) -> None:
    use_cores(1)
    search, first, more = _measure_round(2_000 if quick else _EVALUATIONS, 100 if quick else 2_000)
    draw, receive, size = _measure_pictures(4 if quick else 100)
    sent = _measure_sent(4 if quick else _PART)
    rounds = -(-MAPS // _ROUND)
    chosen = rounds * first + more * _ROUND * rounds * (rounds - 1) / 2
    rows = [
        ["a round of 16 searches, 512 maps at most", f"{search:.1f} s", "hosts", _duration(rounds * search / cores)],
        ["choosing a round's maps, the first", f"{first:.2f} s", "caller", ""],
        ["for each earlier map", f"{1e6 * more:.0f} us", "caller", _duration(chosen)],
        ["a varied view of 160 x 120", f"{1e3 * draw:.1f} ms", "hosts", _duration(PICTURES * draw / cores)],
        ["receiving and writing it", f"{1e3 * receive:.2f} ms", "caller", _duration(PICTURES * receive)],
        ["its size", f"{size / 1e3:.0f} KB", "", f"{PICTURES * size / 1e9:,.0f} GB"],
        ["sent to workers, a part", f"{sent / 1e3:.1f} KB", "", f"{PICTURES / _PART * sent / 1e9:,.1f} GB"],
    ]
    heads = ["part", "one core", "where", f"{MAPS:,} maps, {PICTURES:,} pictures, {cores:,} cores"]
    print(f"\n{table(heads, rows)}")


def _measure_round(evaluations: int, earlier: int) -> tuple[float, float, float]:
    """Returns the seconds of a round, of its first choice of maps, and of this choice for each earlier map."""
    options: Pytree = {"seeds": _SEEDS, "evaluations": evaluations}
    evolve(1, _SHAPE, **options)  # compiles
    result, search = _time(lambda: evolve(0, _SHAPE, **options))
    _, first = _time(lambda: result.choose(_ROUND))
    others = [road_map.codes for road_map in _random_maps(earlier)]
    _, last = _time(lambda: result.choose(_ROUND, exclude=others))
    return search, first, max(last - first, 0) / earlier


def _measure_pictures(maps: int) -> tuple[float, float, float]:
    """Returns the seconds to draw a picture with its labels, and to receive and write it, and their bytes."""
    options: Pytree = {"maps_from": _random_maps(maps), **_DRAWN}
    spec = DatasetSpec(views=5, **options)
    count = maps * spec.views
    with TemporaryDirectory() as folder, ProcessPoolExecutor(1, get_context("spawn")) as pool:
        _, here = _time(lambda: make_dataset(spec, Path(folder, "here"), workers=1))
        make_dataset(spec, Path(folder, "first"), executor=pool)  # starts the worker
        _, caller = _time(lambda: make_dataset(spec, Path(folder, "there"), executor=pool))
        size = sum(file.stat().st_size for file in Path(folder, "here").rglob("*.png"))
    return (here - caller) / count, caller / count, size / count


class _Sizes:
    """An executor that draws here, and counts the bytes of the arguments that would be sent to a worker."""

    def __init__(self) -> None:
        self.sent = 0

    def submit(self, function: Callable[..., Pytree], /, *args: Pytree) -> Future:
        self.sent += len(pickle.dumps(args))
        future: Future = Future()
        future.set_result(function(*args))
        return future


def _measure_sent(pictures: int) -> int:
    """Returns the bytes that a worker gets to draw a part with `pictures` pictures, each of another map."""
    options: Pytree = {"maps_from": _random_maps(pictures), **_DRAWN}
    executor = _Sizes()
    with TemporaryDirectory() as folder:
        make_dataset(DatasetSpec(**options), Path(folder, "out"), executor=executor, parts=1)
    return executor.sent


def _random_maps(count: int) -> list[RoadMap]:
    grids = generate_batch(np.random.default_rng(0), count, _SHAPE, border="closed").grid
    return [RoadMap(np.asarray(grid, np.int8)) for grid in grids]


def _time(work: Callable[[], T]) -> tuple[T, float]:
    """Returns the result of some work, and this process's processor seconds."""
    began = time.process_time()
    result = work()
    return result, time.process_time() - began


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 600 else f"{seconds / 3600:,.1f} h"


if __name__ == "__main__":
    leave(main())
