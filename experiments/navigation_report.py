"""Tables and figures of `navigation.py`, from the files of its finished runs."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from figures import save
from matplotlib.figure import Figure
from navigation_tasks import CONDITIONS, TASKS
from numpy.typing import ArrayLike, NDArray
from report import table
from scipy import stats
from significance import bootstrap_interval

from elitelanes_jax._util.atomic_io import write_atomic
from elitelanes_jax.problem.descriptor import Axis
from elitelanes_jax.tiles.render import render
from elitelanes_jax.tiles.tileset import load_tiles

__all__ = ["Difference", "correlation", "difference", "hard_niches", "read_runs", "success_by_niche", "write_report"]

TESTS = {
    "trained on": "its own maps",
    "seen": "niches trained on",
    "held out": "niches held out",
    "test ea": "EA",
    "test wfc": "WFC",
    "test random": "random",
    "human-made": "made by hand",
}
"""The tests by name, with words for their maps."""

_REFERENCE = {"lane": "maps-100", "map": "maps-1000", "window": "maps-1000"}
_ALIKE = ("seen", "held out")
_FEATURES = ("cyclomatic", "straight_share", "mean_detour", "repetition", "ambiguity")

Runs = dict[tuple[str, str, int], dict[str, Any]]


class Difference(NamedTuple):
    """A mean difference between runs of the same seeds, with its 95 % bootstrap interval; NaN under three seeds."""

    mean: float
    low: float
    high: float
    seeds: int


def read_runs(out: Path) -> Runs:
    """Reads the finished runs of a folder: what `judge` says of each test, by task, condition and seed."""
    runs = {}
    for name in TASKS:
        for condition in CONDITIONS:
            for file in sorted((out / "runs").glob(f"{name}-{condition}-*.json")):
                seed = file.stem.removeprefix(f"{name}-{condition}-")
                if seed.isdigit():
                    runs[name, condition, int(seed)] = json.loads(file.read_text(encoding="utf-8"))
    return runs


def difference(
    runs: Runs, task: str, one: tuple[str, str], other: tuple[str, str], figure: str = "success"
) -> Difference:
    """Compares two (condition, test), over the seeds that both have."""
    pairs = [
        (found[one[1]][figure], runs[task, other[0], seed][other[1]][figure])
        for (name, condition, seed), found in sorted(runs.items())
        if (name, condition) == (task, one[0]) and one[1] in found and other[1] in runs.get((task, other[0], seed), {})
    ]
    apart = [first - second for first, second in pairs]
    mean = float(np.mean(apart)) if apart else float("nan")
    low, high = bootstrap_interval(apart) if len(apart) > 2 else (float("nan"), float("nan"))
    return Difference(mean, low, high, len(apart))


def correlation(failure: ArrayLike, feature: ArrayLike) -> float:
    """Returns Spearman's rank correlation; NaN where one of them is constant."""
    if np.ptp(failure) == 0 or np.ptp(feature) == 0:
        return float("nan")
    return float(stats.spearmanr(failure, feature).statistic)


def success_by_niche(runs: Runs, out: Path, task: str, condition: str) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    """Averages the success on maps of each niche, trained on or held out, over all seeds.

    Returns:
      Means ``[10, 10]``, NaN in niches without a map, and the numbers of maps.
    """
    total, count = np.zeros((10, 10)), np.zeros((10, 10), int)
    for (name, trained, seed), found in runs.items():
        if (name, trained) == (task, condition):
            niches = json.loads((out / "maps" / f"{seed}.json").read_text(encoding="utf-8"))["niches"]
            for test in _ALIKE:
                for (loops, straights), success in zip(niches[test], found[test]["by_map"], strict=True):
                    total[loops, straights] += success
                    count[loops, straights] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), count


def write_report(out: Path, tasks: Sequence[str]) -> None:
    """Writes navigation.md and the figures of all finished runs of some tasks into the folder."""
    runs = {key: found for key, found in read_runs(out).items() if key[0] in tasks}
    trained = [name for name in TASKS if any(key[0] == name for key in runs)]
    parts = ["# Navigation", *(part for name in trained for part in _task_tables(runs, name))]
    if "where" in tasks:
        parts += _places_tables(out)
    parts += _hard_tables(runs, out)
    write_atomic(out / "navigation.md", ("\n\n".join(part.rstrip() for part in parts) + "\n").encode())
    if trained:
        save(_curves(runs, trained), out / "navigation.png")
    heated = [name for name in ("map", "window") if any(key[:2] == (name, "maps-1000") for key in runs)]
    if heated:
        save(_heat(runs, out, heated), out / "niches.png")


def _of(runs: Runs, task: str, condition: str, test: str, figure: str) -> NDArray[np.float64]:
    held = sorted((key[2], found) for key, found in runs.items() if key[:2] == (task, condition))
    return np.array([found[test][figure] for _, found in held if test in found])


