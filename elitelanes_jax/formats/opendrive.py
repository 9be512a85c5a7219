"""Road networks as OpenDRIVE 1.7, for CARLA, esmini and others.

Roads are lines and arcs, exactly where the tiles have them. Roads lead from crossing to crossing
along the middle of straights and turns, with a lane on each side. A crossing is a junction as large
as its tile, with a connecting road for each movement. Cars turn back at dead ends, in junctions
with one connecting road. A road back to its own crossing has a junction halfway, a ring has two.

OpenDRIVE allows no junction next to a junction: between adjacent crossings is a road of 1/1024
tile.
"""

import math
from itertools import count
from typing import NamedTuple

from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats._roads import arrival, cut_roads, middle_across_tile, middle_of_road
from elitelanes_jax.formats._scene import Approach, Lanelet, Scene, make_scene
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.signals import Signal, list_signals
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import Curve, lane_curves
from elitelanes_jax.lanes.links import Cell, side_towards
from elitelanes_jax.lanes.movements import BACK, LaneNode

# The south-west corner of the grid is on the equator, on the central meridian of UTM's zone 32.
_GEO_REFERENCE = "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=0 +y_0=0 +datum=WGS84 +units=m"


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
    scene = make_scene(source, streets)
    # Tiles with two links are inside roads. Crossings and dead ends are nodes.
    nodes = {tile for tile, neighbours in scene.links.items() if len(neighbours) != 2}
    paths = cut_roads(scene.links, nodes)
    # A tile without links has no road, and so no junction.
    ends_of_paths = {tile for path in paths for tile in (path[0], path[-1])}
    numbers = {tile: index for index, tile in enumerate(sorted(nodes | ends_of_paths), 1)}
    junctions = {tile: numbers[tile] for tile in sorted(ends_of_paths)}
    signals = list_signals(scene.road_map, scene.rights, paths)
    # CARLA takes a number for a road if there is one with it, so roads are numbered after
    # junctions.
    number = count(max(junctions.values()) + 1).__next__
    roads: list[str] = []
    # The end of a road at each node where drivers arrive.
    ends: dict[LaneNode, _End] = {}
    for path in paths:
        road = number()
        ends[arrival(path[::-1])] = _End(road, starts=True)
        ends[arrival(path)] = _End(road, starts=False)
        roads.append(_road(path, road, junctions, signals, scene))
    contents: dict[Cell, list[str]] = {tile: [] for tile in junctions}
    for lanelet in scene.lanelets:
        movement = lanelet.movement
        tile = movement.node.tile
        # Movements on other tiles are part of the roads between junctions.
        if tile in junctions:
            # The road that a movement leads to ends where its oncoming drivers arrive.
            start, end = ends[movement.node], ends[LaneNode(*tile, (movement.exit + 2) % 4)]
            road = number()
            roads.append(_connecting_road(lanelet, road, junctions[tile], start, end, scene))
            contents[tile].append(
                f'<connection id="{len(contents[tile])}" incomingRoad="{start.road}" '
                f'connectingRoad="{road}" contactPoint="start">'
                f'<laneLink from="{start.lane_in}" to="-1"/></connection>'
            )
    controllers: list[str] = []
    for tile, approaches in scene.crossings.items():
        contents[tile] += _rights(approaches, controllers, signals, ends)
    file = ['<?xml version="1.0" encoding="UTF-8"?>', "<OpenDRIVE>", _header(scene)]
    file += roads + controllers
    for (row, column), junction in junctions.items():
        content = "".join(contents[row, column])
        file.append(f'<junction id="{junction}" name="{row}_{column}">{content}</junction>')
    return "\n".join([*file, "</OpenDRIVE>\n"])


def _header(scene: Scene) -> str:
    north, east = (length * scene.streets.tile_size for length in scene.road_map.codes.shape)
    extent = f'north="{north:.9g}" south="0" east="{east:.9g}" west="0"'
    reference = f"<geoReference>{_GEO_REFERENCE}</geoReference>"
    return f'<header revMajor="1" revMinor="7" name="" version="1" {extent}>{reference}</header>'


