"""The graph of a grid's lanes, and shortest ways on it; without JAX. Traffic keeps right, and nobody turns back."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.streets import AHEAD
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.movements import EXIT, list_movements
from elitelanes_jax.network.roads import LANE_OFFSET

LENGTHS = np.array([(0.5 - LANE_OFFSET) * np.pi / 2, 1, (0.5 + LANE_OFFSET) * np.pi / 2])
"""float64 ``[3]``: the length of a movement in tiles, to the right, straight on and to the left."""

_AHEAD = np.array(AHEAD)
_DOWN, _RIGHT = (np.array([getattr(side, name) for side in SIDES]) for name in ("down", "right"))


class LaneGraph(NamedTuple):
    """The lanes of a grid."""

    nodes: NDArray[np.int_]  # [N, 3], row, column and heading when a tile is entered: 0 north, 1 east, 2 south, 3 west
    edges: NDArray[np.int_]  # [M, 2], the movements, from node to node, in the order of their first nodes
    turns: NDArray[np.int_]  # [M], 0 right, 1 straight, 2 left


def lane_graph(codes: ArrayLike) -> LaneGraph:
    """Makes the graph of a grid's lanes, of codes ``[H, W]``, by the connections that neighbours return.

    Raises:
      InputError: for a bad grid (see `check_grid`), or one without a lane.
    """
    moves = list_movements(np.asarray(check_grid(codes)))
    if not len(moves):
        raise InputError("grid: expected a lane, a tile that connects to two others, got none")
    row, column, heading, turn = moves.T
    out = EXIT[heading, turn]
    ends = np.concatenate([moves[:, :3], np.stack([row + _DOWN[out], column + _RIGHT[out], out], axis=-1)])
    nodes, indices = np.unique(ends, axis=0, return_inverse=True)
    return LaneGraph(nodes, indices.reshape(2, -1).T, turn)


def lane_points(graph: LaneGraph, height: int, shares: ArrayLike) -> NDArray[np.complex128]:
    """Returns points on the centres of all lanes, complex128 ``[M, S]``, tiles east + north·i of the south-west corner.

    `height` is the grid's. `shares`, floats ``[S]``, are the parts of each lane's length before the points, 0 to 1.
    """
    row, column, heading = graph.nodes[graph.edges[:, 0]].T
    ahead, shares = _AHEAD[heading][:, None], np.asarray(shares, float)
    entry = (column + 0.5 + (height - row - 0.5) * 1j)[:, None] - ahead * (0.5 + LANE_OFFSET * 1j)
    bend = (graph.turns - 1)[:, None]  # to the left
    radius, angle = 0.5 + LANE_OFFSET * bend, shares * np.pi / 2
    arc = radius * (np.sin(angle) + bend * (1 - np.cos(angle)) * 1j)
    return np.asarray(entry + ahead * np.where(bend == 0, shares, arc))
