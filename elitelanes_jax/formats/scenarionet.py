"""Scenarios of ScenarioNet for MetaDrive's `ScenarioEnv`.

A folder has a pickle for each scenario, and the index of the folder. The pickles hold dictionaries,
lists, texts, numbers and arrays. They name no private module of NumPy, so that its versions 1 and 2
read them.
"""

import os
import pickle
from collections.abc import Iterable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path, paths
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Plain, Untyped
from elitelanes_jax.formats._traffic import STEP, STEPS, CarSides, Log, Traffic, make_traffic
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets

# MetaDrive's types of what is on a map.
_KINDS = {
    "lane": "LANE_SURFACE_STREET",
    "road_line": "ROAD_LINE_BROKEN_SINGLE_YELLOW",
    "road_edge": "ROAD_EDGE_BOUNDARY",
    "stop_sign": "STOP_SIGN",
}
_VEHICLE = "VEHICLE"
_DATASET = "elitelanes"
# The scenario names this version of its format.
_VERSION = "MetaDrive v0.4.3"
# Python 3.4 and later read pickles of this protocol.
_PROTOCOL = 4


def to_scenarionet(
    road_map: RoadMap, name: str, streets: Streets = Streets(), *, seed: int = 0
) -> bytes:
    """Returns a scenario of ScenarioNet as a pickle; the same map gives the same bytes.

    A lane's id is its index: lanes come first, one for each movement, in ascending order of row,
    column, heading and turn. Cars turn back at dead ends. They drive for 9 s at the speed limit
    along random turns, and none touches another. The first one is the car that `ScenarioEnv`
    controls. If it comes back to its own route, the scenario ends before, because MetaDrive finds
    its place on the route by the distance alone.

    MetaDrive reads files whose names begin with ``sd_`` and end with ``.pkl``. Their folder needs
    the files of `index_scenarios`.

    Args:
      road_map: the map. Connections that no neighbour returns, or that leave the grid, are no roads.
      name: the id of the scenario.
      streets: their measures. Signs stand at all-way stops alone.
      seed: the seed of the cars' starts and turns, 0 to 2**32 - 1.

    Raises:
      InputError: for a map without a lane from a tile to another, or a bad seed.
    """
    traffic = make_traffic(road_map, streets, seed)
    steps = _steps_before_return(traffic.logs[0], streets)
    tracks: dict[str, _Track] = {}
    # A car gets the next number when it is kept, so the first one is always car 0, which MetaDrive
    # controls.
    for log in _without_touching(traffic.logs, traffic.sides):
        number = str(len(tracks))
        tracks[number] = _track(number, log, traffic.sides, steps)
    features = _features(traffic)
    metadata: dict[str, Plain] = {
        "id": name,
        "scenario_id": name,
        "dataset": _DATASET,
        "coordinate": "metadrive",
        "metadrive_processed": False,
        "sdc_id": "0",
        "ts": (np.arange(steps) * STEP).astype("<f4"),
        **_summaries(tracks, len(features)),
    }
    scenario: dict[str, Plain] = {
        "id": name,
        "version": _VERSION,
        "length": steps,
        "metadata": metadata,
        "tracks": tracks,
        # The scenarios have no lights.
        "dynamic_map_states": {},
        "map_features": features,
    }
    return _to_pickle(scenario)


@name_wrong_arguments
def index_scenarios(folder: str | Path, files: Iterable[str | Path]) -> dict[str, bytes]:
    """Returns the files that make a folder a database of ScenarioNet, by their names.

    Args:
      folder: the folder of the database.
      files: the files of `to_scenarionet`, in the order of their indices in `ScenarioEnv`, in any
        folders.

    Raises:
      InputError: for no files, files that have the same name, or a file that `to_scenarionet` did
        not write.
      OSError: if a file cannot be read.
    """
    summary: dict[str, Plain] = {}
    mapping: dict[str, Plain] = {}
    folder = check_named("folder", path, folder)
    for file in check_named("files", paths, files):
        if file.name in summary:
            raise InputError("files", "files of different names", f"two for {file.name}")
        summary[file.name] = _read_metadata(file)
        # The index names the folder of each file relative to its own, "" for the same folder.
        place = os.path.relpath(file.parent, folder)
        mapping[file.name] = "" if place == "." else Path(place).as_posix()
    return {"dataset_summary.pkl": _to_pickle(summary), "dataset_mapping.pkl": _to_pickle(mapping)}


def _steps_before_return(log: Log, streets: Streets) -> int:
    """Returns the steps of a car before it is on a part of the road where it was earlier."""
    distances = np.abs(log.position[:, None] - log.position)
    steps = np.arange(STEPS)
    # The lengths of the way from each earlier step to each later one.
    driven = (steps[:, None] - steps) * STEP * streets.speed
    # A car has only just left the last two widths of a lane, so they do not count. A car that turns
    # back is at least the width of a lane from where it came.
    returns = ((distances < streets.lane / 2) & (driven > 2 * streets.lane)).any(axis=1)
    # `argmax` is 0 if the car never returns.
    return int(np.argmax(returns)) or STEPS


def _without_touching(logs: list[Log], sides: CarSides) -> list[Log]:
    """Returns the logs of cars that never touch one before them. Three circles cover a car."""
    third = sides.length / 3
    # The circles are around the thirds of a car, and reach their corners.
    apart = 2 * np.hypot(third / 2, sides.width / 2)
    clear_logs: list[Log] = []
    circles_of_logs: list[NDArray[np.complex128]] = []
    for log in logs:
        ahead = np.exp(1j * log.heading)[:, None]
        # The circles of a log at all steps are complex `[91, 3]`.
        circles = log.position[:, None] + third * np.array([-1, 0, 1]) * ahead
        # Circles of two cars are compared at the same step.
        gaps = [np.abs(circles[:, :, None] - other[:, None]).min() for other in circles_of_logs]
        if min(gaps, default=np.inf) > apart:
            clear_logs.append(log)
            circles_of_logs.append(circles)
    return clear_logs


