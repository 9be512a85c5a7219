"""Gridlock, slow and obvious: loops and streets with NetworkX, chances and determinants with SciPy in float64."""

import math
from decimal import Decimal, localcontext
from itertools import pairwise
from typing import NamedTuple

import networkx as nx
import numpy as np
from oracle import road_graph
from scipy.stats import poisson

HEADINGS = ((-1, 0), (0, 1), (1, 0), (0, -1))


def gridlock_number(grid, slots=1):
    """By the girth of the graph of tiles, which is infinite without a loop."""
    girth = nx.girth(road_graph(grid))
    return 0 if math.isinf(girth) else slots * girth - 1


def gridlock_loop(grid):
    """The least of all shortest loops, as lists of tiles: clockwise, from the first tile row by row."""
    graph = road_graph(np.asarray(grid))
    girth = nx.girth(graph)
    loops = []
    for cycle in [] if math.isinf(girth) else nx.simple_cycles(graph, length_bound=girth):
        first = cycle.index(min(cycle))
        loop = cycle[first:] + cycle[:first]
        goes_east = loop[1][0] == loop[0][0]
        loops.append(loop if goes_east else loop[:1] + loop[:0:-1])
    return min(loops, default=[])


class Street(NamedTuple):
    """The tiles of a street from crossing to crossing, with both."""

    tiles: tuple

    @property
    def headings(self):
        return [HEADINGS.index((b[0] - a[0], b[1] - a[1])) for a, b in pairwise(self.tiles)]

    def millimetres(self, tile_size):
        """The right lane of the street, without 7.2 m at each end: half a crossing, and the radius of its corners."""
        turns = [(after - before) % 4 for before, after in pairwise(self.headings)]
        arc = {side: round(500 * math.pi * (tile_size / 2 + side * 1.6)) for side in (-1, 1)}
        lengths = {0: round(1000 * tile_size), 1: arc[-1], 3: arc[1]}
        return sum(lengths[turn] for turn in turns) + round(1000 * tile_size) - 14_400

    def capacity(self, tile_size):
        """The cars that find room: each needs 5 m, and 2.5 m to the next one."""
        return max(1, (self.millimetres(tile_size) + 2500) // 7500)

    def leads_to(self, other):
        """Not back along the same road."""
        return self.tiles[-1] == other.tiles[0] and self.tiles[-2] != other.tiles[1]


def streets(grid):
    """All streets, in both directions, of the roads that lead to no dead end; rings without a crossing have none."""
    graph = road_graph(grid)
    core = graph.subgraph(nx.k_core(graph, 2))
    found = []
    for start in core:
        for first in core[start] if core.degree(start) > 2 else ():
            tiles = [start, first]
            while core.degree(tiles[-1]) == 2:
                tiles.append(next(tile for tile in core[tiles[-1]] if tile != tiles[-2]))
            found.append(Street(tuple(tiles)))
    return found


def street_graph(grid, tile_size):
    """Streets as nodes. An edge has the capacity of the street that it leads to."""
    found = streets(grid)
    graph = nx.DiGraph()
    graph.add_nodes_from(found)
    for one in found:
        graph.add_weighted_edges_from((one, other, other.capacity(tile_size)) for other in found if one.leads_to(other))
    return graph


def gamma(grid, tile_size=16.0):
    """The least number of cars that fill a cycle of streets, 0 without one."""
    graph = street_graph(grid, tile_size)
    totals = []
    for start in graph:
        cars = nx.single_source_dijkstra_path_length(graph, start)
        totals += [cars[last] + start.capacity(tile_size) for last in graph.predecessors(start) if last in cars]
    return min(totals, default=0)


def turn_shares(graph, tile_size):
    """What passes from street to street if cars drive between all pairs, by all ways over fewest streets alike.

    A pair of streets has the product of their lengths. Returns a matrix of flows, in the order of the graph.
    """
    order = {street: index for index, street in enumerate(graph)}
    flow = np.zeros((len(order), len(order)))
    for start in graph:
        for goal in nx.descendants(graph, start):
            pair = start.millimetres(tile_size) * goal.millimetres(tile_size) / 1e6
            ways = list(nx.all_shortest_paths(graph, start, goal))
            for way in ways:
                for one, other in pairwise(way):
                    flow[order[one], order[other]] += pair / len(ways)
    return flow


def gridlock_potential(grid, robots, tile_size=16.0):
    """-log det(I - diag(p) T): p the chance that a street is full, T the shares of turns at its end.

    The cars on a street are Poisson, in proportion to its flow and to its length, and 20 m more for the crossing.
    """
    graph = street_graph(grid, tile_size)
    flow = turn_shares(graph, tile_size)
    passing = flow.sum(axis=1)
    if not passing.any():
        return 0.0
    lengths = np.array([street.millimetres(tile_size) for street in graph])
    load = passing * (lengths + 20_000)
    cars = robots * load / load.sum()
    most = [street.capacity(tile_size) - 1 for street in graph]
    return expected_cycles(flow, poisson.sf(most, cars), poisson.cdf(most, cars))


def expected_cycles(flow, full, free):
    """The formula by Gaussian elimination with 60 digits: a determinant may be 1 - 1e-50."""
    with localcontext(prec=60):
        rows = []
        for index, onward in enumerate(flow.tolist()):
            # Of both chances, the smaller one has more digits.
            chance = Decimal(full[index]) if full[index] < 0.5 else 1 - Decimal(free[index])
            total = sum(map(Decimal, onward)) or Decimal(1)
            rows.append([(column == index) - chance * Decimal(value) / total for column, value in enumerate(onward)])
        result = Decimal(0)
        while rows:
            (pivot, *first), *others = rows
            result -= pivot.ln()
            rows = [[b - a / pivot * c for b, c in zip(rest, first, strict=True)] if a else rest for a, *rest in others]
        return float(result)
