"""Road networks as OpenDRIVE 1.7, for CARLA, esmini and others.

Roads are lines and arcs, exactly where the tiles have them. Roads lead from crossing to crossing
along the middle of straights and turns, with a lane on each side. A crossing is a junction as large
as its tile, with a connecting road for each movement. Cars turn back at dead ends, in junctions
with one connecting road. A road back to its own crossing has a junction halfway, a ring has two.

OpenDRIVE allows no junction next to a junction: between adjacent crossings is a road of 0.1 m, or
of 1/64 tile on tiles of less than 6.4 m.
"""

import math
from collections.abc import Iterator
from itertools import chain, count, product
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from elitelanes_jax._util.checks import check_named, xml_name
from elitelanes_jax.formats._beside import Place, Ways
from elitelanes_jax.formats._earth import plane_of
from elitelanes_jax.formats._roads import (
    arrival,
    cut_roads,
    middle_across_tile,
    middle_of_road,
)
from elitelanes_jax.formats._scene import Approach, Lanelet, Scene, make_scene
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import MapObject, base_kind
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.signals import Signal, is_signal, list_signals
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import Curve, lane_curves
from elitelanes_jax.lanes.links import side_towards
from elitelanes_jax.lanes.movements import BACK, LaneNode
from elitelanes_jax.network.links import Cell

# Between adjacent crossings, roads lead this far beyond the border, in metres, or in tiles if that
# is less. Readers join points that are up to 0.05 m apart. It displaces turning lanes by 0.02 m.
_INSET, _MOST_INSET = 0.05, 1 / 128

# The part of its width by which a lane around a dead end is narrower in its middle. Without it, the
# inner edge would be a point.
_ISLAND = 1 / 20

# The types of signs in the German road traffic regulations (StVO), and their subtypes.
_TYPES = {
    "sign_stop": ("206", "-1"),
    "sign_yield": ("205", "-1"),
    "sign_t_light_ahead": ("131", "-1"),
    "sign_do_not_enter": ("267", "-1"),
    "sign_oneway_left": ("220", "10"),
    "sign_oneway_right": ("220", "20"),
    "sign_pedestrian": ("350", "-1"),
    "sign_parking": ("314", "-1"),
}


# The types of objects by the first kinds that have them. Other objects are obstacles.
_OBJECTS = {"tree": "tree", "house": "building", "building": "building", "barrier": "barrier"}


# A signal is beside its lane, at this distance from the middle of the road in widths of the lane.
_ASIDE = 1.25

# The kinds of signals that make drivers stop or give way where they enter a crossing.
_STOPPING = ("sign_stop", "sign_yield", "trafficlight")

# The length of a stop line along the road, in widths of the lane.
_STOP_LINE = 0.1


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


class _Road(NamedTuple):
    """A road.

    Attributes:
      attributes: its name, its number and its junction.
      link: the elements of the link to what is before and after it.
      curves: the lines and arcs of its reference line.
      tiles: the tiles that it passes.
      lanes: the elements of its lanes.
      signals: the elements of its signals.
      objects: the elements of its objects after their numbers, which are added last.
    """

    attributes: str
    link: str
    curves: list[Curve]
    tiles: list[Cell]
    lanes: str
    signals: str
    objects: list[str]


