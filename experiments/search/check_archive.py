"""Measures networks, and compares them with the certificates, with NumPy and NetworkX alone."""

from collections.abc import Iterable, Mapping
from typing import NamedTuple

import networkx as nx
import numpy as np
from numpy.typing import NDArray

__all__ = ["Score", "check", "count_tiles", "rescore"]

_NORTH, _EAST, _SOUTH, _WEST = 8, 4, 2, 1


class Score(NamedTuple):
    """What is measured of a network; `filled` says whether every cell has a road."""

    fitness: int
    cyclomatic: int
    flawless: bool
    filled: bool
    bridges: int


def rescore(grid: NDArray[np.integer]) -> Score:
    """Measures a grid of codes ``[H, W]``, tile by tile and as a graph."""
    connections = np.array([code.bit_count() for code in range(16)])[grid]
    east = (grid[:, :-1] & _EAST > 0) & (grid[:, 1:] & _WEST > 0)
    south = (grid[:-1] & _SOUTH > 0) & (grid[1:] & _NORTH > 0)
    matched = np.zeros(grid.shape, int)
    for links, ends in ((east, (np.s_[:, :-1], np.s_[:, 1:])), (south, (np.s_[:-1], np.s_[1:]))):
        for end in ends:
            matched[end] += links
    outward = np.zeros(grid.shape, bool)
    for edge, side in ((np.s_[0], _NORTH), (np.s_[-1], _SOUTH), (np.s_[:, 0], _WEST), (np.s_[:, -1], _EAST)):
        outward[edge] |= grid[edge] & side > 0
    dead_ends = int(((connections == 1) | (matched < connections)).sum())

    nodes = np.arange(grid.size).reshape(grid.shape)
    graph = nx.Graph()
    graph.add_nodes_from(nodes[grid > 0].tolist())
    graph.add_edges_from(zip(nodes[:, :-1][east].tolist(), nodes[:, 1:][east].tolist(), strict=True))
    graph.add_edges_from(zip(nodes[:-1][south].tolist(), nodes[1:][south].tolist(), strict=True))
    components = nx.number_connected_components(graph)
    cyclomatic = graph.number_of_edges() - graph.number_of_nodes() + components

    crossing, turn = connections >= 3, np.isin(grid, (3, 6, 9, 12))
    crossings = int((east & crossing[:, :-1] & crossing[:, 1:]).sum() + (south & crossing[:-1] & crossing[1:]).sum())
    turns = int((turn[:, :-1] & turn[:, 1:]).sum() + (turn[:-1] & turn[1:]).sum())
    straights = sum(map(_squares, grid == _EAST + _WEST)) + sum(map(_squares, (grid == _NORTH + _SOUTH).T))
    fitness = 480 * dead_ends + 300 * max(components - 1, 0) + 150 * int(outward.sum()) + 200 * crossings + 80 * turns
    bridges = sum(1 for _ in nx.bridges(graph))
    fitness += 100 * bridges - 2 * cyclomatic - 2 * straights
    flawless = components == 1 and not (dead_ends or crossings or turns)
    return Score(fitness, cyclomatic, flawless, bool((grid > 0).all()), bridges)


def count_tiles(grid: NDArray[np.integer], kind: str) -> int:
    """Counts the ``turns``, ``crossings`` or ``straights`` of a grid of codes ``[H, W]``."""
    codes = {"turns": (3, 6, 9, 12), "crossings": (7, 11, 13, 14, 15), "straights": (5, 10)}[kind]
    return int(np.isin(grid, codes).sum())


def _squares(marks: NDArray[np.bool_]) -> int:
    """Sums the squares of the lengths of all runs of marks."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marks, [False]])))
    return int(((edges[1::2] - edges[::2]) ** 2).sum())


def check(
    optima: Mapping[int, int], grids: Iterable[NDArray[np.integer]], *, fill: bool
) -> tuple[dict[int, list[int]], list[str]]:
    """Compares networks with certificates.

    Args:
      optima: the certified fitness by feasible cyclomatic number.
      grids: of codes. A grid that is not flawless does not count, nor one with an empty cell if `fill` is set.
      fill: whether every cell has to be filled.

    Returns:
      The fitness of all networks that count, by cyclomatic number, and a line for each that should not exist.
    """
    found: dict[int, list[int]] = {}
    faults = []
    for grid in grids:
        score = rescore(grid)
        if not score.flawless or (fill and not score.filled):
            continue
        found.setdefault(score.cyclomatic, []).append(score.fitness)
        certified = optima.get(score.cyclomatic)
        if certified is None or score.fitness < certified:
            expected = "no network" if certified is None else f"{certified} at best"
            faults.append(
                f"cyclomatic number {score.cyclomatic}: certified {expected}, got {score.fitness}: {grid.tolist()}"
            )
    return found, faults
