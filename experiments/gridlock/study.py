"""Which towns jam first, and does a formula of their streets tell?

    python -m experiments.gridlock.study [--towns N] [--seeds N] [--out DIR]

Cars drive through towns in SUMO, 5 m long, so many that some towns jam. README.md has the question, the formula, and
the hypotheses. All were committed before the first run.
"""

import argparse
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, kept, leave, open_results, require, run, whole
from experiments.gridlock.cost import draw_cost, find_small_towns
from experiments.gridlock.jams import SETTINGS, Setting, drive, full_loop, least_loop, make_network, stand
from experiments.gridlock.report import Jam, Runs, write_report
from experiments.gridlock.towns import make_towns

__all__ = ["SMALL_TOWNS", "TOWNS", "main"]

TOWNS, SMALL_TOWNS = (Path(__file__).parent / "results" / name for name in ("towns.json", "small_towns.json"))
"""The codes of the study's towns, and those of the smallest towns with a gridlock number, by name."""

SEEDS, LOOP_SEEDS = 8, 2
"""The runs of a town in a setting, and its runs with fewer cars than fill a loop."""

LOOKED_AT = 30
"""The jams of a setting that are looked at. They are the first ones of towns."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("gridlock", __doc__)
    parser.add_argument("--towns", type=whole(1, 200), default=200, metavar="N", help="use the first N towns, shuffled")
    parser.add_argument("--seeds", type=whole(2, 100), default=SEEDS, metavar="N", help="runs of a town in a setting")
    parser.add_argument("--out", type=Path, default=Path("results/gridlock"), metavar="DIR", help="folder of results")
    options = parser.parse_args(arguments)
    return run("gridlock", lambda: _study(options))


def _study(options: argparse.Namespace) -> None:
    require("this study needs", "eclipse-sumo")
    use_compile_cache()
    towns = kept(TOWNS, make_towns)
    open_results(options.out, {"seeds": options.seeds})
    # In this order, the first towns are of all sizes.
    names = np.random.default_rng(0).permutation(sorted(towns))[: options.towns].tolist()
    grids = {name: np.array(towns[name], np.int8) for name in names}
    runs, jams = dict[tuple[str, str], Runs](), dict[tuple[str, str], Jam]()
    for name, grid in grids.items():
        for kind, setting in SETTINGS.items():
            file = options.out / "runs" / f"{name}-{kind}.json"
            runs[name, kind] = kept(file, partial(runs_of, grid, setting, options.seeds))
    for kind, setting in SETTINGS.items():
        jammed = [name for name in names if any(run[1] for run in runs[name, kind]["usual"])]
        for name in jammed[:LOOKED_AT]:
            file = options.out / "jams" / f"{name}-{kind}.json"
            jams[name, kind] = kept(file, partial(jam_of, grids[name], setting, runs[name, kind]))
    write_report(options.out, grids, runs, jams)
    draw_cost(kept(SMALL_TOWNS, find_small_towns), options.out / "cost.png")


def runs_of(grid: NDArray[np.int8], setting: Setting, seeds: int) -> Runs:
    """Lets cars drive through a town.

    Returns:
      The runs of each kind. "usual": a number of cars for each link. "below": one car less than fills the loop of
      streets that the fewest cars fill. "below_loop": as many cars, which all drive to this loop and around it.
      "above_loop": twice as many cars as fill this loop, which drive in the same way.
    """
    links = sum(code.bit_count() for code in grid.ravel().tolist()) // 2
    with tempfile.TemporaryDirectory() as folder:
        network = make_network(Path(folder), grid, setting)
        loop = least_loop(network)
        filled = sum(network.capacity[street] for street in loop)
        plans = {
            "usual": (round(setting.cars_per_link * links), seeds, []),
            "below": (filled - 1, 1, []),
            "below_loop": (filled - 1, LOOP_SEEDS, loop),
            "above_loop": (2 * filled, 1, loop),
        }
        runs: Runs = {}
        for kind, (cars, count, around) in plans.items():
            runs[kind] = [[cars, *drive(network, cars, seed, around)] for seed in range(count)]
    return runs


def jam_of(grid: NDArray[np.int8], setting: Setting, runs: Runs) -> Jam:
    """Repeats the first run of a town that jammed, and looks at its end."""
    (seed, (cars, *_)), *_ = ((seed, run) for seed, run in enumerate(runs["usual"]) if run[1])
    with tempfile.TemporaryDirectory() as folder:
        network = make_network(Path(folder), grid, setting)
        standing = stand(network, int(cars), seed)
        return Jam(loop=full_loop(network, standing), cars=standing)


if __name__ == "__main__":
    leave(main())
