"""Nodes and movements: the graph of lanes.

The fields of a `LaneNode` or a `Movement` are whole numbers, or integer arrays of NumPy or JAX of
one shape. So one record is a single movement, all movements of a map, or those of a batch of
robots.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Whole, WholeT
from elitelanes_jax.lanes.links import Codes, linked_codes
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.links import Cell

TURNS = ("right", "straight", "left")
"""The turns of a movement by their indices."""

BACK = 3
"""The turn of a movement that leaves a dead end by the side where it came in."""


def exit_heading(heading: WholeT, turn: WholeT) -> WholeT:
    """Returns the heading with which a movement leaves its tile.

    `turn` may be `BACK`.
    """
    # Headings count clockwise: right is 1 more, and left 1 less. Only two bits are kept.
    return (heading + 1 - turn) & 3


def turn_between(heading: WholeT, next_heading: WholeT) -> WholeT:
    """Returns the turn of a movement that enters with a heading and leaves with another.

    The turn is `BACK` if the headings are opposite.
    """
    # This is `exit_heading` solved for the turn, modulo 4.
    return (heading - next_heading + 1) & 3


def step_towards(heading: WholeT) -> tuple[WholeT, WholeT]:
    """Returns the rows down and the columns right from a tile to its neighbour.

    The neighbour is in a heading, 0 to 3.
    """
    # It is 1 for east and west.
    is_across = heading & 1
    # North and south step along rows, by -1 and 1; east and west along columns, by 1 and -1.
    return (heading - 1) * (1 - is_across), (2 - heading) * is_across


EXIT = exit_heading(np.arange(4)[:, None], np.arange(3))
"""int ``[4, 3]``: the heading with which a movement leaves a tile.

The axes are the heading with which the movement enters, and its turn.
"""


def _movements_of_codes() -> Bool[np.ndarray, "16 4 4"]:
    """Returns whether a tile has a movement, by its code, the heading, and the turn with `BACK`."""
    table = np.zeros((16, 4, 4), bool)
    for code in range(16):
        for heading, side in enumerate(SIDES):
            # A tile is entered by the side opposite to the heading.
            if not code & side.opposite:
                continue
            # A movement needs a connection on the side by which it leaves.
            for turn, out in enumerate(EXIT[heading]):
                table[code, heading, turn] = bool(code & SIDES[out].bit)
            # A dead end has that side alone.
            table[code, heading, BACK] = code == side.opposite
    return table


_MOVEMENTS = _movements_of_codes()

MOVEMENTS = _MOVEMENTS[..., :BACK]
"""bool ``[16, 4, 3]``: whether a tile has a movement.