def _road(
    path: list[Cell],
    number: int,
    junctions: dict[Cell, int],
    signals: dict[LaneNode, list[Signal]],
    scene: Scene,
) -> str:
    """Returns the element of a road between junctions, with its signals and a lane on each side."""
    streets = scene.streets
    plan, length = _plan_view(middle_of_road(path, scene.links), scene)
    # Who arrives at the first tile drives against the direction of the road, on lane 1.
    signs = [_signal(signal, 0, 1, scene) for signal in signals[arrival(path[::-1])]]
    signs += [_signal(signal, length, -1, scene) for signal in signals[arrival(path)]]
    lanes = (
        f"<left>{_lane(1, 'solid', streets)}</left>"
        f"<center>{_lane(0, 'broken', streets)}</center>"
        f"<right>{_lane(-1, 'solid', streets)}</right>"
    )
    row, column = path[0]
    return _element(
        f'name="{row}_{column}_{side_towards(path[0], path[1]).name}" id="{number}" junction="-1"',
        f'<predecessor elementType="junction" elementId="{junctions[path[0]]}"/>'
        f'<successor elementType="junction" elementId="{junctions[path[-1]]}"/>',
        length,
        plan,
        f'<lanes><laneSection s="0">{lanes}</laneSection></lanes>'
        f"<signals>{''.join(signs)}</signals>",
        streets,
    )


def _connecting_road(
    lanelet: Lanelet, number: int, junction: int, start: _End, end: _End, scene: Scene
) -> str:
    """Returns the element of a road across a junction, with the right lane alone and no marks."""
    streets, movement = scene.streets, lanelet.movement
    pieces = _connecting_pieces(lanelet, scene)
    plan, length = _plan_view(pieces, scene)
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
        f'name="{movement.name}" id="{number}" junction="{junction}"',
        f"<predecessor {start.link}/><successor {end.link}/>",
        length,
        plan,
        f'<lanes>{offset}<laneSection s="0">{lanes}</laneSection></lanes>',
        streets,
    )


def _connecting_pieces(lanelet: Lanelet, scene: Scene) -> list[Curve]:
    """Returns the line or arc across a junction.

    It leads from the end of one road to the start of another.
    """
    movement = lanelet.movement
    if movement.turn == BACK:
        # The roads already lead to the middle of the tile, so the lines on both sides are left out.
        return lane_curves(movement, scene.streets.lane / scene.streets.tile_size / 2)[1:2]
    # Only roads between adjacent crossings lead beyond the border. This tile is then a crossing,
    # because a junction inside a road is next to no crossing.
    return middle_across_tile(
        movement,
        from_crossing=movement.node.tile_before in scene.crossings,
        to_crossing=movement.next_node.tile in scene.crossings,
    )


def _rights(
    approaches: list[Approach],
    controllers: list[str],
    signals: dict[LaneNode, list[Signal]],
    ends: dict[LaneNode, _End],
) -> list[str]:
    """Returns the elements of a junction that say who goes first, and adds controllers of lights.

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
    for low in approaches:
        for high in approaches[::-1]:
            if (low.control, high.control) == ("yield", "go_first"):
                roads = f'high="{ends[high.node].road}" low="{ends[low.node].road}"'
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
    position = f's="{s:.12g}" t="{1.25 * lane * streets.lane:.9g}"'
    size = f'zOffset="{above:.9g}" height="{height:.9g}" width="{width:.9g}"'
    return (
        f'<signal {position} id="{signal.number}" name="{signal.kind}" orientation="{orientation}" '
        f'{about} value="-1" {size}><validity fromLane="{lane}" toLane="{lane}"/>{place}</signal>'
    )


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
    attributes: str, link: str, length: float, plan: str, content: str, streets: Streets
) -> str:
    """Returns the element of a road; lengths are in metres."""
    speed = f'<speed max="{streets.speed:.9g}" unit="m/s"/>'
    return (
        f'<road {attributes} length="{length:.12g}"><link>{link}</link>'
        f'<type s="0" type="town">{speed}</type>'
        f"<planView>{plan}</planView>{content}</road>"
    )


def _plan_view(pieces: list[Curve], scene: Scene) -> tuple[str, float]:
    """Returns the elements of lines and arcs, and their length in metres."""
    tile_size = scene.streets.tile_size
    geometries = ""
    s = 0.0
    for east, south, heading, length, curvature in pieces:
        x, y = east * tile_size, (scene.rows - south) * tile_size
        # Headings are clockwise from north, and angles counter-clockwise from east.
        angle = (1 - heading) * math.pi / 2
        metres = length * tile_size
        place = f's="{s:.12g}" x="{x:.12g}" y="{y:.12g}" hdg="{angle:.12g}" length="{metres:.12g}"'
        shape = f'<arc curvature="{curvature / tile_size:.12g}"/>' if curvature else "<line/>"
        geometries += f"<geometry {place}>{shape}</geometry>"
        s += metres
    return geometries, s
