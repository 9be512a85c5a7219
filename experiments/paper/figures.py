"""Plots of the paper's study."""

from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from elitelanes_jax.plots import metric_boxes
from experiments.paper.published import METHODS, METRICS, SHAPE, TABLE
from experiments.paper.runs import Row
from experiments.paper.tables import group_rows

__all__ = ["plot_comparison", "plot_scaling"]


def plot_comparison(rows: Sequence[Row], title: str) -> Figure:
    """Draws box plots of the paper's metrics by method, and marks the paper's means."""
    groups = group_rows(rows)
    figure, axes = plt.subplots(3, 3, figsize=(13, 10.5), layout="constrained")
    for (metric, letters), ax in zip(METRICS.items(), axes.flat, strict=True):
        samples = {
            name.replace(", ", ",\n"): {metric: [row.values[metric] for row in held]} for name, held in groups.items()
        }
        metric_boxes(samples, metric, ax=ax)
        if (rows[0].height, rows[0].width) == SHAPE:
            means = [TABLE[held[0].method][metric].mean for held in groups.values()]
            label, positions = "the paper's mean", range(1, len(means) + 1)
            ax.plot(positions, means, "D", color="crimson", markersize=6, label=label, zorder=3)
        words = "cyclomatic number" if metric == "cyclomatic" else metric.replace("_", " ")
        ax.set_title(f"{words} ({letters})", fontsize=11)
        ax.tick_params(axis="x", labelsize=8)
    if axes[0, 0].get_legend_handles_labels()[0]:
        axes[0, 0].legend(fontsize=9)
    figure.suptitle(title)
    return figure


def plot_scaling(rows: Sequence[Row], title: str) -> Figure:
    """Plots quality per tile and time per run against the number of tiles: median and middle half of the seeds."""
    panels = {
        "fitness": "fitness a tile",
        "dead_ends": "dead ends a tile",
        "cyclomatic": "cyclomatic number a tile",
        "crossings": "crossings a tile",
        "straight_score": "straight score a tile",
        "seconds": "seconds a run",
    }
    figure, axes = plt.subplots(2, 3, figsize=(13, 7.5), layout="constrained")
    for (name, words), ax in zip(panels.items(), axes.flat, strict=True):
        for index, method in enumerate(dict.fromkeys(row.method for row in rows)):
            cells = sorted({row.height * row.width for row in rows if row.method == method})
            low, middle, high = np.transpose([_quartiles(rows, method, count, name) for count in cells])
            width = 4 - 0.7 * index  # lines that coincide stay visible
            ax.plot(cells, middle, "o-", color=f"C{index}", label=METHODS[method], linewidth=width, markersize=4)
            ax.fill_between(cells, low, high, color=f"C{index}", alpha=0.2)
        ax.set(xscale="log", xlabel="tiles", yscale="log" if name == "seconds" else "linear")
        ax.set_title(words, fontsize=11)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=9)
    figure.suptitle(title)
    return figure


def _quartiles(rows: Sequence[Row], method: str, cells: int, name: str) -> list[float]:
    scale = 1 if name == "seconds" else cells
    values = [row.values[name] / scale for row in rows if row.method == method and row.height * row.width == cells]
    return np.quantile(values, [0.25, 0.5, 0.75]).tolist()