class _Track(TypedDict):
    """The track of a car: an array of each part of its state, with a row for each step."""

    type: str
    state: dict[str, NDArray]
    metadata: dict[str, Plain]


def _track(number: str, log: Log, sides: CarSides, steps: int) -> _Track:
    """Returns the track of a car in the first steps of its log."""
    state: dict[str, NDArray] = {
        "position": _floats(log.position[:steps], 3),
        "heading": log.heading[:steps].astype("<f4"),
        "velocity": _floats(log.velocity[:steps], 2),
        "valid": np.ones(steps, bool),
    }
    for name, side in sides._asdict().items():
        state[name] = np.full(steps, side, "<f4")
    about: dict[str, Plain] = {
        "type": _VEHICLE,
        "object_id": number,
        "track_length": steps,
        "dataset": _DATASET,
    }
    return {"type": _VEHICLE, "state": state, "metadata": about}


def _features(traffic: Traffic) -> dict[str, Plain]:
    """Returns what is on the map, by ids that are whole numbers."""
    features: dict[str, Plain] = {}
    for index, road in enumerate(traffic.roads):
        feature: dict[str, Plain] = {"type": _KINDS[road.kind]}
        if road.kind == "stop_sign":
            feature["position"] = _floats(road.points, 3)[0]
            feature["lane"] = list(map(str, road.lanelets))
        else:
            feature["polyline"] = _floats(road.points, 3)
        if road.kind == "lane":
            lanelet = traffic.scene.lanelets[index]
            # The polygon goes along the left bound and comes back along the right one.
            left, right = traffic.scene.bounds(lanelet)
            feature["polygon"] = _floats(np.concatenate([left, right[::-1]]), 2)
            feature["entry_lanes"] = list(map(str, lanelet.predecessors))
            feature["exit_lanes"] = list(map(str, lanelet.successors))
            # MetaDrive's neighbours are lanes to change to. Each direction has one lane, so there
            # are none.
            feature |= {"left_neighbor": [], "right_neighbor": []}
            feature["speed_limit_kmh"] = 3.6 * traffic.scene.streets.speed
        features[str(index)] = feature
    return features


def _floats(points: NDArray[np.complex128], dimensions: int) -> NDArray[np.float32]:
    """Returns x, y and, in three dimensions, 0 for z."""
    coordinates = np.stack([points.real, points.imag, 0 * points.real], axis=1)
    return coordinates[:, :dimensions].astype("<f4")


def _summaries(tracks: Mapping[str, _Track], features: int) -> dict[str, Plain]:
    """Returns the numbers that ScenarioNet's filters read.

    They are those of each car, and those of the scenario.
    """
    cars: dict[str, Plain] = {}
    distances: list[float] = []
    for number, track in tracks.items():
        position = track["state"]["position"]
        steps = len(position)
        distance = float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum())
        distances.append(distance)
        cars[number] = {
            "type": _VEHICLE,
            "object_id": number,
            "moving_distance": distance,
            "track_length": steps,
            "valid_length": steps,
            "continuous_valid_length": steps,
        }
    # A car moves if its way is longer than 1 m.
    moving = sum(distance > 1 for distance in distances)
    numbers: dict[str, Plain] = {
        "object_types": [_VEHICLE],
        "num_map_features": features,
        "num_objects": len(cars),
        "num_objects_each_type": {_VEHICLE: len(cars)},
        "num_moving_objects": moving,
        "num_moving_objects_each_type": {_VEHICLE: moving},
        "num_traffic_lights": 0,
        "num_traffic_light_types": [],
        "num_traffic_light_each_step": {},
        "map_height_diff": 0.0,
    }
    return {"object_summary": cars, "number_summary": numbers}


class _Pickler(pickle.Pickler):
    """Writes arrays by public names.

    NumPy's own way names a private module, in which NumPy 1 and 2 differ.
    """

    # `Any` is the type of this method in the library.
    def reducer_override(self, obj: Any) -> Any:
        if not isinstance(obj, np.ndarray):
            return NotImplemented
        # MetaDrive changes positions in place. An array over a bytearray allows this, and one over
        # bytes does not.
        return np.ndarray, (obj.shape, obj.dtype.str, bytearray(obj.tobytes()))


class _Unpickler(pickle.Unpickler):
    """Reads the pickles of `_Pickler` alone, so that other files run no code."""

    def find_class(self, module: str, name: str) -> type:
        # Any other name raises a `KeyError`, and nothing is imported.
        return {"numpy.ndarray": np.ndarray, "builtins.bytearray": bytearray}[f"{module}.{name}"]


def _to_pickle(content: dict[str, Plain]) -> bytes:
    stream = BytesIO()
    _Pickler(stream, _PROTOCOL).dump(content)
    return stream.getvalue()


def _read_metadata(file: Path) -> dict[str, Plain]:
    """Returns the metadata of a scenario as a summary has it, with the times as a list.

    Raises `InputError` for a file that `to_scenarionet` did not write.
    """
    content = file.read_bytes()
    try:
        metadata: dict[str, Untyped] = _Unpickler(BytesIO(content)).load()["metadata"]
        return metadata | {"ts": metadata["ts"].tolist()}
    except Exception:
        # A file that is no pickle raises errors of many kinds.
        raise InputError(file, "a scenario of to_scenarionet", "another file") from None
