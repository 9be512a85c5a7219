"""Road networks for SUMO, the traffic simulator.

The files are the plain XML from which SUMO's `netconvert` makes a network.

Roads lead from crossing to crossing, with a lane in each direction; traffic keeps right. They run
along the middle of straights and the arcs of turns. SUMO has no edge from a node to itself, so a
road back to its start, such as a ring, is cut in two.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from jaxtyping import Float, Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import check_named, is_whole, xml_name
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats._earth import plane_of
from elitelanes_jax.formats._roads import cut_roads
from elitelanes_jax.formats._scene import Scene, make_scene
from elitelanes_jax.formats.road_map import RoadMap, as_map
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import CHORDS
from elitelanes_jax.lanes.links import linked_tiles, side_towards
from elitelanes_jax.lanes.movements import LaneNode
from elitelanes_jax.network.codes import CONNECTIONS
from elitelanes_jax.network.links import Cell

_SUFFIXES = {"node": ".nod.xml", "edge": ".edg.xml", "connection": ".con.xml"}
_SETTINGS = {
    "output-file": "{name}.net.xml",
    # The network keeps the coordinates of the grid.
    "offset.disable-normalization": "true",
    # Four decimals suit streets as small as Duckietown's.
    "precision": "4",
    # Otherwise netconvert warns that the turns of tiles are sharp.
    "geometry.min-radius": "0",
    # Roads around a block are no roundabout.
    "roundabouts.guess": "false",
}

# In names of files, SUMO takes these for a list, a port of the network, a folder, and a variable of
# the environment. There is no way to quote them.
_REFUSED = (",", ":", "\\", "${")
# SUMO expands these characters in names of files. Their codes are read as the characters.
_QUOTED = {"%": "%25", "~": "%7e"}

# The angles t of points on a tile, see `_line`, and the number of points before the middle of the
# tile.
_ARC = np.linspace(0, math.pi / 2, CHORDS + 1)[:, None]
_HALF = _ARC.size // 2


class Sumo(NamedTuple):
    """The files of a map.

    x is east and y north of the grid's south-west corner, in metres.

    Attributes:
      nodes: plain XML; each is named ROW_COLUMN after its tile.
      edges: each is named ROW_COLUMN_SIDE after its first tile and the side by which it leaves that
        tile.
      connections: the connections from each edge to those that start at its end; back along the
        same road only at dead ends.
      settings: the settings for ``netconvert -c``, which makes the network NAME.net.xml.
    """

    nodes: str
    edges: str
    connections: str
    settings: str


def to_sumo(road_map: RoadMap, name: str, streets: Streets = Streets()) -> Sumo:
    """Writes a map for SUMO; the same map gives the same texts.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      name: the name of the files, without their suffixes .nod.xml, .edg.xml and .con.xml, for the
        settings.
      streets: their measures. A crossing with lights or stop signs on the map has these, and no
        other right of way.

    Returns:
      A record of the texts of the files: `nodes`, `edges` and `connections`, plain XML, and
      `settings` for ``netconvert -c``, which makes the network NAME.net.xml. A node is named
      ROW_COLUMN after its tile. An edge is named ROW_COLUMN_SIDE after its first tile and the side
      by which it leaves that tile. Connections lead from each edge to those that start at its end;
      back along the same road only at dead ends. x is east and y north of the grid's south-west
      corner, in metres.

    Raises:
      InputError: for a map without any road, a bad name, or bad measures.
    """
    scene = make_scene(road_map, streets)
    nodes: dict[Cell, str] = {}
    edges = []
    connections = []
    for road in _roads(road_map.codes, scene.links):
        line = scene.to_metres(_line(road, scene.links))
        node = road[0]
        nodes[node] = _node(node, line[0], scene.rights.get(node, "priority"), streets)
        edges.append(_edge(road, line, streets))
        # Each link of a node begins a road. Cars turn back only where no other road leaves the node.
        onward = [tile for tile in scene.links[road[-1]] if tile != road[-2]] or [road[-2]]
        for tile in sorted(onward):
            ends = f'from="{_edge_id(road[0], road[1])}" to="{_edge_id(road[-1], tile)}"'
            connections.append(f'{ends} fromLane="0" toLane="0"')
    return Sumo(
        _xml("node", nodes.values(), first=_location(scene)),
        _xml("edge", edges),
        _xml("connection", connections),
        _settings(check_named("name", _file_name, name)),
    )


@name_wrong_arguments
def to_sumo_trips(source: UserValue, trips: Sequence[tuple[LaneNode, LaneNode]]) -> str:
    """Writes trips for SUMO, the text of a file ``.rou.xml``.

    One trip starts each second, in the order of the list. A trip leads from the edge of `to_sumo`
    on which its start is to the edge on which its goal is.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      trips: starts and goals. Each is a `drive.LaneNode` or a plain (row, column, heading): the
        heading with which that tile is entered, 0 north, 1 east, 2 south, 3 west.

    Raises:
      InputError: for a bad map, or a start or goal that is on no road.
    """
    edges: dict[tuple[Cell, Cell], str] = {}
    codes = as_map(source).codes
    for road in _roads(codes, linked_tiles(codes)):
        for step in pairwise(road):
            edges[step] = _edge_id(road[0], road[1])

    def edge_of(node: LaneNode) -> str:
        row, column, heading = node
        # A node of the lane graph is entered by a step from the tile before. This step is on one
        # road alone.
        step: tuple[Cell, Cell] | None = None
        if heading in range(4):
            step = LaneNode(row, column, heading).tile_before, (row, column)
        if step is None or step not in edges:
            is_cell = is_whole(row) and is_whole(column) and row >= 0 and column >= 0
            place = describe_cell(row, column) if is_cell else f"[{row!r}, {column!r}]"
            raise InputError(
                "trips", "starts and goals on roads", f"{place} with the heading {heading!r}"
            )
        return edges[step]

    elements = []
    for number, (start, goal) in enumerate(trips):
        ends = f'from="{edge_of(start)}" to="{edge_of(goal)}"'
        elements.append(f'id="{number}" depart="{number}" {ends}')
    return _xml("trip", elements, root="routes")


def _file_name(value: UserValue) -> str:
    """Checks for a name that SUMO's settings can hold; returns it as they have it."""
    name = xml_name(value)
    for part in _REFUSED:
        if part in name:
            raise InputError("", f"a name without {part}, as in SUMO's settings", quote(name))
    quoted = "".join(_QUOTED.get(character, character) for character in name)
    # SUMO removes spaces at the start of a name, so the first one is written as its code.
    return f"%20{quoted[1:]}" if quoted.startswith(" ") else quoted


