"""Compares searches with proven optima, counts the niches that they fill, and tests constraints and rules.

    python -m experiments.search.optimum [--out DIR] [--cores N] [--quick]

A search is given nothing that is known: optima, the best fitness found before and the comb are only compared with its
results. The folder keeps finished parts and checkpoints: after an interruption, the same command continues.
"""

import argparse
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeVar

import matplotlib as mpl

mpl.use("Agg")
import jax
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import Result, SearchSpec, __version__, evolve, fitness, measure
from elitelanes_jax.benchmark import find_task
from elitelanes_jax.formats import LINES
from elitelanes_jax.network import canonical_form
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.problem import SHARES, coverage, qd_score
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, add_cores, kept, leave, open_results, run, save, table, write

__all__ = ["METHODS", "OPTIMA", "RUNS", "comb", "main", "niche_table"]

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
    (16, True, "ea", "tuned", 1_000_000),
    (24, True, "ea", "tuned", 1_000_000),
]

_HEAD = ["grid", "method", "preset", "evaluations", "optimum", "found", "reached"]
_HEAD += ["after evaluations", "µs each", "ms"]

_COMB = ("┌─ ┬─── ┬┐", "├┐ │┌┬┐ ││", "││ ││││ ││", "││ └┴┘│ └┤", "└┴ ───┴ ─┘")


