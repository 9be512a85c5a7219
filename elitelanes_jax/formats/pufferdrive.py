"""Road networks for PufferDrive 2, a simulator for reinforcement learning: its binary map, and the same as JSON.

PufferDrive finds the lane that continues another by geometry: ends within 1 cm, and headings of
their outer segments within 0.1 rad, which it does not unwrap at pi. So each lane begins and ends
with a segment that has exactly one of the four headings, and its direction is the same number on
both sides of a border.
"""

import json
import struct
from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, to_metres
from elitelanes_jax.lanes.curves import CHORDS, lane_curves
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import BACK, LaneGraph, Movement, lane_graph, no_lane
from elitelanes_jax.network.codes import CONNECTIONS

AGENTS = 32
"""The most cars of a map."""

# A car's position every 0.1 s, for 9 s: the length of all its maps.
_STEPS, _STEP = 91, 0.1
# Length of the first and the last segment of a lane, in tiles. They leave an arc by a
# ten-thousandth of this.
_STRAIGHT = 2.0**-9
# Sides of a car, in widths of a lane: 4.5 m and 1.9 m on lanes of 3.2 m.
_LENGTH, _WIDTH, _HEIGHT = 1.4, 0.6, 0.5

# The number of a road's kind in JSON, which is Waymo's, and in the binary.
_KINDS = {"lane": (2, 4), "road_line": (9, 5), "road_edge": (15, 6), "stop_sign": (17, 7)}
_VEHICLE = 1


class PufferDrive(NamedTuple):
    """The files of a map. x is east and y north of the grid's south-west corner, in metres.

    Attributes:
      binary: what PufferDrive loads.
      text: the same as JSON. Its lanes also have the numbers of those before and after them.
    """

    binary: bytes
    text: str


class _Road(NamedTuple):
    """A line of the map, complex ``[P]``."""

    kind: str
    points: NDArray[np.complex128]


@name_wrong_arguments
def to_pufferdrive(
    source: UserValue, name: str, streets: Streets = Streets(), *, seed: int = 0
) -> PufferDrive:
    """Writes a map for PufferDrive; the same map gives the same files.

    Lanes come first, one for each movement, in ascending order of row, column, heading and turn;
    their ids are their indices. Cars turn back at dead ends. Up to `AGENTS` cars start in the
    middle of random lanes, at most one on a tile. Each has a log of 9 s at the speed limit along
    random turns, and its goal is the end of the log.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour
        returns, or that leave the grid, are no roads.
      name: the name of the scenario, in the JSON.
      streets: their measures. Signs stand at all-way stops alone.
      seed: of the cars' starts and turns.

    Raises:
      InputError: for a bad map, one without a lane from a tile to another, bad measures, or a bad
        seed.
    """
    seed = check_named("seed", SEED, seed)
    road_map = as_map(source)
    graph = lane_graph(road_map.codes, turn_back=True)
    roads = _list_roads(road_map.codes, graph, streets)
    for tile, rule in rights_of_way(road_map, streets).items():
        if rule == "allway_stop":
            roads += _stop_signs(tile, graph, streets, len(road_map.codes))
    logs = _drive(graph, roads, streets, np.random.default_rng(seed))
    return PufferDrive(
        _to_binary(roads, logs, streets), _to_json(name, graph, roads, logs, streets)
    )


def _list_roads(codes: NDArray[np.int8], graph: LaneGraph, streets: Streets) -> list[_Road]:
    """Returns the lanes, the lines between them, and the edges of the road."""
    links = CONNECTIONS[linked_codes(codes)]
    width, height = streets.lane / streets.tile, len(codes)
    movements = graph.list_movements()
    lanes = [_Road("lane", _line(movement, width / 2, streets, height)) for movement in movements]
    lines: list[_Road] = []
    edges: list[_Road] = []
    previous: Movement | None = None
    for movement in movements:
        # The first movement from a side is the one that keeps furthest to the right.
        is_rightmost = previous is None or previous.node != movement.node
        is_first = previous is None or previous.node.tile != movement.node.tile
        if is_rightmost:
            edges.append(_Road("road_edge", _line(movement, width, streets, height)))
        if is_first and links[movement.node.tile] == 2:
            lines.append(_Road("road_line", _line(movement, 0.0, streets, height)))
        previous = movement
    return lanes + lines + edges


def _line(
    movement: Movement, offset: float, streets: Streets, height: int
) -> NDArray[np.complex128]:
    shift = np.array([movement.column, movement.row])
    return to_metres(
        _line_in_tile(movement.heading, movement.turn, offset) + shift, streets, height
    )


@cache
def _line_in_tile(heading: int, turn: int, offset: float) -> Float[np.ndarray, "P 2"]:
    """Returns the points of a line across the tile (0, 0), whose outer segments are straight ahead."""
    movement = Movement(0, 0, heading, turn)
    parts: list[Float[np.ndarray, "S 2"]] = []
    for curve in lane_curves(movement, offset):
        # Lines are cut too: PufferDrive files a segment under the middle of it, in cells of 5 m.
        parts.append(curve.points(np.linspace(0, 1, CHORDS + 1))[1 if parts else 0 :])
    points = np.concatenate(parts)
    first, last = points[0], points[-1]
    # The coordinate across the heading is copied, because sines of right angles are not exactly 0.
    inner = [_ahead(first, heading, _STRAIGHT), _ahead(last, movement.exit, -_STRAIGHT)]
    return np.concatenate([[first, inner[0]], points[1:-1], [inner[1], last]]).round(12)


def _ahead(point: Float[np.ndarray, "2"], heading: int, distance: float) -> Float[np.ndarray, "2"]:
    steps = np.array([(0, -1), (1, 0), (0, 1), (-1, 0)])
    return point + distance * steps[heading]


