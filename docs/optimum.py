"""Draws the pictures in docs/optimum.md.

python docs/optimum.py
"""

from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure

from elitelanes_jax import evolve
from elitelanes_jax.benchmark import Task, find_task
from elitelanes_jax.plots import road_map

SIZES = ("6x6B", "7x7A", "8x8B", "9x9A", "12x12A")
BUDGETS = (1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 200_000)
COLUMNS = 7

Rows = list[tuple[str, list[tuple[str, np.ndarray]]]]
"""Titled rows of networks with words."""


def strips(name: str, rows: Rows) -> None:
    """Draws titled rows of networks, each with words above it; a row of more than `COLUMNS` networks is broken."""
    lines = [
        (title if first == 0 else "", pairs[first : first + COLUMNS])
        for title, pairs in rows
        for first in range(0, len(pairs), COLUMNS)
    ]
    figure = Figure(figsize=(1.5 * COLUMNS, 1.75 * len(lines)), layout="constrained")
    for axes, (title, pairs) in zip(figure.subplots(len(lines), COLUMNS, squeeze=False), lines, strict=True):
        for ax in axes[len(pairs) :]:
            ax.set_axis_off()
        for ax, (words, grid) in zip(axes, pairs, strict=False):
            road_map(grid, lanes=False, ax=ax)
            ax.set_title(words, fontsize=9)
        axes[0].set_ylabel(title)
    figure.savefig(Path(__file__).parent / name, dpi=80, metadata={"Software": None})


def best(task: Task) -> list[tuple[str, np.ndarray]]:
    facts = zip(task.cyclomatic, task.optimum, task.witnesses, strict=True)
    return [(f"{cycles}: {fitness}", grid) for cycles, fitness, grid in facts]


def elites(task: Task, numbers: tuple[int, ...]) -> Rows:
    """Returns the elites of some cyclomatic numbers in one run, after each budget; a row for each number."""
    rows: Rows = [(f"{cycles} cycles", []) for cycles in numbers]
    for budget in BUDGETS:
        result = evolve(jax.random.key(0), task.shape, fill=task.fill, evaluations=budget, progress=False)
        for cycles, (_, row) in zip(numbers, rows, strict=True):
            # The other axes count kinds of flaws: their first bin has none.
            niche = np.ravel_multi_index((cycles, 0, 0, 0, 0), [axis.bins for axis in result.search.axes])
            if result.elites.valid[niche]:
                row.append((f"{budget:,}: {result.elites.fitness[niche]}", np.asarray(result.elites.grids[niche])))
    return rows


def main() -> None:
    tasks = [find_task(f"{size}-10000") for size in SIZES]
    strips("optimum.png", [(task.name.removesuffix("-10000"), best(task)) for task in tasks])
    strips("optimum-search.png", elites(find_task("9x9A-10000"), (4, 8, 9)))


if __name__ == "__main__":
    main()
