"""Draws the rooms of the package and their imports, for CONTRIBUTING.md.

python docs/house.py
"""

from itertools import groupby
from pathlib import Path

import grimp
import networkx as nx
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

PACKAGE = "elitelanes_jax"
WIDTH, HEIGHT, GAP = 1.7, 0.62, 0.55
INK, FILL, ARROW = "#28282c", "#e8eef4", "#7a8794"


def rooms() -> nx.DiGraph:
    """Returns the imports between rooms; those that follow from others are left out."""
    modules = grimp.build_graph(PACKAGE, exclude_type_checking_imports=True)
    imports = nx.DiGraph()
    for module in modules.modules:
        for imported in modules.find_modules_directly_imported_by(module):
            room, other = (name.split(".")[1:2] for name in (module, imported))
            if room and other and room != other and room != ["__main__"]:
                imports.add_edge(*room, *other)
    return nx.transitive_reduction(imports)


def lines_of(room: str) -> int:
    """Returns the number of lines of a room."""
    folder = Path(__file__).parents[1] / PACKAGE
    files = [folder / f"{room}.py"] if (folder / f"{room}.py").exists() else (folder / room).rglob("*.py")
    return sum(len(file.read_text(encoding="utf-8").splitlines()) for file in files)


def places(house: nx.DiGraph) -> dict[str, tuple[float, float]]:
    """Returns the place of each room: below all that import it, and near their middle."""
    floors = {room: floor for floor, group in enumerate(nx.topological_generations(house)) for room in group}
    # A room moves down to its own imports, where the arrows are short.
    for room in reversed(list(nx.topological_sort(house))):
        floors[room] = min((floors[other] for other in house.successors(room)), default=floors[room] + 1) - 1
    positions: dict[str, tuple[float, float]] = {}
    by_floor = sorted(floors, key=lambda room: (floors[room], room))
    for floor, group in groupby(by_floor, key=lambda room: floors[room]):
        above = {
            room: [positions[other][0] for other in house.predecessors(room) if other in positions] or [0.0]
            for room in group
        }
        order = sorted(above, key=lambda room: (sum(above[room]) / len(above[room]), room))
        for index, room in enumerate(order):
            positions[room] = (index - (len(order) - 1) / 2) * (WIDTH + GAP), -floor * (HEIGHT + GAP)
    return positions


def draw(house: nx.DiGraph) -> Figure:
    """Draws each room with its number of lines, in hundreds, and an arrow to each room that it imports."""
    place = places(house)
    across = max(x for x, _ in place.values()) - min(x for x, _ in place.values()) + WIDTH + 0.4
    down = max(-y for _, y in place.values()) + HEIGHT + 0.4
    figure = Figure(figsize=(across, down))
    ax = figure.add_axes((0, 0, 1, 1))
    for room, other in house.edges:
        (x, y), (to_x, to_y) = place[room], place[other]
        arrow = {"arrowstyle": "-|>", "color": ARROW, "lw": 1.2, "shrinkA": 0, "shrinkB": 1}
        ax.annotate("", (to_x, to_y + HEIGHT / 2), (x, y - HEIGHT / 2), arrowprops=arrow, zorder=1)
    for room, (x, y) in place.items():
        corner = x - WIDTH / 2, y - HEIGHT / 2
        box = FancyBboxPatch(corner, WIDTH, HEIGHT, boxstyle="round,pad=0,rounding_size=0.1", fc=FILL, ec=INK)
        ax.add_patch(box)
        ax.text(x, y + 0.08, room, ha="center", va="center", fontsize=12, color=INK, weight="bold")
        ax.text(x, y - 0.16, f"{round(lines_of(room), -2):,} lines", ha="center", va="center", fontsize=9, color=INK)
    middle = (min(x for x, _ in place.values()) + max(x for x, _ in place.values())) / 2
    ax.set_xlim(middle - across / 2, middle + across / 2)
    ax.set_ylim(-down + HEIGHT / 2 + 0.2, HEIGHT / 2 + 0.2)
    ax.axis("off")
    return figure


if __name__ == "__main__":
    draw(rooms()).savefig(Path(__file__).parent / "house.png", dpi=110)
