"""Metrics, repair and comparison as their definitions read, slow and obvious: the graph's metrics by NetworkX."""

from pathlib import Path

import networkx as nx
import numpy as np

CERTIFICATES = Path(__file__).parents[1] / "elitelanes_jax" / "benchmark" / "certificates.json"

STEPS = {8: (-1, 0), 4: (0, 1), 2: (1, 0), 1: (0, -1)}
OPPOSITE = {8: 2, 4: 1, 2: 8, 1: 4}
TURNS = (3, 6, 9, 12)


def road_graph(grid):
    """Tiles as nodes, links as edges."""
    height, width = grid.shape
    graph = nx.Graph()
    for row in range(height):
        for column in range(width):
            if grid[row, column]:
                graph.add_node((row, column))
    for row, column in list(graph):
        for side, (down, right) in STEPS.items():
            other = (row + down, column + right)
            if grid[row, column] & side and other in graph and grid[other] & OPPOSITE[side]:
                graph.add_edge((row, column), other)
    return graph


def measure(grid, alphabet=range(16)):
    """All metrics of a grid as a dict."""
    grid = np.asarray(grid, int)
    height, width = grid.shape
    graph = road_graph(grid)
    connections = {cell: int(grid[cell]).bit_count() for cell in np.ndindex(grid.shape)}
    crossing = {cell for cell, count in connections.items() if count >= 3}
    unmatched = dict.fromkeys(graph, 0)
    outward = dict.fromkeys(graph, 0)
    for row, column in graph:
        for side, (down, right) in STEPS.items():
            if not grid[row, column] & side:
                continue
            other = (row + down, column + right)
            if not (0 <= other[0] < height and 0 <= other[1] < width):
                outward[row, column] += 1
            elif not graph.has_edge((row, column), other):
                unmatched[row, column] += 1
    pairs = [(a, b) for a, b in graph.edges if a in crossing and b in crossing]
    components = nx.number_connected_components(graph)
    return {
        "components": components,
        "cyclomatic": graph.number_of_edges() - graph.number_of_nodes() + components,
        "dead_ends": sum(connections[cell] == 1 or unmatched[cell] + outward[cell] > 0 for cell in graph),
        "boundary_violations": sum(count > 0 for count in outward.values()),
        "bridges": sum(1 for _ in nx.bridges(graph)),
        "crossings": len(crossing),
        "adjacent_crossings": 2 * len(pairs),
        "adjacent_crossing_score": sum(connections[a] + connections[b] for a, b in pairs),
        "adjacent_turns": sum(
            grid[row, column] in TURNS and grid[other] in TURNS
            for row, column in np.ndindex(grid.shape)
            for other in ((row, column + 1), (row + 1, column))
            if other[0] < height and other[1] < width
        ),
        "straight_score": sum(_runs(row, 5) for row in grid) + sum(_runs(column, 10) for column in grid.T),
        "straights": int(np.isin(grid, (5, 10)).sum()),
        "turns": int(np.isin(grid, TURNS).sum()),
        "crowded_crossings": sum(
            (a in crossing or b in crossing) and all(t in crossing or grid[t] in TURNS for t in (a, b))
            for a, b in _sides(height, width)
        ),
        "unlinked_neighbours": sum(
            bool(grid[a]) and bool(grid[b]) and not graph.has_edge(a, b) for a, b in _sides(height, width)
        ),
        "tiles": graph.number_of_nodes(),
        "empty_cells": int((grid == 0).sum()),
        "edges": graph.number_of_edges(),
        "mismatches": sum(unmatched.values()),
        "off_alphabet": sum(int(code) not in alphabet for code in grid.flat),
        "coverage": np.float32(graph.number_of_nodes() / grid.size),
    }


def _sides(height, width):
    """All pairs of cells that share a side."""
    for row, column in np.ndindex(height, width):
        if column + 1 < width:
            yield (row, column), (row, column + 1)
        if row + 1 < height:
            yield (row, column), (row + 1, column)


