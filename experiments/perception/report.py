"""Table and figure of `segmentation.py`, from a row for each training and test."""

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from elitelanes_jax.tiles import LABELS
from experiments.common import table
from experiments.perception.training_sets import CONDITIONS

__all__ = ["TESTS", "figure", "tables"]

Row = dict[str, Any]

TESTS = {
    "seen": "Pictures trained on",
    "held out": "Pictures held out",
    "four-way": "Pictures trained on, four-way crossings",
    "photographs": "Photographs",
}
"""The tests by name, with words for the tile pictures that their maps are drawn with."""

_REFERENCE = "maps-1000"


def tables(rows: Sequence[Row], training: str) -> str:
    """Makes all tables, as Markdown.

    Args:
      rows: each with condition, seed and test, the IoU of each label, their mean, and figures about its maps.
      training: the length of the training, in words.
    """
    parts = [
        f"# Trained for {training}, {len({row['seed'] for row in rows})} seeds",
        "Intersection over union, means of the seeds. The mean of the classes also has its lowest and highest seed and "
        f"its difference from {CONDITIONS[_REFERENCE].words}: the mean, lowest and highest of runs with the same seed.",
    ]
    for test in _tests(rows):
        head = ["trained on", "drawings", *LABELS, "mean", "lowest, highest", "difference"]
        parts += [f"## {TESTS[test]}", table(head, [_judged(rows, test, name) for name in _conditions(rows)])]
    head = ["trained on", "drawings", "different maps", "neighbourhoods of 2 x 2 tiles", "of the test's"]
    shown = [
        [
            *_named(name),
            f"{_of(rows, rows[0]['test'], name, 'different').mean():.0f}",
            f"{_of(rows, rows[0]['test'], name, 'patterns').mean():.0f}",
            f"{100 * _of(rows, rows[0]['test'], name, 'met').mean():.0f} %",
        ]
        for name in _conditions(rows)
    ]
    parts += ["## The maps", "Neighbourhoods that are equal when rotated count once; maps also when mirrored."]
    return "\n\n".join(part.rstrip() for part in (*parts, table(head, shown))) + "\n"


def _judged(rows: Sequence[Row], test: str, name: str) -> list[str]:
    means, others = _of(rows, test, name, "mean"), _of(rows, test, _REFERENCE, "mean")
    apart = means - others if name != _REFERENCE and len(others) else None
    return [
        *_named(name),
        *(f"{_of(rows, test, name, label).mean():.3f}" for label in LABELS),
        f"{means.mean():.3f}",
        f"{means.min():.3f}, {means.max():.3f}",
        "" if apart is None else f"{apart.mean():+.3f}, {apart.min():+.3f} to {apart.max():+.3f}",
    ]


def figure(rows: Sequence[Row]) -> Figure:
    """Plots the mean IoU of every run, by condition, with the mean of the seeds."""
    names, tests = _conditions(rows), _tests(rows)
    size = (2 + 3.2 * len(tests), 1.2 + 0.34 * len(names))
    plot, axes = plt.subplots(1, len(tests), figsize=size, layout="constrained", sharey=True, squeeze=False)
    for test, ax in zip(tests, axes[0], strict=True):
        for place, name in enumerate(names):
            means = _of(rows, test, name, "mean")
            ax.plot(means, np.full(len(means), place), "o", color="#1b6ca8", markersize=5, alpha=0.6)
            ax.plot([means.mean()] * 2, [place - 0.3, place + 0.3], color="#d1495b", linewidth=2)
        ax.set_title(TESTS[test], fontsize=10)
        ax.set_xlabel("mean IoU")
        ax.locator_params(axis="x", nbins=4)
        ax.grid(axis="x", alpha=0.3)
    axes[0, 0].set_ylabel("maps · drawings")
    axes[0, 0].set_yticks(range(len(names)), [" · ".join(_named(name)) for name in names], fontsize=8)
    axes[0, 0].invert_yaxis()
    return plot


def _of(rows: Sequence[Row], test: str, name: str, key: str) -> NDArray[np.float64]:
    """Returns a column of one condition and test, by seed."""
    held = [row for row in rows if (row["test"], row["condition"]) == (test, name)]
    return np.array([row[key] for row in sorted(held, key=lambda row: row["seed"])], float)


def _conditions(rows: Sequence[Row]) -> list[str]:
    return [name for name in CONDITIONS if any(row["condition"] == name for row in rows)]


def _tests(rows: Sequence[Row]) -> list[str]:
    return [test for test in TESTS if any(row["test"] == test for row in rows)]


def _named(name: str) -> list[str]:
    return [CONDITIONS[name].words, f"{CONDITIONS[name].drawings:,}"]
