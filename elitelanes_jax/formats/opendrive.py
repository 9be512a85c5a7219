"""Road networks as OpenDRIVE 1.7, for CARLA, esmini and others: lines and arcs, exactly where the tiles have them.

Roads lead from crossing to crossing along the middle of straights and turns, with a lane on each side. A crossing is a
junction as large as its tile, with a connecting road for each movement. Cars turn back at dead ends, in junctions with
one connecting road. A ring is two roads.

OpenDRIVE allows no junction next to a junction: between adjacent crossings is a road of twice `_INSET`.
"""

import math
import xml.etree.ElementTree as ET
from itertools import pairwise
from typing import NamedTuple

from numpy.typing import ArrayLike

from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.graph import Cell, linked_tiles, walk_roads
from elitelanes_jax.formats.streets import AHEAD, BACK, GEO_REFERENCE, Streets, Way, lanes, middle_of_side
from elitelanes_jax.network.codes import SIDE_TOWARDS, SIDES

_INSET = 2.0**-11
"""From the border of a crossing to its junction, in tiles, if the next tile is a crossing too.

Where its lanes turn they are 0.0002 tiles out of place, 6 mm on tiles of 30 m.
"""

_SIGNS = {  # by right of way: country, type, dynamic
    "allway_stop": ("DE", "206", "no"),
    "traffic_light": ("OpenDRIVE", "1000001", "yes"),
}


class _Piece(NamedTuple):
    """A line or an arc of a road's middle: where it starts, its heading, its length and its curvature, in tiles."""

    start: complex
    heading: int
    length: float
    curvature: float = 0.0


class _End(NamedTuple):
    """An end of a road: its number, and whether the road starts there."""

    road: int
    starts: bool

    @property
    def link(self) -> dict[str, UserValue]:
        """The attributes of a link to it."""
        return {"elementType": "road", "elementId": self.road, "contactPoint": "start" if self.starts else "end"}

    @property
    def lane_in(self) -> int:
        """The lane that leads to this end; the other one, with the opposite sign, leads away."""
        return 1 if self.starts else -1


def to_opendrive(codes: ArrayLike, streets: Streets = Streets()) -> str:
    """Writes a grid as the text of an OpenDRIVE file, ``.xodr``.

    Args:
      codes: integer codes ``[H, W]``. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures.

    Returns:
      A text; the same grid gives the same text. x is east and y north of the grid's south-west corner, in metres. Roads
      are named by the tile and the side where they start, such as ``3_4_east``; connecting roads by their tile, the
      side by which they enter and their turn, such as ``3_4_west_left``.

    Raises:
      InputError: for a bad grid (see `check_grid`), or one without any road.
    """
    network = lanes(codes)
    links = linked_tiles(codes)
    height, width = network.links.shape
    junctions = {tile: number for number, tile in enumerate((tile for tile in links if len(links[tile]) != 2), 1)}
    root = ET.Element("OpenDRIVE")
    bounds = {"north": height * streets.tile, "south": 0, "east": width * streets.tile, "west": 0}
    header = _add(root, "header", revMajor=1, revMinor=7, name="", version="1", **bounds)
    _add(header, "geoReference").text = GEO_REFERENCE

    roads = 0
    ends: dict[tuple[Cell, Cell], _End] = {}  # by the tile of a junction and the next tile of the road
    for path in walk_roads(links, set(junctions)):
        if path[0] in junctions:
            roads += 1
            ends[path[0], path[1]], ends[path[-1], path[-2]] = _End(roads, True), _End(roads, False)
            around = [{"elementType": "junction", "elementId": junctions[tile]} for tile in (path[0], path[-1])]
            road = _add_road(root, roads, _name(path), _middle(path, links, height), around, streets)
            _add_lanes(road, streets, {})
            _add_signals(road, roads, [len(links[tile]) > 2 for tile in (path[0], path[-1])], streets)
            continue
        half = len(path) // 2
        for part, step in ((path[-2:-1] + path[: half + 1], 1), (path[half - 1 :], -1)):
            roads += 1
            around = [_End(roads + step, False).link, _End(roads + step, True).link]
            road = _add_road(root, roads, _name(part[1:]), _middle(part, links, height), around, streets)
            _add_lanes(road, streets, {lane: (lane, lane) for lane in (1, -1)})

    built = {tile: ET.Element("junction", id=str(junctions[tile]), name=f"{tile[0]}_{tile[1]}") for tile in junctions}
    for way in network.ways:
        if way.tile not in junctions:
            continue
        roads += 1
        incoming, outgoing = ends[way.tile, way.before], ends[way.tile, way.after]
        crossings = [len(links[way.tile]) > 2 and len(links[tile]) > 2 for tile in (way.before, way.after)]
        pieces = _back(way, streets, height) if way.turn == BACK else _across(way, *crossings, height=height)
        around = [incoming.link, outgoing.link]
        road = _add_road(root, roads, way.name, pieces, around, streets, junctions[way.tile])
        _add_lanes(road, streets, {-1: (incoming.lane_in, -outgoing.lane_in)}, way)
        junction = built[way.tile]
        connection = _add(
            junction,
            "connection",
            id=len(junction),
            incomingRoad=incoming.road,
            connectingRoad=roads,
            contactPoint="start",
        )
        _add(connection, "laneLink", **{"from": incoming.lane_in, "to": -1})
    controllers = 0
    for tile, junction in built.items():
        roads_by_axis = [
            [ends[tile, other] for other in links[tile] if (other[0] != tile[0]) == upright]
            for upright in (True, False)
        ]
        if len(links[tile]) > 2:
            controllers = _add_rights(root, junction, roads_by_axis, controllers, streets)
    root.extend(built.values())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


