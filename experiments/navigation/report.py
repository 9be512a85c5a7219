"""Tables and figures of `navigation.py`, from the files of its finished runs."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from elitelanes_jax.problem import Axis
from elitelanes_jax.tiles import load_tiles, render
from experiments.common import Untyped, save, table, write
from experiments.navigation.hypotheses import answers
from experiments.navigation.outcomes import (
    FEATURES,
    Difference,
    Runs,
    correlations,
    difference,
    over_seeds,
    read_places,
    read_runs,
    success_by_niche,
)
from experiments.navigation.tasks import CONDITIONS, TASKS, Figures

__all__ = ["Archive", "hard_niches", "write_report"]

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

_KEYS: tuple[Figures, ...] = ("success", "worst", "spl", "tiles")
_REFERENCE = {"lane": "maps-100", "map": "maps-1000", "window": "maps-1000"}


def write_report(out: Path, tasks: Sequence[str]) -> None:
    """Writes navigation.md and the figures of all finished runs of some tasks into the folder."""
    runs = {key: found for key, found in read_runs(out).items() if key[0] in tasks}
    trained = [name for name in TASKS if any(key[0] == name for key in runs)]
    parts = [
        "# Navigation",
        *_answers_table(runs, out),
        *(part for name in trained for part in _task_tables(runs, name)),
    ]
    if "where" in tasks:
        parts += _places_tables(out)
    parts += _hard_tables(runs, out)
    write(out / "navigation.md", "\n\n".join(part.rstrip() for part in parts) + "\n")
    write(out / "navigation.json", json.dumps(_figures(runs, out), indent=1) + "\n")
    shown = [name for name in ("map", "window") if name in trained]
    if shown:
        save(_curves(runs, shown), out / "navigation.png")
    heated = [name for name in shown if any(key[:2] == (name, "maps-1000") for key in runs)]
    if heated:
        save(_heat(runs, out, heated), out / "niches.png")


def _answers_table(runs: Runs, out: Path) -> list[str]:
    """Makes the table of the hypotheses."""
    rows = [
        [
            str(answer.hypothesis),
            answer.words,
            _words(answer.found),
            str(answer.found.seeds),
            f"at least {answer.least:g}" if np.isfinite(answer.least) else f"at most {answer.most:g}",
            answer.verdict,
        ]
        for answer in answers(runs, out)
    ]
    about = (
        "Means over seeds, and 95 % bootstrap intervals. As expected: yes where the whole interval lies within the "
        "range, no where it lies outside. Intervals of ten seeds hold the true mean about 9 times in ten."
    )
    head = ["", "figure", "mean, interval", "seeds", "expected", "as expected"]
    return ["## The hypotheses", about, table(head, rows)] if rows else []


def _figures(runs: Runs, out: Path) -> list[dict[str, object]]:
    """Lists all runs with their figures by test; and of the maps of each seed the means of their features."""
    trained = [
        {"task": task, "condition": condition, "seed": seed}
        | {test: {key: round(judged[key], 5) for key in _KEYS} for test, judged in found.items()}
        for (task, condition, seed), found in sorted(runs.items())
    ]
    places = [
        {"task": "where", "seed": seed}
        | {test: {key: round(float(np.mean(values)), 5) for key, values in of.items()} for test, of in found.items()}
        for seed, found in read_places(out).items()
    ]
    return trained + places


def _of(runs: Runs, task: str, condition: str, test: str, figure: Figures) -> NDArray[np.float64]:
    held = sorted((key[2], found) for key, found in runs.items() if key[:2] == (task, condition))
    return np.array([found[test][figure] for _, found in held if test in found])


def _task_tables(runs: Runs, name: str) -> list[str]:
    """Makes the tables of a task: success by test, the worst tenth, SPL, and the differences from the reference."""
    conditions = [condition for condition in CONDITIONS if any(key[:2] == (name, condition) for key in runs)]
    tests = [test for test in TESTS if any(test in found for key, found in runs.items() if key[0] == name)]
    parts = [f"## {name}: {TASKS[name].words}"]
    figures: dict[Figures, str] = {
        "success": "Success",
        "worst": "Success on the worst tenth of maps",
        "spl": "SPL",
        "tiles": "Tiles",
    }
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


def _words(apart: Difference, digits: int = 3) -> str:
    if apart.seeds == 0:
        return ""
    interval = f", {apart.low:+.{digits}f} to {apart.high:+.{digits}f}" if apart.seeds > 2 else ""
    return f"{apart.mean:+.{digits}f}{interval}"


def _places_tables(out: Path) -> list[str]:
    """Makes the table of task "where": means over maps, then over seeds."""
    found = list(read_places(out).values())
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
    places, rows = read_places(out), []
    for task in ("map", "window"):
        values = [over_seeds(correlations(runs, places, task, "maps-1000", feature)) for feature in FEATURES]
        if values[0].seeds:
            rows.append([f"{task}, {CONDITIONS['maps-1000'].words}", *(_words(value, 2) for value in values)])
    if not rows:
        return []
    about = "Spearman's rank correlation of a map's failures with its features, over all unseen maps of MAP-Elites."
    return ["## What makes a map hard", about, table(["driver", *FEATURES], rows)]


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
    axes[0, -1].legend(fontsize=8, title="tested on", title_fontsize=8, loc="lower right")
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


class Archive(NamedTuple):
    """Maps in the niches of two axes.

    Attributes:
      words: what maps they are.
      grids: codes ``[N, H, W]``.
      bins: of each grid, ``[N, 2]``.
      failures: the share of levels that a driver fails on each, ``[N]``.
    """

    words: str
    grids: NDArray[np.int8]
    bins: NDArray[np.int_]
    failures: NDArray[np.float64]


def hard_niches(archives: Sequence[Archive], hardest: NDArray[np.int_], axes: Sequence[Axis]) -> Figure:
    """Draws the mean failure rate in each niche of some archives, and up to six maps of the last by their numbers."""
    extent = tuple(axis.bins for axis in axes)
    heats = [_means(extent, one.bins, one.failures) for one in archives]
    plot = plt.figure(figsize=(4.3 * len(archives) + 4.6, 4.8), layout="constrained")
    halves: Untyped = plot.subfigures(1, 2, width_ratios=(4.3 * len(archives), 4.6))
    shown = halves[0].subplots(1, len(archives), sharey=True, squeeze=False)[0]
    names = ("loops (cyclomatic number), from", "ambiguity of places (tiles until one is known), from")
    lows = [[axis.start + axis.width * place for place in range(axis.bins)] for axis in axes]
    for ax, one, heat in zip(shown, archives, heats, strict=True):
        image = ax.imshow(heat.T, origin="lower", cmap="magma", aspect="auto", vmin=0, vmax=np.nanmax(heats))
        ax.set_title(f"maps {one.words}", fontsize=10)
        ax.set_xticks(range(extent[0]), [f"{low:g}" for low in lows[0]])
        ax.set_yticks(range(extent[1]), [f"{low / 100:g}" for low in lows[1]])
        ax.set_xlabel(names[0])
    shown[0].set_ylabel(names[1])
    halves[0].colorbar(image, ax=shown, label="failure rate of the driver", format=PercentFormatter(1, 0))
    _, grids, bins, failures = archives[-1]
    tiles = load_tiles()
    for ax, place in zip(halves[1].subplots(2, 3).flat, hardest, strict=False):
        ax.imshow(render(grids[place], tiles, tile_px=32).image)
        loops, away = (axis.start + axis.width * at for axis, at in zip(axes, bins[place], strict=True))
        ax.set_title(f"{failures[place]:.0%} fail\n{loops:g} loops, {away / 100:g} tiles", fontsize=8)
    for ax in halves[1].axes:
        ax.axis("off")
    halves[1].suptitle("the hardest niches' maps", fontsize=10)
    return plot


def _means(extent: tuple[int, ...], bins: NDArray[np.int_], values: NDArray[np.float64]) -> NDArray[np.float64]:
    total, count = np.zeros(extent), np.zeros(extent)
    np.add.at(total, tuple(bins.T), values)
    np.add.at(count, tuple(bins.T), 1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
