"""Road networks as OpenDRIVE 1.7, for CARLA, esmini and others.

Roads are lines and arcs, exactly where the tiles have them. Roads lead from crossing to crossing
along the middle of straights and turns, with a lane on each side. A crossing is a junction as large
as its tile, with a connecting road for each movement. Cars turn back at dead ends, in junctions
with one connecting road. A road back to its own crossing has a junction halfway, a ring has two.

OpenDRIVE allows no junction next to a junction: between adjacent crossings is a road of 1/1024
tile.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats._pieces import middle_across_tile, middle_of_road
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import (
    Arrival,
    Signal,
    list_signals,
    rights_of_way,
    signal_element,
)
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import Curve, lane_curves
from elitelanes_jax.lanes.links import Cell, linked_tiles, side_towards, walk_roads
from elitelanes_jax.lanes.movements import BACK, Movement, lane_graph

# The south-west corner of the grid is on the equator, on the central meridian of UTM's zone 32.
_GEO_REFERENCE = "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=0 +y_0=0 +datum=WGS84 +units=m"


class _End(NamedTuple):
    """An end of a road: its number, and whether the road starts there."""

    road: int
    starts: bool

    @property
    def link(self) -> str:
        """The attributes of a link to it."""
        contact = "start" if self.starts else "end"
        return f'elementType="road" elementId="{self.road}" contactPoint="{contact}"'

    @property
    def lane_in(self) -> int:
        """The lane that leads to this end; the other one, with the opposite sign, leads away."""
        return 1 if self.starts else -1


class _Network(NamedTuple):
    """The roads and junctions that the tiles of a map become.

    Attributes:
      links: the linked neighbours of each tile.
      junctions: the number of the junction on each tile that has one, in ascending order.
      paths: the tiles of each road between junctions, with those of both junctions.
      first_road: the number of the first path's road. CARLA takes a number for a road if there is
        one with it, so roads are numbered after junctions.
      ends: the end of a road at each arrival in a junction.
      height: the number of rows.
      streets: the measures of all roads.
    """

    links: dict[Cell, list[Cell]]
    junctions: dict[Cell, int]
    paths: list[list[Cell]]
    first_road: int
    ends: dict[Arrival, _End]
    height: int
    streets: Streets


def to_opendrive(source: UserValue, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of an OpenDRIVE file, ``.xodr``.

    Args:
      source: a `RoadMap`, whose signs and lights are written too, a grid ``[H, W]`` of codes, or a
        file. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west
      corner, in metres. Roads are named by the tile and the side where they start, such as
      ``3_4_east``; connecting roads by their tile, the side by which they enter and their turn,
      such as ``3_4_west_left``.

    Raises:
      InputError: for a bad map, one without any road, or bad measures.
    """
    road_map = as_map(source)
    rules = rights_of_way(road_map, streets)
    movements = lane_graph(road_map.codes, turn_back=True).list_movements()
    network = _make_network(road_map.codes, streets)
    signals = list_signals(road_map, rules, network.paths)
    connections: dict[Cell, list[str]] = {tile: [] for tile in network.junctions}
    roads = _roads(network, signals)
    for movement in movements:
        tile = movement.node.tile
        # Movements on other tiles are part of the roads between junctions.
        if tile in network.junctions:
            number = network.first_road + len(roads)
            roads.append(_connecting_road(network, number, movement))
            connections[tile].append(_connection(network, number, movement, len(connections[tile])))
    controllers, rights = _rights_at_junctions(network, rules, signals)
    junctions = []
    for tile, number in network.junctions.items():
        content = "".join(connections[tile] + rights.get(tile, []))
        junctions.append(f'<junction id="{number}" name="{tile[0]}_{tile[1]}">{content}</junction>')
    head = ['<?xml version="1.0" encoding="UTF-8"?>', "<OpenDRIVE>"]
    head.append(_header(road_map.codes.shape, streets))
    return "\n".join(head + roads + controllers + junctions + ["</OpenDRIVE>\n"])