def _middle(path: list[Cell], links: dict[Cell, list[Cell]], height: int) -> list[_Piece]:
    """Returns the middle of a road, across all tiles of a path but the first and the last.

    It also leads to the middle of a dead end at an end of the path, and between adjacent crossings into both.
    """
    headings = [SIDES.index(SIDE_TOWARDS[b[0] - a[0], b[1] - a[1]]) for a, b in pairwise(path)]
    leads = [0.5 if len(links[tile]) == 1 else 0.0 for tile in (path[0], path[-1])]
    if len(path) == 2 and not any(leads):
        leads = [_INSET, _INSET]
    first = middle_of_side(path[0], headings[0], height) - leads[0] * AHEAD[headings[0]]
    pieces = [_Piece(first, headings[0], leads[0])]
    for tile, into, out in zip(path[1:-1], headings[:-1], headings[1:], strict=True):
        pieces += _across(Way(*tile, into, (into - out + 1) % 4), height=height)
    pieces.append(_Piece(middle_of_side(path[-1], headings[-1] - 2, height), headings[-1], leads[1]))
    merged: list[_Piece] = []
    for piece in pieces:
        if not piece.length:
            continue
        if merged and not piece.curvature and not merged[-1].curvature:
            merged[-1] = merged[-1]._replace(length=merged[-1].length + piece.length)
        else:
            merged.append(piece)
    return merged


def _across(way: Way, from_crossing: bool = False, to_crossing: bool = False, *, height: int) -> list[_Piece]:
    """Returns the middle of a way across its tile, between points as far from the borders as junctions begin."""
    inset, outset = _INSET * from_crossing, _INSET * to_crossing
    start = middle_of_side(way.tile, way.heading - 2, height) + inset * AHEAD[way.heading]
    bend = way.turn - 1
    if not bend:
        return [_Piece(start, way.heading, 1 - inset - outset)]
    deepest = max(inset, outset)
    radius = 0.5 - deepest
    end = middle_of_side(way.tile, way.exit, height) - deepest * AHEAD[way.exit]
    return [
        _Piece(start, way.heading, deepest - inset),
        _Piece(start + (deepest - inset) * AHEAD[way.heading], way.heading, radius * math.pi / 2, bend / radius),
        _Piece(end, way.exit, deepest - outset),
    ]


def _back(way: Way, streets: Streets, height: int) -> list[_Piece]:
    """Returns the half circle that is the centre of the lane around a dead end."""
    radius = streets.lane / streets.tile / 2
    middle = middle_of_side(way.tile, way.heading - 2, height) + AHEAD[way.heading] / 2
    return [_Piece(middle - radius * 1j * AHEAD[way.heading], way.heading, radius * math.pi, 1 / radius)]


