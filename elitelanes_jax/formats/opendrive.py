"""Road networks as OpenDRIVE 1.7, for CARLA, esmini and others: lines and arcs, exactly where the tiles have them.

Roads lead from crossing to crossing along the middle of straights and turns, with a lane on each side. A crossing is a
junction as large as its tile, with a connecting road for each movement. Cars turn back at dead ends, in junctions with
one connecting road. A road back to its own crossing has a junction halfway, a ring has two.

OpenDRIVE allows no junction next to a junction: between adjacent crossings is a road of twice `_INSET`.
"""

import math
from itertools import accumulate
from typing import NamedTuple

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats._pieces import across, middle
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import Arrival, Signal, list_signals, rights_of_way, signal_element
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import Curve, lane_curves
from elitelanes_jax.lanes.links import Cell, linked_tiles, side_towards, walk_roads
from elitelanes_jax.lanes.movements import BACK, Movement, lane_graph

# On the equator, on the central meridian of UTM's zone 32.
_GEO_REFERENCE = "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=0 +y_0=0 +datum=WGS84 +units=m"


class _End(NamedTuple):
    """An end of a road: its number, and whether the road starts there."""

    road: int
    starts: bool

    @property
    def link(self) -> str:
        """The attributes of a link to it."""
        return f'elementType="road" elementId="{self.road}" contactPoint="{"start" if self.starts else "end"}"'

    @property
    def lane_in(self) -> int:
        """The lane that leads to this end; the other one, with the opposite sign, leads away."""
        return 1 if self.starts else -1