def _task_tables(runs: Runs, name: str) -> list[str]:
    """Makes the tables of a task: success by test, the worst tenth, SPL, and the differences from the reference."""
    conditions = [condition for condition in CONDITIONS if any(key[:2] == (name, condition) for key in runs)]
    tests = [test for test in TESTS if any(test in found for key, found in runs.items() if key[0] == name)]
    parts = [f"## {name}: {TASKS[name].words}"]
    figures = {"success": "Success", "worst": "Success on the worst tenth of maps", "spl": "SPL", "tiles": "Tiles"}
    for figure, words in figures.items():
        if figure == ("spl" if name == "lane" else "tiles"):
            continue
        head = ["trained on", "seeds", *(TESTS[test] for test in tests)]
        rows = [
            [
                CONDITIONS[condition].words,
                str(len(_of(runs, name, condition, "seen", figure))),
                *(_mean(_of(runs, name, condition, test, figure), 1 if figure == "tiles" else 3) for test in tests),
            ]
            for condition in conditions
        ]
        parts += [f"### {words}", table(head, rows)]
    reference = _REFERENCE[name]
    head = [f"success less that of {CONDITIONS[reference].words}", *(TESTS[test] for test in tests)]
    rows = [
        [
            CONDITIONS[condition].words,
            *(_words(difference(runs, name, (condition, test), (reference, test))) for test in tests),
        ]
        for condition in conditions
        if condition != reference
    ]
    if any(key[:2] == (name, reference) for key in runs):
        parts += ["### Differences", "Means of runs with the same seed, and 95 % intervals.", table(head, rows)]
    return parts


def _mean(values: NDArray[np.float64], digits: int) -> str:
    return f"{values.mean():.{digits}f}" if len(values) else ""


def _words(apart: Difference) -> str:
    if apart.seeds == 0:
        return ""
    interval = f", {apart.low:+.3f} to {apart.high:+.3f}" if apart.seeds > 2 else ""
    return f"{apart.mean:+.3f}{interval}"


def _places(out: Path) -> list[dict[str, Any]]:
    return [json.loads(file.read_text(encoding="utf-8")) for file in sorted((out / "runs").glob("where-*.json"))]


def _places_tables(out: Path) -> list[str]:
    """Makes the table of task "where": means over maps, then over seeds."""
    found = _places(out)
    if not found:
        return []
    keys = {"never": "places never known", "tiles": "tiles until known", "ambiguity": "ambiguity, tiles"}
    keys |= {
        "cyclomatic": "cyclomatic number",
        "straight_share": "straights",
        "mean_detour": "mean detour",
        "repetition": "repetition",
    }
    rows = [
        [TESTS[test], *(f"{np.mean([np.mean(seed[test][key]) for seed in found]):.3g}" for key in keys)]
        for test in TESTS
        if test in found[0]
    ]
    return ["## where: find out where on a known map one is", table(["maps", *keys.values()], rows)]


def _hard_tables(runs: Runs, out: Path) -> list[str]:
    """Makes the table of what makes a map hard: correlations of failures with features, over unseen maps."""
    places = {int(file.stem.removeprefix("where-")): file for file in (out / "runs").glob("where-*.json")}
    rows = []
    for task in ("map", "window"):
        by_feature: dict[str, list[float]] = {feature: [] for feature in _FEATURES}
        for (name, condition, seed), found in sorted(runs.items()):
            if (name, condition) == (task, "maps-1000") and seed in places:
                known = json.loads(places[seed].read_text(encoding="utf-8"))
                failure = 1 - np.concatenate([found[test]["by_map"] for test in _ALIKE])
                for feature, values in by_feature.items():
                    values.append(correlation(failure, np.concatenate([known[test][feature] for test in _ALIKE])))
        if by_feature["ambiguity"]:
            rows.append([f"{task}, {CONDITIONS['maps-1000'].words}", *map(_correlated, by_feature.values())])
    if not rows:
        return []
    about = "Spearman's rank correlation of a map's failures with its features, over all unseen maps of MAP-Elites."
    return ["## What makes a map hard", about, table(["driver", *_FEATURES], rows)]


def _correlated(values: Sequence[float]) -> str:
    known = [value for value in values if np.isfinite(value)]
    if not known:
        return ""
    low, high = bootstrap_interval(known) if len(known) > 2 else (np.nan, np.nan)
    return f"{np.mean(known):+.2f}" + (f", {low:+.2f} to {high:+.2f}" if len(known) > 2 else "")


