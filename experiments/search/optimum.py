"""Compares searches with proven optima: of all networks, and of each cyclomatic number.

    python -m experiments.search.optimum [--out DIR] [--cores N] [--quick]

A search is given nothing that is known: optima are only compared with its results. The folder keeps finished parts and
checkpoints: after an interruption, the same command continues.
"""

import argparse
import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import matplotlib as mpl

mpl.use("Agg")
import jax
import matplotlib.pyplot as plt
import numpy as np

from elitelanes_jax import SearchSpec, __version__, evolve
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, add_cores, kept, leave, open_results, run, save, table, write

__all__ = ["METHODS", "OPTIMA", "RUNS", "main"]

T = TypeVar("T")

# The proven optima by side, of grids with all cells filled (A), and of grids that may have empty cells (B).
OPTIMA = {
    True: {3: -10, 4: -18, 5: -56, 6: -158, 8: -438, 12: -1898},
    False: {3: -10, 4: -34, 5: -82, 6: -158, 8: -466, 12: -2034},
}

METHODS = ("ea", "pso", "gwo", "map-elites")

# The runs: side, whether every cell is filled, method, preset, evaluations.
RUNS = [
    *[(side, fill, one, "tuned", 100_000) for side in (3, 4, 5, 6, 8) for fill in (True, False) for one in METHODS],
    *[(8, True, one, "paper", 100_000) for one in METHODS],
    (8, True, "map-elites", "standard", 100_000),
    *[(12, True, one, preset, 300_000) for preset in ("tuned", "paper") for one in METHODS],
    (12, True, "map-elites", "standard", 300_000),
    (12, False, "ea", "tuned", 2_000_000),
    *[(12, False, one, "tuned", 300_000) for one in METHODS[1:]],
]

# Grids with certificates, and the evaluations of each run of MAP-Elites.
NICHES = {
    **{"7x7B": 600_000, "8x8B": 1_000_000, "9x9A": 1_000_000, "9x9B": 2_000_000},
    **{"10x10A": 1_000_000, "12x12A": 5_000_000},
}

_HEAD = ["grid", "method", "preset", "evaluations", "optimum", "found", "reached"]
_HEAD += ["after evaluations", "µs each", "ms"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("optimum", __doc__)
    parser.add_argument("--out", type=Path, default=Path("results/optimum"), metavar="DIR", help="folder of results")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to test the program")
    add_cores(parser)
    options = parser.parse_args(arguments)
    return run("optimum", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    use_compile_cache()
    parts, quick = options.out / "parts", options.quick
    open_results(parts, {"quick": quick, "version": __version__, "jax": jax.__version__})
    rows, curves = [], {}
    for side, fill, method, preset, budget in RUNS:
        name = f"{side}{'A' if fill else 'B'}-{method}-{preset}"
        row, evaluations, gap = _part(parts, name, partial(_reach, quick, side, fill, method, preset, budget))
        rows.append(row)
        print(" | ".join(row), flush=True)
        if (side, fill) == (12, True):
            curves[method, preset] = (evaluations, gap)
    niches = []
    for size, budget in NICHES.items():
        niches.append(_part(parts, f"niches-{size}", partial(_count_niches, quick, size, budget)))
        print(" | ".join(niches[-1]), flush=True)
    head = ["grid", "evaluations of a run", "(niche, run) pairs at the certified optimum", "filled"]
    head += ["by cyclomatic number, runs at the optimum"]
    write(options.out / "optimum.md", f"{table(_HEAD, rows, left=3)}\n{table(head, niches)}")
    _draw(curves, options.out / "optimum.png")
    print(f"written to {options.out}")


def _part(folder: Path, name: str, make: Callable[[Path], T]) -> T:
    """Returns what an earlier run has kept under a name; if there is nothing, what `make` returns.

    `make` gets a folder for checkpoints, which is removed when it is done.
    """
    checkpoint = folder / f"{name}-search"
    made = kept(folder / f"{name}.json", lambda: make(checkpoint))
    shutil.rmtree(checkpoint, ignore_errors=True)
    return made


def _reach(
    quick: bool, side: int, fill: bool, method: str, preset: str, budget: int, checkpoint: Path
) -> tuple[list[str], list[int], list[float]]:
    """Makes a row of the table of optima, and the curve of the gap: evaluations, and the median over seeds."""
    seeds = 2 if quick else 16
    budget = budget // 50 if quick else budget
    spec, shape = SearchSpec(method=method, preset=preset, fill=fill, evaluations=budget), (side, side)
    history = evolve(seed_keys(0, seeds), shape, spec=spec, checkpoint=checkpoint, every=30).history
    best, last = history.best_fitness, history.best_fitness[:, -1]
    goal = OPTIMA[fill][side]
    reached = best <= goal
    first = history.evaluations[reached.argmax(axis=1)][reached.any(axis=1)]
    microseconds = 1e6 * history.seconds / (seeds * history.evaluations[-1])
    after = time = ""
    if len(first):
        median = np.median(first)
        after, time = f"{int(median):,}, at most {first.max():,}", f"{median * microseconds / 1000:,.2f}"
    row = [f"{side} {'A' if fill else 'B'}", method, preset, f"{budget:,}"]
    row += [f"{goal:,}"]
    row += [f"{int(last.min()):,} to {int(last.max()):,}" if last.min() < last.max() else f"{int(last.min()):,}"]
    row += [f"{len(first)} of {seeds}", after, f"{microseconds:.1f}", time]
    return row, history.evaluations.tolist(), np.median(best - goal, axis=0).tolist()


def _count_niches(quick: bool, size: str, budget: int, checkpoint: Path) -> list[str]:
    """Makes a row of the table of niches, of eight runs of the tuned MAP-Elites."""
    task, (seeds, evaluations) = find_task(f"{size}-10000"), (2, budget // 300) if quick else (8, budget)
    spec = SearchSpec(preset="tuned", fill=task.fill, evaluations=evaluations)
    elites = evolve(seed_keys(700, seeds), task.shape, spec=spec, checkpoint=checkpoint, every=30).elites
    metrics = jax.device_get(elites.metrics)
    flaws = metrics.dead_ends + metrics.adjacent_crossings + metrics.adjacent_turns + (metrics.components != 1)
    in_niche = (np.asarray(elites.valid) & (flaws == 0))[..., None] & (metrics.cyclomatic[..., None] == task.cyclomatic)
    optimal = (in_niche & (np.asarray(elites.fitness)[..., None] == task.optimum)).any(axis=1)
    filled = in_niche.any(axis=1).mean()
    runs = " ".join(f"{number}:{hits}" for number, hits in zip(task.cyclomatic, optimal.sum(axis=0), strict=True))
    return [size, f"{evaluations:,}", f"{optimal.sum()} of {optimal.size}", f"{filled:.0%}", runs]


def _draw(curves: Mapping[tuple[str, str], tuple[list[int], list[float]]], file: Path) -> None:
    """Plots the median gap to the optimum against evaluations."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    colours = dict(zip(METHODS, ("#1b6ca8", "#66a182", "#edae49", "#d1495b"), strict=True))
    lines = {"tuned": "-", "standard": "--", "paper": ":"}
    for (method, preset), (evaluations, gap) in curves.items():
        axes.plot(evaluations, np.array(gap) + 1, lines[preset], color=colours[method], label=f"{method}, {preset}")
    axes.set(xscale="log", yscale="log", xlabel="evaluations of a seed", ylabel="fitness above the optimum + 1, median")
    axes.set_title("12 x 12, every cell filled")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2)
    save(figure, file, dpi=130)


if __name__ == "__main__":
    leave(main())
