"""Tables and figure of `segmentation`."""

from collections.abc import Sequence
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from elitelanes_jax.tiles import LABELS
from experiments.common import table
from experiments.perception.training_sets import CONDITIONS

__all__ = ["TESTS", "Row", "make_tables", "plot"]

TESTS = {
    "seen": "Pictures trained on",
    "held out": "Pictures held out",
    "four-way": "Pictures trained on, four-way crossings",
    "photographs": "Photographs",
}
"""The tests by name, with words for the tile pictures that their maps are drawn with."""

_REFERENCE = "maps-1000"


class Row(NamedTuple):
    """The outcome of a training in a test.

    Attributes:
      condition: one of `CONDITIONS`.
      seed: index of the run.
      different: number of distinct maps.
      patterns: number of neighbourhoods of 2 x 2 tiles in the maps.
      met: share of the test's neighbourhoods that the maps have.
      test: one of `TESTS`.
      ious: intersection over union of each label.
      mean: their mean.
    """

    condition: str
    seed: int
    different: int
    patterns: int
    met: float
    test: str
    ious: dict[str, float]
    mean: float

    def flat(self) -> dict[str, str | float]:
        """Returns the row of a table, by the names of its columns."""
        row = {name: value for name, value in self._asdict().items() if name not in ("ious", "mean")}
        return row | self.ious | {"mean": self.mean}


def make_tables(rows: Sequence[Row], training: str) -> str:
    """Makes all tables.

    Args:
      rows: of all runs.
      training: the length of a training, in words.
    """
    seeds = len({row.seed for row in rows})
    parts = [
        f"# Trained for {training}, {seeds} seeds",
        "Intersection over union, means of the seeds. The mean of the classes also has its lowest and highest seed and "
        f"its difference from {CONDITIONS[_REFERENCE].words}: the mean, lowest and highest of runs with the same seed.",
    ]
    names = _conditions(rows)
    for test in _tests(rows):
        head = ["trained on", "drawings", *LABELS, "mean", "lowest, highest", "difference"]
        parts += [f"## {TESTS[test]}", table(head, [_test_cells(rows, test, name) for name in names])]
    head = ["trained on", "drawings", "different maps", "neighbourhoods of 2 x 2 tiles", "of the test's"]
    lines = []
    for name in names:
        held = [row for row in rows if (row.condition, row.test) == (name, rows[0].test)]
        different, known, met = np.mean([(row.different, row.patterns, row.met) for row in held], axis=0)
        lines.append([*_named(name), f"{different:.0f}", f"{known:.0f}", f"{100 * met:.0f} %"])
    parts += ["## The maps", "Neighbourhoods that are equal when rotated count once; maps also when mirrored."]
    return "\n\n".join(part.rstrip() for part in (*parts, table(head, lines))) + "\n"


def _test_cells(rows: Sequence[Row], test: str, name: str) -> list[str]:
    means, reference = _means(rows, test, name), _means(rows, test, _REFERENCE)
    ious = [row.ious for row in rows if (row.condition, row.test) == (name, test)]
    cells = [f"{np.mean([one[label] for one in ious]):.3f}" for label in LABELS]
    cells += [f"{means.mean():.3f}", f"{means.min():.3f}, {means.max():.3f}"]
    if name == _REFERENCE or not len(reference):
        return [*_named(name), *cells, ""]
    difference = means - reference
    span = f"{difference.mean():+.3f}, {difference.min():+.3f} to {difference.max():+.3f}"
    return [*_named(name), *cells, span]


def plot(rows: Sequence[Row]) -> Figure:
    """Plots the mean IoU of every run by condition, and the mean of the seeds."""
    names, tests = _conditions(rows), _tests(rows)
    size = (2 + 3.2 * len(tests), 1.2 + 0.34 * len(names))
    figure, axes = plt.subplots(1, len(tests), figsize=size, layout="constrained", sharey=True, squeeze=False)
    for test, ax in zip(tests, axes[0], strict=True):
        for height, name in enumerate(names):
            means = _means(rows, test, name)
            ax.plot(means, np.full(len(means), height), "o", color="#1b6ca8", markersize=5, alpha=0.6)
            ax.plot([means.mean()] * 2, [height - 0.3, height + 0.3], color="#d1495b", linewidth=2)
        ax.set_title(TESTS[test], fontsize=10)
        ax.set_xlabel("mean IoU")
        ax.locator_params(axis="x", nbins=4)
        ax.grid(axis="x", alpha=0.3)
    axes[0, 0].set_ylabel("maps · drawings")
    axes[0, 0].set_yticks(range(len(names)), [" · ".join(_named(name)) for name in names], fontsize=8)
    axes[0, 0].invert_yaxis()
    return figure


def _means(rows: Sequence[Row], test: str, name: str) -> NDArray[np.float64]:
    """Returns the mean IoU of one condition in one test, by seed."""
    return np.array(
        [row.mean for row in sorted(rows, key=lambda row: row.seed) if (row.condition, row.test) == (name, test)]
    )


def _conditions(rows: Sequence[Row]) -> list[str]:
    return [name for name in CONDITIONS if any(row.condition == name for row in rows)]


def _tests(rows: Sequence[Row]) -> list[str]:
    return [test for test in TESTS if any(row.test == test for row in rows)]


def _named(name: str) -> list[str]:
    return [CONDITIONS[name].words, f"{CONDITIONS[name].drawings:,}"]
