"""The optimum of one niche as an integer programme, solved by HiGHS: another way than the frontier's."""

import time

import networkx as nx
import numpy as np
from oracle import STEPS, road_graph
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csr_array

__all__ = ["solve"]


def solve(height, width, fill, cyclomatic, seconds, counted=None):
    """Returns the lowest fitness of a flawless network without bridges, infinite if there is none; None without proof.

    With `counted`, such as ``("turns", 8)``, the network has this number of tiles of the kind.

    A variable for each tile of each cell, and for each run of straights. Where a solution falls apart, or has a bridge,
    the sets of cells on both sides must be held together by two links, and it is solved again.
    """
    cells = list(np.ndindex(height, width))
    tiles = {}
    for row, column in cells:
        for code in range(16):
            inside = all(
                0 <= row + down < height and 0 <= column + right < width
                for side, (down, right) in STEPS.items()
                if code & side
            )
            if code.bit_count() != 1 and (code or not fill) and inside:
                tiles[row, column, code] = len(tiles)
    runs = {}
    for row, column in cells:
        for length in range(1, max(height, width) - 1):
            for code, down, right in ((5, 0, 1), (10, 1, 0)):
                run = tuple((row + k * down, column + k * right) for k in range(length))
                if all((*cell, code) in tiles for cell in run):
                    runs[code, run] = len(tiles) + len(runs)
    size = len(tiles) + len(runs)
    rows, lows, highs = [], [], []

    def require(terms, low, high):
        rows.append(terms)
        lows.append(low)
        highs.append(high)

    def total(cell, wanted, weight=1):
        return {tiles[*cell, code]: weight for code in range(16) if (*cell, code) in tiles and wanted(code)}

    def link(cell, side):
        return total(cell, lambda code: code & side)

    def turn(code):
        return code in (3, 6, 9, 12)

    def crossing(code):
        return code.bit_count() >= 3

    for cell in cells:
        require(total(cell, lambda code: True), 1, 1)
        for code in (5, 10):
            if (*cell, code) in tiles:
                covering = {place: -1 for (kind, run), place in runs.items() if kind == code and cell in run}
                require({tiles[*cell, code]: 1} | covering, 0, 0)
        for side, back, down, right in ((4, 1, 0, 1), (2, 8, 1, 0)):
            other = (cell[0] + down, cell[1] + right)
            if other in cells:
                here, there = link(cell, side), link(other, back)
                require(here | dict.fromkeys(there, -1), 0, 0)
                require(total(cell, turn) | total(other, turn), 0, 1)
                crossings = total(cell, crossing) | total(other, crossing)
                require({place: crossings.get(place, 0) + here.get(place, 0) for place in crossings | here}, 0, 2)
    beyond = {tiles[cell]: cell[2].bit_count() / 2 - 1 for cell in tiles if cell[2]}
    require(beyond, cyclomatic - 1, cyclomatic - 1)
    if counted:
        kind, number = counted
        is_counted = {"turns": turn, "crossings": crossing, "straights": lambda code: code in (5, 10)}[kind]
        require({tiles[cell]: 1 for cell in tiles if is_counted(cell[2])}, number, number)
    gains = np.zeros(size)
    for (_, run), place in runs.items():
        gains[place] = len(run) ** 2
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        entries = [(number, place, value) for number, terms in enumerate(rows) for place, value in terms.items()]
        number, place, value = zip(*entries, strict=True)
        matrix = csr_array((value, (number, place)), shape=(len(rows), size))
        found = milp(
            -gains,
            constraints=LinearConstraint(matrix, lows, highs),
            integrality=np.ones(size),
            bounds=Bounds(0, 1),
            options={"time_limit": max(1, deadline - time.monotonic()), "mip_rel_gap": 0},
        )
        if found.status == 2:
            return np.inf
        if found.status != 0:
            return None
        grid = np.zeros((height, width), int)
        for (row, column, code), place in tiles.items():
            if found.x[place] > 0.5:
                grid[row, column] = code
        graph = road_graph(grid)
        parts = list(nx.connected_components(graph))
        for edge in list(nx.bridges(graph)):
            graph.remove_edge(*edge)
            parts += [nx.node_connected_component(graph, edge[0])]
            graph.add_edge(*edge)
        if len(parts) == 1:
            return -2 * (cyclomatic + round(-found.fun))
        for part in parts:
            leaving = {}
            for row, column in part:
                for side, (down, right) in STEPS.items():
                    if (row + down, column + right) not in part:
                        leaving |= _sum(leaving, link((row, column), side))
            inner, outer = min(part), min(set(graph) - part, default=None)
            if outer is None:
                continue
            # With a road on both sides at least two links lead from one to the other.
            ends = total(inner, bool, -2) | total(outer, bool, -2)
            require(_sum(leaving, ends), -2, np.inf)
    return None


def _sum(one, other):
    return {place: one.get(place, 0) + other.get(place, 0) for place in one | other}
