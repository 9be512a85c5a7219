"""The streets that tiles become: their measures, a lane for each movement across a tile, and the graph of lanes.

Positions are complex numbers, east + north·i, from the south-west corner of the grid. Traffic keeps right. A lane's
left bound is the middle of the road; its right bound is one width of a lane beside it. The graph has Duckietown's
lanes, and no way back at dead ends.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.checks import one_of, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, option
from elitelanes_jax.formats.graph import Cell
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.network.movements import EXIT, TURNS, linked_codes, list_movements
from elitelanes_jax.network.roads import LANE_OFFSET

BACK = 3
"""The turn of a way that leaves a dead end by the side where it came in."""

_CHORDS = 8  # of a quarter circle, in formats that have no arcs: 0.5 % of its radius from it


@dataclass(frozen=True)
class Streets(Record):
    """Measures of the streets that tiles become.

    The defaults suit SUMO's own cars, 5 m long: between adjacent crossings there is room for two of them. On shorter
    streets waiting cars block the crossings behind them. ``Streets(tile=8.43)`` has the proportions of Duckietown,
    58.5 cm a tile and 22.2 cm from the middle of the road to its white line; a Duckiebot has 2.6 m there.

    Attributes:
      tile: side of a tile in metres, 0.01 to 1000, and more than two lanes.
      lane: width of a lane in metres, 0.001 to 500.
      speed: limit in metres a second, 0.001 to 100.
      right_of_way: at crossings: "allway_stop", the meaning of stop lines on all sides, "priority",
        "right_before_left" or "traffic_light".
    """

    tile: float = option(30.0, real(0.01, 1000))
    lane: float = option(3.2, real(0.001, 500))
    speed: float = option(8.33, real(0.001, 100))
    right_of_way: str = option("allway_stop", one_of("allway_stop", "priority", "right_before_left", "traffic_light"))

    def check_together(self) -> None:
        """Checks that a tile has room for two lanes."""
        if self.tile <= 2 * self.lane:
            if self.tile == Streets.tile:  # the lane was given, not the tile
                raise InputError(f"lane: expected less than half of a tile, {self.tile / 2:g} m, got {self.lane:g} m")
            raise InputError(f"tile: expected more than two lanes, {2 * self.lane:g} m, got {self.tile:g} m")


class Way(NamedTuple):
    """A lane across a tile."""

    row: int  # from the north
    column: int  # from the west
    heading: int  # when the tile is entered: 0 north, 1 east, 2 south, 3 west
    turn: int  # 0 right, 1 straight, 2 left, 3 back, at a dead end

    @property
    def tile(self) -> Cell:
        """Its row and column."""
        return self.row, self.column

    @property
    def before(self) -> Cell:
        """The tile that it comes from."""
        return self.row - SIDES[self.heading].down, self.column - SIDES[self.heading].right

    @property
    def after(self) -> Cell:
        """The tile that it leads to."""
        return self.row + SIDES[self.exit].down, self.column + SIDES[self.exit].right

    @property
    def exit(self) -> int:
        """The heading with which the tile is left."""
        return int(EXIT[self.heading, self.turn]) if self.turn < BACK else (self.heading + 2) % 4

    @property
    def name(self) -> str:
        """Row, column, side of entry and turn, such as ``3_4_west_left``."""
        return f"{self.row}_{self.column}_{SIDES[self.heading - 2].name}_{(*TURNS, 'back')[self.turn]}"


class Lanes(NamedTuple):
    """All lanes of a map."""

    ways: list[Way]  # in ascending order
    after: list[list[int]]  # the indices of the ways that continue each way
    links: NDArray[np.int8]  # [H, W], the number of links of each tile


def lanes(codes: ArrayLike) -> Lanes:
    """Lists the lanes of a map, codes ``[H, W]``: its movements, and a way back at each dead end.

    Raises:
      InputError: for a bad grid, or one without any road.
    """
    grid = np.asarray(check_grid(codes))
    linked = linked_codes(grid)
    if not linked.any():
        raise no_road()
    ends = [
        (row, column, (side + 2) % 4, BACK)
        for row, column in np.argwhere(CONNECTIONS[linked] == 1)
        for side in range(4)
        if linked[row, column] == SIDES[side].bit
    ]
    ways = sorted(Way(*map(int, way)) for way in (*list_movements(grid), *ends))
    entries: dict[tuple[int, ...], list[int]] = {}
    for index, way in enumerate(ways):
        entries.setdefault(way[:3], []).append(index)
    return Lanes(ways, [entries[*way.after, way.exit] for way in ways], CONNECTIONS[linked])


def no_road() -> InputError:
    """Makes the error for a map without lanes."""
    return InputError("grid: expected a road, two tiles that connect to each other, got none")


def middle_of_side(tile: Cell, side: int, height: int) -> complex:
    """Returns the middle of a side of a tile, in tiles. Side -1 is 3, and so on."""
    return tile[1] + 0.5 + (height - tile[0] - 0.5) * 1j + AHEAD[side] / 2


AHEAD = (1j, 1, -1j, -1)
"""The unit vectors of headings, east + north·i."""


def giving_way(ways: Iterable[Way]) -> set[int]:
    """Returns the headings of a crossing's ways that cannot go straight on: at three arms one, at four none."""
    ways = list(ways)
    return {way.heading for way in ways} - {way.heading for way in ways if way.turn == 1}


