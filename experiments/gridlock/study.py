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
from typing import TypeAlias

import numpy as np

from experiments.common import Parser, kept, leave, open_results, require, run, whole
from experiments.gridlock.jams import SETTINGS, Setting, drive, least_loop, make_network
from experiments.gridlock.towns import make_towns

__all__ = ["TOWNS", "main"]

TOWNS = Path(__file__).parent / "results" / "towns.json"
"""The codes of the study's towns, by name."""

SEEDS, LOOP_SEEDS = 8, 2
"""The runs of a town in a setting, and its runs with fewer cars than fill a loop."""

Runs: TypeAlias = dict[str, list[list[float]]]
"""Runs by kind; of each the number of cars, and the fields of `Run`."""


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
    towns = kept(TOWNS, make_towns)
    open_results(options.out, {"seeds": options.seeds})
    # In this order, the first towns are of all sizes.
    names = np.random.default_rng(0).permutation(sorted(towns))[: options.towns].tolist()
    for name in names:
        for kind, setting in SETTINGS.items():
            kept(options.out / "runs" / f"{name}-{kind}.json", partial(runs_of, towns[name], setting, options.seeds))


def runs_of(codes: list[list[int]], setting: Setting, seeds: int) -> Runs:
    """Lets cars drive through a town.

    Returns:
      The runs of each kind. "usual": a number of cars for each link. "below": one car less than fills the loop of
      streets that the fewest cars fill. "below_loop": as many, all of which drive to this loop and around it.
      "above_loop": twice as many as fill this loop, which drive so too.
    """
    grid = np.array(codes, np.int8)
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


if __name__ == "__main__":
    leave(main())