def _add_road(
    root: ET.Element,
    number: int,
    name: str,
    pieces: list[_Piece],
    around: list[dict[str, UserValue]],
    streets: Streets,
    junction: int = -1,
) -> ET.Element:
    pieces = [piece for piece in pieces if piece.length]
    length = sum(piece.length for piece in pieces) * streets.tile
    road = _add(root, "road", name=name, length=length, id=number, junction=junction)
    link = _add(road, "link")
    _add(link, "predecessor", **around[0])
    _add(link, "successor", **around[1])
    _add(_add(road, "type", s=0, type="town"), "speed", max=streets.speed, unit="m/s")
    plan, s = _add(road, "planView"), 0.0
    for start, heading, steps, curvature in pieces:
        x, y = start.real * streets.tile, start.imag * streets.tile
        geometry = _add(plan, "geometry", s=s, x=x, y=y, hdg=(1 - heading) * math.pi / 2, length=steps * streets.tile)
        if curvature:
            _add(geometry, "arc", curvature=curvature / streets.tile)
        else:
            _add(geometry, "line")
        s += steps * streets.tile
    return road


def _add_lanes(road: ET.Element, streets: Streets, links: dict[int, tuple[int, int]], way: Way | None = None) -> None:
    """Adds the lanes of a road, with their links; of a connecting road only the right one, without marks."""
    lanes = _add(road, "lanes")
    if way and way.turn == BACK:
        _add(lanes, "laneOffset", s=0, a=streets.lane / 2, b=0, c=0, d=0)
    section = _add(lanes, "laneSection", s=0)
    for side, number in (("left", 1), ("center", 0), ("right", -1)):
        if way and number == 1:
            continue
        lane = _add(_add(section, side), "lane", id=number, type="driving" if number else "none", level="false")
        if number in links:
            link = _add(lane, "link")
            _add(link, "predecessor", id=links[number][0])
            _add(link, "successor", id=links[number][1])
        if number:
            _add(lane, "width", sOffset=0, a=streets.lane, b=0, c=0, d=0)
        kind = "none" if way else "solid" if number else "broken"
        _add(lane, "roadMark", sOffset=0, type=kind, weight="standard", color="standard" if number else "yellow")


def _add_signals(road: ET.Element, number: int, at_crossings: list[bool], streets: Streets) -> None:
    """Adds a stop sign or a traffic light to the right of each end of a road at a crossing."""
    if streets.right_of_way not in _SIGNS or not any(at_crossings):
        return
    country, kind, dynamic = _SIGNS[streets.right_of_way]
    signals = _add(road, "signals")
    for end, at_crossing in enumerate(at_crossings):
        if at_crossing:
            signal = _add(
                signals,
                "signal",
                s=float(road.attrib["length"]) * end,
                t=1.25 * streets.lane * (1 - 2 * end),
                id=2 * number + end,
                name="",
                dynamic=dynamic,
                orientation="+" if end else "-",
                zOffset=0.7 * streets.lane,
                country=country,
                type=kind,
                subtype=-1,
                value=-1,
                height=0.25 * streets.lane,
                width=0.25 * streets.lane,
            )
            _add(signal, "validity", fromLane=1 - 2 * end, toLane=1 - 2 * end)


def _add_rights(
    root: ET.Element, junction: ET.Element, axes: list[list[_End]], controllers: int, streets: Streets
) -> int:
    """Adds who goes first: the road that goes straight on over the third one, or lights in turn."""
    if streets.right_of_way == "priority" and sorted(map(len, axes)) == [1, 2]:
        (low,), high = sorted(axes, key=len)
        for end in high:
            _add(junction, "priority", high=end.road, low=low.road)
    if streets.right_of_way == "traffic_light":
        for sequence, axis in enumerate(axes):
            controllers += 1
            controller = _add(
                root, "controller", id=controllers, name=f"{junction.attrib['name']}_{sequence}", sequence=sequence
            )
            for end in axis:
                _add(controller, "control", signalId=2 * end.road + (not end.starts), type=0)
            _add(junction, "controller", id=controllers, type=0, sequence=sequence)
    return controllers


def _name(path: list[Cell]) -> str:
    row, column = path[0]
    return f"{row}_{column}_{SIDE_TOWARDS[path[1][0] - row, path[1][1] - column].name}"


def _add(parent: ET.Element, tag: str, **attributes: UserValue) -> ET.Element:
    return ET.SubElement(parent, tag, {key: _text(value) for key, value in attributes.items()})


def _text(value: UserValue) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)
