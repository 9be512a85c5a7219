"""Chooses the learning rate of each method, on 5 x 5 A. The rows of the table have other spaces.

    python -m experiments.navigation.ued.rates [--methods ...] [--seeds N] [--rounds N] [--quick]

Writes rates.md into the folder of results, which keeps every finished row: the same command continues. `RATES` in
rows.py has the chosen rates.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from elitelanes_jax import __version__
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, kept, leave, open_results, require, run, table, whole, write

__all__ = ["CANDIDATES", "main"]

CANDIDATES = (1e-3, 2e-3, 4e-3, 8e-3)
"""The rates that are compared."""

_SPACE = "5x5A"


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("rates", __doc__)
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="of rows.METHODS, default all")
    parser.add_argument("--seeds", type=whole(1, 1000), default=3, metavar="N", help="of each rate; default 3")
    parser.add_argument("--rounds", type=whole(10, 10_000), default=60, metavar="N", help="of driving; default 60")
    parser.add_argument("--out", type=Path, default=Path("results/ued-rates"), metavar="DIR")
    parser.add_argument("--quick", action="store_true", help="few levels side by side, to test the program")
    options = parser.parse_args(arguments)
    return run("rates", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax", "jaxued")
    from experiments.navigation.ued.agent import settings
    from experiments.navigation.ued.report import at_end
    from experiments.navigation.ued.rows import check_methods, run_row

    methods = check_methods(options.methods)
    ppo = settings(options.rounds, quick=options.quick)
    about = {"program": "ued-rates", "version": __version__, "space": _SPACE, "ppo": ppo._asdict()}
    open_results(options.out, about)
    use_compile_cache()
    lines = []
    for method in methods:
        means = []
        for rate in CANDIDATES:
            regrets = []
            for seed in range(options.seeds):
                make = partial(run_row, method, seed, _SPACE, ppo._replace(rate=rate), unseen=False)
                row = kept(options.out / "rows" / f"{method.replace(' ', '-')}.{rate:g}.{seed}.json", make)
                regrets.append(at_end(row)["mean"])
            means.append(float(np.mean(regrets)))
            print(f"{method}, rate {rate:g}: mean regret {means[-1]:.4f}", flush=True)
        best = CANDIDATES[int(np.argmin(means))]
        lines.append([method, *(f"{mean:.4f}" for mean in means), f"{best:g}"])
    head = ["method", *(f"{rate:g}" for rate in CANDIDATES), "chosen"]
    means_of = f"the means of {options.seeds} seeds"
    words = f"Mean regret of the sampled policy on all levels of 5 x 5 A by learning rate: {means_of}.\n\n"
    write(options.out / "rates.md", "# Learning rates\n\n" + words + table(head, lines))
    print(options.out / "rates.md")


if __name__ == "__main__":
    leave(main())
