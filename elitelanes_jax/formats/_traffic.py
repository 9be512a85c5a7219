"""Traffic on a map: its roads in metres, and cars that drive along their lanes.

Roads are lanes, lines, edges and stop signs. Lanes come first, one for each movement, in ascending
order of row, column, heading and turn. Each car has a log of 9 s.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from elitelanes_jax._util.checks import SEED, check_named
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.signals import rights_of_way
from elitelanes_jax.formats.streets import Streets, to_metres
from elitelanes_jax.lanes.curves import CHORDS, lane_curves, moved
from elitelanes_jax.lanes.links import Cell, linked_codes
from elitelanes_jax.lanes.movements import BACK, LaneGraph, Movement, lane_graph, no_lane_error
from elitelanes_jax.network.codes import CONNECTIONS

AGENTS = 32
"""The most cars of a map."""

STEPS = 91
"""The number of positions in a log: 9 s, the length of all of PufferDrive's maps."""

STEP = 0.1
"""Seconds from a position to the next one."""

# The sides of a car in widths of a lane. On lanes of 3.2 m a car is 4.5 m long and 1.9 m wide.
_LENGTH, _WIDTH, _HEIGHT = 1.4, 0.6, 0.5

# The length of the first and the last segment of a lane, in tiles. These segments leave an arc by a
# ten-thousandth of their length.
_STRAIGHT = 2.0**-9


class CarSides(NamedTuple):
    """The length, the width and the height of all cars, in metres."""

    length: float
    width: float
    height: float


class Road(NamedTuple):
    """A line of the map.

    Attributes:
      kind: "lane", "road_line", the line between lanes, "road_edge" or "stop_sign".
      points: complex ``[P]``; a sign has one point.
      movement: the movement that the line follows. A sign is for all movements from this one's
        node.
    """

    kind: str
    points: NDArray[np.complex128]
    movement: Movement


class Log(NamedTuple):
    """What a car does in each of 91 steps.

    The position and the velocity are complex ``[91]``, and the heading is in radians ``[91]``.
    """

    position: NDArray[np.complex128]
    velocity: NDArray[np.complex128]
    heading: NDArray[np.float64]


class Traffic(NamedTuple):
    """The traffic on a map.

    Positions are complex: metres east + north·i of the grid's south-west corner.

    Attributes:
      graph: the graph of the lanes. Cars turn back at dead ends.
      roads: lanes come first; their indices are those of the graph's movements.
      logs: the logs of up to `AGENTS` cars.
      sides: the sides of each car.
      rows: the number of rows of the grid.
    """

    graph: LaneGraph
    roads: list[Road]
    logs: list[Log]
    sides: CarSides
    rows: int


def make_traffic(source: UserValue, streets: Streets, seed: int) -> Traffic:
    """Makes the traffic on a map; the same map and seed give the same traffic.

    Cars start in the middle of random lanes, at most one on a tile. Each follows random turns at
    the speed limit.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file. Connections that no neighbour
        returns, or that leave the grid, are no roads.
      streets: their measures. Signs stand at all-way stops alone.
      seed: the seed of the cars' starts and turns, 0 to 2**32 - 1.

    Raises:
      InputError: for a bad map, one without a lane from a tile to another, bad measures, or a bad
        seed.
    """
    seed = check_named("seed", SEED, seed)
    road_map = as_map(source)
    rows = len(road_map.codes)
    graph = lane_graph(road_map.codes, turn_back=True)
    roads = _list_roads(road_map.codes, graph, streets)
    rules = rights_of_way(road_map, streets)
    stops = [tile for tile, rule in rules.items() if rule == "allway_stop"]
    roads += _stop_signs(stops, graph, streets, rows)
    logs = _drive(graph, roads, streets, np.random.default_rng(seed))
    sides = CarSides(_LENGTH * streets.lane, _WIDTH * streets.lane, _HEIGHT * streets.lane)
    return Traffic(graph, roads, logs, sides, rows)