def _curves(runs: Runs, tasks: Sequence[str]) -> Figure:
    """Plots the success of every run by the number of maps trained on; other sources beside."""
    plot, axes = plt.subplots(1, len(tasks), figsize=(5.2 * len(tasks), 4.2), layout="constrained", squeeze=False)
    shown = {"seen": "#1b6ca8", "held out": "#e08e2b", "test ea": "#6a994e", "trained on": "#999999"}
    for name, ax in zip(tasks, axes[0], strict=True):
        conditions = [condition for condition in CONDITIONS if any(key[:2] == (name, condition) for key in runs)]
        for number, (test, colour) in enumerate(shown.items()):
            places, means = [], []
            for place, condition in enumerate(conditions):
                values = _of(runs, name, condition, test, "success")
                if len(values):
                    at = place + 0.09 * (number - 1.5)
                    ax.plot([at] * len(values), values, "o", color=colour, markersize=3, alpha=0.5)
                    places.append(at)
                    means.append(values.mean())
            ax.plot(places, means, "_", color=colour, markersize=12, markeredgewidth=2.5, label=TESTS[test])
        ax.set_xticks(range(len(conditions)), [CONDITIONS[c].words for c in conditions], rotation=40, ha="right")
        ax.tick_params(axis="x", labelsize=8)
        ax.set_title(TASKS[name].words.capitalize(), fontsize=9)
        ax.set_ylabel("success")
        ax.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8, title="tested on", title_fontsize=8)
    return plot


def _heat(runs: Runs, out: Path, tasks: Sequence[str]) -> Figure:
    """Draws the success of drivers trained on 1000 maps in each niche, with the number of maps tested."""
    plot, axes = plt.subplots(1, len(tasks), figsize=(5.6 * len(tasks), 4.6), layout="constrained", squeeze=False)
    for name, ax in zip(tasks, axes[0], strict=True):
        means, count = success_by_niche(runs, out, name, "maps-1000")
        image = ax.imshow(means.T, origin="lower", cmap="viridis", vmax=1)
        for place in np.argwhere(count > 0):
            mean, middle = means[tuple(place)], (np.nanmin(means) + 1) / 2
            words = {"ha": "center", "va": "center", "fontsize": 6, "color": "white" if mean < middle else "black"}
            ax.text(*place, f"{mean:.2f}\n{count[tuple(place)]}", **words)
        ax.set_xticks(range(10), [f"{2 * low}" for low in range(10)])
        ax.set_yticks(range(10), [f"{8 * low} %" for low in range(10)])
        ax.set_xlabel("loops (cyclomatic number), from")
        ax.set_ylabel("straights, from")
        ax.set_title(f"{name}: success by niche, and maps tested", fontsize=9)
        plot.colorbar(image, ax=ax, shrink=0.8)
    return plot


def hard_niches(
    grids: NDArray[np.int8], bins: NDArray[np.int_], failures: NDArray[np.float64], axes: Sequence[Axis]
) -> Figure:
    """Draws the mean failure rate in each niche of an archive, and the hardest map of each of the six hardest niches.

    Of niches with fewer than three maps none is shown: chance would choose them.

    Args:
      grids: codes ``[N, H, W]``.
      bins: of each grid, ``[N, 2]``.
      failures: of each grid, shares.
      axes: the two axes.
    """
    extent = tuple(axis.bins for axis in axes)
    total, count = np.zeros(extent), np.zeros(extent)
    np.add.at(total, tuple(bins.T), failures)
    np.add.at(count, tuple(bins.T), 1)
    means = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    plot = plt.figure(figsize=(12, 5.2), layout="constrained")
    halves: Any = plot.subfigures(1, 2, width_ratios=(1.1, 1))
    left, right = halves
    ax = left.subplots()
    image = ax.imshow(means.T, origin="lower", cmap="magma", aspect="auto")
    names = ("loops (cyclomatic number), from", "ambiguity of places (tiles until one is known), from")
    for number, (axis, name) in enumerate(zip(axes, names, strict=True)):
        lows = [axis.start + axis.width * place for place in range(axis.bins)]
        shown = [f"{low / (100 if number else 1):g}" for low in lows]
        (ax.set_yticks if number else ax.set_xticks)(range(axis.bins), shown)
        (ax.set_ylabel if number else ax.set_xlabel)(name)
    left.colorbar(image, ax=ax, label="failure rate of the driver")
    enough = [tuple(place) for place in np.argwhere(count >= min(3, count.max()))]
    hardest = sorted(enough, key=lambda place: -means[place])[:6]
    tiles = load_tiles()
    for ax, place in zip(right.subplots(2, 3).flat, hardest, strict=False):
        among = np.flatnonzero((bins == place).all(axis=1))
        worst = among[failures[among].argmax()]
        ax.imshow(render(grids[worst], tiles, tile_px=32).image)
        loops, tiles_to_go = (axis.start + axis.width * at for axis, at in zip(axes, place, strict=True))
        words = f"{loops} loops, {tiles_to_go / 100:g} tiles: {means[place]:.0%} fail"
        ax.set_title(f"{words}\nthis map: {failures[worst]:.0%}", fontsize=8)
    for ax in right.axes:
        ax.axis("off")
    right.suptitle("the hardest map of each of the six hardest niches", fontsize=10)
    return plot
