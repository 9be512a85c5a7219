"""Lanes and ways as their definitions read, slow and obvious: polylines in NumPy, shortest paths by NetworkX."""

import jax
import networkx as nx
import numpy as np
from oracle import OPPOSITE, STEPS
from scipy.spatial import KDTree

from elitelanes_jax import random_grids, repair

BITS = (8, 4, 2, 1)
DIRECTIONS = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]])  # x east and y south, by heading
POINTS = 10_000


def drawn_maps(seed, count, shape, **how):
    drawn = random_grids(jax.random.key(seed), count, shape)
    return np.asarray(jax.jit(jax.vmap(lambda grid: repair(grid, **how)))(drawn))


def pick(tree, index):
    return jax.tree.map(lambda part: part[index], tree)


def turned(heading, turn):
    """The heading after a turn: 0 right, 1 straight, 2 left."""
    return (heading + (1, 0, 3)[turn]) % 4


def links(grid, row, column):
    """The sides of a tile that lead to a neighbour which leads back."""
    found = []
    for side in BITS:
        other = (row + STEPS[side][0], column + STEPS[side][1])
        inside = 0 <= other[0] < len(grid) and 0 <= other[1] < len(grid[0])
        if grid[row, column] & side and inside and grid[other] & OPPOSITE[side]:
            found.append(side)
    return found


def lane_graph(grid):
    """Nodes are (row, column, heading); an edge for each movement, with its turn."""
    graph = nx.DiGraph()
    for row, column in np.ndindex(grid.shape):
        open_sides = links(grid, row, column)
        for heading, side in enumerate(BITS):
            if OPPOSITE[side] not in open_sides:
                continue
            graph.add_node((row, column, heading))
            for turn in range(3):
                out = turned(heading, turn)
                if BITS[out] in open_sides:
                    down, right = STEPS[BITS[out]]
                    graph.add_edge((row, column, heading), (row + down, column + right, out), turn=turn)
    return graph


def polyline(heading, turn, lane_offset=0.2):
    """The centre of a lane across the tile from (0, 0) to (1, 1): float ``[POINTS, 2]``."""
    ahead = DIRECTIONS[heading]
    rightward = DIRECTIONS[(heading + 1) % 4]
    entry = np.array([0.5, 0.5]) - 0.5 * ahead
    t = np.linspace(0, 1, POINTS)[:, None]
    if turn == 1:
        return entry + lane_offset * rightward + t * ahead
    side = rightward if turn == 0 else -rightward
    corner = entry + 0.5 * side
    radius = 0.5 - lane_offset if turn == 0 else 0.5 + lane_offset
    angle = t * np.pi / 2
    return corner + radius * (np.cos(angle) * -side + np.sin(angle) * ahead)


def polyline_errors(points, thetas, heading, turn, lane_offset=0.2):
    """`d`, `phi` and `s` of poses within a tile, by the nearest of the polyline's points."""
    line = polyline(heading, turn, lane_offset)
    steps = np.diff(line, axis=0)
    along = np.concatenate([[0], np.cumsum(np.hypot(*steps.T))])
    _, nearest = KDTree(line).query(points)
    tangent = steps[np.minimum(nearest, POINTS - 2)]
    tangent = tangent / np.hypot(*tangent.T)[:, None]
    away = points - line[nearest]
    left = away[:, 0] * tangent[:, 1] - away[:, 1] * tangent[:, 0]  # y points south
    d = np.sign(left) * np.hypot(*away.T)
    lane = np.arctan2(-tangent[:, 1], tangent[:, 0])
    return d, np.angle(np.exp(1j * (thetas - lane))), along[nearest]