@name_wrong_arguments
def to_opendrive(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of an OpenDRIVE file, ``.xodr``.

    Args:
      source: a `RoadMap`, whose signs and lights are written too, a grid ``[H, W]`` of codes, or a file. Connections
        that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no other right of way.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west corner, in metres. Roads
      are named by the tile and the side where they start, such as ``3_4_east``; connecting roads by their tile, the
      side by which they enter and their turn, such as ``3_4_west_left``.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rules = rights_of_way(road_map, streets)
    graph = lane_graph(road_map.codes, turn_back=True)
    links = linked_tiles(road_map.codes)
    height, width = road_map.codes.shape
    nodes = {tile for tile in links if len(links[tile]) != 2}
    for path in walk_roads(links, nodes):
        if path[0] == path[-1]:
            nodes |= {path[0], path[len(path) // 2]}
    junctions = {tile: number for number, tile in enumerate(sorted(nodes), 1) if links[tile]}
    first = max(junctions.values()) + 1  # CARLA takes a number for a road if there is one
    paths = walk_roads(links, set(junctions))
    ends: dict[Arrival, _End] = {}
    for number, path in enumerate(paths, first):
        ends[path[0], path[1]], ends[path[-1], path[-2]] = _End(number, True), _End(number, False)
    signals = list_signals(road_map, rules, paths)
    roads: list[str] = []
    for number, path in enumerate(paths, first):
        row, column = path[0]
        name = f"{row}_{column}_{side_towards(*path[:2]).name}"
        both = [junctions[path[end]] for end in (0, -1)]
        pieces = middle(path, links)
        *_, length = accumulate(piece.length * streets.tile for piece in pieces)  # to the last digit as in `_element`
        signs = [signal_element(one, 0, 1, streets, height) for one in signals[path[0], path[1]]]
        signs += [signal_element(one, length, -1, streets, height) for one in signals[path[-1], path[-2]]]
        roads.append(_road(number, name, pieces, both, signs, streets, height))

    built: dict[Cell, list[str]] = {tile: [] for tile in junctions}
    for movement in graph.list_movements():
        tile, tile_before, tile_after = movement.node.tile, movement.node.tile_before, movement.next_node.tile
        if tile not in junctions:
            continue
        number, connections = first + len(roads), built[tile]
        start, end = ends[tile, tile_before], ends[tile, tile_after]
        if movement.turn == BACK:
            _, half_circle, _ = lane_curves(movement, streets.lane / streets.tile / 2)
            pieces = [half_circle]
        else:
            is_crossing = len(links[tile]) > 2
            gaps = [is_crossing and len(links[neighbour]) > 2 for neighbour in (tile_before, tile_after)]
            pieces = across(movement, *gaps)
        roads.append(_connecting_road(number, junctions[tile], movement, pieces, start, end, streets, height))
        place = f'id="{len(connections)}" incomingRoad="{start.road}" connectingRoad="{number}" contactPoint="start"'
        connections.append(f'<connection {place}><laneLink from="{start.lane_in}" to="-1"/></connection>')
    controllers: list[str] = []
    for tile, rule in rules.items():
        axes = [[(tile, other) for other in links[tile] if (other[1] == tile[1]) == side] for side in (0, 1)]
        if rule == "traffic_light":
            built[tile] += _lights([[one for end in axis for one in signals[end]] for axis in axes], controllers)
        elif rule == "priority" and len(links[tile]) == 3:  # the road that goes straight on
            (low,), high = sorted(axes, key=len)
            built[tile] += [f'<priority high="{ends[end].road}" low="{ends[low].road}"/>' for end in high]
    header = (
        f'<header revMajor="1" revMinor="7" name="" version="1" north="{height * streets.tile:.9g}" south="0" '
        f'east="{width * streets.tile:.9g}" west="0"><geoReference>{_GEO_REFERENCE}</geoReference></header>'
    )
    crossings = [
        f'<junction id="{junctions[row, column]}" name="{row}_{column}">{"".join(parts)}</junction>'
        for (row, column), parts in built.items()
    ]
    head = ('<?xml version="1.0" encoding="UTF-8"?>', "<OpenDRIVE>", header)
    return "\n".join([*head, *roads, *controllers, *crossings, "</OpenDRIVE>\n"])


def _lights(axes: list[list[Signal]], controllers: list[str]) -> list[str]:
    """Returns the elements of a crossing for its lights, together along each axis; adds their controllers."""
    rights = []
    for sequence, axis in enumerate(axes):
        lights = "".join(f'<control signalId="{one.number}" type="0"/>' for one in axis if one.kind == "trafficlight")
        place = f'id="{len(controllers) + 1}" sequence="{sequence}"'
        controllers.append(f"<controller {place}>{lights}</controller>")
        rights.append(f'<controller {place} type="0"/>')
    return rights


def _road(
    number: int, name: str, pieces: list[Curve], nodes: list[int], signs: list[str], streets: Streets, height: int
) -> str:
    """Returns the element of a road between junctions, with a lane on each side and its signals."""
    sides = (("left", 1, "solid"), ("center", 0, "broken"), ("right", -1, "solid"))
    lanes = "".join(f"<{side}>{_lane(lane, mark, streets)}</{side}>" for side, lane, mark in sides)
    section = f'<lanes><laneSection s="0">{lanes}</laneSection></lanes><signals>{"".join(signs)}</signals>'
    links = [f'elementType="junction" elementId="{node}"' for node in nodes]
    return _element(f'name="{name}" id="{number}" junction="-1"', links, pieces, section, streets, height)


def _connecting_road(
    number: int,
    junction: int,
    movement: Movement,
    pieces: list[Curve],
    start: _End,
    end: _End,
    streets: Streets,
    height: int,
) -> str:
    """Returns the element of a road across a junction, with the right lane alone and no marks."""
    link = f'<link><predecessor id="{start.lane_in}"/><successor id="{-end.lane_in}"/></link>'
    offset = f'<laneOffset s="0" a="{streets.lane / 2:.9g}" b="0" c="0" d="0"/>' if movement.turn == BACK else ""
    centre, right = _lane(0, "none", streets), _lane(-1, "none", streets, link)
    section = f'<lanes>{offset}<laneSection s="0"><center>{centre}</center><right>{right}</right></laneSection></lanes>'
    attributes = f'name="{movement.name}" id="{number}" junction="{junction}"'
    return _element(attributes, [start.link, end.link], pieces, section, streets, height)


def _lane(number: int, mark: str, streets: Streets, link: str = "") -> str:
    width = f'<width sOffset="0" a="{streets.lane:.9g}" b="0" c="0" d="0"/>' if number else ""
    return (
        f'<lane id="{number}" type="{"driving" if number else "none"}" level="false">{link}{width}'
        f'<roadMark sOffset="0" type="{mark}" weight="standard" color="{"standard" if number else "yellow"}"/></lane>'
    )


def _element(attributes: str, links: list[str], pieces: list[Curve], lanes: str, streets: Streets, height: int) -> str:
    geometries, s = [], 0.0
    for east, south, heading, length, curvature in pieces:
        x, y, metres = (value * streets.tile for value in (east, height - south, length))
        angle = (1 - heading) * math.pi / 2
        place = f's="{s:.12g}" x="{x:.12g}" y="{y:.12g}" hdg="{angle:.12g}" length="{metres:.12g}"'
        shape = f'<arc curvature="{curvature / streets.tile:.12g}"/>' if curvature else "<line/>"
        geometries.append(f"<geometry {place}>{shape}</geometry>")
        s += metres
    return (
        f'<road {attributes} length="{s:.12g}"><link><predecessor {links[0]}/><successor {links[1]}/></link>'
        f'<type s="0" type="town"><speed max="{streets.speed:.9g}" unit="m/s"/></type>'
        f"<planView>{''.join(geometries)}</planView>{lanes}</road>"
    )
