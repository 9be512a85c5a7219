"""Trains agents by methods of environment design, and writes their exact regret: RoadUED.

    python -m experiments.navigation.ued.study [--methods ...] [--seeds N] [--rounds N] [--space NAME] [--scores]
        [--quick] [--out DIR]

Writes ued.md and ued.png into the folder of results, which keeps every finished row: the same command continues.
"""

import argparse
import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from elitelanes_jax import InputError, __version__
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, kept, leave, open_results, require, run, whole


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("ued", __doc__)
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="of rows.METHODS, default all")
    parser.add_argument("--seeds", type=whole(1, 1000), default=10, metavar="N", help="rows of each; default 10")
    parser.add_argument("--rounds", type=whole(10, 10_000), default=120, metavar="N", help="of driving; default 120")
    parser.add_argument("--space", default="7x7A", choices=("5x5B", "5x5A", "6x6A", "7x7A"), help="default 7x7A")
    parser.add_argument("--out", type=Path, default=Path("results/ued"), metavar="DIR", help="default results/ued")
    parser.add_argument("--quick", action="store_true", help="few levels side by side, to test the program")
    parser.add_argument("--scores", action="store_true", help="also study the scores, the longest part by far")
    options = parser.parse_args(arguments)
    return run("ued", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    require("training needs", "flax", "optax", "jaxued")
    from experiments.navigation.ued.agent import settings
    from experiments.navigation.ued.report import at_end, write_report
    from experiments.navigation.ued.rows import RATES, check_methods, run_row
    from experiments.navigation.ued.scores import study_scores

    methods = check_methods(options.methods)
    ppo = settings(options.rounds, quick=options.quick)
    about = {"program": "ued", "version": __version__, "space": options.space, "ppo": ppo._asdict(), "rates": RATES}
    open_results(options.out, about)
    use_compile_cache()
    for seed in range(options.seeds):
        for method in methods:
            of_method = ppo._replace(rate=RATES.get(method, ppo.rate))
            make = partial(run_row, method, seed, options.space, of_method, unseen=not options.quick)
            row = kept(options.out / "rows" / f"{method.replace(' ', '-')}.{seed}.json", make)
            end = at_end(row)
            print(f"{method}, seed {seed}: mean {end['mean']:.4f}, worst 1 % {end['cvar1']:.4f}", flush=True)
        if options.scores:
            of_scores = ppo._replace(rate=RATES["domain randomisation"])
            scores = partial(study_scores, seed, options.space, of_scores)
            print(
                f"scores, seed {seed}: {json.dumps(kept(options.out / 'scores' / f'{seed}.json', scores))}", flush=True
            )
    if not write_report(options.out):
        raise InputError(options.out, "finished rows", "none")
    print(options.out / "ued.md")


if __name__ == "__main__":
    leave(main())
