"""Searches compared with proven optima, and with constraints that some network is known to meet.

python -m experiments.search.optimum [--out DIR] [--quick]

What is done is kept in the folder, and a search goes on where it was: killed at any moment, the same command continues.

Compares the presets with the proven optima, fills the niches of the cyclomatic number, searches under random
constraints, and makes maps after Duckietown's rules. A search is given nothing that is known: optima, the best fitness
found before and the comb are only compared with its results.
"""

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import evolve, fitness, measure
from elitelanes_jax._util.checks import path
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.folders import remove
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.cli.arguments import Parser, add_cores, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.formats import LINES
from elitelanes_jax.network import canonical_form
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.problem import SHARES, coverage, gaps, qd_score
from elitelanes_jax.search import Result, use_compile_cache
from experiments.common import kept, open_results

# The proven optima by side, from integer programming: of grids with all cells filled (A), or some left empty (B).
OPTIMA = {
    True: {3: -10, 4: -18, 5: -56, 6: -158, 8: -438, 12: -1898},
    False: {3: -10, 4: -34, 5: -82, 6: -158, 8: -466, 12: -2034},
}

FLAWS = ("dead_ends", "adjacent_crossings", "adjacent_turns")

METHODS = ("ea", "pso", "gwo", "map-elites")

COLUMNS = [
    "grid",
    "method",
    "preset",
    "evaluations",
    "optimum",
    "found",
    "reached",
    "after evaluations",
    "µs each",
    "ms",
]

# By method and preset: evaluations, and the median gap to the optimum.
Curves = dict[str, tuple[list[int], list[float]]]

LINES_OF = {"tuned": "-", "standard": "--", "paper": ":"}

# The runs: side, whether every cell is filled, method, preset, evaluations.
RUNS = [
    *[(side, fill, one, "tuned", 100_000) for side in (3, 4, 5, 6, 8) for fill in (True, False) for one in METHODS],
    *[(8, True, one, "paper", 100_000) for one in METHODS],
    (8, True, "map-elites", "standard", 100_000),
    *[(12, True, one, preset, 300_000) for preset in ("tuned", "paper") for one in METHODS],
    (12, True, "map-elites", "standard", 300_000),
    (12, False, "ea", "tuned", 2_000_000),
    *[(12, False, one, "tuned", 300_000) for one in METHODS[1:]],
    (16, True, "ea", "tuned", 1_000_000),
    (24, True, "ea", "tuned", 1_000_000),
]

_COMB = ("┌─ ┬─── ┬┐", "├┐ │┌┬┐ ││", "││ ││││ ││", "││ └┴┘│ └┤", "└┴ ───┴ ─┘")


