"""Tables and figures of `study`, from the files of its finished runs, and the statistics that compare them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from experiments.common import bootstrap_interval, save, table, write
from experiments.navigation.tasks import CONDITIONS, TASKS, Figures, Judged

__all__ = ["Difference", "Runs", "difference", "success_by_niche", "write_report"]

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

ALIKE = ("seen", "held out")
"""The tests on unseen maps of MAP-Elites."""

Runs: TypeAlias = dict[tuple[str, str, int], dict[str, Judged]]
"""The figures of each test, by task, condition and seed."""


class Difference(NamedTuple):
    """A mean over seeds, as of differences between runs of the same seed, with its 95 % bootstrap interval.

    The interval is NaN under three seeds.
    """

    mean: float
    low: float
    high: float
    seeds: int


def read_runs(out: Path) -> Runs:
    """Reads the finished runs of a folder."""
    runs: Runs = {}
    for name in TASKS:
        for condition in CONDITIONS:
            for file in sorted((out / "runs").glob(f"{name}-{condition}-*.json")):
                seed = file.stem.removeprefix(f"{name}-{condition}-")
                if seed.isdigit():
                    runs[name, condition, int(seed)] = json.loads(file.read_text(encoding="utf-8"))
    return runs


def difference(
    runs: Runs, task: str, one: tuple[str, str], other: tuple[str, str], figure: Figures = "success"
) -> Difference:
    """Compares two (condition, test), over the seeds that both have."""
    pairs = [
        (found[one[1]][figure], runs[task, other[0], seed][other[1]][figure])
        for (name, condition, seed), found in sorted(runs.items())
        if (name, condition) == (task, one[0]) and one[1] in found and other[1] in runs.get((task, other[0], seed), {})
    ]
    return over_seeds([first - second for first, second in pairs])


def over_seeds(values: Sequence[float]) -> Difference:
    """Averages a figure of each seed."""
    mean = float(np.mean(values)) if len(values) else float("nan")
    low, high = bootstrap_interval(values) if len(values) > 2 else (float("nan"), float("nan"))
    return Difference(mean, low, high, len(values))


def write_report(out: Path, tasks: Sequence[str]) -> None:
    """Writes navigation.md and the figures of all finished runs of some tasks into the folder."""
    runs = {key: found for key, found in read_runs(out).items() if key[0] in tasks}
    trained = [name for name in TASKS if any(key[0] == name for key in runs)]
    parts = ["# Navigation", *(part for name in trained for part in _task_tables(runs, name))]
    write(out / "navigation.md", "\n\n".join(part.rstrip() for part in parts) + "\n")
    write(out / "navigation.json", json.dumps(_figures(runs), indent=1) + "\n")
    shown = [name for name in ("map", "window") if name in trained]
    if shown:
        save(_curves(runs, shown), out / "navigation.png")
    heated = [name for name in shown if any(key[:2] == (name, "maps-1000") for key in runs)]
    if heated:
        save(_heat(runs, out, heated), out / "niches.png")


def _figures(runs: Runs) -> list[dict[str, object]]:
    """Lists all runs with their figures by test."""
    return [
        {"task": task, "condition": condition, "seed": seed}
        | {test: {key: round(judged[key], 5) for key in ("success", "spl")} for test, judged in found.items()}
        for (task, condition, seed), found in sorted(runs.items())
    ]


def _of(runs: Runs, task: str, condition: str, test: str, figure: Figures) -> NDArray[np.float64]:
    held = sorted((key[2], found) for key, found in runs.items() if key[:2] == (task, condition))
    return np.array([found[test][figure] for _, found in held if test in found])


def _task_tables(runs: Runs, name: str) -> list[str]:
    """Makes the tables of a task: success by test, SPL, and the differences from the reference."""
    conditions = [condition for condition in CONDITIONS if any(key[:2] == (name, condition) for key in runs)]
    tests = [test for test in TESTS if any(test in found for key, found in runs.items() if key[0] == name)]
    parts = [f"## {name}: {TASKS[name].words}"]
    figures: dict[Figures, str] = {"success": "Success", "spl": "SPL"}
    for figure, words in figures.items():
        head = ["trained on", "seeds", *(TESTS[test] for test in tests)]
        rows = [
            [
                CONDITIONS[condition].words,
                str(len(_of(runs, name, condition, "seen", figure))),
                *(_mean(_of(runs, name, condition, test, figure)) for test in tests),
            ]
            for condition in conditions
        ]
        parts += [f"### {words}", table(head, rows)]
    reference = "maps-1000"
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


def _mean(values: NDArray[np.float64]) -> str:
    return f"{values.mean():.3f}" if len(values) else ""


def _words(apart: Difference) -> str:
    if apart.seeds == 0:
        return ""
    interval = f", {apart.low:+.3f} to {apart.high:+.3f}" if apart.seeds > 2 else ""
    return f"{apart.mean:+.3f}{interval}"


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


def success_by_niche(runs: Runs, out: Path, task: str, condition: str) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    """Averages the success on maps of each niche, trained on or held out, over all seeds.

    Returns:
      Means ``[10, 10]``, NaN in niches without a map, and the numbers of maps.
    """
    total, count = np.zeros((10, 10)), np.zeros((10, 10), int)
    for (name, trained, seed), found in runs.items():
        if (name, trained) == (task, condition):
            niches = json.loads((out / "maps" / f"{seed}.json").read_text(encoding="utf-8"))["niches"]
            for test in ALIKE:
                for (loops, straights), success in zip(niches[test], found[test]["by_map"], strict=True):
                    total[loops, straights] += success
                    count[loops, straights] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), count