The axes are the code of the tile (of links), the heading and the turn.
"""


class LaneNode(NamedTuple):
    """A node of the graph of lanes: a tile and the heading with which it was entered.

    A node determines where a robot may drive next. Each field is a whole number or an integer
    array.

    Attributes:
      row: the row of the tile, from 0 in the north.
      column: the column of the tile, from 0 in the west.
      heading: 0 north, 1 east, 2 south, 3 west.
    """

    row: Whole
    column: Whole
    heading: Whole

    def equals(self, other: "LaneNode") -> Whole:
        """Returns whether both are the same node, for arrays element by element."""
        is_tile = (self.row == other.row) & (self.column == other.column)
        return is_tile & (self.heading == other.heading)

    @property
    def tile(self) -> Cell:
        """Its row and column."""
        return self.row, self.column

    @property
    def tile_before(self) -> Cell:
        """The tile that leads here."""
        # The step to this tile is one in its heading, so the step back is subtracted.
        down, right = step_towards(self.heading)
        return self.row - down, self.column - right


class Movement(NamedTuple):
    """A way across a tile. Each field is a whole number or an integer array.

    Attributes:
      row: the row of the tile, from 0 in the north.
      column: the column of the tile, from 0 in the west.
      heading: the heading with which the tile is entered: 0 north, 1 east, 2 south, 3 west.
      turn: 0 right, 1 straight, 2 left; 3 back, where a format's cars turn at dead ends.
    """

    row: Whole
    column: Whole
    heading: Whole
    turn: Whole

    @property
    def node(self) -> LaneNode:
        """The tile and the heading when it is entered."""
        return LaneNode(self.row, self.column, self.heading)

    @property
    def exit(self) -> Whole:
        """The heading with which the tile is left."""
        return exit_heading(self.heading, self.turn)

    @property
    def next_node(self) -> LaneNode:
        """The tile after the movement, and the heading there."""
        heading = self.exit
        # The movement leaves into the neighbour in its exit heading, and enters it with that
        # heading.
        down, right = step_towards(heading)
        return LaneNode(self.row + down, self.column + right, heading)

    @property
    def name(self) -> str:
        """Row, column, side of entry and turn of a single movement, such as ``3_4_west_left``."""
        # A movement enters by the side opposite to its heading.
        side, turn = SIDES[(self.heading + 2) % 4], (*TURNS, "back")[self.turn]
        return f"{self.row}_{self.column}_{side.name}_{turn}"


class LaneGraph(NamedTuple):
    """The lanes of a map: N nodes and M movements between them.

    Attributes:
      nodes: int ``[N]`` each, in ascending order of row, column and heading.
      movements: int ``[M]`` each, in ascending order of row, column, heading and turn.
      edges: int ``[M, 2]``, the indices of the nodes where each movement starts and ends.
    """

    nodes: LaneNode
    movements: Movement
    edges: Int[np.ndarray, "M 2"]

    def node(self, index: int) -> LaneNode:
        """Returns a node, in whole numbers of Python."""
        return LaneNode(*(int(field[index]) for field in self.nodes))

    def list_movements(self) -> list[Movement]:
        """Returns the movements one by one, in whole numbers of Python."""
        return [Movement(*fields) for fields in np.stack(self.movements, axis=1).tolist()]

    def list_successors(self) -> list[list[int]]:
        """Returns the indices of the movements that continue each movement."""
        starts, ends = self.edges.T
        # Movements are in the order of the nodes where they start, so those of a node are a range.
        first = np.searchsorted(starts, ends, "left").tolist()
        stop = np.searchsorted(starts, ends, "right").tolist()
        return [list(range(*span)) for span in zip(first, stop, strict=True)]

    def list_predecessors(self) -> list[list[int]]:
        """Returns the indices of the movements that each movement continues."""
        successors = self.list_successors()
        predecessors: list[list[int]] = [[] for _ in successors]
        for index, following in enumerate(successors):
            for movement in following:
                predecessors[movement].append(index)
        return predecessors


def movements_of(codes: Codes, *, turn_back: bool = False) -> Movement:
    """Lists the movements of a map, int ``[M]`` each.

    Movements are in ascending order of row, column, heading and turn.

    Args:
      codes: integer codes ``[H, W]``.
      turn_back: whether there is a movement back at each dead end.

    Raises:
      InputError: for a bad grid.
    """
    # Only formats with cars that turn at dead ends ask for movements back.
    table = _MOVEMENTS if turn_back else MOVEMENTS
    # The links of a tile select its rows of the table. `argwhere` lists them in ascending order.
    return Movement(*np.argwhere(table[np.asarray(linked_codes(codes))]).T)


def lane_graph(codes: Codes, *, turn_back: bool = False) -> LaneGraph:
    """Makes the graph of a map's lanes. Its arguments are those of `movements_of`.

    Raises:
      InputError: for a bad grid, or one without a lane.
    """
    movements = movements_of(codes, turn_back=turn_back)
    # With turns at dead ends, any link is a lane, so the map lacks a whole road.
    if not movements.row.size:
        raise no_road_error() if turn_back else no_lane_error()
    # Each movement leads from its node to the next one. `unique` sorts these nodes and numbers the
    # ends.
    ends = [np.stack(node, axis=1) for node in (movements.node, movements.next_node)]
    nodes, indices = np.unique(np.concatenate(ends), axis=0, return_inverse=True)
    return LaneGraph(LaneNode(*nodes.T), movements, indices.reshape(2, -1).T)


def no_road_error() -> InputError:
    """Makes the error for a map without links."""
    return InputError("grid", "a road, two tiles that connect to each other", "none")


def no_lane_error() -> InputError:
    """Makes the error for a map without movements."""
    return InputError("grid", "a lane, a tile that connects to two others", "none")
