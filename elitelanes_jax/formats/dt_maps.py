"""Duckietown's newer maps: a folder with a YAML file for each layer.

Duckietown's library and its simulator read them.

Both have poses in the layer ``frames``, and yaw counter-clockwise. At yaw 0 a straight tile leads
from north to south.

The library dt-maps 0.1.0 has the middle of a tile, in metres from the south-west corner of the map.
At yaw 0 a curve leads from south to east, and a 3-way tile has no west side, as in its
``get_tile_graph``.

The Duckiematrix has the south-west corner of a tile, in tiles. At yaw 0 a curve leads from north to
west, and a 3-way tile has no south side, as in its map loop_0
(github.com/duckietown/duckiematrix-examples, August 2025).
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import pi, remainder

import numpy as np
import yaml

from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats.dt_layers import (
    LAYERS,
    ROADS,
    ROADS_OF_MATRIX,
    SIGNS,
    TURNED_AS_LIBRARY,
    TURNED_AS_MATRIX,
)
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_roads, check_tile_size
from elitelanes_jax.formats.objects import OBJECT_KINDS, OTHER, MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.tags import TAG_FAMILY, TAG_SIZE
from elitelanes_jax.lanes.curves import lane_curves
from elitelanes_jax.lanes.movements import lane_graph
from elitelanes_jax.network.codes import list_turned

_MAP = "map_0"

_Table = dict[str, Plain]


def to_dt_maps(road_map: RoadMap, *, tile_size: float = TILE_SIZE) -> dict[str, str]:
    """Returns the texts of a map's layers for the library dt-maps 0.1.0.

    The keys are the names of the layers, such as ``tiles``. The library reads each from a file
    ``NAME.yaml``.

    Args:
      road_map: the map.
      tile_size: the side of a tile in metres, 0.01 to 100.

    Raises:
      InputError: for a bad size, or tiles with one connection, which Duckietown lacks; the message
        names them.
    """
    check_tile_size(tile_size)
    check_roads(road_map.codes)
    size = float(tile_size)

    def frame_of_tile(i: int, j: int, yaw: float) -> _Table:
        # The library has the middle of a tile, in metres.
        return {"relative_to": _MAP, "pose": _pose((i + 0.5) * size, (j + 0.5) * size, yaw)}

    layers = _write_layers(road_map, size, ROADS, frame_of_tile, robot="duckiebot")
    return _texts(layers, "1.0", TURNED_AS_LIBRARY)


def to_duckiematrix(road_map: RoadMap, *, tile_size: float = TILE_SIZE) -> dict[str, str]:
    """Returns the texts of a map's layers for the Duckiematrix, by the names of `to_dt_maps`.

    Robots are ``map_0/vehicle_0``, ``map_0/vehicle_1`` and so on. Duckietown's Gym environment
    drives the first one. A map without robots gets one, in the middle of its first lane.
    `MapInterpreter` of the package duckietown-sdk 0.2.0 reads the layers of tiles.

    Args:
      road_map: the map.
      tile_size: the side of a tile in metres, 0.01 to 100.

    Raises:
      InputError: for a bad size, a map without a lane, or tiles with one connection, which
        Duckietown lacks; the message names them.
    """
    check_tile_size(tile_size)
    check_roads(road_map.codes)
    robots = [thing for thing in road_map.objects or () if thing.kind == "duckiebot"]
    others = [thing for thing in road_map.objects or () if thing.kind != "duckiebot"]
    # The Gym environment drives the first robot, so a map needs one.
    if not robots:
        robots = [_robot_on_first_lane(road_map)]
    # Robots come first, because the index of an object is the number in its name, and the first
    # robot is `vehicle_0`.
    road_map = replace(road_map, objects=(*robots, *others))

    def frame_of_tile(i: int, j: int, yaw: float) -> _Table:
        # The Duckiematrix has the south-west corner of a tile, in tiles.
        return {"relative_to": None, "unit": "tiles", "pose": _pose(float(i), float(j), yaw)}

    layers = _write_layers(
        road_map, float(tile_size), ROADS_OF_MATRIX, frame_of_tile, robot="vehicle"
    )
    return _texts(layers, 1.0, TURNED_AS_MATRIX)


def _robot_on_first_lane(road_map: RoadMap) -> MapObject:
    """Returns a robot in the middle of the map's first lane."""
    lane = lane_curves(lane_graph(road_map.codes).list_movements()[0])[0]
    x, y = lane.points(np.array([0.5]))[0].tolist()
    # Headings are clockwise from north, and angles counter-clockwise from east. In the middle of an
    # arc half of its turn is done.
    angle = pi / 2 - lane.heading * pi / 2 + lane.curvature * lane.length / 2
    return MapObject("duckiebot", x, y, angle, OBJECT_KINDS["duckiebot"].height)


