"""How many of the niches that any of many long runs fills one of them fills.

Filled is a niche whose elite has no flaw, keeps the style's rules and is in its ranges.

python -m experiments.realism.niches [--style NAME] [--size ROWS COLUMNS] [--seeds N] [--evaluations N]
"""

import argparse
from collections.abc import Sequence

import numpy as np

from elitelanes_jax import evolve
from elitelanes_jax._util.checks import whole
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.search import use_compile_cache, without_flaws

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser(prog="niches", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--style", default="town", metavar="NAME", help="by default town")
    parser.add_argument("--size", nargs=2, type=checked_by(whole(2)), default=(8, 8), metavar=("ROWS", "COLUMNS"))
    parser.add_argument("--seeds", type=checked_by(whole(2)), default=64, metavar="N", help="by default 64")
    parser.add_argument("--evaluations", type=checked_by(whole(1)), default=1_000_000, metavar="N")
    options = parser.parse_args(arguments)
    return guarded("niches", lambda: _main(options), interrupted="nothing is kept")


def _main(options: argparse.Namespace) -> int:
    use_compile_cache()
    result = evolve(
        0, tuple(options.size), seeds=options.seeds, style=options.style, evaluations=options.evaluations, progress=True
    )
    filled, _ = without_flaws(result.satisfies(), result.elites.by_name(), result.spec)
    runs = filled.sum(axis=1) / filled.any(axis=0).sum()
    of_runs = np.bincount(filled.sum(axis=0))[1:]
    say(
        f"any of {options.seeds} runs: {filled.any(axis=0).sum()} niches of {filled.shape[1]}; one run: "
        f"{runs.mean():.1%} of them ({runs.min():.1%} to {runs.max():.1%})\n"
        f"found by one run alone: {of_runs[0]}; by every run: {of_runs[options.seeds - 1 :].sum()}"
    )
    return 0


if __name__ == "__main__":
    leave(main)
