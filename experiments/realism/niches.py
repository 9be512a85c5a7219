"""Compares the niches that one long run fills with those that any of many runs fills.

python -m experiments.realism.niches [--style NAME] [--size ROWS COLUMNS] [--seeds N] [--evaluations N]

A niche counts as filled if its elite has no flaw, keeps the style's rules and is in the style's ranges.
"""

import argparse
from collections.abc import Sequence

import numpy as np

from elitelanes_jax import InputError, evolve
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, run, whole

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("niches", __doc__)
    parser.add_argument("--style", default="town", metavar="NAME", help="of the towns; default town")
    size = "of the towns; default 8 8"
    parser.add_argument("--size", nargs=2, type=whole(2), default=(8, 8), metavar=("ROWS", "COLUMNS"), help=size)
    parser.add_argument("--seeds", type=whole(2), default=64, metavar="N", help="runs; default 64")
    parser.add_argument("--evaluations", type=whole(1), default=1_000_000, metavar="N", help="of each; default 1000000")
    options = parser.parse_args(arguments)
    return run("niches", lambda: _compare(options))


def _compare(options: argparse.Namespace) -> None:
    use_compile_cache()
    result = evolve(
        0, tuple(options.size), seeds=options.seeds, style=options.style, evaluations=options.evaluations, progress=True
    )
    filled, _ = result.without_flaws()
    if not filled.any():
        raise InputError("evaluations", "enough to fill a niche", options.evaluations)
    runs = filled.sum(axis=1) / filled.any(axis=0).sum()
    of_runs = np.bincount(filled.sum(axis=0))[1:]
    print(
        f"any of {options.seeds} runs: {filled.any(axis=0).sum()} niches of {filled.shape[1]}; one run: "
        f"{runs.mean():.1%} of them ({runs.min():.1%} to {runs.max():.1%})\n"
        f"found by one run alone: {of_runs[0]}; by every run: {of_runs[options.seeds - 1 :].sum()}"
    )


if __name__ == "__main__":
    leave(main())
