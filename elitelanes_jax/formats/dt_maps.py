"""Duckietown's newer maps: a folder with a YAML file for each layer, which the library dt-maps 0.1.0 reads.

Poses are in the layer ``frames``: metres from the south-west corner, and yaw counter-clockwise. At yaw 0 a straight
tile leads from north to south, a curve from south to east, and a 3-way tile has no west side, as in ``get_tile_graph``.
"""

from collections.abc import Mapping
from math import cos, pi, remainder, sin
from pathlib import Path

import numpy as np
import yaml

from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, brief
from elitelanes_jax._util.files import MIB
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats._duckietown_objects import FALSE, TAG_FAMILY, real_of, table_of, whole_of
from elitelanes_jax.formats._yaml_tree import yaml_tree
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_roads, check_tile_size
from elitelanes_jax.formats.objects import OBJECT_KINDS, OTHER, MapObject, base_kind, check_kind
from elitelanes_jax.formats.road_map import RoadMap, as_map, text_of
from elitelanes_jax.formats.tags import TAG_SIZE
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, rotate_codes

LAYERS = ("frames", "tile_maps", "tiles", "traffic_signs", "ground_tags", "citizens", "vehicles", "decorations")
"""The layers of a map, each a file. The library has no type for decorations, and keeps them as they are."""

_MAP = "map_0"
_ROADS = {"straight": NORTH | SOUTH, "curve": SOUTH | EAST, "3way": NORTH | EAST | SOUTH, "4way": 15}
_GROUNDS = ("grass", "floor", "asphalt")
_TILE = {rotate_codes(code, turns): (kind, turns) for kind, code in _ROADS.items() for turns in (3, 2, 1, 0)}
_SIGNS = {
    kind: kind.removeprefix("sign_").lower()
    for kind in OBJECT_KINDS
    if kind.startswith("sign_") and kind not in ("sign_blank", "sign_street_name")
} | {"sign_4_way_intersect": "four_way_intersect", "sign_T_intersect": "t_intersection"}
_KIND_OF_SIGN = {name: kind for kind, name in _SIGNS.items()}


def to_dt_maps(road_map: UserValue, *, tile_size: float = TILE_SIZE) -> dict[str, str]:
    """Returns the texts of a map's layers, by their names in `LAYERS`.

    Args:
      road_map: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      tile_size: in metres, 0.01 to 100.

    Raises:
      InputError: for a bad map or size, or tiles with one connection, which Duckietown lacks; the message names them.
    """
    check_tile_size(tile_size)
    given = as_map(road_map)
    grid = check_roads(given.codes)
    size, rows = float(tile_size), len(grid)
    layers: dict[str, dict[str, Plain]] = {name: {} for name in LAYERS}
    layers["tile_maps"][_MAP] = {"tile_size": {"x": size, "y": size}}
    layers["frames"][_MAP] = _frame(None, 0.0, 0.0, 0.0)
    for (row, i), code in np.ndenumerate(grid):
        j, (kind, turns) = rows - 1 - row, _TILE.get(int(code), ("grass", 0))
        name = f"{_MAP}/tile_{i}_{j}"
        layers["tiles"][name] = {"i": i, "j": j, "type": kind}
        layers["frames"][name] = _frame(_MAP, (i + 0.5) * size, (j + 0.5) * size, turns * pi / 2)
    for index, thing in enumerate(given.objects or ()):
        name = f"{_MAP}/{thing.kind.removeprefix(OTHER)}_{index}"
        if name in layers["tiles"]:  # of the kind other:tile_0
            name = f"{_MAP}/other_{name.removeprefix(f'{_MAP}/')}"
        layer, values = _entry(thing)
        layers[layer][name] = values | {"height": thing.height} | ({} if thing.static else {"static": False})
        layers["frames"][name] = _frame(_MAP, thing.x * size, (rows - thing.y) * size, thing.angle)
    return {
        name: yaml.safe_dump({"version": "1.0", name: values}, sort_keys=False, default_flow_style=None, width=200)
        for name, values in layers.items()
    }


def read_dt_maps(folder: str | Path) -> RoadMap:
    """Reads a folder of layers: its tiles and objects.

    All frames have to be relative to the map's, or to frames that are. Watchtowers and layers of other names are not
    read. An object has its usual height, unless the file says "height".

    Raises:
      InputError: if a file cannot be read, or anything in it is not as it should be; the message names the file.
    """
    folder_path = check_named("folder", path, folder)
    layers = {name: _layer(folder_path, name) for name in LAYERS}
    maps = list(layers["tile_maps"])
    if len(maps) != 1:
        raise InputError(f"{folder_path / 'tile_maps.yaml'}: expected one map, got {len(maps)}")
    frames = {name: value for name, value in layers["frames"].items() if name != maps[0]}
    try:
        size = real_of(table_of(layers["tile_maps"][maps[0]], "tile_size"), "x")
        check_tile_size(size)
        cells = {name: (whole_of(one, "i"), whole_of(one, "j")) for name, one in layers["tiles"].items()}
        sides = [max((cell[axis] for cell in cells.values()), default=-1) + 1 for axis in (0, 1)]
        if min(sides) < 1 or max(sides) > 1024 or min(min(cell) for cell in cells.values()) < 0:
            raise InputError(f"tiles: expected sides of 1 to 1024 tiles, from i = 0 and j = 0 on, got {sides}")
        if len(set(cells.values())) < len(cells):
            raise InputError("tiles: expected one tile in each cell, got several")
        codes = np.zeros(sides[::-1], np.int8)
        for name, (i, j) in cells.items():
            codes[sides[1] - 1 - j, i] = _code(layers["tiles"][name].get("type"), _pose(frames, name, maps[0])[2])
        objects = [
            _object(layer, name, layers[layer][name], _pose(frames, name, maps[0]), sides[1], size)
            for name in frames
            for layer in LAYERS[3:]
            if name in layers[layer]
        ]
        return RoadMap(codes, objects=tuple(objects) or None)
    except InputError as error:
        raise InputError(f"{folder_path}: {error}") from None


