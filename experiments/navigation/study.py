"""Measures whether a driver learns more from more maps, or from maps of another source.

    python -m experiments.navigation.study [--tasks ...] [--seeds N] [--cores N] [--quick]

PPO trains drivers on sets of maps that differ in their number and source alone, with the same steps, networks and
distances from start to goal. Tests use maps that no driver was trained on: of the same niches, of niches held out, of
other sources, and made by hand. README.md has the hypotheses and the results. The folder of results keeps every
finished run: after an interruption, the same command continues from there.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import __version__
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, Untyped, add_cores, kept, leave, open_results, require, run, whole, write
from experiments.navigation.maps import SIDE, Grids, MapBudget, human_maps, make_maps

if TYPE_CHECKING:
    from experiments.navigation.tasks import Judged, TrainBudget

_TASKS = ("map", "window")
_HUMAN = Path(__file__).parents[2] / ".venv-duckietown"  # of make duckietown; people's maps are tests where it is

_FULL_MAPS = MapBudget()
_QUICK_MAPS = MapBudget(most=12, others=4, tests=2, other_tests=2, runs=4, evaluations=400)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("navigation", __doc__)
    parser.add_argument("--tasks", nargs="+", default=_TASKS, choices=_TASKS, help="default both")
    parser.add_argument("--seeds", type=whole(1, 1000), metavar="N", help="runs of each; default 10, or 1 if quick")
    add_cores(parser)
    out = Path("results/navigation")
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"folder of results; default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    options = parser.parse_args(arguments)
    return run("navigation", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax")
    tasks = [name for name in _TASKS if name in options.tasks]
    folder = next(_HUMAN.glob("lib/*/site-packages/duckietown_world/data/gd1/maps"), None)
    human = np.zeros((0, SIDE, SIDE), np.int8) if folder is None else human_maps(folder)
    about = {"program": "navigation", "version": __version__, "quick": options.quick, "human_made": human.tolist()}
    open_results(options.out, about)
    use_compile_cache()
    began = time.perf_counter()
    seeds = range(options.seeds or (1 if options.quick else 10))
    can_settle = hasattr(os, "sched_setaffinity")  # macOS and Windows cannot keep a process on a core
    cores = min(options.cores or len(os.sched_getaffinity(0)), len(seeds)) if can_settle else 1
    _work(seeds, cores, partial(_do, tasks, options.out, options.quick, human.tolist()))
    from experiments.navigation.report import write_report

    write_report(options.out, tasks)
    print(f"{options.out / 'navigation.md'}, {time.perf_counter() - began:.0f} s")


def _work(seeds: Sequence[int], count: int, do: Callable[[int], None]) -> None:
    """Does all seeds in order, one on each of `count` cores at a time."""
    if count == 1:
        for seed in seeds:
            do(seed)
        return
    method = multiprocessing.get_context("spawn")
    cores = method.Queue()
    for core in sorted(os.sched_getaffinity(0))[:count]:
        cores.put(core)
    with ProcessPoolExecutor(count, method, _settle, (cores,)) as pool:
        for _ in pool.map(do, seeds):
            pass


def _settle(cores: Untyped) -> None:
    """Keeps a process to one core of a queue: several runs side by side are faster than one run on all cores."""
    os.sched_setaffinity(0, {cores.get()})
    use_compile_cache()


def _do(tasks: Sequence[str], out: Path, quick: bool, human: list[Grids], seed: int) -> None:
    """Makes the maps of a seed and runs each task under all conditions. Prints a line for each run."""
    from experiments.navigation.tasks import CONDITIONS, FEW, TASKS, TrainBudget

    made = kept(out / "maps" / f"{seed}.json", partial(make_maps, seed, _QUICK_MAPS if quick else _FULL_MAPS))
    maps = {part: np.array(grids, np.int8) for part, grids in made["grids"].items()}
    tests = {part: maps[part] for part in ("seen", "held out", "test ea", "test wfc", "test random")}
    if len(human):
        tests["human-made"] = np.array(human, np.int8)
    budget = TrainBudget(updates=2, levels=256, each=2) if quick else TrainBudget()
    for name in tasks:
        for condition in TASKS[name].conditions:
            if condition in TASKS[name].few and seed >= FEW:
                continue
            do = partial(_train, name, condition, seed, maps, tests, out, budget)
            found = kept(out / "runs" / f"{name}-{condition}-{seed}.json", do)
            success = ", ".join(f"{test} {judged['success']:.3f}" for test, judged in found.items())
            print(f"{name}, {CONDITIONS[condition].words}, seed {seed}: success {success}", flush=True)


def _train(
    name: str,
    condition: str,
    seed: int,
    maps: Mapping[str, NDArray[np.int8]],
    tests: dict[str, NDArray[np.int8]],
    out: Path,
    budget: "TrainBudget",
) -> "dict[str, Judged]":
    """Trains a driver on a condition's maps; returns the figures of each test."""
    from flax.serialization import to_bytes

    from experiments.navigation.tasks import CONDITIONS, TASKS, test_driver, train_driver

    about, task = CONDITIONS[condition], TASKS[name]
    weights = train_driver(task, about, seed, maps[about.source], budget)
    # The test on the training's own maps has as many maps as the first test: it shows what a driver knows by heart.
    own = np.arange(len(maps["seen"])) % max(about.maps, 1) % len(maps[about.source])
    judged = test_driver(task, weights, tests | {"trained on": maps[about.source][own]}, budget)
    if condition in ("maps-1000", "maps-100"):
        write(out / "drivers" / f"{name}-{condition}-{seed}.msgpack", to_bytes(weights))
    return judged


if __name__ == "__main__":
    leave(main())
