"""Runs the generators of the PCG Benchmark on its problems of road networks.

    python -m experiments.search.pcg [--problems ...] [--generators ...] [--seeds N] [--out DIR]

`make pcg` clones the benchmark and its generators first. Writes pcg.md into the folder of results, which keeps every
finished run: the same command continues.
"""

import argparse
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypedDict

import numpy as np
from scipy import stats

from elitelanes_jax import InputError, __version__
from elitelanes_jax.benchmark.interop import VARIANTS, register_pcg_problems
from experiments.common import Parser, Untyped, bootstrap_interval, kept, leave, open_results, run, table, whole, write

GENERATORS = {"random": "random search", "es": "evolution strategy", "ga": "genetic algorithm"}
"""The modules of the generators, and their names in the table."""

GENERATIONS = 60
"""Of 100 contents each, after a first one. A run ends when it has solved its problem."""


class Row(TypedDict):
    """The figures of a run: the generations until its end, and the quality and the flaws of its best content."""

    generations: int
    quality: float
    flaws: int


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("pcg", __doc__)
    parser.add_argument("--problems", nargs="+", metavar="NAME", help="default all, except roads-large-v0")
    parser.add_argument("--generators", nargs="+", metavar="NAME", choices=GENERATORS, help="default all")
    parser.add_argument("--seeds", type=whole(1, 1000), default=20, metavar="N", help="runs of each; default 20")
    parser.add_argument("--out", type=Path, default=Path("results/pcg"), metavar="DIR", help="default results/pcg")
    options = parser.parse_args(arguments)
    return run("pcg", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    problems = options.problems or [name for name in VARIANTS if name != "roads-large-v0"]
    if unknown := [name for name in problems if name not in VARIANTS]:
        raise InputError("--problems", f"some of {', '.join(VARIANTS)}", unknown[0])
    open_results(options.out, {"program": "pcg", "version": __version__, "generations": GENERATIONS})
    lines = []
    for problem in problems:
        for generator in options.generators or GENERATORS:
            rows = []
            for seed in range(1, options.seeds + 1):
                file = options.out / "rows" / f"{problem}.{generator}.{seed}.json"
                rows.append(kept(file, partial(run_generator, problem, generator, seed)))
            lines.append([problem, GENERATORS[generator], *_figures(rows)])
            print(" | ".join(lines[-1]), flush=True)
    head = ["problem", "generator", "runs", "solved", "share", "best quality", "fewest flaws", "generations"]
    write(options.out / "pcg.md", "# Generators of the PCG Benchmark\n\n" + table(head, lines, left=2))
    print(options.out / "pcg.md")


def run_generator(problem: str, name: str, seed: int) -> Row:
    """Runs a generator on a problem as the benchmark's own program does, with a seed from 1."""
    register_pcg_problems()
    environment: Untyped = import_module("pcg_benchmark").make(problem)
    # The fitness of these generators is quality alone. Diversity, and the images that it compares, would take most of
    # the time.
    roads: Untyped = environment._problem
    roads.info = lambda content: roads.measure(roads.read(content))
    environment.diversity = lambda infos: (1.0, np.ones(len(infos)), infos)
    environment.seed(seed)
    try:
        module: Untyped = import_module(f"generators.{name}")
    except ImportError:
        hint = "put a checkout of github.com/amidos2006/benchmark_experiments in PYTHONPATH, or use make pcg"
        raise InputError("generators", "the generators of the PCG Benchmark", "no such module", hint) from None
    generator = module.Generator(environment)
    generator.reset(seed=seed)
    generations = 0
    while generations < GENERATIONS and generator.best() < 1:
        generator.update()
        generations += 1
    (infos,) = environment.info([generator._chromosomes[0]._content])
    return {"generations": generations, "quality": float(generator.best()), "flaws": infos["flaws"]}


def _figures(rows: list[Row]) -> list[str]:
    """Returns the cells of a line of the table, with 95 % intervals: Wilson's of shares, and bootstrap of means."""
    solved = sum(row["quality"] >= 1 for row in rows)
    share = stats.binomtest(solved, len(rows)).proportion_ci(method="wilson")
    qualities = [row["quality"] for row in rows]
    low, high = bootstrap_interval(qualities) if len(rows) > 2 and np.ptp(qualities) else (qualities[0], qualities[0])
    generations = [row["generations"] for row in rows if row["quality"] >= 1]
    return [
        str(len(rows)),
        str(solved),
        f"{solved / len(rows):.2f} ({share.low:.2f} to {share.high:.2f})",
        f"{np.mean(qualities):.3f} ({low:.3f} to {high:.3f})",
        str(min(row["flaws"] for row in rows)),
        f"{np.median(generations):.0f}" if generations else "",
    ]


if __name__ == "__main__":
    leave(main())
