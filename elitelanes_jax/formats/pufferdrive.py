"""Road networks for PufferDrive 2, a simulator for reinforcement learning.

They are its binary map, and the same map as JSON. PufferDrive finds the lane that continues
another by geometry: ends within 1 cm, and headings of their outer segments within 0.1 rad, which it
does not unwrap at pi.
"""

import json
import struct
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats._traffic import STEPS, Traffic, make_traffic
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets


class _KindNumbers(NamedTuple):
    """The number of a road's kind in JSON, which is Waymo's, and in the binary."""

    in_json: int
    in_binary: int


_KINDS = {
    "lane": _KindNumbers(2, 4),
    "road_line": _KindNumbers(9, 5),
    "road_edge": _KindNumbers(15, 6),
    "stop_sign": _KindNumbers(17, 7),
}
# The number of the kind of all cars in the binary file.
_VEHICLE = 1


class PufferDrive(NamedTuple):
    """The files of a map. x is east and y north of the grid's south-west corner, in metres.

    Attributes:
      binary: what PufferDrive loads.
      text: the same as JSON. Its lanes also have the numbers of those before and after them.
    """

    binary: bytes
    text: str


def to_pufferdrive(
    road_map: RoadMap, name: str, streets: Streets = Streets(), *, seed: int = 0
) -> PufferDrive:
    """Writes a map for PufferDrive; the same map gives the same files.

    Lanes come first, one for each movement, in ascending order of row, column, heading and turn;
    their ids are their indices. Cars turn back at dead ends. Up to 32 cars start in the middle of
    random lanes, at most one on a tile. Each has a log of 9 s at the speed limit along random
    turns, and its goal is the end of the log.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      name: the name of the scenario, in the JSON.
      streets: their measures. Signs stand at all-way stops alone.
      seed: the seed of the cars' starts and turns, 0 to 2**32 - 1.

    Returns:
      A record of the files: `binary`, the bytes that PufferDrive loads; and `text`, the same as
      JSON, whose lanes also have the numbers of those before and after them. x is east and y north
      of the grid's south-west corner, in metres.

    Raises:
      InputError: for a map without a lane from a tile to another, or a bad seed.
    """
    traffic = make_traffic(road_map, streets, seed)
    return PufferDrive(_to_binary(traffic), _to_json(name, traffic))


def _to_binary(traffic: Traffic) -> bytes:
    """Returns PufferDrive's binary: whole numbers and floats of 32 bits, the least byte first."""
    length, width, height = traffic.sides
    # The head says that PufferDrive has no car of its own here, -1, and none to predict, 0.
    parts = [struct.pack("<4i", -1, 0, len(traffic.logs), len(traffic.roads))]
    for number, log in enumerate(traffic.logs):
        # The goal of a car is the last position of its log.
        goal = log.position[-1]
        parts.append(struct.pack("<4i", 0, _VEHICLE, number, STEPS))
        parts += [_floats(log.position), _floats(log.velocity), _one_float_each(log.heading)]
        # All positions of a log are valid.
        parts.append(np.ones(STEPS, "<i4").tobytes())
        # The last two values are the z of the goal, and 0 for a car that is not an expert.
        parts.append(struct.pack("<6fi", width, length, height, goal.real, goal.imag, 0, 0))
    for number, road in enumerate(traffic.roads):
        parts.append(struct.pack("<4i", 0, _KINDS[road.kind].in_binary, number, len(road.points)))
        # A road has the fields of a car's size and goal too, without a meaning.
        parts += [_floats(road.points), struct.pack("<6fi", 0, 0, 0, 0, 0, 0, 0)]
    return b"".join(parts)


def _floats(points: NDArray[np.complex128]) -> bytes:
    """Returns all x, then all y, then all z, which are 0, of points x + y·i."""
    return _one_float_each(np.concatenate([points.real, points.imag, np.zeros(len(points))]))


def _one_float_each(values: NDArray[np.float64]) -> bytes:
    return values.astype("<f4").tobytes()


def _to_json(name: str, traffic: Traffic) -> str:
    # Micrometres are enough, and keep the text short.
    length, width, height = (round(side, 6) for side in traffic.sides)
    objects: list[Plain] = []
    for number, log in enumerate(traffic.logs):
        car: dict[str, Plain] = {
            "id": number,
            "type": "vehicle",
            "mark_as_expert": False,
            "length": length,
            "width": width,
            "height": height,
            "valid": [True] * STEPS,
            "position": _places(log.position),
            "velocity": _places(log.velocity),
            "heading": log.heading.round(6).tolist(),
            "goalPosition": _places(log.position[-1:])[0],
        }
        objects.append(car)
    roads: list[Plain] = []
    for number, road in enumerate(traffic.roads):
        line: dict[str, Plain] = {
            "id": number,
            "type": road.kind,
            "map_element_id": _KINDS[road.kind].in_json,
            "geometry": _places(road.points),
        }
        # The ids of lanes are their indices, because lanes come first.
        if road.kind == "lane":
            lanelet = traffic.scene.lanelets[number]
            line["entry_lanes"] = list(lanelet.predecessors)
            line["exit_lanes"] = list(lanelet.successors)
            line["speed_limit"] = traffic.scene.streets.speed
        roads.append(line)
    content: dict[str, Plain] = {
        "name": name,
        "scenario_id": name,
        "objects": objects,
        "roads": roads,
        # The map has no traffic lights, no car of PufferDrive's own and none to predict.
        "tl_states": {},
        "metadata": {
            "sdc_track_index": -1,
            "tracks_to_predict": [],
            "objects_of_interest": [],
        },
    }
    return json.dumps(content, separators=(",", ":")) + "\n"


def _places(points: NDArray[np.complex128]) -> list[Plain]:
    rounded = np.round(points, 6).tolist()
    return [{"x": point.real, "y": point.imag, "z": 0.0} for point in rounded]