def to_opendrive(road_map: RoadMap, streets: Streets = Streets(), *, name: str = "map") -> str:
    """Writes a grid as the text of an OpenDRIVE file, ``.xodr``.

    Args:
      road_map: the map, whose signs, lights and objects are written too. Connections that no
        neighbour returns, or that leave the grid, are no roads.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.
      name: the name of the map, in the header.

    Returns:
      A text; the same map gives the same text. x is east and y north of the grid's south-west
      corner, in metres. Roads are named by the tile and the side where they start, such as
      ``3_4_east``; connecting roads by their tile, the side by which they enter and their turn,
      such as ``3_4_west_left``.

    Raises:
      InputError: for a map without any road, bad measures, or a bad name.
    """
    scene = make_scene(road_map, streets)
    title = check_named("name", xml_name, name)
    # Tiles with two links are inside roads. Crossings and dead ends are nodes.
    nodes = {tile for tile, neighbours in scene.links.items() if len(neighbours) != 2}
    paths = cut_roads(scene.links, nodes)
    tiles = sorted({tile for path in paths for tile in (path[0], path[-1])})
    junctions = {tile: number for number, tile in enumerate(tiles, 1)}
    # CARLA takes a number for the number of a road if a road has it. Therefore roads are numbered
    # after junctions.
    first = len(junctions) + 1
    signals = list_signals(road_map, scene.rights, paths)
    roads = [
        _road(path, number, junctions, signals, scene) for number, path in enumerate(paths, first)
    ]
    # The end of a road at each node where drivers arrive.
    ends: dict[LaneNode, _End] = {}
    for number, path in enumerate(paths, first):
        ends[arrival(path[::-1])] = _End(number, starts=True)
        ends[arrival(path)] = _End(number, starts=False)
    contents: dict[Cell, list[str]] = {tile: [] for tile in junctions}
    # The number of the connecting road of each lanelet that has one.
    connecting: dict[int, int] = {}
    for index, lanelet in enumerate(scene.lanelets):
        node = lanelet.movement.node
        # Movements on other tiles are part of the roads between junctions.
        if node.tile in junctions:
            # The road that a movement leads to ends where its oncoming drivers arrive.
            leaving = LaneNode(*node.tile, (lanelet.movement.exit + 2) % 4)
            start, end = ends[node], ends[leaving]
            number = connecting[index] = first + len(roads)
            junction = junctions[node.tile]
            roads.append(_connecting_road(lanelet, number, junction, start, end, signals, scene))
            contents[node.tile].append(
                f'<connection id="{len(contents[node.tile])}" incomingRoad="{start.road}" '
                f'connectingRoad="{number}" contactPoint="start">'
                f'<laneLink from="{start.lane_in}" to="-1"/></connection>'
            )
    controllers: list[str] = []
    for tile, approaches in scene.crossings.items():
        contents[tile] += _rights(approaches, controllers, signals, connecting)
    _place_objects(roads, scene)
    for approach in chain.from_iterable(scene.crossings.values()):
        if approach.control in ("stop", "light"):
            end = ends[approach.node]
            road = roads[end.road - first]
            road.objects.append(_stop_line(road, end, scene))
    file = ['<?xml version="1.0" encoding="UTF-8"?>', "<OpenDRIVE>", _header(title, scene)]
    numbers = count(1)
    file += [_element(road, numbers, scene) for road in roads]
    file += controllers
    for (row, column), junction in junctions.items():
        content = "".join(contents[row, column])
        file.append(f'<junction id="{junction}" name="{row}_{column}">{content}</junction>')
    return "\n".join([*file, "</OpenDRIVE>\n"])


def _header(name: str, scene: Scene) -> str:
    north, east = (length * scene.streets.tile_size for length in scene.road_map.codes.shape)
    extent = f'north="{north:.9g}" south="0" east="{east:.9g}" west="0"'
    reference = f"<geoReference><![CDATA[{plane_of(scene.streets.origin)}]]></geoReference>"
    about = f'revMajor="1" revMinor="7" name={quoteattr(name)} version="1"'
    return f"<header {about} {extent}>{reference}</header>"


def _inset(scene: Scene) -> float:
    """Returns how far roads between adjacent crossings lead beyond the border, in tiles."""
    return min(_INSET / scene.streets.tile_size, _MOST_INSET)