def _layer(folder: Path, name: str) -> dict[str, dict[str, Plain]]:
    file = folder / f"{name}.yaml"
    if name in LAYERS[3:] and not file.exists():
        return {}
    values = check_named(str(file), yaml_tree, text_of(file, 32 * MIB, "YAML"))
    found = values.get(name) if isinstance(values, dict) else None
    found = {} if found in ("", "~", "null") else found
    if not isinstance(found, dict) or not all(isinstance(one, dict) for one in found.values()):
        raise InputError(f"{file}: expected a table of tables under {name!r}, got {brief(found, 40)}")
    return found


def _frame(relative_to: str | None, x: float, y: float, yaw: float) -> dict[str, Plain]:
    yaw = remainder(yaw, 2 * pi)
    pose = {"x": round(x, 6), "y": round(y, 6), "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": round(yaw, 6)}
    return {"relative_to": relative_to, "pose": pose}


def _pose(frames: Mapping[str, dict[str, Plain]], name: str, root: str) -> tuple[float, float, float]:
    """Returns x, y and yaw of a frame in the frame of the map."""
    x = y = yaw = 0.0
    frame: Plain = name
    for _ in range(len(frames) + 1):
        if frame == root:
            return x, y, yaw
        if not isinstance(frame, str) or frame not in frames:
            break
        pose = frames[frame].get("pose")
        if not isinstance(pose, dict):
            raise InputError(f"frames: {frame}: expected a pose, got {brief(pose, 40)}")
        turn = real_of(pose, "yaw")
        x, y = cos(turn) * x - sin(turn) * y + real_of(pose, "x"), sin(turn) * x + cos(turn) * y + real_of(pose, "y")
        yaw = remainder(yaw + turn, 2 * pi)  # the sum of several may be infinite
        frame = frames[frame].get("relative_to")
    raise InputError(f"frames: expected frames relative to {root}, got one relative to {brief(frame, 40)}")


def _code(kind: Plain, yaw: float) -> int:
    if kind in _GROUNDS:
        return 0
    turns = round(yaw / (pi / 2))
    if not isinstance(kind, str) or kind not in _ROADS or abs(yaw - turns * pi / 2) > 0.01:
        kinds, got = ", ".join((*_ROADS, *_GROUNDS)), brief(kind, 40)
        raise InputError(f"tiles: expected {kinds}, at a right angle, got {got} with yaw {yaw:g}")
    return int(rotate_codes(_ROADS[kind], turns % 4))


def _entry(thing: MapObject) -> tuple[str, dict[str, Plain]]:
    """Returns the layer of an object, and what that says of its kind."""
    if thing.kind == "duckie":
        return "citizens", {"color": "yellow"}
    if thing.kind == "duckiebot":
        return "vehicles", {"configuration": "DB21M", "id": None, "color": "blue"}
    tag: dict[str, Plain] = {} if thing.tag is None else {"id": thing.tag, "family": TAG_FAMILY}
    if thing.kind == "floor_tag":
        return "ground_tags", {"size": TAG_SIZE} | tag
    kind = _SIGNS.get(thing.kind)
    return "traffic_signs" if kind else "decorations", {"type": kind or thing.kind.removeprefix(OTHER)} | tag


def _object(
    layer: str, name: str, values: dict[str, Plain], pose: tuple[float, float, float], rows: int, size: float
) -> MapObject:
    usual = {"citizens": "duckie", "vehicles": "duckiebot", "ground_tags": "floor_tag"}
    given = values.get("type")
    given = given if isinstance(given, str) else brief(given, 40)
    kind = usual.get(layer) or (_KIND_OF_SIGN.get(given) if layer == "traffic_signs" else given)
    if kind not in OBJECT_KINDS:
        kind = check_named(f"{layer}: {name}", check_kind, OTHER + given)
    height = real_of(values, "height", OBJECT_KINDS[base_kind(kind)].height)
    tag = whole_of(values, "id") if "id" in values and layer not in ("citizens", "vehicles") else None
    x, y, static = pose[0] / size, rows - pose[1] / size, values.get("static") not in FALSE
    return MapObject(kind, x, y, remainder(pose[2], 2 * pi), height, tag, static)
