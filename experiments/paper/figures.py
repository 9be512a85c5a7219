"""The plot of the paper's study."""

from collections.abc import Sequence

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from experiments.paper.published import METRICS, SHAPE, TABLE
from experiments.paper.runs import Row
from experiments.paper.tables import group_rows

__all__ = ["plot_comparison"]


def plot_comparison(rows: Sequence[Row], title: str) -> Figure:
    """Draws box plots of the paper's metrics by method, and marks the paper's means."""
    groups = group_rows(rows)
    figure, axes = plt.subplots(3, 3, figsize=(13, 10.5), layout="constrained")
    for (metric, letters), ax in zip(METRICS.items(), axes.flat, strict=True):
        samples = [[row.values[metric] for row in held] for held in groups.values()]
        names = [name.replace(", ", ",\n") for name in groups]
        ax.boxplot(samples, widths=0.55, medianprops={"color": "black"}, tick_labels=names)
        ax.grid(axis="y", alpha=0.3)
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