def _road(
    path: list[Cell],
    number: int,
    junctions: dict[Cell, int],
    signals: dict[LaneNode, list[Signal]],
    scene: Scene,
) -> _Road:
    """Returns a road between junctions, with its signals and a lane on each side."""
    curves = middle_of_road(path, scene.links, _inset(scene))
    # Who arrives at the first tile drives against the direction of the road, on lane 1.
    signs = [_signal(signal, 0, 1, scene) for signal in signals[arrival(path[::-1])]]
    length = _length(curves, scene)
    signs += [_signal(signal, length, -1, scene) for signal in signals[arrival(path)]]
    width = _width(scene.streets.lane)
    lanes = (
        f'{_shift()}<laneSection s="0"><left>{_lane(1, "solid", scene, width)}</left>'
        f"<center>{_lane(0, 'broken', scene)}</center>"
        f"<right>{_lane(-1, 'solid', scene, width)}</right></laneSection>"
    )
    row, column = path[0]
    side = side_towards(path[0], path[1]).name
    first, last = junctions[path[0]], junctions[path[-1]]
    return _Road(
        f'name="{row}_{column}_{side}" id="{number}" junction="-1"',
        f'<predecessor elementType="junction" elementId="{first}"/>'
        f'<successor elementType="junction" elementId="{last}"/>',
        curves,
        path,
        lanes,
        "".join(signs),
        [],
    )


def _connecting_road(
    lanelet: Lanelet,
    number: int,
    junction: int,
    start: _End,
    end: _End,
    signals: dict[LaneNode, list[Signal]],
    scene: Scene,
) -> _Road:
    """Returns a road across a junction, with the right lane alone and no marks.

    It leads from the end of one road to the start of another.
    """
    streets, movement = scene.streets, lanelet.movement
    if movement.turn == BACK:
        # The roads already lead to the middle of the tile, so the lines on both sides are left out.
        # The reference line is the half circle along the centre of the lane, not the middle of the
        # road.
        curves = lane_curves(movement, streets.lane / streets.tile_size / 2)[1:2]
        island, half = _ISLAND * streets.lane, _length(curves, scene) / 2
        shift = _shift(streets.lane / 2, island, half)
        width = _width(streets.lane, island, half)
    else:
        # Only roads between adjacent crossings lead beyond the border. This tile is then a
        # crossing, because a junction inside a road is next to no crossing.
        inset = _inset(scene) * (movement.node.tile_before in scene.crossings)
        outset = _inset(scene) * (movement.next_node.tile in scene.crossings)
        curves = middle_across_tile(movement, inset, outset)
        shift, width = _shift(), _width(streets.lane)
    link = f'<link><predecessor id="{start.lane_in}"/><successor id="{-end.lane_in}"/></link>'
    lanes = (
        f'{shift}<laneSection s="0"><center>{_lane(0, "none", scene)}</center>'
        f"<right>{_lane(-1, 'none', scene, width, link)}</right></laneSection>"
    )
    references = "".join(
        f'<signalReference s="0" t="{-_ASIDE * streets.lane:.9g}" id="{signal.number}" '
        'orientation="+"><validity fromLane="-1" toLane="-1"/></signalReference>'
        for signal in signals[movement.node]
        if signal.kind in _STOPPING
    )
    return _Road(
        f'name="{movement.name}" id="{number}" junction="{junction}"',
        f"<predecessor {start.link}/><successor {end.link}/>",
        curves,
        [movement.node.tile],
        lanes,
        references,
        [],
    )


def _shift(offset: float = 0.0, island: float = 0.0, half: float = 0.0) -> str:
    """Returns how far the lanes are to the left of the reference line; see `_cubics`."""
    return "".join(f'<laneOffset s="{poly}/>' for poly in _cubics(offset, island, half))


def _width(lane: float, island: float = 0.0, half: float = 0.0) -> str:
    """Returns the width of a lane; see `_cubics`."""
    return "".join(f'<width sOffset="{poly}/>' for poly in _cubics(lane, island, half))


def _cubics(value: float, island: float, half: float) -> list[str]:
    """Returns a value along a road, as cubics in the length.

    The value is less by `island` after the length `half`, and again `value` after twice that length.
    """
    if not island:
        return [f'0" a="{value:.9g}" b="0" c="0" d="0"']
    c, d = 3 * island / half**2, 2 * island / half**3
    return [
        f'0" a="{value:.9g}" b="0" c="{-c:.9g}" d="{d:.9g}"',
        f'{half:.12g}" a="{value - island:.9g}" b="0" c="{c:.9g}" d="{-d:.9g}"',
    ]


