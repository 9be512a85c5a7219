"""Navigation on generated maps: whether a driver learns more from more maps, or from other ones.

    python -m experiments.navigation.study [--tasks ...] [--seeds N] [--cores N] [--human-made DIR] [--quick]

Drivers are trained by PPO on sets of maps that differ in their number and source alone: the same steps, networks and
distances from start to goal. They are tested on maps that none was trained on: of the same niches, of niches held out,
of other sources, and made by hand. What was expected stands in README.md. The folder of results keeps every finished
run: after an interruption, the same command continues from there.
"""

import argparse
import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from elitelanes_jax import InputError, __version__
from elitelanes_jax._util.checks import path, whole
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.threads import count_cores
from elitelanes_jax.cli.arguments import Parser, add_cores, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.search import use_compile_cache
from experiments.common import kept, open_results
from experiments.navigation.maps import SIDE, MapBudget, human_maps, make_maps

_TASKS = ("map", "window", "where", "lane")
_HUMAN = Path(__file__).parents[2] / ".venv-duckietown"

_FULL_MAPS = MapBudget()
_QUICK_MAPS = MapBudget(most=12, others=4, tests=2, other_tests=2, runs=4, evaluations=400)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="navigation", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(_TASKS), metavar="NAME", help=f"of {', '.join(_TASKS)}")
    parser.add_argument(
        "--seeds", type=checked_by(whole(1, 1000)), metavar="N", help="runs of each; by default 10, or 1 if quick"
    )
    add_cores(parser)
    parser.add_argument(
        "--human-made", type=checked_by(path), metavar="DIR", help="of Duckietown's YAML maps, to test on as well"
    )
    out = "results/navigation"
    parser.add_argument("--out", type=checked_by(path), default=Path(out), metavar="DIR", help=f"by default {out}")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to see that it runs")
    options = parser.parse_args(arguments)
    return guarded("navigation", lambda: _run(options), interrupted="what is done is kept; start again to continue")


def _run(options: argparse.Namespace) -> int:
    for package in ("flax", "optax"):
        import_optional(package, "training needs flax and optax", "flax optax")
    for name in options.tasks:
        if name not in _TASKS:
            raise InputError(f"tasks: expected some of {', '.join(_TASKS)}, got {name!r}")
    tasks = [name for name in _TASKS if name in options.tasks]
    folder = options.human_made or next(_HUMAN.glob("lib/*/site-packages/duckietown_world/data/gd1/maps"), None)
    human = np.zeros((0, SIDE, SIDE), np.int8) if folder is None else human_maps(folder)
    about = {"program": "navigation", "version": __version__, "quick": options.quick, "human_made": human.tolist()}
    open_results(options.out, about)
    use_compile_cache()
    began = time.perf_counter()
    seeds = range(options.seeds or (1 if options.quick else 10))
    _work(seeds, partial(_do, tasks, options.out, options.quick, human.tolist()))
    from experiments.navigation.report import write_report

    write_report(options.out, tasks)
    say(f"{options.out / 'navigation.md'}, {time.perf_counter() - began:.0f} s")
    return 0


def _work(seeds: Sequence[int], do: Callable[[int], None]) -> None:
    """Does all seeds in order, one on each core at a time where the system can keep a process to a core."""
    count = min(count_cores(), len(seeds))
    if count == 1 or not hasattr(os, "sched_setaffinity"):  # not on macOS and Windows
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


def _settle(cores: Any) -> None:
    """Keeps a process to one core: several runs side by side are faster than one on all."""
    os.sched_setaffinity(0, {cores.get()})
    use_compile_cache()


def _do(tasks: Sequence[str], out: Path, quick: bool, human: Any, seed: int) -> None:
    """Does all of a seed: makes its maps, and runs each task under all conditions; prints a line for each run."""
    from experiments.navigation.localization import find_places
    from experiments.navigation.tasks import CONDITIONS, FEW, TASKS, TrainBudget

    maps = kept(out / "maps" / f"{seed}.json", partial(make_maps, seed, _QUICK_MAPS if quick else _FULL_MAPS))
    maps = {part: np.array(grids, np.int8) for part, grids in maps.items() if part != "niches"}
    tests = {part: maps[part] for part in ("seen", "held out", "test ea", "test wfc", "test random")}
    if len(human):
        tests["human-made"] = np.array(human, np.int8)
    if "where" in tasks:
        kept(out / "runs" / f"where-{seed}.json", partial(find_places, tests))
        say(f"where, seed {seed}")
    for name in [name for name in tasks if name != "where"]:
        budget = TrainBudget(updates=2, levels=256, each=2) if quick else TrainBudget()
        if name == "lane":
            budget = budget._replace(each=min(budget.each, 5))  # its episodes are long
        for condition in TASKS[name].conditions:
            if condition in TASKS[name].few and seed >= FEW:
                continue
            run = partial(_train, name, condition, seed, maps, tests, out, budget)
            found = kept(out / "runs" / f"{name}-{condition}-{seed}.json", run)
            say(
                f"{name}, {CONDITIONS[condition].words}, seed {seed}: success "
                + ", ".join(f"{test} {judged['success']:.3f}" for test, judged in found.items())
            )


def _train(name: str, condition: str, seed: int, maps: Any, tests: Any, out: Path, budget: Any) -> Any:
    from flax.serialization import to_bytes

    from experiments.navigation.tasks import CONDITIONS, TASKS, test_driver, train_driver

    about, task = CONDITIONS[condition], TASKS[name]
    weights = train_driver(task, about, seed, maps[about.source], budget)
    # The training's own maps too, as many times as there are maps in the first test: what a driver knows by heart.
    own = np.arange(len(maps["seen"])) % max(about.maps, 1) % len(maps[about.source])
    judged = test_driver(task, weights, tests | {"trained on": maps[about.source][own]}, budget)
    if condition in ("maps-1000", "maps-100"):
        write_atomic(out / "drivers" / f"{name}-{condition}-{seed}.msgpack", to_bytes(weights))
    return judged


if __name__ == "__main__":
    leave(main)
