"""Draws the picture of docs/how-it-works.md.

python docs/how_it_works.py
"""

from itertools import product
from pathlib import Path

import networkx as nx
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from elitelanes_jax.formats import tile_graph
from elitelanes_jax.plots import road_map

Cell = tuple[int, int]  # row and column

CODES = np.array(
    [
        [6, 7, 3, 0, 6, 5, 3],
        [10, 10, 10, 0, 10, 0, 10],
        [12, 13, 13, 5, 13, 5, 9],
        [0, 6, 5, 3, 0, 0, 0],
        [0, 12, 5, 13, 5, 1, 0],
    ]
)

ROAD, BRIDGE, OUTER = "#4a4f5a", "#d7263d", "#8d9298"
PLATE = {"boxstyle": "round,pad=0.2", "facecolor": "white", "edgecolor": "none"}
INNER = ("#1b7fbd", "#e08a1e", "#2a9d5c", "#8e5bb5")


def main() -> None:
    figure = Figure(figsize=(10.5, 3), layout="constrained")
    tiles, corners, sides = figure.subplots(1, 3)
    roads = list(tile_graph(CODES).edges)
    faces = faces_of(roads)
    draw_tiles(tiles)
    draw_corners(corners, roads, faces)
    bridges = draw_sides(sides, roads, faces)
    tiles.set_title(f"{np.count_nonzero(CODES)} tiles, {len(roads)} roads from tile to tile")
    corners.set_title(f"{len(set(faces.values()))} faces, the outer one in grey")
    sides.set_title(f"the same face on both sides: {bridges} bridges")
    figure.savefig(Path(__file__).parent / "how-it-works.png", dpi=110, metadata={"Software": None})


def between(one: Cell, other: Cell) -> list[Cell]:
    """Returns the two corners beside the road between two tiles. Corner (r, c) lies north-west of tile (r, c)."""
    return sorted(set.intersection(*({(r, c) for r, c in product((y, y + 1), (x, x + 1))} for y, x in (one, other))))


def dual(roads: list[tuple[Cell, Cell]]) -> nx.Graph:
    """Joins all corners, those of the border included, to their neighbours where no road runs between."""
    graph = nx.grid_2d_graph(CODES.shape[0] + 1, CODES.shape[1] + 1)
    graph.remove_edges_from(between(*road) for road in roads)
    return graph


def faces_of(roads: list[tuple[Cell, Cell]]) -> dict[Cell, int]:
    """Returns the number of each corner's face, 0 for the outer one."""
    found = sorted(nx.connected_components(dual(roads)), key=min)
    return {corner: number for number, face in enumerate(found) for corner in face}


def colour(face: int) -> str:
    return INNER[face - 1] if face else OUTER


def draw_tiles(ax: Axes) -> None:
    road_map(CODES, width=0.36, lanes=False, ax=ax)
    for row, column in np.argwhere(CODES):
        ax.text(column + 0.5, row + 0.5, CODES[row, column], ha="center", va="center", fontsize=8, bbox=PLATE)
    show_all(ax)


def draw_corners(ax: Axes, roads: list[tuple[Cell, Cell]], faces: dict[Cell, int]) -> None:
    draw_roads(ax, roads, ["#c3c6c4"] * len(roads))
    for one, other in dual(roads).edges:
        ax.plot(*zip(one[::-1], other[::-1], strict=True), color=colour(faces[one]), linewidth=1.5, alpha=0.6)
    for (row, column), face in faces.items():
        ax.plot(column, row, "o", color=colour(face), markersize=7, clip_on=False)


def draw_sides(ax: Axes, roads: list[tuple[Cell, Cell]], faces: dict[Cell, int]) -> int:
    """Draws the faces beside each road; returns the number of bridges."""
    beside = [[faces[corner] for corner in between(*road)] for road in roads]
    draw_roads(ax, roads, [BRIDGE if one == other else ROAD for one, other in beside])
    for (one, other), around in zip(roads, beside, strict=True):
        middle = (np.array(one) + other) / 2 + 0.5
        for corner, face in zip(between(one, other), around, strict=True):
            y, x = middle + 0.45 * (corner - middle)
            ax.plot(x, y, "o", color=colour(face), markersize=4.5)
    return sum(one == other for one, other in beside)


def draw_roads(ax: Axes, roads: list[tuple[Cell, Cell]], colours: list[str]) -> None:
    road_map(np.zeros_like(CODES), ax=ax)
    show_all(ax)
    for (one, other), shade in zip(roads, colours, strict=True):
        (top, left), (bottom, right) = one, other
        line = [left + 0.5, right + 0.5], [top + 0.5, bottom + 0.5]
        ax.plot(*line, color=shade, linewidth=5, solid_capstyle="round")


def show_all(ax: Axes) -> None:
    """Widens the limits, so that no corner on the border is cut off."""
    ax.set(xlim=(-0.15, CODES.shape[1] + 0.15), ylim=(CODES.shape[0] + 0.15, -0.15))


if __name__ == "__main__":
    main()