def _rights(
    approaches: list[Approach],
    controllers: list[str],
    signals: dict[LaneNode, list[Signal]],
    connecting: dict[int, int],
) -> list[str]:
    """Returns the elements of a junction that say who goes first, and adds controllers of lights.

    `connecting` are the numbers of connecting roads by the indices of their lanelets.
    Each axis has a controller, which the sequence orders: west to east, then north to south.
    """
    rights: list[str] = []
    for sequence, axis in enumerate((1, 0)):
        controls = ""
        # Roads are in clockwise order from the north, where drivers arrive with heading 2.
        for approach in approaches[::-1]:
            if approach.control == "light" and approach.node.heading % 2 == axis:
                for signal in signals[approach.node]:
                    if signal.kind == "trafficlight":
                        controls += f'<control signalId="{signal.number}" type="0"/>'
        if controls:
            place = f'id="{len(controllers) + 1}" sequence="{sequence}"'
            controllers.append(f"<controller {place}>{controls}</controller>")
            rights.append(f'<controller {place} type="0"/>')
    for low, high in product(approaches, approaches[::-1]):
        if (low.control, high.control) == ("yield", "go_first"):
            for low_lane, high_lane in product(low.lanelets, high.lanelets):
                roads = f'high="{connecting[high_lane]}" low="{connecting[low_lane]}"'
                rights.append(f"<priority {roads}/>")
    return rights


def _signal(signal: Signal, s: float, lane: int, scene: Scene) -> str:
    """Returns the element of a signal for the drivers of a lane.

    `s` is the distance of the signal from the start of its road.
    """
    streets = scene.streets
    if signal.item is None:
        # A signal without an object of the map gets a size and a height in proportion to the lane.
        height = width = streets.lane / 4
        above = 0.7 * streets.lane
        place = ""
    else:
        item = signal.item
        height = item.height * streets.tile_size / TILE_SIZE
        width = item.footprint[1] * streets.tile_size / TILE_SIZE
        above = 0.0
        x, y = item.x * streets.tile_size, (scene.rows - item.y) * streets.tile_size
        place = f'<positionInertial x="{x:.9g}" y="{y:.9g}" z="0" hdg="{signal.heading:.9g}"/>'
    if signal.kind == "trafficlight":
        # OpenDRIVE itself defines this type, a light with three colours.
        about = 'country="OpenDRIVE" type="1000001" subtype="-1" dynamic="yes"'
    else:
        kind, subtype = _TYPES.get(signal.kind, ("-1", "-1"))
        about = f'country="DE" type="{kind}" subtype="{subtype}" dynamic="no"'
    # A signal is read by those who drive along the road, "+", or against it, "-".
    orientation = "-" if lane > 0 else "+"
    position = f's="{s:.17g}" t="{_ASIDE * lane * streets.lane:.9g}"'
    size = f'zOffset="{above:.9g}" height="{height:.9g}" width="{width:.9g}"'
    return (
        f'<signal {position} id="{signal.number}" name="{signal.kind}" orientation="{orientation}" '
        f'{about} {size}><validity fromLane="{lane}" toLane="{lane}"/>{place}</signal>'
    )


def _place_objects(roads: list[_Road], scene: Scene) -> None:
    """Adds the objects of the map, without signs, lights and tags, to their roads."""
    ways = Ways([road.curves for road in roads], [road.tiles for road in roads])
    for item in scene.road_map.objects or ():
        if item.height and not is_signal(item):
            place = ways.place_beside(item.x, item.y)
            if place is not None:
                roads[place.way].objects.append(_object_beside(item, place, scene))