def fitness(metrics):
    """The paper's equation, as the specification reads it."""
    return (
        480 * metrics["dead_ends"]
        + 300 * max(metrics["components"] - 1, 0)
        + 150 * metrics["boundary_violations"]
        + 100 * metrics["bridges"]
        + 100 * metrics["adjacent_crossings"]
        + 80 * metrics["adjacent_turns"]
        - 2 * metrics["cyclomatic"]
        - 2 * metrics["straight_score"]
    )


def _runs(line, code):
    """Sum of the squares of the lengths of all runs of a code."""
    text = "".join("#" if tile == code else "." for tile in line)
    return sum(len(run) ** 2 for run in text.split("."))


def repair(grid, rank):
    """Flip, one edge at a time: the higher rank dictates, between equals the link is made."""
    grid = np.array(grid, int)
    rank = np.asarray(rank, int)
    height, width = grid.shape
    made = np.zeros_like(grid)
    for row, column in np.ndindex(grid.shape):
        for side, (down, right) in ((4, (0, 1)), (2, (1, 0))):
            other = (row + down, column + right)
            if other[0] >= height or other[1] >= width:
                continue
            mine, theirs = bool(grid[row, column] & side), bool(grid[other] & OPPOSITE[side])
            if rank[row, column] == rank[other]:
                link = mine or theirs
            else:
                link = mine if rank[row, column] > rank[other] else theirs
            if link:
                made[row, column] |= side
                made[other] |= OPPOSITE[side]
    return made


def raster_rank(shape):
    """Ranks that fall row by row: the paper's loop goes through the tiles in this order."""
    return np.arange(shape[0] * shape[1], 0, -1).reshape(shape)


def fill(grid, fixed):
    """Adds links to a repaired grid: stubs go straight on, then east, south, west and north are tried in turn."""
    grid = np.array(grid, int)

    def link(row, column, side):
        down, right = {8: (-1, 0), 4: (0, 1), 2: (1, 0), 1: (0, -1)}[side]
        other = (row + down, column + right)
        if min(other) < 0 or other[0] >= grid.shape[0] or other[1] >= grid.shape[1]:
            return
        if not fixed[row, column] and not fixed[other]:
            grid[row, column] |= side
            grid[other] |= OPPOSITE[side]

    for row, column, code in [(*cell, grid[cell]) for cell in np.ndindex(grid.shape)]:
        if code in OPPOSITE:
            link(row, column, OPPOSITE[code])
    for side in (4, 2, 1, 8):
        for row, column in [cell for cell in np.ndindex(grid.shape) if int(grid[cell]).bit_count() < 2]:
            link(row, column, side)
    return grid


def difference(one, other):
    """The least share of cells that differ, over all images of one grid at all positions on the other."""
    one, other = np.asarray(one, np.int8), np.asarray(other, np.int8)
    least = min(_count_differing(one, image) for image in _images(other))
    return least / max(one.size, other.size)


def _count_differing(one, other):
    """Lays a grid on another at every position, also beside it. Cells outside a grid are empty."""
    height, width = other.shape
    around = np.pad(one, ((height, height), (width, width)))
    windows = np.lib.stride_tricks.sliding_window_view(around, other.shape)
    inside = (windows != other).sum(axis=(2, 3))
    outside = (one > 0).sum() - (windows > 0).sum(axis=(2, 3))
    return (inside + outside).min()


def _images(grid):
    for image in (grid, _with_sides(grid[:, ::-1], {8: 8, 4: 1, 2: 2, 1: 4})):
        for _ in range(4):
            yield image
            image = _with_sides(np.rot90(image, -1), {8: 4, 4: 2, 2: 1, 1: 8})


def _with_sides(grid, new_sides):
    """Replaces each connection of each tile by the one on its new side."""
    return np.int8(sum(np.where(grid & old, new, 0) for old, new in new_sides.items()))
