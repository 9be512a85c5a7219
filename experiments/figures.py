"""Plots of the experiments."""

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from paper import METHODS, METRICS, TABLE, is_of_the_papers_size
from report import selections

from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.plots import metric_boxes

__all__ = ["comparison", "save", "scaling"]

_WORDS = {
    "components": "components (CO)",
    "dead_ends": "dead ends (DE)",
    "cyclomatic": "cyclomatic number (CY)",
    "boundary_violations": "boundary violations (BV)",
    "adjacent_crossing_score": "adjacent crossing score (ACV)",
    "coverage": "coverage (CV)",
    "crossings": "crossings (CR)",
    "straight_score": "straight score (SR)",
    "adjacent_turns": "adjacent turns (AT)",
}


def comparison(rows: Sequence[dict[str, Any]], title: str) -> Figure:
    """Draws box plots of the paper's metrics by method, with the paper's means marked."""
    groups = selections(rows)
    samples = {name.replace(", ", ",\n"): held for name, (_, held) in groups.items()}
    figure, axes = plt.subplots(3, 3, figsize=(13, 10.5), layout="constrained")
    for metric, ax in zip(METRICS, axes.flat, strict=True):
        metric_boxes({name: {metric: [row[metric] for row in held]} for name, held in samples.items()}, metric, ax=ax)
        means = [TABLE[method][metric].mean for method, _ in groups.values()]
        if is_of_the_papers_size(rows[0]):
            ax.plot(
                range(1, len(means) + 1), means, "D", color="crimson", markersize=6, label="the paper's mean", zorder=3
            )
        ax.set_title(_WORDS[metric], fontsize=11)
        ax.tick_params(axis="x", labelsize=8)
    if axes[0, 0].get_legend_handles_labels()[0]:
        axes[0, 0].legend(fontsize=9)
    figure.suptitle(title)
    return figure


def scaling(rows: Sequence[dict[str, Any]], title: str) -> Figure:
    """Plots quality a tile and time a run by number of tiles: medians, with the middle half of the seeds."""
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
        for number, method in enumerate(dict.fromkeys(row["method"] for row in rows)):
            cells = sorted({row["height"] * row["width"] for row in rows if row["method"] == method})
            low, middle, high = np.transpose([_quartiles(rows, method, count, name) for count in cells])
            width = 4 - 0.7 * number  # lines that coincide stay visible
            ax.plot(cells, middle, "o-", color=f"C{number}", label=METHODS[method], linewidth=width, markersize=4)
            ax.fill_between(cells, low, high, color=f"C{number}", alpha=0.2)
        ax.set_xscale("log")
        if name == "seconds":
            ax.set_yscale("log")
        ax.set_xlabel("tiles")
        ax.set_title(words, fontsize=11)
        ax.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=9)
    figure.suptitle(title)
    return figure


def _quartiles(rows: Sequence[dict[str, Any]], method: str, cells: int, name: str) -> list[float]:
    share = 1 if name == "seconds" else cells
    held = [row for row in rows if row["method"] == method and row["height"] * row["width"] == cells]
    return np.quantile([row[name] / share for row in held], [0.25, 0.5, 0.75]).tolist()


def save(figure: Figure, file: Path) -> None:
    """Writes a figure and closes it. Equal figures give equal files, and a file is written whole or not at all."""
    content = io.BytesIO()
    kind = file.suffix.removeprefix(".")
    metadata: dict[str, Any] = {"CreationDate": None} if kind == "pdf" else {}
    figure.savefig(content, format=kind, dpi=110, metadata=metadata)
    plt.close(figure)
    write_atomic(file, content.getvalue())