def _object_beside(item: MapObject, place: Place, scene: Scene) -> str:
    """Returns the element of an object after its number."""
    size = scene.streets.tile_size
    length, width, height = (side * size / TILE_SIZE for side in (*item.footprint, item.height))
    outline = ""
    sides = f'radius="{length / 2:.6g}"'
    if not item.is_round:
        sides = f'length="{length:.6g}" width="{width:.6g}"'
        corners = ""
        # The corners are counter-clockwise.
        for index, (u, v) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            corner = f'id="{index}" u="{u * length / 2:.6g}" v="{v * width / 2:.6g}" z="0"'
            corners += f'<cornerLocal {corner} height="{height:.6g}"/>'
        outline = f'<outlines><outline id="0" outer="true">{corners}</outline></outlines>'
    kind = _OBJECTS.get(base_kind(item.kind), "obstacle")
    return _object(
        f'name="{item.kind}" type="{kind}" {sides} height="{height:.6g}"',
        place.along * size,
        place.left * size,
        item.angle - place.angle,
        outline,
    )


def _stop_line(road: _Road, end: _End, scene: Scene) -> str:
    """Returns the stop line at an end of a road, on the lane that leads there."""
    length, lane = _length(road.curves, scene), scene.streets.lane
    depth = min(_STOP_LINE * lane, length)
    s = depth / 2 if end.starts else length - depth / 2
    return _object(
        f'name="stop_line" type="roadMark" subtype="signalLines" '
        f'length="{depth:.6g}" width="{lane:.6g}" height="0"',
        s,
        end.lane_in * lane / 2,
        0.0,
        f'<validity fromLane="{end.lane_in}" toLane="{end.lane_in}"/>',
    )


def _object(attributes: str, s: float, t: float, heading: float, content: str) -> str:
    """Returns the element of an object after its number."""
    place = f's="{s:.9g}" t="{t:.9g}" zOffset="0" hdg="{heading:.9g}" pitch="0" roll="0"'
    return f'{attributes} {place} orientation="none">{content}</object>'


def _lane(number: int, mark: str, scene: Scene, width: str = "", link: str = "") -> str:
    """Returns the element of a lane; lane 0 is the line between the directions and has no width."""
    # These are the values of lane 0.
    kind, color, speed = "none", "yellow", ""
    if number != 0:
        kind, color = "driving", "standard"
        speed = f'<speed sOffset="0" max="{scene.streets.speed:.9g}" unit="m/s"/>'
    road_mark = (
        f'<roadMark sOffset="0" type="{mark}" weight="standard" color="{color}" laneChange="none"/>'
    )
    return f'<lane id="{number}" type="{kind}" level="false">{link}{width}{road_mark}{speed}</lane>'


def _element(road: _Road, numbers: Iterator[int], scene: Scene) -> str:
    """Returns the element of a road, whose objects take the next numbers. Lengths are in metres."""
    objects = "".join(f'<object id="{next(numbers)}" {content}' for content in road.objects)
    tile_size = scene.streets.tile_size
    plan = ""
    s = 0.0
    for east, south, heading, length, curvature in road.curves:
        x, y = east * tile_size, (scene.rows - south) * tile_size
        # Headings are clockwise from north, and angles counter-clockwise from east.
        angle = (1 - heading) * math.pi / 2
        metres = length * tile_size
        # Readers add up lengths and compare the sum with `s` to 1e-9 m. On a road of 1 km or more,
        # 12 digits are fewer than that.
        place = f's="{s:.17g}" x="{x:.12g}" y="{y:.12g}" hdg="{angle:.12g}" length="{metres:.17g}"'
        shape = f'<arc curvature="{curvature / tile_size:.12g}"/>' if curvature else "<line/>"
        plan += f"<geometry {place}>{shape}</geometry>"
        s += metres
    return (
        f'<road {road.attributes} length="{s:.17g}" rule="RHT"><link>{road.link}</link>'
        f'<type s="0" type="town"><speed max="{scene.streets.speed:.9g}" unit="m/s"/></type>'
        f"<planView>{plan}</planView>"
        '<elevationProfile><elevation s="0" a="0" b="0" c="0" d="0"/></elevationProfile>'
        f"<lanes>{road.lanes}</lanes><objects>{objects}</objects>"
        f"<signals>{road.signals}</signals></road>"
    )


def _length(curves: list[Curve], scene: Scene) -> float:
    """Returns the length of a road in metres, with the rounding of its element."""
    length = 0.0
    for curve in curves:
        length += curve.length * scene.streets.tile_size
    return length