def comb(side: int) -> NDArray[np.int8]:
    """Makes the densest grid of long streets side by side, for sides of multiples of 4; at 12 it is an optimum."""
    lines = [left + middle * (side // 4 - 1) + right for left, middle, right in (line.split(" ") for line in _COMB)]
    lines = [*lines[:2], *[lines[2]] * (side - 4), *lines[3:]]
    return np.array([[LINES.index(sign) for sign in line] for line in lines], np.int8)


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
    texts = [text for fill in (True, False) for text in _part(parts, f"niches-{fill}", partial(_niches, quick, fill))]
    texts += [
        _part(parts, "constraints", lambda _: _constraints(quick)),
        _part(parts, "duckietown", lambda _: _duckietown(quick)),
    ]
    print(*texts, sep="\n", flush=True)
    write(options.out / "optimum.md", "\n".join([table(_HEAD, rows, left=3), *(f"{text}\n" for text in texts)]))
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


def _search(checkpoint: Path, seeds: int, side: int, evaluations: int, spec: SearchSpec) -> Result:
    """Runs several seeds on a square, from where an earlier run was."""
    return evolve(
        seed_keys(0, seeds), (side, side), spec=spec, evaluations=evaluations, checkpoint=checkpoint, every=30
    )


def _reach(
    quick: bool, side: int, fill: bool, method: str, preset: str, budget: int, checkpoint: Path
) -> tuple[list[str], list[int], list[float]]:
    """Makes a row of the table of optima, and the curve of the gap: evaluations, and the median over seeds."""
    seeds = 2 if quick else 4 if side > 16 else 16
    budget = budget // 50 if quick else budget
    history = _search(checkpoint, seeds, side, budget, SearchSpec(method=method, preset=preset, fill=fill)).history
    best, last = history.best_fitness, history.best_fitness[:, -1]
    proven = OPTIMA[fill].get(side)
    goal = int(fitness(measure(comb(side)))) if proven is None else proven
    reached = best <= goal
    first = history.evaluations[reached.argmax(axis=1)][reached.any(axis=1)]
    microseconds = 1e6 * history.seconds / (seeds * history.evaluations[-1])
    after = time = ""
    if len(first):
        median = np.median(first)
        after, time = f"{int(median):,}, at most {first.max():,}", f"{median * microseconds / 1000:,.2f}"
    row = [f"{side} {'A' if fill else 'B'}", method, preset, f"{budget:,}"]
    row += [f"{goal:,}" + (" (comb)" if proven is None else "")]
    row += [f"{int(last.min()):,} to {int(last.max()):,}" if last.min() < last.max() else f"{int(last.min()):,}"]
    row += [f"{len(first)} of {seeds}", after, f"{microseconds:.1f}", time]
    return row, history.evaluations.tolist(), np.median(best - goal, axis=0).tolist()


def _niches(quick: bool, fill: bool, checkpoint: Path) -> list[str]:
    """Measures how many of the feasible flawless niches of the cyclomatic number runs fill, and their fitness."""
    budget = 5_000_000 if fill else 2_000_000
    seeds, evaluations = (1, budget // 100) if quick else (8, budget)
    result = _search(checkpoint, seeds, 12, evaluations, SearchSpec(preset="tuned", fill=fill))
    metrics = result.elites.metrics
    flawless = np.array(result.elites.valid & (metrics.components == 1))
    for name in ("dead_ends", "adjacent_crossings", "adjacent_turns"):
        flawless &= np.asarray(getattr(metrics, name)) == 0
    least, most = (3, 21) if fill else (1, 24)
    best = np.full((len(flawless), 25), np.inf)
    cyclomatic = np.minimum(metrics.cyclomatic, 24)
    for seed, slot in np.argwhere(flawless):
        niche = int(cyclomatic[seed, slot])
        best[seed, niche] = min(best[seed, niche], int(result.elites.fitness[seed, slot]))
    best = best[:, least : most + 1]
    filled = np.isfinite(best)
    text = (
        f"{'A' if fill else 'B'}: filled {sorted(filled.sum(axis=1).tolist())} of {best.shape[1]} in {budget:,} "
        f"evaluations, mean {coverage(filled).mean():.0%}; {result.history.seconds:.0f} s for all seeds. "
        f"Mean QD score {qd_score(best, filled, 0).mean():,.0f} (an elite of fitness 0 counts nothing)."
    )
    optima = find_task("12x12A-10000").optimum if fill else None
    if optima is not None:
        text += f" At the optimum: {sorted((best == optima).sum(axis=1).tolist())}."
    return [text, niche_table(best, least, optima)]


def niche_table(best: NDArray[np.float64], least: int, optima: NDArray[np.int_] | None) -> str:
    """Makes a table of the elites in each niche, and of their gaps to the optima.

    Args:
      best: the fitness of R runs in N niches, ``[R, N]``, infinite in vacant niches.
      least: the cyclomatic number of the first niche.
      optima: ``[N]``, None if they are not proven.
    """
    rows = []
    for index, column in enumerate(best.T):
        elites = column[np.isfinite(column)]
        figures = np.array([elites.min(), np.median(elites)]) if len(elites) else np.array([])
        row = [f"{least + index}", f"{len(elites)} of {len(column)}"]
        row += [f"{value:,.0f}" for value in figures] or ["", ""]
        if optima is not None:
            row += [f"{gap:+,.0f}" for gap in figures - optima[index]] or ["", ""]
        rows.append(row)
    head = ["cyclomatic number", "filled", "best", "median"]
    return table(head + (["best against the optimum", "median"] if optima is not None else []), rows, left=0)


def _constraints(quick: bool) -> str:
    """Searches under random constraints that a known map meets, each for at most ten seconds."""
    archive = evolve(seed_keys(7, 4), (12, 12), preset="tuned", fill=True, evaluations=10_000 if quick else 200_000)
    usable = np.argwhere(np.asarray(archive.elites.valid & (archive.elites.metrics.components == 1)))
    rng = np.random.default_rng(0)
    names = ("crossings", "cyclomatic", "straight_share", "turn_share", "adjacent_turns", "bridges", "straight_score")
    spec = SearchSpec(method="ea", preset="tuned", fill=True)
    count, met, times = 3 if quick else 100, 0, []
    for index in range(count):
        seed, slot = usable[rng.integers(len(usable))]
        where = {}
        for name in rng.choice(names, 3, replace=False).tolist():
            share = name in SHARES
            part = SHARES[name][0] if share else name
            value = float(getattr(archive.elites.metrics, part)[seed, slot]) / (144 if share else 1)
            width = 0.05 if share else max(1, value // 10)
            low, high = max(0, value - width), value + width
            where[name] = (round(low, 4), round(min(high, 1), 4)) if share else (int(low), int(high))
        search = partial(evolve, seed_keys(index, 4), (12, 12), spec=spec, where=where)
        if not index:
            search(evaluations=1)  # compiles, once for all
        began, state, done = time.perf_counter(), None, False
        while not done and time.perf_counter() - began < 10:
            result = search(evaluations=8000, state=state)
            state, done = result.state, bool(result.satisfies().any())
        met += done
        times.append(time.perf_counter() - began)
    found = f"{met} of {count} random sets of three ranges met"
    return f"{found}; median {np.median(times):.1f} s, longest {max(times):.1f} s."


def _duckietown(quick: bool) -> str:
    """Makes a thousand maps of 9 x 9 after Duckietown's rules."""
    count, seeds, evaluations = (20, 2, 10_000) if quick else (1000, 32, 100_000)
    spec = SearchSpec(preset="tuned", rules="duckietown")
    began = time.perf_counter()
    axes = "cyclomatic:16 tiles:27:3"
    maps = evolve(seed_keys(0, seeds), (9, 9), spec=spec, axes=axes, evaluations=evaluations).choose(count).maps
    seconds = time.perf_counter() - began
    different = len({canonical_form(road_map.codes) for road_map in maps})
    return (
        f"{different} distinct 9 x 9 maps after Duckietown's rules in {seconds:.0f} s, compilation and choice included."
    )


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