def _settings(name: str) -> str:
    """Returns the settings for netconvert; `name` is that of the files as SUMO reads it."""
    values = {f"{kind}-files": name + suffix for kind, suffix in _SUFFIXES.items()}
    values |= {key: value.format(name=name) for key, value in _SETTINGS.items()}
    lines = "".join(f"    <{key} value={quoteattr(value)}/>\n" for key, value in values.items())
    return f"<configuration>\n{lines}</configuration>\n"


def _roads(grid: Int8[np.ndarray, "H W"], links: dict[Cell, list[Cell]]) -> list[list[Cell]]:
    """Lists the tiles from node to node, of each road in each direction."""
    # A crossing stays a node even if no neighbour returns some of its connections.
    nodes = {tile for tile in links if CONNECTIONS[grid[tile]] >= 3 or len(links[tile]) < 2}
    roads = []
    for road in cut_roads(links, nodes):
        roads += [road, road[::-1]]
    return sorted(roads)


def _line(road: list[Cell], links: dict[Cell, list[Cell]]) -> Float[np.ndarray, "P 2"]:
    """Returns x and y of the middle of a road from node to node, in tiles.

    Points on straight lines are left out.

    Each tile is crossed from border to border. For a and b, the vectors from its centre to both
    borders, a·(1 - sin t) + b·(1 - cos t) is the quarter circle of a turn, and on a straight, where
    b = -a, the line.
    """
    # The first and the last tile also need a neighbour on their other side.
    beyond = [_beyond(road[0], road[1], links), *road, _beyond(road[-1], road[-2], links)]
    centres = np.array([[column + 0.5, row + 0.5] for row, column in beyond])[:, None]
    # These are the vectors from the centres of tiles to the borders between them.
    half_steps = np.diff(centres, axis=0) / 2
    from_entry = half_steps[:-1] * (1 - np.sin(_ARC))
    to_exit = half_steps[1:] * (1 - np.cos(_ARC))
    across = centres[1:-1] - from_entry + to_exit
    # Nodes are in the middle of their tiles, so the line starts and ends there.
    line = across.reshape(-1, 2)[_HALF:-_HALF]
    # Tiles share the points on their borders, and each of these points is kept once.
    is_apart = np.hypot(*np.diff(line, axis=0).T) > 1e-9
    line = line[np.append(True, is_apart)]
    pieces = np.diff(line, axis=0)
    x, y = pieces[:-1].T
    next_x, next_y = pieces[1:].T
    # Inner points of straight lines are left out.
    is_bent = abs(x * next_y - y * next_x) > 1e-9
    return np.asarray(line[[True, *is_bent, True]])