def bounds(way: Way, streets: Streets, height: int) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Returns the left and the right bound of a way, with the same number of points.

    At a dead end the left bound leads around an island, a tenth of a lane wide.
    """
    start, ahead = middle_of_side(way.tile, way.heading - 2, height), AHEAD[way.heading]
    left, right = (start + ahead * line for line in _bounds(way.turn, streets.lane / streets.tile))
    return left * streets.tile, right * streets.tile


@cache
def _bounds(turn: int, lane: float) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Returns the bounds of a way that starts in 0, ahead in the direction of 1, in tiles."""
    right = -1j * lane
    if turn == 1:
        return np.array([0, 1 + 0j]), np.array([right, right + 1])
    if turn == BACK:
        around = -1j * np.exp(1j * np.linspace(0, np.pi, 2 * _CHORDS + 1))
        left = np.concatenate([[0], 0.5 + lane / 20 * around, [0]])
        return left, np.concatenate([[right], 0.5 + lane * around, [-right]])
    bend = turn - 1  # to the left
    centre = bend * 0.5j
    turned = np.exp(bend * 1j * np.linspace(0, np.pi / 2, _CHORDS + 1))
    return centre - centre * turned, centre + (right - centre) * turned


LENGTHS = np.array([(0.5 - LANE_OFFSET) * np.pi / 2, 1, (0.5 + LANE_OFFSET) * np.pi / 2])
"""float64 ``[3]``: the length of a movement in tiles, to the right, straight on and to the left."""

_DOWN, _RIGHT = (np.array([getattr(side, name) for side in SIDES]) for name in ("down", "right"))


class LaneGraph(NamedTuple):
    """The lanes of a grid."""

    nodes: NDArray[np.int_]  # [N, 3], row, column and heading when a tile is entered: 0 north, 1 east, 2 south, 3 west
    edges: NDArray[np.int_]  # [M, 2], the movements, from node to node, in the order of their first nodes
    turns: NDArray[np.int_]  # [M], 0 right, 1 straight, 2 left


def lane_graph(codes: ArrayLike) -> LaneGraph:
    """Makes the graph of a grid's lanes, of codes ``[H, W]``, by the connections that neighbours return.

    Raises:
      InputError: for a bad grid, or one without a lane.
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
    ahead, shares = np.array(AHEAD)[heading][:, None], np.asarray(shares, float)
    entry = (column + 0.5 + (height - row - 0.5) * 1j)[:, None] - ahead * (0.5 + LANE_OFFSET * 1j)
    bend = (graph.turns - 1)[:, None]  # to the left
    radius, angle = 0.5 + LANE_OFFSET * bend, shares * np.pi / 2
    arc = radius * (np.sin(angle) + bend * (1 - np.cos(angle)) * 1j)
    return np.asarray(entry + ahead * np.where(bend == 0, shares, arc))
