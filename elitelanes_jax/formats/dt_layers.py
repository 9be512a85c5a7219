"""Reads Duckietown's newer maps: a folder with a YAML file for each layer.

Layers are, for example, tiles, frames and traffic signs.

The library dt-maps, the Duckiematrix and map editors write these folders in different ways. The
cell of a tile is in its ``i`` and ``j``, in the position of its frame, or in its name. Positions
are in metres or in tiles, at the middle of a cell or at its south-west corner. A frame is relative
to the frame that it names, or else to the one that its name continues: ``map_0/vehicle_0`` to
``map_0``.
"""

import re
from collections.abc import Mapping
from itertools import chain
from math import cos, floor, isfinite, pi, radians, remainder, sin
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.errors import InputError, brief, shorten
from elitelanes_jax._util.files import MIB, read_input
from elitelanes_jax._util.types import Plain
from elitelanes_jax.formats._yaml_tree import yaml_tree
from elitelanes_jax.formats._yaml_values import FALSE, NOTHING, real_of, table_of, whole_of
from elitelanes_jax.formats.duckietown import GROUNDS, TILE_SIZE, check_tile_size
from elitelanes_jax.formats.objects import (
    OBJECT_KINDS,
    OTHER,
    MapObject,
    base_kind,
    check_kind,
    check_object,
)
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.network.codes import CONNECTIONS, EAST, NORTH, SOUTH, WEST, rotate_codes
from elitelanes_jax.network.links import Cell

OBJECT_LAYERS = ("traffic_signs", "ground_tags", "citizens", "vehicles", "decorations")
"""The layers of objects. The library has no type for decorations, and keeps them as they are."""

LAYERS = ("frames", "tile_maps", "tiles", *OBJECT_LAYERS)
"""The layers of a map, each a file."""

ROADS = {"straight": NORTH | SOUTH, "curve": SOUTH | EAST, "3way": NORTH | EAST | SOUTH, "4way": 15}
"""The code of each kind of tile with a road at yaw 0, as the library's graph of lanes has it."""

_SIGN_KINDS = [kind for kind in OBJECT_KINDS if kind.startswith("sign_")]
_SHORT_NAMES = {kind: kind.removeprefix("sign_").lower() for kind in _SIGN_KINDS}

# The kinds of signs that the library has no name for.
_NAMELESS = ("sign_blank", "sign_street_name")

SIGNS = {kind: name for kind, name in _SHORT_NAMES.items() if kind not in _NAMELESS}
"""The library's name of each kind of sign."""

SIGNS["sign_4_way_intersect"] = "four_way_intersect"
SIGNS["sign_T_intersect"] = "t_intersection"

TURNED_AS_LIBRARY = "# Curves and 3-way tiles are turned as in the library dt-maps 0.1.0.\n"
TURNED_AS_MATRIX = "# Curves and 3-way tiles are turned as in the Duckiematrix.\n"
"""The first lines of tiles that we write, which say how they are turned."""

ROADS_OF_MATRIX = ROADS | {"curve": NORTH | WEST, "3way": NORTH | EAST | WEST}
"""The same codes in the maps of the Duckiematrix and of map editors."""

# The ways of turning tiles: the first line of tiles that we write, and the codes of the kinds.
_WAYS = {TURNED_AS_LIBRARY: ROADS, TURNED_AS_MATRIX: ROADS_OF_MATRIX}

# The kind of each sign by the library's name, or by the name of our kind.
_KIND_OF_SIGN = {name: kind for kind, name in SIGNS.items()}
_KIND_OF_SIGN |= {name: kind for kind, name in _SHORT_NAMES.items()}
_KIND_OF_LAYER = {"citizens": "duckie", "vehicles": "duckiebot", "ground_tags": "floor_tag"}

_METRES = ("m", "metres", "meters")
_CELL_IN_NAME = re.compile(r"_(-?\d{1,4})_(-?\d{1,4})$")
# How far a position may be from a cell, in tiles, or a yaw from a right angle, in radians.
_NEAR = 0.05
_MOST_BYTES = 32 * MIB
# The most steps from a frame to the map, and the most characters of a name. A map needs a few steps
# and 30 characters. Without limits, a file of 1 MB would take 20 minutes.
_MOST_STEPS, _LONGEST_NAME = 64, 1024

