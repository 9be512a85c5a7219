"""Writes the table of docs/metrics.md, and draws what each metric counts.

python docs/metrics.py --search   # also finds the ends of ranges again, for elitelanes_jax/problem/extremes.txt
python docs/metrics.py
"""

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax.network import Metrics, Weights, plain_measure
from elitelanes_jax.plots import road_map
from elitelanes_jax.problem import describe_features, features_of

PAGE = Path(__file__).with_suffix(".md")

EXTREMES = Path(__file__).parents[1] / "elitelanes_jax" / "problem" / "extremes.txt"

SIDE = 12

NORTH, EAST, SOUTH, WEST = 8, 4, 2, 1  # the bits of a tile's code
STRAIGHTS, TURNS, CROSSINGS = (5, 10), (3, 6, 9, 12), (7, 11, 13, 14, 15)

# The weights of flaws are the usual ones; those of a metric are so small that no flaw is worth it.
SEARCHED = {
    "cyclomatic": 10,
    "bridges": 10,
    "crossings": 10,
    "adjacent_crossings": 3,
    "adjacent_crossing_score": 1,
    "adjacent_turns": 10,
    "straight_score": 1,
    "straights": 10,
    "turns": 10,
    "crowded_crossings": 10,
    "unlinked_neighbours": 10,
}


def search() -> None:
    """Writes the fewest maps found that have the lowest and the highest value of each feature between them."""
    pool = list(known())
    for name, weight in SEARCHED.items():
        for sign in (1, -1):
            flaws = ("components", "dead_ends", "boundary_violations", "off_alphabet", name)
            weights = {other: 0 for other in Weights._fields if other not in flaws} | {name: sign * weight}
            result = evolve(0, (SIDE, SIDE), seeds=2, method="ea", evaluations=150_000, weights=weights)
            found = [road_map.codes for road_map in result.choose(999).maps]
            pool += found
            values = [features_of(grid)[name] for grid in found]
            print(
                name, "least" if sign > 0 else "most", min(values, default=None), max(values, default=None), flush=True
            )
    rows = [features_of(grid) for grid in pool]
    chosen: set[int] = set()
    for name in rows[0]:
        values = [row[name] for row in rows]
        for extreme in (min(values), max(values)):
            holders = [place for place, value in enumerate(values) if value == extreme]
            if not chosen & set(holders):
                chosen.add(holders[0])
    EXTREMES.write_text("".join(f"{text(pool[place])}\n" for place in sorted(chosen)), encoding="ascii")


def text(grid: NDArray[np.int8]) -> str:
    return " ".join("".join(f"{code:x}" for code in row) for row in grid.tolist())


def known() -> Iterator[NDArray[np.int8]]:
    """Makes maps whose values are extreme by construction: all links, and one ring through all cells."""
    for links in (lambda row, column, down: True, comb):
        grid = np.zeros((SIDE, SIDE), np.int8)
        for row, column in np.ndindex(SIDE, SIDE):
            if column + 1 < SIDE and links(row, column, False):
                grid[row, column] |= EAST
                grid[row, column + 1] |= WEST
            if row + 1 < SIDE and links(row, column, True):
                grid[row, column] |= SOUTH
                grid[row + 1, column] |= NORTH
        yield grid


def comb(row: int, column: int, down: bool) -> bool:
    """Tells which links a ring has that goes down the first column and back up through all others, row by row."""
    if down:
        return column == 0 or (column == SIDE - 1 if row % 2 == 0 else column == 1)
    return column > 0 or row in (0, SIDE - 1)


# A small map for each flaw, which no map of `generate` has.
FLAWED = {
    "components": [[6, 3, 0, 0], [12, 9, 6, 3], [0, 0, 12, 9]],
    "dead_ends": [[6, 3, 0, 0], [14, 15, 5, 1], [12, 9, 0, 0]],
    "boundary_violations": [[6, 3, 0, 0], [14, 15, 5, 5], [12, 9, 0, 0]],
    "mismatches": [[6, 7, 3, 0], [10, 10, 14, 0], [12, 13, 9, 0]],
    "empty_cells": [[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]],
}

