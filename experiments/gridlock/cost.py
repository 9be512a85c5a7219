"""What a larger gridlock number costs a town: more tiles, and the more of them the more loops it has.

MAP-Elites fills niches of gridlock number and cyclomatic number with towns of few tiles, that keep Duckietown's rules.

A town of one part has at least number + 1 tiles around each of its loops + 1 faces. A link is on the border of two
faces. So it has at least (number + 1)(loops + 1) / 2 links, and loops - 1 tiles fewer than links.
"""

from pathlib import Path

import jax
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from elitelanes_jax import evolve
from elitelanes_jax.network import gridlock_loop, gridlock_number, plain_measure
from elitelanes_jax.plots import road_map
from experiments.common import save

__all__ = ["draw_cost", "find_small_towns", "least_tiles"]

SIDE, SEEDS, EVALUATIONS = 9, 4, 200_000
SHOWN = ((7, 3), (7, 8), (11, 3), (11, 6), (15, 2), (15, 4), (19, 3), (27, 2))
"""The gridlock numbers and cyclomatic numbers of the towns on the picture."""


def least_tiles(number: int, loops: int) -> int:
    """Returns a lower bound of the tiles of a town with a gridlock number and a number of loops."""
    return -(-(number + 1) * (loops + 1) // 2) - loops + 1


def find_small_towns() -> dict[str, list[str]]:
    """Returns the smallest town found with each "NUMBER,LOOPS": its rows of codes, as hexadecimal digits."""
    axes = [
        {"metric": "gridlock_number", "bins": 16, "width": 2, "start": 3},
        {"metric": "cyclomatic", "bins": 9, "width": 1, "start": 1},
    ]
    result = evolve(
        jax.random.split(jax.random.key(0), SEEDS),
        (SIDE, SIDE),
        rules="duckietown",
        axes=axes,
        weights={"tiles": 1, "straight_score": 0, "cyclomatic": 0},
        evaluations=EVALUATIONS,
    )
    towns: dict[str, tuple[int, list[str]]] = {}
    for town in result.choose(10_000).maps:
        tiles = int(np.count_nonzero(town.codes))
        number, loops = int(gridlock_number(town.codes)), plain_measure(town.codes)["cyclomatic"]
        name = f"{number},{loops}"
        if name not in towns or tiles < towns[name][0]:
            towns[name] = tiles, ["".join(f"{code:x}" for code in row) for row in town.codes.tolist()]
    return {name: codes for name, (_, codes) in sorted(towns.items())}


def draw_cost(towns: dict[str, list[str]], file: Path) -> None:
    """Draws the tiles of the towns against their gridlock number, with the bound, and some of the towns."""
    grids: dict[tuple[int, int], NDArray[np.int8]] = {}
    for name, rows in towns.items():
        number, loops = map(int, name.split(","))
        grids[number, loops] = np.array([[int(code, 16) for code in row] for row in rows], np.int8)
    figure = Figure(figsize=(11, 5), layout="constrained")
    grid = figure.add_gridspec(2, 7)
    ax = figure.add_subplot(grid[:, :3])
    for loops in (1, 2, 3, 4, 6, 8):
        numbers = sorted(number for number, count in grids if count == loops)
        tiles = [np.count_nonzero(grids[number, loops]) for number in numbers]
        (line,) = ax.plot(numbers, tiles, "o-", ms=4, label=f"{loops}")
        ax.plot(numbers, [least_tiles(number, loops) for number in numbers], "--", lw=1, color=line.get_color())
    ax.set(xlabel="gridlock number", ylabel="tiles of the smallest town found")
    ax.legend(title="loops; dashed: bound", loc="upper right", ncols=2)
    for place, key in enumerate(SHOWN):
        ax = figure.add_subplot(grid[place // 4, 3 + place % 4])
        road_map(grids[key], width=0.6, lanes=False, loop=gridlock_loop(grids[key]), ax=ax)
        ax.set_title(f"number {key[0]}, loops {key[1]}\n{np.count_nonzero(grids[key])} tiles", fontsize=8)
    save(figure, file)