def _write_layers(
    road_map: RoadMap,
    size: float,
    roads: Mapping[str, int],
    frame_of_tile: Callable[[int, int, float], _Table],
    robot: str,
) -> dict[str, _Table]:
    """Returns the tables of a map's layers.

    Args:
      road_map: the map.
      size: the side of a tile in metres.
      roads: the code of each kind of tile with a road at yaw 0.
      frame_of_tile: the frame of a tile from its column i, its row j from the south, and its yaw.
      robot: what the frames of robots are named after.
    """
    kinds = list_turned(roads)
    rows = len(road_map.codes)
    layers: dict[str, _Table] = {name: {} for name in LAYERS}
    layers["tile_maps"][_MAP] = {"tile_size": {"x": size, "y": size}}
    layers["frames"][_MAP] = {"relative_to": None, "pose": _pose(0.0, 0.0, 0.0)}
    for (row, i), code in np.ndenumerate(road_map.codes):
        # Rows of these maps are numbered from the south.
        j = rows - 1 - row
        kind, turns = kinds.get(int(code), ("grass", 0))
        name = f"{_MAP}/tile_{i}_{j}"
        layers["tiles"][name] = {"i": i, "j": j, "type": kind}
        layers["frames"][name] = frame_of_tile(i, j, turns * pi / 2)
    for index, thing in enumerate(road_map.objects or ()):
        stem = robot if thing.kind == "duckiebot" else thing.kind.removeprefix(OTHER)
        name = f"{_MAP}/{stem}_{index}"
        if name in layers["tiles"]:
            # An object of the kind "other:tile_0" has the name of a tile.
            name = f"{_MAP}/other_{name.removeprefix(f'{_MAP}/')}"
        layer, values = _entry(thing)
        values["height"] = thing.height
        if not thing.static:
            values["static"] = False
        layers[layer][name] = values
        pose = _pose(thing.x * size, (rows - thing.y) * size, thing.angle)
        layers["frames"][name] = {"relative_to": _MAP, "pose": pose}
    return layers


def _texts(layers: Mapping[str, _Table], version: str | float, turned: str) -> dict[str, str]:
    """Returns layers as YAML. `turned` is the comment which says how tiles are turned."""
    texts: dict[str, str] = {}
    for name, values in layers.items():
        content = {"version": version, name: values}
        texts[name] = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200)
    # A comment is no part of the values, so it is put before the YAML text.
    return texts | {"tiles": turned + texts["tiles"]}


def _pose(x: float, y: float, yaw: float) -> _Table:
    yaw = remainder(yaw, 2 * pi)
    return {
        "x": round(x, 6),
        "y": round(y, 6),
        "z": 0.0,
        "roll": 0.0,
        "pitch": 0.0,
        "yaw": round(yaw, 6),
    }


def _entry(thing: MapObject) -> tuple[str, _Table]:
    """Returns the layer of an object, and the fields there that its kind determines."""
    if thing.kind == "duckie":
        return "citizens", {"color": "yellow"}
    if thing.kind == "duckiebot":
        return "vehicles", {"configuration": "DB21M", "id": None, "color": "blue"}
    tag: _Table = {} if thing.tag is None else {"id": thing.tag, "family": TAG_FAMILY}
    if thing.kind == "floor_tag":
        return "ground_tags", {"size": TAG_SIZE} | tag
    kind = SIGNS.get(thing.kind)
    layer = "traffic_signs" if kind else "decorations"
    return layer, {"type": kind or thing.kind.removeprefix(OTHER)} | tag
