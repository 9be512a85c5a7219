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
from elitelanes_jax.formats._scene import Lanelet, Line, Scene, make_scene
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.curves import CHORDS, lane_curves, moved
from elitelanes_jax.lanes.movements import LaneNode, Movement, no_lane_error
from elitelanes_jax.network.links import Cell

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
      lanelets: the indices of the lanelets that it belongs to.
    """

    kind: str
    points: Line
    lanelets: list[int]


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
      scene: the road network.
      roads: lanes come first; their indices are those of the lanelets.
      logs: the logs of up to `AGENTS` cars.
      sides: the sides of each car.
    """

    scene: Scene
    roads: list[Road]
    logs: list[Log]
    sides: CarSides


def make_traffic(road_map: RoadMap, streets: Streets, seed: int) -> Traffic:
    """Makes the traffic on a map; the same map and seed give the same traffic.

    Cars start in the middle of random lanes, at most one on a tile. Each follows random turns at
    the speed limit.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      streets: their measures. Signs stand at all-way stops alone.
      seed: the seed of the cars' starts and turns, 0 to 2**32 - 1.

    Raises:
      InputError: for a map without a lane from a tile to another, bad measures, or a bad seed.
    """
    seed = check_named("seed", SEED, seed)
    scene = make_scene(road_map, streets)
    roads = _list_roads(scene)
    logs = _drive(scene, roads, np.random.default_rng(seed))
    sides = CarSides(_LENGTH * streets.lane, _WIDTH * streets.lane, _HEIGHT * streets.lane)
    return Traffic(scene, roads, logs, sides)


def _list_roads(scene: Scene) -> list[Road]:
    """Returns the lanes, the lines between them, the edges of the road, and the stop signs.

    Each crossing has one sign for each heading, to the right of the lanes that enter it.
    """
    lanes: list[Road] = []
    lines: list[Road] = []
    edges: list[Road] = []
    width = scene.streets.lane / scene.streets.tile_size
    previous: LaneNode | None = None
    for index, lanelet in enumerate(scene.lanelets):
        node = lanelet.movement.node
        lanes.append(Road("lane", _line(lanelet, width / 2, scene), [index]))
        # A line between the lanes of both directions is drawn once, and not on crossings and dead
        # ends.
        if lanelet.arms == 2 and (previous is None or previous.tile != node.tile):
            lines.append(Road("road_line", _line(lanelet, 0.0, scene), [index]))
        # Lanelets are in ascending order of turn, so the first one from a side keeps furthest to
        # the right. Its right edge is an edge of the road. The right edges of the others cross the
        # road.
        if node != previous:
            edges.append(Road("road_edge", _line(lanelet, width, scene), [index]))
        previous = node
    signs: list[Road] = []
    for approaches in scene.crossings.values():
        for approach in approaches:
            if approach.control == "stop":
                edge = _line(scene.lanelets[approach.lanelets[0]], width, scene)
                signs.append(Road("stop_sign", edge[:1], approach.lanelets))
    return lanes + lines + edges + signs


def _line(lanelet: Lanelet, offset: float, scene: Scene) -> Line:
    row, column, heading, turn = lanelet.movement
    return scene.to_metres(_line_in_tile(heading, turn, offset) + np.array([column, row]))


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


def _drive(scene: Scene, roads: list[Road], rng: np.random.Generator) -> list[Log]:
    """Drives cars from random lanes along random turns."""
    # A car does not start in the middle of turning back.
    starts = [index for index, lanelet in enumerate(scene.lanelets) if lanelet.arms > 1]
    if not starts:
        raise no_lane_error()
    # The tiles where cars start. With one car on each, no two cars start in the same place.
    taken: set[Cell] = set()
    logs: list[Log] = []
    for index in rng.permutation(starts).tolist():
        tile = scene.lanelets[index].movement.node.tile
        if len(logs) < AGENTS and tile not in taken:
            taken.add(tile)
            logs.append(_follow(index, scene, roads, rng))
    return logs


def _follow(start: int, scene: Scene, roads: list[Road], rng: np.random.Generator) -> Log:
    """Returns the log of a car that starts in the middle of a lane, and takes random turns."""
    parts = [roads[start].points]
    length = _lengths(parts[0])[-1]
    # The distances from the start of the first lane at each step.
    along = length / 2 + np.arange(STEPS) * STEP * scene.streets.speed
    index = start
    # Lanes are added until they are longer than the distance at the last step.
    while length <= along[-1]:
        index = int(rng.choice(scene.lanelets[index].successors))
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
    return Log(np.interp(along, lengths, path), ahead * scene.streets.speed, np.angle(ahead))


def _lengths(path: NDArray[np.complex128], before: float = 0.0) -> NDArray[np.float64]:
    """Returns the length of a path up to each of its points.

    `before` is the length before its first point.
    """
    return np.cumsum(np.concatenate([[before], np.abs(np.diff(path))]))