def comb(side: int) -> NDArray[np.int8]:
    """Makes the densest grid of long streets side by side, for sides of multiples of 4; at 12 it is an optimum."""
    lines = [left + middle * (side // 4 - 1) + right for left, middle, right in (line.split(" ") for line in _COMB)]
    lines = [*lines[:2], *[lines[2]] * (side - 4), *lines[3:]]
    return np.array([[LINES.index(sign) for sign in line] for line in lines], np.int8)


def timed(place: Path, seeds: int, side: int, evaluations: int, **setting: Any) -> tuple[Result, float]:
    """Runs several seeds on a square, from where an earlier run was; returns the result and its seconds of search."""
    result = evolve(seed_keys(0, seeds), (side, side), evaluations=evaluations, checkpoint=place, every=30, **setting)
    return result, result.history.seconds


def step(folder: Path, name: str, make: Callable[[Path], Any]) -> Any:
    """Returns what an earlier run has kept under a name, else what `make` returns; it has a place for checkpoints."""
    place = folder / f"{name}-search"
    made = kept(folder / f"{name}.json", lambda: make(place))
    remove(place)
    return made


def reach(folder: Path, quick: bool) -> tuple[list[str], Curves]:
    """Makes the rows of the table of optima, and the curves of the gap at 12 x 12."""
    rows, curves = [], {}
    for side, fill, method, preset, budget in RUNS:
        name = f"{side}{'A' if fill else 'B'}-{method}-{preset}"
        row, curve = step(folder, name, partial(reach_one, quick, side, fill, method, preset, budget))
        rows.append(row)
        print(row, flush=True)
        if (side, fill) == (12, True):
            curves[f"{method}, {preset}"] = curve
    return rows, curves


def reach_one(
    quick: bool, side: int, fill: bool, method: str, preset: str, budget: int, place: Path
) -> tuple[str, tuple[list[int], list[float]]]:
    """Makes one row of the table, and the curve of its gap: evaluations and the median over seeds."""
    seeds = 2 if quick else 4 if side > 16 else 16
    budget = budget // 50 if quick else budget
    result, seconds = timed(place, seeds, side, budget, method=method, preset=preset, fill=fill)
    best = result.history.best_fitness
    goal = OPTIMA[fill].get(side, int(fitness(measure(comb(side)))) if side % 4 == 0 else None)
    reached = best <= goal
    first = np.where(reached.any(axis=1), result.history.evaluations[reached.argmax(axis=1)], -1)
    last = best[:, -1]
    per = 1e6 * seconds / (seeds * result.history.evaluations[-1])
    soon = took = ""
    if (first > 0).any():
        median = np.median(first[first > 0])
        soon, took = f"{int(median):,}, at most {first.max():,}", f"{median * per / 1000:,.2f}"
    found = f"{int(last.min()):,} to {int(last.max()):,}" if last.min() < last.max() else f"{int(last.min()):,}"
    mark = "" if side in OPTIMA[fill] else " (comb)"
    row = (
        f"| {side} {'A' if fill else 'B'} | {method} | {preset} | {budget:,} | {goal:,}{mark} | {found} "
        f"| {(first > 0).sum()} of {seeds} | {soon} | {per:.1f} | {took} |"
    )
    return row, (result.history.evaluations.tolist(), np.median(best - goal, axis=0).tolist())


def niches(quick: bool, fill: bool, place: Path) -> list[str]:
    """Measures how many of the feasible flawless niches of the cyclomatic number runs fill, and their fitness."""
    budget = 5_000_000 if fill else 2_000_000
    seeds, evaluations = (1, budget // 100) if quick else (8, budget)
    result, seconds = timed(place, seeds, 12, evaluations, preset="tuned", fill=fill)
    metrics = result.elites.metrics
    flawless = np.array(result.elites.valid & (metrics.components == 1))
    for name in FLAWS:
        flawless &= np.asarray(getattr(metrics, name)) == 0
    least, most = (3, 21) if fill else (1, 24)
    best = np.full((len(flawless), 25), np.inf)
    for seed, place in np.argwhere(flawless):
        number = min(int(metrics.cyclomatic[seed, place]), 24)
        best[seed, number] = min(best[seed, number], int(result.elites.fitness[seed, place]))
    best = best[:, least : most + 1]
    filled = np.isfinite(best)
    row = f"{'A' if fill else 'B'}: filled {sorted(filled.sum(axis=1).tolist())} of {best.shape[1]} in "
    row += f"{budget:,} evaluations, {coverage(filled).mean():.0%} in the mean; {seconds:.0f} s for all seeds. "
    row += f"QD score {qd_score(best, filled, 0).mean():,.0f} in the mean (an elite of fitness 0 counts nothing)."
    optima = find_task("12x12A-10000").optimum if fill else None
    if optima is not None:
        row += f" At the optimum: {sorted((best == optima).sum(axis=1).tolist())}."
    return [row, niche_table(best, least, optima)]


def niche_table(best: NDArray[np.float64], least: int, optima: NDArray[np.int_] | None) -> str:
    """Makes a table of the elites of runs ``[R, N]``, vacant niches infinite, and of their gaps to the optima."""
    lines = ["| cyclomatic number | filled | best | median |", "|---:|---:|---:|---:|"]
    if optima is not None:
        lines = [lines[0] + " best against the optimum | median |", lines[1] + "---:|---:|"]
    for place, elites in enumerate(best.T):
        of = elites[np.isfinite(elites)]
        told = [f"{least + place}", f"{len(of)} of {len(elites)}"]
        figures = np.array([of.min(), np.median(of)]) if len(of) else np.array([])
        told += [f"{value:,.0f}" for value in figures] or ["", ""]
        if optima is not None:
            told += [f"{gap:+,.0f}" for gap in gaps(figures, np.isfinite(figures), optima[place])] or ["", ""]
        lines.append(f"| {' | '.join(told)} |")
    return "\n".join(lines)


def constraints(quick: bool) -> str:
    """Searches under random constraints that a known map meets, each for at most ten seconds."""
    archive = evolve(seed_keys(7, 4), (12, 12), preset="tuned", fill=True, evaluations=10_000 if quick else 200_000)
    usable = np.argwhere(np.asarray(archive.elites.valid & (archive.elites.metrics.components == 1)))
    rng = np.random.default_rng(0)
    names = ("crossings", "cyclomatic", "straight_share", "turn_share", "adjacent_turns", "bridges", "straight_score")
    count, met, times = 3 if quick else 100, 0, []
    for number in range(count):
        place = tuple(usable[rng.integers(len(usable))])
        where = {}
        for name in rng.choice(names, 3, replace=False).tolist():
            share = name in SHARES
            part = SHARES[name][0] if share else name
            value = float(getattr(archive.elites.metrics, part)[place]) / (144 if share else 1)
            width = 0.05 if share else max(1, value // 10)
            low, high = max(0, value - width), value + width
            where[name] = (round(low, 4), round(min(high, 1), 4)) if share else (int(low), int(high))
        began, state, done = time.perf_counter(), None, False
        setting: dict[str, Any] = {"method": "ea", "preset": "tuned", "fill": True, "where": where}
        if not number:
            evolve(seed_keys(number, 4), (12, 12), evaluations=1, **setting)  # compiled once for all
            began = time.perf_counter()
        while not done and time.perf_counter() - began < 10:
            result = evolve(seed_keys(number, 4), (12, 12), evaluations=8000, state=state, **setting)
            state, done = result.state, bool(result.satisfies().any())
        met += done
        times.append(time.perf_counter() - began)
    text = f"{met} of {count} random sets of three ranges met; "
    return f"{text}median {np.median(times):.1f} s, longest {max(times):.1f} s."


def duckietown(quick: bool) -> str:
    """Makes a thousand maps of 9 x 9 after Duckietown's rules."""
    wanted, began = 20 if quick else 1000, time.perf_counter()
    result = evolve(
        seed_keys(0, 2 if quick else 32),
        (9, 9),
        preset="tuned",
        rules="duckietown",
        axes=("cyclomatic:16", "tiles:27:3"),
        evaluations=10_000 if quick else 100_000,
    )
    maps = result.choose(wanted).maps
    seconds = time.perf_counter() - began
    distinct = len({canonical_form(road_map.codes) for road_map in maps})
    return (
        f"{distinct} distinct 9 x 9 maps after Duckietown's rules in {seconds:.0f} s, compilation and choice included."
    )


def draw(curves: Curves, file: Path) -> None:
    """Plots the median gap to the optimum against evaluations."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    colours = dict(zip(METHODS, ("#1b6ca8", "#66a182", "#edae49", "#d1495b"), strict=True))
    for name, (evaluations, gap) in curves.items():
        method, preset = name.split(", ")
        axes.plot(evaluations, np.array(gap) + 1, LINES_OF[preset], color=colours[method], label=name)
    axes.set(xscale="log", yscale="log", xlabel="evaluations of a seed", ylabel="fitness above the optimum + 1, median")
    axes.set_title("12 x 12, every cell filled")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=2)
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="optimum.py", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--out", type=checked_by(path), default=Path("results/optimum"), help="folder to write to")
    parser.add_argument("--quick", action="store_true", help="tiny budgets, to see that it runs")
    add_cores(parser)
    options = parser.parse_args(arguments)
    return guarded("optimum.py", lambda: _run(options), interrupted="what is done is kept; the same command continues")


def _run(options: argparse.Namespace) -> int:
    use_compile_cache()
    parts = options.out / "parts"
    open_results(parts, {"quick": options.quick, "versions": installed_versions()})
    rows, curves = reach(parts, options.quick)
    told = [
        line for fill in (True, False) for line in step(parts, f"niches-{fill}", partial(niches, options.quick, fill))
    ]
    told += [
        step(parts, "constraints", lambda _: constraints(options.quick)),
        step(parts, "duckietown", lambda _: duckietown(options.quick)),
    ]
    print(*told, sep="\n", flush=True)
    header = [f"| {' | '.join(COLUMNS)} |", f"|{'---|' * 3}{'---:|' * (len(COLUMNS) - 3)}"]
    text = "\n".join([*header, *rows, "", *(f"{line}\n" for line in told)])
    write_atomic(options.out / "optimum.md", text.encode())
    draw(curves, options.out / "optimum.png")
    say(f"written to {options.out}")
    return 0


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