def _list_roads(codes: NDArray[np.int8], graph: LaneGraph, streets: Streets) -> list[Road]:
    """Returns the lanes, the lines between them, and the edges of the road."""
    links = CONNECTIONS[linked_codes(codes)]
    width, height = streets.lane / streets.tile_size, len(codes)
    movements = graph.list_movements()
    lanes = [
        Road("lane", _line(movement, width / 2, streets, height), movement)
        for movement in movements
    ]
    lines: list[Road] = []
    edges: list[Road] = []
    previous: Movement | None = None
    for movement in movements:
        # Movements are in ascending order of turn, so the first one from a side keeps furthest to
        # the right.
        is_rightmost = previous is None or previous.node != movement.node
        is_first = previous is None or previous.node.tile != movement.node.tile
        # The right edge of this movement is an edge of the road. The right edges of other movements
        # cross the road.
        if is_rightmost:
            edges.append(Road("road_edge", _line(movement, width, streets, height), movement))
        # A line between the lanes of both directions is drawn once, and not on crossings and dead
        # ends.
        if is_first and links[movement.node.tile] == 2:
            lines.append(Road("road_line", _line(movement, 0.0, streets, height), movement))
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
    """Returns the points of a line across the tile (0, 0), whose outer segments are straight ahead.

    The direction of an outer segment is exactly one of the four headings, and therefore the same
    number on both sides of a border. PufferDrive joins lanes by this direction.
    """
    movement = Movement(0, 0, heading, turn)
    parts: list[Float[np.ndarray, "S 2"]] = []
    for curve in lane_curves(movement, offset):
        # A straight line is cut into chords too, because PufferDrive files a segment under the
        # middle of it, in cells of 5 m.
        part = curve.points(np.linspace(0, 1, CHORDS + 1))
        if parts:
            # A curve starts at the last point of the curve before it.
            part = part[1:]
        parts.append(part)
    points = np.concatenate(parts)
    # Near each end is a further point, exactly along the heading. It fixes the direction of the
    # outer segment.
    first, last = points[[0, -1]].tolist()
    # Copying keeps the coordinate across the heading exact, because sines of right angles are not
    # exactly 0.
    second = moved(first, heading, _STRAIGHT)
    last_but_one = moved(last, movement.exit, -_STRAIGHT)
    return np.concatenate([[first, second], points[1:-1], [last_but_one, last]]).round(12)


def _stop_signs(tiles: list[Cell], graph: LaneGraph, streets: Streets, height: int) -> list[Road]:
    """Returns the signs to the right of the lanes that enter crossings.

    Each crossing has one sign for each heading.
    """
    width = streets.lane / streets.tile_size
    # All turns from a side share the sign, so one movement for each heading is kept.
    by_heading: dict[Cell, dict[int, Movement]] = {tile: {} for tile in tiles}
    for movement in graph.list_movements():
        if movement.node.tile in by_heading:
            by_heading[movement.node.tile][movement.heading] = movement
    signs: list[Road] = []
    for entering in by_heading.values():
        for movement in entering.values():
            points = _line(movement, width, streets, height)[:1]
            signs.append(Road("stop_sign", points, movement))
    return signs


def _drive(
    graph: LaneGraph, roads: list[Road], streets: Streets, rng: np.random.Generator
) -> list[Log]:
    """Drives cars from random lanes along random turns."""
    movements, successors = graph.list_movements(), graph.list_successors()
    # A car does not start in the middle of turning back.
    starts = [index for index, movement in enumerate(movements) if movement.turn != BACK]
    if not starts:
        raise no_lane_error()
    # The tiles where cars start. With one car on each, no two cars start in the same place.
    taken: set[tuple[int, int]] = set()
    logs: list[Log] = []
    for index in rng.permutation(starts).tolist():
        tile = movements[index].node.tile
        if len(logs) < AGENTS and tile not in taken:
            taken.add(tile)
            logs.append(_follow(index, successors, roads, streets, rng))
    return logs


def _follow(
    start: int,
    successors: list[list[int]],
    roads: list[Road],
    streets: Streets,
    rng: np.random.Generator,
) -> Log:
    """Returns the log of a car that starts in the middle of a lane, and takes random turns."""
    parts = [roads[start].points]
    length = _lengths(parts[0])[-1]
    # The distances from the start of the first lane at each step.
    along = length / 2 + np.arange(STEPS) * STEP * streets.speed
    index = start
    # Lanes are added until they are longer than the distance at the last step.
    while length <= along[-1]:
        index = int(rng.choice(successors[index]))
        # A lane starts at the last point of the lane before it, so this point is left out.
        part = roads[index].points[1:]
        end_before = parts[-1][-1:]
        length = _lengths(np.concatenate([end_before, part]), length)[-1]
        parts.append(part)
    path = np.concatenate(parts)
    lengths = _lengths(path)
    # The direction of the segment that a car is on gives its heading and its velocity.
    directions = np.diff(path) / np.abs(np.diff(path))
    ahead = directions[np.searchsorted(lengths, along, side="right") - 1]
    return Log(np.interp(along, lengths, path), ahead * streets.speed, np.angle(ahead))


def _lengths(path: NDArray[np.complex128], before: float = 0.0) -> NDArray[np.float64]:
    """Returns the length of a path up to each of its points.

    `before` is the length before its first point.
    """
    return np.cumsum(np.concatenate([[before], np.abs(np.diff(path))]))
