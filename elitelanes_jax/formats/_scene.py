"""The scene of a map: its lanelets, and its crossings with who goes first there.

All formats of networks write this record. Files have positions in metres, x east and y north of the
grid's south-west corner. Here such a position is the complex number x + y·i.
"""

from itertools import groupby
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Complex128, Float

from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import lane_polyline, middle_of_side
from elitelanes_jax.lanes.links import linked_tiles
from elitelanes_jax.lanes.movements import BACK, TURNS, LaneNode, Movement, lane_graph
from elitelanes_jax.network.links import Cell

Line: TypeAlias = Complex128[np.ndarray, " P"]
"""Points in metres, x + y·i."""

_STRAIGHT = TURNS.index("straight")

# What the drivers of all approaches find, by the right of way.
_CONTROLS = {
    "allway_stop": "stop",
    "traffic_light": "light",
    "right_before_left": "right_before_left",
    "priority": "",
}


class Lanelet(NamedTuple):
    """A lane across a tile, for one movement.

    Attributes:
      movement: the movement that it leads along.
      predecessors: the indices of the lanelets that lead into it.
      successors: the indices of the lanelets that continue it.
      arms: the number of roads that meet on its tile: 1 at a dead end, over 2 at a crossing.
    """

    movement: Movement
    predecessors: list[int]
    successors: list[int]
    arms: int


class Approach(NamedTuple):
    """A way into a crossing.

    Attributes:
      node: the tile of the crossing, and the heading of the drivers who arrive.
      lanelets: the indices of the lanelets that start here, one for each turn.
      control: what the drivers find: "stop", "light", "right_before_left", "yield", "go_first"; ""
        where all approaches have priority.
    """

    node: LaneNode
    lanelets: list[int]
    control: str


class Scene(NamedTuple):
    """The road network of a map.

    Attributes:
      road_map: the map, with its signs and lights.
      streets: the measures of all roads.
      links: the linked neighbours of each tile.
      lanelets: one for each movement, in ascending order of row, column, heading and turn. Cars
        turn back at dead ends.
      rights: the right of way of each crossing, by its tile.
      crossings: the approaches of each crossing, by its tile, in ascending order of their headings.
    """

    road_map: RoadMap
    streets: Streets
    links: dict[Cell, list[Cell]]
    lanelets: list[Lanelet]
    rights: dict[Cell, str]
    crossings: dict[Cell, list[Approach]]

    @property
    def rows(self) -> int:
        """The number of rows of the grid."""
        return len(self.road_map.codes)

    def to_metres(self, points: Float[np.ndarray, "P 2"]) -> Line:
        """Converts points in tiles east and south of the grid's north-west corner to metres."""
        return (points[:, 0] + (self.rows - points[:, 1]) * 1j) * self.streets.tile_size

    def bounds(self, lanelet: Lanelet) -> tuple[Line, Line]:
        """Returns the left and the right bound of a lanelet, with as many points.

        The left bound is the middle of the road. The right bound is the width of a lane beside it.
        At a dead end the left bound leads around an island, a tenth of a lane wide.
        """
        movement = lanelet.movement
        lane = self.streets.lane / self.streets.tile_size
        if movement.turn == BACK:
            # The left bound starts and ends in the middle of the road. Between its ends it is the
            # outline of the island.
            left = lane_polyline(movement, lane / 20)
            left[[0, -1]] = middle_of_side(movement.node.tile, (movement.heading + 2) % 4)
        else:
            left = lane_polyline(movement, 0.0)
        return self.to_metres(left), self.to_metres(lane_polyline(movement, lane))


def make_scene(road_map: RoadMap, streets: Streets) -> Scene:
    """Makes the scene of a map.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Raises:
      InputError: for a map without any road, or bad measures.
    """
    check_named("streets", instance(Streets), streets)
    links = linked_tiles(road_map.codes)
    rights = rights_of_way(road_map, links, streets.right_of_way)
    graph = lane_graph(road_map.codes, turn_back=True)
    lanelets: list[Lanelet] = []
    for movement, before, after in zip(
        graph.list_movements(), graph.list_predecessors(), graph.list_successors(), strict=True
    ):
        lanelets.append(Lanelet(movement, before, after, len(links[movement.node.tile])))
    crossings: dict[Cell, list[Approach]] = {tile: [] for tile in rights}
    # Lanelets are in the order of their nodes, so `groupby` collects those of each node.
    for node, starting in groupby(
        range(len(lanelets)), lambda index: lanelets[index].movement.node
    ):
        if node.tile in crossings:
            indices = list(starting)
            control = _control(rights[node.tile], [lanelets[index] for index in indices])
            crossings[node.tile].append(Approach(node, indices, control))
    return Scene(road_map, streets, links, lanelets, rights, crossings)


def _control(right_of_way: str, lanelets: list[Lanelet]) -> str:
    """Returns what the drivers of an approach find, from which these lanelets start."""
    # Where three roads meet, the one that ends there has no turn straight on, and gives way. Where
    # four roads meet, no road gives way.
    if right_of_way == "priority" and lanelets[0].arms == 3:
        leads_straight_on = any(lanelet.movement.turn == _STRAIGHT for lanelet in lanelets)
        return "go_first" if leads_straight_on else "yield"
    return _CONTROLS[right_of_way]