def _beyond(node: Cell, neighbour: Cell, links: dict[Cell, list[Cell]]) -> Cell:
    """Returns the tile behind a node, for a road to a neighbour.

    This is the tile on the only other road, or otherwise the tile straight behind.
    """
    if len(links[node]) == 2:
        return next(other for other in links[node] if other != neighbour)
    return 2 * node[0] - neighbour[0], 2 * node[1] - neighbour[1]


def _node(node: Cell, place: complex, kind: str, streets: Streets) -> str:
    # The radius is SUMO's own, 4 m for lanes of 3.2 m, if there is room. It does not reach the
    # border of the tile, because adjacent crossings need an edge between them.
    radius = min(1.25 * streets.lane, 0.9 * (streets.tile_size / 2 - streets.lane))
    return (
        f'id="{_id(node)}" x="{place.real:.4f}" y="{place.imag:.4f}" type="{kind}" '
        f'radius="{radius:.4f}"'
    )


def _edge(road: list[Cell], line: Iterable[complex], streets: Streets) -> str:
    shape = " ".join(f"{point.real:.4f},{point.imag:.4f}" for point in line)
    return (
        f'id="{_edge_id(road[0], road[1])}" from="{_id(road[0])}" to="{_id(road[-1])}" '
        f'numLanes="1" speed="{streets.speed:g}" width="{streets.lane:g}" '
        f'spreadType="right" shape="{shape}"'
    )


def _id(node: Cell) -> str:
    return f"{node[0]}_{node[1]}"


def _edge_id(node: Cell, neighbour: Cell) -> str:
    return f"{_id(node)}_{side_towards(node, neighbour).name}"


def _location(scene: Scene) -> str:
    """Returns the element that says where on earth x and y are 0."""
    north, east = (length * scene.streets.tile_size for length in scene.road_map.codes.shape)
    box = f"0,0,{east:.4f},{north:.4f}"
    # SUMO has longitudes of the corners here, and reads none of them.
    boundary = f'convBoundary="{box}" origBoundary="{box}"'
    plane = plane_of(scene.streets.origin)
    return f'    <location netOffset="0,0" {boundary} projParameter="{plane}"/>\n'


def _xml(name: str, elements: Iterable[str], root: str | None = None, first: str = "") -> str:
    """Returns a file of elements, given their attributes; `first` is the text before them.

    The name of its root is by default the plural of the elements' name.
    """
    if root is None:
        root = f"{name}s"
    lines = "".join(f"    <{name} {attributes}/>\n" for attributes in elements)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<{root}>\n{first}{lines}</{root}>\n'