def _stop_signs(
    tile: tuple[int, int], graph: LaneGraph, streets: Streets, height: int
) -> list[_Road]:
    """Returns the signs to the right of the lanes that enter a crossing."""
    headings = {
        movement.heading: movement
        for movement in graph.list_movements()
        if movement.node.tile == tile
    }
    width = streets.lane / streets.tile
    return [
        _Road("stop_sign", _line(movement, width, streets, height)[:1])
        for movement in headings.values()
    ]


class _Log(NamedTuple):
    """What a car does in each step: position and velocity, complex ``[91]``, and heading in radians ``[91]``."""

    position: NDArray[np.complex128]
    velocity: NDArray[np.complex128]
    heading: NDArray[np.float64]


def _drive(
    graph: LaneGraph, roads: list[_Road], streets: Streets, rng: np.random.Generator
) -> list[_Log]:
    """Drives cars from random lanes along random turns."""
    movements, successors = graph.list_movements(), graph.list_successors()
    starts = [index for index, movement in enumerate(movements) if movement.turn != BACK]
    if not starts:
        raise no_lane()
    taken: set[tuple[int, int]] = set()
    logs: list[_Log] = []
    for index in rng.permutation(starts).tolist():
        tile = movements[index].node.tile
        if len(logs) < AGENTS and tile not in taken:
            taken.add(tile)
            logs.append(_follow(index, successors, roads, streets, rng))
    return logs


def _follow(
    start: int,
    successors: list[list[int]],
    roads: list[_Road],
    streets: Streets,
    rng: np.random.Generator,
) -> _Log:
    """Follows lanes from the middle of one."""
    path = roads[start].points
    first = _lengths(path)[-1] / 2
    along = first + np.arange(_STEPS) * _STEP * streets.speed
    index = start
    while _lengths(path)[-1] <= along[-1]:
        index = int(rng.choice(successors[index]))
        path = np.concatenate([path, roads[index].points[1:]])
    lengths = _lengths(path)
    directions = np.diff(path) / np.abs(np.diff(path))
    ahead = directions[np.searchsorted(lengths, along, side="right") - 1]
    return _Log(np.interp(along, lengths, path), ahead * streets.speed, np.angle(ahead))


def _lengths(path: NDArray[np.complex128]) -> NDArray[np.float64]:
    """Returns the length of the path up to each of its points."""
    return np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path)))])


def _to_binary(roads: list[_Road], logs: list[_Log], streets: Streets) -> bytes:
    """Returns PufferDrive's binary: whole numbers and floats of 32 bits, the least byte first."""
    length, width, height = (share * streets.lane for share in (_LENGTH, _WIDTH, _HEIGHT))
    # No car of its own, none to predict.
    parts = [struct.pack("<4i", -1, 0, len(logs), len(roads))]
    for number, log in enumerate(logs):
        goal = log.position[-1]
        parts.append(struct.pack("<4i", 0, _VEHICLE, number, _STEPS))
        parts += [_floats(log.position), _floats(log.velocity), _one_float_each(log.heading)]
        parts.append(np.ones(_STEPS, "<i4").tobytes())
        parts.append(struct.pack("<6fi", width, length, height, goal.real, goal.imag, 0, 0))
    for number, road in enumerate(roads):
        parts.append(struct.pack("<4i", 0, _KINDS[road.kind][1], number, len(road.points)))
        parts += [_floats(road.points), struct.pack("<6fi", 0, 0, 0, 0, 0, 0, 0)]
    return b"".join(parts)


def _floats(points: NDArray[np.complex128]) -> bytes:
    """Returns all x, then all y, then all z, which are 0."""
    return _one_float_each(np.concatenate([points.real, points.imag, np.zeros(len(points))]))


def _one_float_each(values: NDArray[np.float64]) -> bytes:
    return values.astype("<f4").tobytes()


def _to_json(
    name: str, graph: LaneGraph, roads: list[_Road], logs: list[_Log], streets: Streets
) -> str:
    successors = graph.list_successors()
    predecessors: list[list[int]] = [[] for _ in successors]
    for index, after in enumerate(successors):
        for lane in after:
            predecessors[lane].append(index)
    length, width, height = (round(share * streets.lane, 6) for share in (_LENGTH, _WIDTH, _HEIGHT))
    objects: list[Plain] = []
    for number, log in enumerate(logs):
        entry: dict[str, Plain] = {"id": number, "type": "vehicle", "mark_as_expert": False}
        entry |= {"length": length, "width": width, "height": height, "valid": [True] * _STEPS}
        entry |= {"position": _places(log.position), "velocity": _places(log.velocity)}
        entry |= {
            "heading": log.heading.round(6).tolist(),
            "goalPosition": _places(log.position[-1:])[0],
        }
        objects.append(entry)
    written: list[Plain] = []
    for number, road in enumerate(roads):
        entry = {"id": number, "type": road.kind, "map_element_id": _KINDS[road.kind][0]}
        entry["geometry"] = _places(road.points)
        if road.kind == "lane":
            entry |= {
                "entry_lanes": list(predecessors[number]),
                "exit_lanes": list(successors[number]),
            }
            entry["speed_limit"] = streets.speed
        written.append(entry)
    metadata: dict[str, Plain] = {
        "sdc_track_index": -1,
        "tracks_to_predict": [],
        "objects_of_interest": [],
    }
    content = {
        "name": name,
        "scenario_id": name,
        "objects": objects,
        "roads": written,
        "tl_states": {},
    }
    return json.dumps(content | {"metadata": metadata}, separators=(",", ":")) + "\n"


def _places(points: NDArray[np.complex128]) -> list[Plain]:
    rounded = np.round(points, 6).tolist()
    return [{"x": point.real, "y": point.imag, "z": 0.0} for point in rounded]