def _make_network(codes: Int8[np.ndarray, "H W"], streets: Streets) -> _Network:
    links = linked_tiles(codes)
    # Tiles with two links are inside roads. Crossings and dead ends are nodes.
    nodes = {tile for tile in links if len(links[tile]) != 2}
    for path in walk_roads(links, nodes):
        # No road may lead back to the junction where it starts. A further junction cuts it in two.
        if path[0] == path[-1]:
            nodes |= {path[0], path[len(path) // 2]}
    # A tile without links has no road, and so no junction.
    linked_nodes = [tile for tile in sorted(nodes) if links[tile]]
    numbers = {tile: index + 1 for index, tile in enumerate(sorted(nodes))}
    junctions = {tile: numbers[tile] for tile in linked_nodes}
    first_road = max(junctions.values()) + 1
    # With all junctions known, the roads are walked again.
    paths = walk_roads(links, set(junctions))
    ends: dict[Arrival, _End] = {}
    for number, path in enumerate(paths, first_road):
        ends[path[0], path[1]] = _End(number, starts=True)
        ends[path[-1], path[-2]] = _End(number, starts=False)
    return _Network(links, junctions, paths, first_road, ends, len(codes), streets)


def _header(shape: tuple[int, ...], streets: Streets) -> str:
    north, east = shape[0] * streets.tile_size, shape[1] * streets.tile_size
    extent = f'north="{north:.9g}" south="0" east="{east:.9g}" west="0"'
    reference = f"<geoReference>{_GEO_REFERENCE}</geoReference>"
    return f'<header revMajor="1" revMinor="7" name="" version="1" {extent}>{reference}</header>'


def _roads(network: _Network, signals: dict[Arrival, list[Signal]]) -> list[str]:
    """Returns the elements of the roads between junctions, with their signals.

    Each road has a lane on each side.
    """
    streets, height = network.streets, network.height
    lanes = (
        f"<left>{_lane(1, 'solid', streets)}</left>"
        f"<center>{_lane(0, 'broken', streets)}</center>"
        f"<right>{_lane(-1, 'solid', streets)}</right>"
    )
    roads = []
    for number, path in enumerate(network.paths, network.first_road):
        pieces = middle_of_road(path, network.links)
        signs = ""
        # Who arrives at the first tile drives against the direction of the road, on lane 1.
        for signal in signals[path[0], path[1]]:
            signs += signal_element(signal, 0, 1, streets, height)
        for signal in signals[path[-1], path[-2]]:
            signs += signal_element(signal, _length(pieces, streets), -1, streets, height)
        row, column = path[0]
        name = f"{row}_{column}_{side_towards(path[0], path[1]).name}"
        roads.append(
            _element(
                f'name="{name}" id="{number}" junction="-1"',
                f'elementType="junction" elementId="{network.junctions[path[0]]}"',
                f'elementType="junction" elementId="{network.junctions[path[-1]]}"',
                pieces,
                f'<lanes><laneSection s="0">{lanes}</laneSection></lanes>'
                f"<signals>{signs}</signals>",
                network,
            )
        )
    return roads


def _connecting_road(network: _Network, number: int, movement: Movement) -> str:
    """Returns the element of a road across a junction, with the right lane alone and no marks."""
    streets = network.streets
    start, end = _ends_of(network, movement)
    link = f'<link><predecessor id="{start.lane_in}"/><successor id="{-end.lane_in}"/></link>'
    lanes = (
        f"<center>{_lane(0, 'none', streets)}</center>"
        f"<right>{_lane(-1, 'none', streets, link)}</right>"
    )
    offset = ""
    if movement.turn == BACK:
        # The reference line is the half circle along the centre of the lane, not the middle of the
        # road.
        offset = f'<laneOffset s="0" a="{streets.lane / 2:.9g}" b="0" c="0" d="0"/>'
    return _element(
        f'name="{movement.name}" id="{number}" junction="{network.junctions[movement.node.tile]}"',
        start.link,
        end.link,
        _connecting_pieces(network, movement),
        f'<lanes>{offset}<laneSection s="0">{lanes}</laneSection></lanes>',
        network,
    )


def _connecting_pieces(network: _Network, movement: Movement) -> list[Curve]:
    """Returns the line or arc across a junction.

    It leads from the end of one road to the start of another.
    """
    if movement.turn == BACK:
        # The roads already lead to the middle of the tile, so the lines on both sides are left out.
        _, half_circle, _ = lane_curves(
            movement, network.streets.lane / network.streets.tile_size / 2
        )
        return [half_circle]
    links = network.links
    # Only roads between adjacent crossings lead beyond the border. This tile is then a crossing,
    # because a junction inside a road is next to no crossing.
    return middle_across_tile(
        movement,
        from_crossing=len(links[movement.node.tile_before]) > 2,
        to_crossing=len(links[movement.next_node.tile]) > 2,
    )


def _connection(network: _Network, number: int, movement: Movement, index: int) -> str:
    """Returns the element of a junction for the connecting road with a number."""
    start, _ = _ends_of(network, movement)
    roads = f'incomingRoad="{start.road}" connectingRoad="{number}" contactPoint="start"'
    lane_link = f'<laneLink from="{start.lane_in}" to="-1"/>'
    return f'<connection id="{index}" {roads}>{lane_link}</connection>'


def _ends_of(network: _Network, movement: Movement) -> tuple[_End, _End]:
    """Returns the ends of the roads that a movement joins."""
    node = movement.node
    return network.ends[node.tile, node.tile_before], network.ends[
        node.tile, movement.next_node.tile
    ]


def _rights_at_junctions(
    network: _Network, rules: dict[Cell, str], signals: dict[Arrival, list[Signal]]
) -> tuple[list[str], dict[Cell, list[str]]]:
    """Returns the controllers of lights, and the elements of junctions that say who goes first."""
    controllers: list[str] = []
    rights: dict[Cell, list[str]] = {}
    for tile, rule in rules.items():
        # The arrivals of the road between north and south.
        along: list[Arrival] = []
        # The arrivals of the road between west and east.
        beside: list[Arrival] = []
        for neighbour in network.links[tile]:
            axis = along if neighbour[1] == tile[1] else beside
            axis.append((tile, neighbour))
        if rule == "traffic_light":
            rights[tile] = []
            # Each axis has a controller. The sequence orders the controllers of a junction.
            for sequence, axis in enumerate((beside, along)):
                place = f'id="{len(controllers) + 1}" sequence="{sequence}"'
                controllers.append(
                    f"<controller {place}>{_controlled_lights(axis, signals)}</controller>"
                )
                rights[tile].append(f'<controller {place} type="0"/>')
        # Only a crossing of three roads has one that ends there, and gives way.
        elif rule == "priority" and len(network.links[tile]) == 3:
            (low,), high = sorted((along, beside), key=len)
            low_road = network.ends[low].road
            rights[tile] = []
            for arrival in high:
                rights[tile].append(
                    f'<priority high="{network.ends[arrival].road}" low="{low_road}"/>'
                )
    return controllers, rights


def _controlled_lights(axis: list[Arrival], signals: dict[Arrival, list[Signal]]) -> str:
    """Returns the elements of a controller.

    There is one for each light at the ends of two opposite roads.
    """
    lights = ""
    for arrival in axis:
        for signal in signals[arrival]:
            if signal.kind == "trafficlight":
                lights += f'<control signalId="{signal.number}" type="0"/>'
    return lights


def _lane(number: int, mark: str, streets: Streets, link: str = "") -> str:
    """Returns the element of a lane; lane 0 is the line between the directions and has no width."""
    # These are the values of lane 0.
    kind, color, width = "none", "yellow", ""
    if number != 0:
        kind, color = "driving", "standard"
        width = f'<width sOffset="0" a="{streets.lane:.9g}" b="0" c="0" d="0"/>'
    road_mark = f'<roadMark sOffset="0" type="{mark}" weight="standard" color="{color}"/>'
    return f'<lane id="{number}" type="{kind}" level="false">{link}{width}{road_mark}</lane>'


def _element(
    attributes: str,
    predecessor: str,
    successor: str,
    pieces: list[Curve],
    lanes: str,
    network: _Network,
) -> str:
    """Returns the element of a road; lengths are in metres."""
    streets = network.streets
    link = f"<link><predecessor {predecessor}/><successor {successor}/></link>"
    speed = f'<speed max="{streets.speed:.9g}" unit="m/s"/>'
    plan = _plan_view(pieces, streets, network.height)
    return (
        f'<road {attributes} length="{_length(pieces, streets):.12g}">{link}'
        f'<type s="0" type="town">{speed}</type>'
        f"<planView>{plan}</planView>{lanes}</road>"
    )


def _plan_view(pieces: list[Curve], streets: Streets, height: int) -> str:
    """Returns the elements of lines and arcs."""
    geometries = []
    s = 0.0
    for east, south, heading, length, curvature in pieces:
        x, y = east * streets.tile_size, (height - south) * streets.tile_size
        # Headings are clockwise from north, and angles counter-clockwise from east.
        angle = (1 - heading) * math.pi / 2
        metres = length * streets.tile_size
        place = f's="{s:.12g}" x="{x:.12g}" y="{y:.12g}" hdg="{angle:.12g}" length="{metres:.12g}"'
        shape = "<line/>"
        if curvature:
            shape = f'<arc curvature="{curvature / streets.tile_size:.12g}"/>'
        geometries.append(f"<geometry {place}>{shape}</geometry>")
        s += metres
    return "".join(geometries)


def _length(pieces: list[Curve], streets: Streets) -> float:
    """Returns the length of a road in metres.

    It has the rounding of the positions in `_plan_view`.
    """
    length = 0.0
    for piece in pieces:
        length += piece.length * streets.tile_size
    return length
