"""Duckietown's newer maps: a folder with a YAML file for each layer, which the library dt-maps 0.1.0 reads.

Poses are in the layer ``frames``: metres from the south-west corner, and yaw counter-clockwise. At yaw 0 a straight
tile leads from north to south, a curve from south to east, and a 3-way tile has no west side, as in ``get_tile_graph``.
"""

from math import pi, remainder

import numpy as np
import yaml

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats._duckietown_objects import TAG_FAMILY
from elitelanes_jax.formats.dt_layers import LAYERS, ROADS, SIGNS, TURNED_AS_LIBRARY
from elitelanes_jax.formats.duckietown import TILE_SIZE, check_roads, check_tile_size
from elitelanes_jax.formats.objects import OTHER, MapObject
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.tags import TAG_SIZE
from elitelanes_jax.network.codes import rotate_codes

_MAP = "map_0"
_TILE = {rotate_codes(code, turns): (kind, turns) for kind, code in ROADS.items() for turns in (3, 2, 1, 0)}


@name_wrong_arguments
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
    texts: dict[str, str] = {}
    for name, values in layers.items():
        content = {"version": "1.0", name: values}
        texts[name] = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=200)
    return texts | {"tiles": TURNED_AS_LIBRARY + texts["tiles"]}


def _frame(relative_to: str | None, x: float, y: float, yaw: float) -> dict[str, Plain]:
    yaw = remainder(yaw, 2 * pi)
    pose = {"x": round(x, 6), "y": round(y, 6), "z": 0.0, "roll": 0.0, "pitch": 0.0, "yaw": round(yaw, 6)}
    return {"relative_to": relative_to, "pose": pose}


def _entry(thing: MapObject) -> tuple[str, dict[str, Plain]]:
    """Returns the layer of an object, and what that says of its kind."""
    if thing.kind == "duckie":
        return "citizens", {"color": "yellow"}
    if thing.kind == "duckiebot":
        return "vehicles", {"configuration": "DB21M", "id": None, "color": "blue"}
    tag: dict[str, Plain] = {} if thing.tag is None else {"id": thing.tag, "family": TAG_FAMILY}
    if thing.kind == "floor_tag":
        return "ground_tags", {"size": TAG_SIZE} | tag
    kind = SIGNS.get(thing.kind)
    return "traffic_signs" if kind else "decorations", {"type": kind or thing.kind.removeprefix(OTHER)} | tag