# A map with something of all other metrics.
EXAMPLE = [
    [6, 3, 0, 0, 0, 6, 7, 3],
    [14, 15, 7, 5, 5, 15, 15, 11],
    [12, 13, 9, 0, 0, 10, 12, 11],
    [0, 0, 0, 0, 0, 12, 5, 9],
]


def counted(name: str, grid: NDArray[np.int8]) -> NDArray[np.bool_]:
    """Returns the cells bool ``[H, W]`` that a metric counts; for one of pairs those of each pair."""
    cells = np.zeros(grid.shape, bool)
    crossing, turn = np.isin(grid, CROSSINGS), np.isin(grid, TURNS)
    alone = {
        "crossings": crossing,
        "turns": turn,
        "straights": np.isin(grid, STRAIGHTS),
        "straight_score": np.isin(grid, STRAIGHTS),
        "tiles": grid > 0,
        "edges": grid > 0,
        "empty_cells": grid == 0,
    }
    if name in alone:
        return alone[name]
    for row, column in np.ndindex(grid.shape):
        for bit, back, other in ((EAST, WEST, (row, column + 1)), (SOUTH, NORTH, (row + 1, column))):
            if other[0] == grid.shape[0] or other[1] == grid.shape[1]:
                continue
            here = (row, column)
            linked = bool(grid[here] & bit and grid[other] & back)
            crossings, turns = (int(kind[here]) + int(kind[other]) for kind in (crossing, turn))
            counts = {
                "adjacent_crossings": linked and crossings == 2,
                "adjacent_crossing_score": linked and crossings == 2,
                "adjacent_turns": turns == 2,
                "crowded_crossings": crossings > 0 and crossings + turns == 2,
                "unlinked_neighbours": not linked and grid[here] > 0 and grid[other] > 0,
                "bridges": linked and cut(grid, (here, bit), (other, back)),
            }
            if counts.get(name):
                cells[here] = cells[other] = True
    return cells


def cut(grid: NDArray[np.int8], *ends: tuple[tuple[int, int], int]) -> bool:
    """Tells whether there is one component more without a link, which is given by its ends: cell and side."""
    without = grid.copy()
    for cell, bit in ends:
        without[cell] &= ~bit
    isolated = sum(int(without[cell] == 0) for cell, _ in ends)
    return plain_measure(without)["components"] + isolated > plain_measure(grid)["components"]


def table() -> str:
    rows = [f"| `{name}` | {meaning} | {values} |" for name, (meaning, values) in describe_features().items()]
    return "\n".join(["| name | meaning | at 12 x 12 |", "|---|---|---|", *rows, ""])


def draw() -> Figure:
    grid = np.array(EXAMPLE, np.int8)
    varied = [name for name in Metrics._fields if name not in (*FLAWED, "off_alphabet", "tiles", "coverage")]
    figure = Figure(figsize=(12, 7.6), layout="constrained")
    axes = figure.subplots(4, 5).ravel()
    for ax in axes:
        ax.axis("off")
    for ax, name in zip(axes, [*varied, *FLAWED], strict=False):
        shown = np.array(FLAWED[name], np.int8) if name in FLAWED else grid
        ax.axis("on")
        road_map(shown, lanes=False, width=0.4, marked=counted(name, shown), ax=ax)
        ax.set_title(f"{name}\n{features_of(shown)[name]}", fontsize=10)
    return figure


def main() -> None:
    if "--search" in sys.argv:
        search()
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(re.sub(r"\| name \|.*?\n(?=\n)", lambda _: table(), page, flags=re.DOTALL), encoding="utf-8")
    draw().savefig(PAGE.with_suffix(".png"), dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    main()