_Table = dict[str, Plain]


class _Pose(NamedTuple):
    """Metres east and north of an origin, and radians counter-clockwise."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def then(self, child: "_Pose") -> "_Pose":
        """Returns the pose of a child, given in this frame, in the parent of this frame."""
        x = self.x + cos(self.yaw) * child.x - sin(self.yaw) * child.y
        y = self.y + sin(self.yaw) * child.x + cos(self.yaw) * child.y
        # The angle stays in a full turn, because the sum of several yaws may be infinite.
        yaw = remainder(self.yaw + child.yaw, 2 * pi)
        return _Pose(x, y, yaw)

    def seen_from(self, origin: "_Pose") -> "_Pose":
        """Returns this pose in the frame of another one."""
        back = _Pose(yaw=-origin.yaw)
        return back.then(_Pose(self.x - origin.x, self.y - origin.y, self.yaw))


def is_layers(folder: Path) -> bool:
    """Returns whether a path is a folder of layers."""
    return (folder / "tiles.yaml").is_file()


def read_layers(folder: Path) -> tuple[Int8[np.ndarray, "H W"], tuple[MapObject, ...] | None]:
    """Reads a folder of layers: its tiles and objects, None without objects.

    Watchtowers and layers of other names are not read. An object has its usual height, unless the
    file says "height". The first line of the tiles that we write says how curves and 3-way tiles
    are turned. In other maps, all are turned so or all as the Duckiematrix has them: the way that
    leaves fewer connections without a neighbour that returns them. If one way leaves none, the
    other leaves some, because the first road tile is a curve that it opens to the north.

    Raises:
      InputError: if a file cannot be read, or anything in it is not as it should be; the message
        names the file, and the tile, frame or object.
    """
    layers = {name: _read_layer(folder, name) for name in LAYERS}
    map_name, size = _tile_map(folder, layers)
    frames = _Frames(folder / "frames.yaml", layers["frames"], map_name, size)
    tiles = _read_tiles(folder / "tiles.yaml", layers["tiles"], frames)
    corner, readings = check_named(str(folder / "tiles.yaml"), _place_tiles, tiles)
    codes = _as_turned(folder, readings)
    # An object may be relative to the frame of a tile. That frame is put into the middle of its
    # tile, even if the file has the corner.
    frames.place_tiles({name: tile.cell for name, tile in tiles.items()})
    objects = _read_objects(folder, layers, frames, corner, codes.shape)
    if not objects:
        return codes, None
    return codes, tuple(objects)


def _read_tiles(file: Path, layer: Mapping[str, _Table], frames: "_Frames") -> dict[str, "_Tile"]:
    """Returns the tiles of a layer by their names."""
    tiles: dict[str, _Tile] = {}
    for name, values in layer.items():
        # A tile needs no frame if its cell is in its values or in its name.
        pose = None
        clockwise = False
        if name in frames:
            pose = frames.pose(name)
            clockwise = frames.is_in_degrees(name)
        label = f"{file}: {name}"
        tiles[name] = check_named(label, _read_tile, name, values, pose, clockwise, frames.size)
    return tiles


def _read_objects(
    folder: Path,
    layers: Mapping[str, Mapping[str, _Table]],
    frames: "_Frames",
    corner: Cell,
    shape: tuple[int, ...],
) -> list[MapObject]:
    """Returns the objects of all layers, in the order of the frames.

    `corner` is the cell of the map's south-west corner. Objects of several layers may share a
    frame.
    """
    west, south = corner
    height, width = shape
    objects_by_frame: dict[str, list[MapObject]] = {name: [] for name in layers["frames"]}
    for layer in OBJECT_LAYERS:
        for name, values in layers[layer].items():
            label = f"{folder / layer}.yaml: {name}"
            if name not in frames:
                raise InputError(label, "a frame of this name in frames.yaml", "none")
            pose = frames.pose(name)
            # The position of a map object is relative to the north-west corner, with y to the
            # south.
            x = pose.x / frames.size - west
            y = height + south - pose.y / frames.size
            map_object = check_named(label, _read_object, layer, values, x, y, pose.yaw)
            map_object = check_named(label, check_object, map_object, height, width)
            objects_by_frame[name].append(map_object)
    # Objects of all layers come in the order of the frames, which is the order in which we write
    # them.
    return list(chain.from_iterable(objects_by_frame.values()))


def _read_layer(folder: Path, name: str) -> dict[str, _Table]:
    """Returns the tables of a layer by their names; none if an optional file does not exist."""
    file = folder / f"{name}.yaml"
    if name not in ("frames", "tiles") and not file.exists():
        return {}
    values = check_named(str(file), yaml_tree, read_input(file, _MOST_BYTES, "YAML"))
    # A layer without entries is written in several ways.
    layer = None
    if isinstance(values, dict) and name in values:
        layer = values[name]
        if layer in NOTHING or layer == []:
            layer = {}
    if not isinstance(layer, dict):
        expected = f"a table of tables under {name!r}"
        raise InputError(file, expected, brief(layer, 40))
    tables: dict[str, _Table] = {}
    for key, value in layer.items():
        if len(key) > _LONGEST_NAME:
            expected = f"names of at most {_LONGEST_NAME:,} characters"
            raise InputError(file, expected, shorten(key, 40))
        if isinstance(value, str) and value in NOTHING:
            tables[key] = {}
        elif isinstance(value, dict):
            tables[key] = value
        else:
            raise InputError(f"{file}: {key}", "a table", brief(value, 40))
    return tables


def _tile_map(folder: Path, layers: Mapping[str, Mapping[str, _Table]]) -> tuple[str, float]:
    """Returns the name of the map, and the side of its tiles in metres."""
    file = folder / "tile_maps.yaml"
    if not layers["tiles"]:
        raise InputError(folder / "tiles.yaml", "tiles", "none")
    names = list(layers["tile_maps"])
    # Without a layer of tile maps, the names of the tiles begin with the name of the map.
    if not names:
        names = sorted({name.partition("/")[0] for name in layers["tiles"]})
    if len(names) != 1:
        raise InputError(file, "one map", len(names))
    map_name = names[0]
    values = layers["tile_maps"].get(map_name, {})
    if "tile_size" not in values:
        return map_name, TILE_SIZE
    sides = values["tile_size"]
    # A single number is the side of a square.
    if not isinstance(sides, dict):
        sides = {"x": sides}
    label = f"{file}: {map_name}: tile_size"
    metres = check_named(label, real_of, sides, "x")
    check_named(f"{file}: {map_name}", check_tile_size, metres)
    if check_named(label, real_of, sides, "y", metres) != metres:
        got = f"x {metres:g} and y {brief(sides['y'], 40)}"
        raise InputError(label, "squares", got)
    return map_name, metres


class _Frames:
    """The frames of a map, and where they are in it."""

    def __init__(self, file: Path, frames: Mapping[str, _Table], root: str, size: float) -> None:
        self.size = size
        self._file, self._frames, self._root = file, frames, root
        self._tiles: dict[str, _Pose] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._frames

    def pose(self, name: str) -> _Pose:
        """Returns the pose of a frame in the frame of the map."""
        pose, top = self._climb(name)
        if top == self._root:
            return pose
        # The frame and its parents lead to the world instead of the map. The map itself may have a
        # pose in the world.
        origin = _Pose()
        if self._root in self:
            origin, _ = self._climb(self._root)
        return pose.seen_from(origin)

    def is_in_degrees(self, name: str) -> bool:
        """Returns whether the yaw of a frame is in degrees."""
        return _is_in_degrees(real_of(table_of(self._frames[name], "pose"), "yaw", 0.0))

    def place_tiles(self, cells: Mapping[str, Cell]) -> None:
        """Puts the frames of tiles in the middles of their cells, (i, j).

        This is necessary because objects may be relative to tiles.
        """
        for name, (i, j) in cells.items():
            yaw = self.pose(name).yaw if name in self else 0.0
            self._tiles[name] = _Pose((i + 0.5) * self.size, (j + 0.5) * self.size, yaw)

    def _climb(self, name: str) -> tuple[_Pose, str | None]:
        """Returns the pose of a frame, and the name of the map that it is in.

        If the frame is not in the map, the pose is in the world, and the name is None.
        """
        pose, frame = _Pose(), name
        # Each step leads to another frame, unless the frames form a circle.
        for _ in range(_MOST_STEPS):
            # The place of a tile is known from its cell, so its frame need not be followed to the
            # map.
            if frame in self._tiles:
                return self._tiles[frame].then(pose), self._root
            label = f"{self._file}: {frame}"
            relative_pose = check_named(label, _relative_pose, self._frames[frame], self.size)
            pose = relative_pose.then(pose)
            parent = self._frames[frame].get("relative_to")
            if parent in NOTHING:
                parent = self._above(frame)
            if parent is None or parent == self._root:
                return pose, parent
            if not isinstance(parent, str) or parent not in self._frames:
                got = brief(parent, 40)
                raise InputError(f"{label}: relative_to", "the name of a frame", got)
            frame = parent
        expected = f"frames that lead to {self._root} in at most {_MOST_STEPS} steps"
        raise InputError(f"{self._file}: {name}: relative_to", expected, "a longer way or a circle")

    def _above(self, name: str) -> str | None:
        """Returns the frame or the map that a name continues.

        Returns None for a name that continues no other name.
        """
        while "/" in name:
            name = name.rpartition("/")[0]
            if name == self._root or name in self._frames:
                return name
        return None


def _relative_pose(frame: _Table, size: float) -> _Pose:
    """Returns the pose of a frame, relative to its parent frame."""
    unit = frame.get("unit")
    if unit == "tiles":
        scale = size
    elif unit in NOTHING or unit in _METRES:
        scale = 1.0
    else:
        raise InputError("unit", "metres or tiles", brief(unit, 40))
    pose = table_of(frame, "pose")
    yaw = real_of(pose, "yaw", 0.0)
    if _is_in_degrees(yaw):
        yaw = radians(yaw)
    x = real_of(pose, "x", 0.0) * scale
    y = real_of(pose, "y", 0.0) * scale
    return _Pose(x, y, yaw)


def _is_in_degrees(yaw: float) -> bool:
    """Returns whether a yaw is a right angle in degrees, as a map editor writes it."""
    return yaw != 0 and yaw % 90 == 0


class _Tile(NamedTuple):
    """A tile: its cell, and its code by each way of `_WAYS`.

    The cell is columns from the west and rows from the south.
    """

    cell: Cell
    codes: tuple[int, ...]


def _read_tile(
    name: str, values: _Table, pose: _Pose | None, clockwise: bool, size: float
) -> _Tile:
    """Returns a tile of the layer.

    `pose` is its frame's, None without a frame. The editor that writes degrees turns tiles
    `clockwise`.
    """
    cell = _cell(name, values, pose, size)
    kind = values.get("type")
    if kind in GROUNDS:
        return _Tile(cell, (0, 0))
    if not isinstance(kind, str) or kind not in ROADS:
        kinds = ", ".join([*ROADS, *GROUNDS])
        raise InputError("type", f"one of {kinds}", brief(kind, 40))
    # A 4-way tile looks the same in all rotations, so it needs no yaw.
    if kind == "4way":
        return _Tile(cell, (15, 15))
    if pose is None:
        expected = f"a frame of this name in frames.yaml for the yaw of a {kind}"
        raise InputError("", expected, "none")
    turns = round(pose.yaw / (pi / 2))
    if abs(pose.yaw - turns * pi / 2) > _NEAR:
        raise InputError("", "a yaw at a right angle", f"{kind!r} with yaw {pose.yaw:g}")
    if clockwise:
        turns = -turns
    # Which way the map uses is known only after all its tiles were read.
    return _Tile(cell, tuple(rotate_codes(roads[kind], turns) for roads in _WAYS.values()))


def _cell(name: str, values: _Table, pose: _Pose | None, size: float) -> Cell:
    """Returns the cell of a tile: of its indices, its position or its name."""
    # Indices come first, because positions may be at the middle or at the corner of a cell.
    if "i" in values and "j" in values:
        return whole_of(values, "i"), whole_of(values, "j")
    if pose is not None:
        return _index(pose.x, size), _index(pose.y, size)
    indices = _CELL_IN_NAME.search(name)
    if indices is None:
        raise InputError(
            "", "i and j, a frame of this name in frames.yaml, or a name such as tile_0_1", "none"
        )
    return int(indices[1]), int(indices[2])


def _index(position: float, size: float) -> int:
    """Returns the index of a cell, of a position at its middle or at its south-west corner."""
    tiles = position / size
    # The quotient of a large position and a small side may be infinite.
    if isfinite(tiles):
        # A quarter of a tile is added, because rounding errors may put a corner just below its
        # index.
        index = floor(tiles + 0.25)
        is_corner = abs(tiles - index) <= _NEAR
        is_middle = abs(tiles - index - 0.5) <= _NEAR
        if is_corner or is_middle:
            return index
    raise InputError("", f"the middle or the corner of a cell of {size:g} m", f"{position:g} m")


def _place_tiles(tiles: Mapping[str, _Tile]) -> tuple[Cell, Int8[np.ndarray, "2 H W"]]:
    """Returns the cell of the map's south-west corner, and the map's codes by each of `_WAYS`."""
    columns = [tile.cell[0] for tile in tiles.values()]
    rows = [tile.cell[1] for tile in tiles.values()]
    # The map begins at the cell (0, 0), or farther west or south if there are tiles.
    west = min(0, min(columns))
    east = max(columns)
    south = min(0, min(rows))
    north = max(rows)
    height = north - south + 1
    width = east - west + 1
    if min(east, north) < 0 or max(height, width) > 1024:
        expected = "sides of 1 to 1024 tiles, from i = 0 and j = 0 on"
        got = shorten(f"{width} x {height}")
        raise InputError("", expected, got)
    # Cells without a tile stay empty.
    name_by_cell: dict[Cell, str] = {}
    readings = np.zeros((len(_WAYS), height, width), np.int8)
    for name, tile in tiles.items():
        first_name = name_by_cell.setdefault(tile.cell, name)
        if first_name != name:
            got = f"{first_name} in the same one"
            raise InputError(name, "one tile in each cell", got)
        column, row = tile.cell
        readings[:, north - row, column - west] = tile.codes
    return (west, south), readings


def _as_turned(folder: Path, readings: Int8[np.ndarray, "2 H W"]) -> Int8[np.ndarray, "H W"]:
    """Returns the reading that our first line names.

    Without this line, returns the reading with fewer loose ends.
    """
    # The line is a comment, so `yaml_tree` does not return it.
    text = read_input(folder / "tiles.yaml", _MOST_BYTES, "YAML")
    for first_line, codes in zip(_WAYS, readings, strict=True):
        # Git and editors may have changed the ends of lines.
        if text.startswith(first_line.rstrip()):
            return codes
    # Of two readings with as many loose ends, `min` returns the first one, the library's.
    return min(readings, key=_count_unreturned)


def _count_unreturned(codes: Int8[np.ndarray, "H W"]) -> int:
    """Returns the number of connections that no neighbour returns."""
    # `linked_codes` removes the connections that no neighbour returns.
    return int((CONNECTIONS[codes] - CONNECTIONS[linked_codes(codes)]).sum())


def _read_object(layer: str, values: _Table, x: float, y: float, angle: float) -> MapObject:
    """Returns an object of a layer."""
    kind = _kind_of(layer, values)
    height = real_of(values, "height", OBJECT_KINDS[base_kind(kind)].height)
    tag = None
    # In these layers an id is that of a robot, not of a tag.
    if layer not in ("citizens", "vehicles") and values.get("id") not in NOTHING:
        tag = whole_of(values, "id")
    return MapObject(kind, x, y, angle, height, tag, values.get("static") not in FALSE)


def _kind_of(layer: str, values: _Table) -> str:
    """Returns the kind of an object of a layer, by its type if the layer has several kinds."""
    if layer in _KIND_OF_LAYER:
        return _KIND_OF_LAYER[layer]
    text = values.get("type")
    if not isinstance(text, str) or text in NOTHING:
        raise InputError("type", "a kind of object", brief(text, 40))
    if layer == "traffic_signs":
        # Maps have several forms of one name: "stop", "sign_stop" and "T-intersection".
        kind = _KIND_OF_SIGN.get(text.lower().replace("-", "_").removeprefix("sign_"), text)
    else:
        kind = text
    if kind in OBJECT_KINDS:
        return kind
    return check_kind(OTHER + kind)
