"""Duckietown's map files, for gym-duckietown and duckietown-world.

The files are YAML with a table of tiles, whose first row is north.

A tile is a kind and the side that it faces, such as ``curve_left/W``. Both programs drive along the
sides that a kind opens: gym-duckietown's ``_get_curve`` and duckietown-world's ``tile_template``.
They agree on all kinds except ``3way_right``, to which gym-duckietown gives the curves of
``3way_left``. We read it like duckietown-world, because only then the tiles of existing maps fit
together, and never write it.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Int8
from numpy.typing import ArrayLike

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import check_named, is_real, real
from elitelanes_jax._util.errors import InputError, brief, list_some, quote
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats._duckietown_objects import read_objects, write_objects
from elitelanes_jax.formats._yaml_tree import yaml_tree
from elitelanes_jax.formats._yaml_values import NOTHING
from elitelanes_jax.formats.objects import MapObject, check_objects
from elitelanes_jax.lanes.links import side_towards
from elitelanes_jax.network.checks import check_sides, known_grid
from elitelanes_jax.network.codes import CONNECTIONS, rotate_codes
from elitelanes_jax.network.links import cut_dead_ends, linked_neighbours

TILE_SIZE = 0.585
"""The side of Duckietown's tiles in metres."""

GROUNDS = ("grass", "floor", "asphalt", "empty")
"""The kinds of tiles without a road. We write grass."""

# The sides that each kind opens when it faces south, as a code.
_ROADS = {
    "straight": 10,
    "curve_left": 12,
    "curve_right": 9,
    "3way_left": 14,
    "3way_right": 11,
    "4way": 15,
}
# The quarter turns counter-clockwise from the south to each side.
_TURNS = {"S": 0, "E": 1, "N": 2, "W": 3}


def _codes_of_tiles() -> dict[str, int]:
    """Returns the code of each tile that a file may name."""
    codes = {}
    without_road = dict.fromkeys((*GROUNDS, "calibration_tile"), 0)
    for kind, code in (_ROADS | without_road).items():
        # A kind without a side faces east.
        codes[kind] = rotate_codes(code, _TURNS["E"])
        for side, turns in _TURNS.items():
            codes[f"{kind}/{side}"] = rotate_codes(code, turns)
    return codes


_CODE = _codes_of_tiles()

# A code may have several names. We write one of them for each code.
_WRITTEN_TILES = (
    "straight/N", "straight/E", "4way",
    "curve_left/S", "curve_left/E", "curve_left/N", "curve_left/W",
    "3way_left/S", "3way_left/E", "3way_left/N", "3way_left/W",
)  # fmt: skip
_TILE_OF_CODE = {_CODE[tile]: tile for tile in _WRITTEN_TILES}


def check_tile_size(tile_size: UserValue, least: float = 0.01, most: float = 100) -> None:
    """Raises an `InputError` unless the side of a tile is a number of metres in a range."""
    if not is_real(tile_size) or not least <= tile_size <= most:
        got = quote(tile_size)
        raise InputError("tile_size", f"metres, a number from {least:g} to {most:g}", got)


def to_duckietown(
    codes: ArrayLike,
    *,
    objects: Sequence[MapObject] | None = None,
    tile_size: float = TILE_SIZE,
) -> str:
    """Returns a grid as the text of a Duckietown map.

    A road that leaves the grid, or that the neighbour does not return, is written unchanged:
    gym-duckietown draws it, duckietown-world loads it, but makes no graph of its lanes.

    Args:
      codes: integer codes ``[H, W]``.
      objects: the objects of the map. Tags are written of signs and tags on the floor only.
      tile_size: the side of a tile in metres, 0.01 to 100. duckietown-world rounds positions to
        centimetres where lanes meet: sizes in whole centimetres work at any extent, 0.585 up to 37
        tiles a side.

    Raises:
      InputError: for a bad grid, object or size, or tiles with one connection, which Duckietown
        lacks; the message names them, and `without_dead_ends` removes them.
    """
    grid = check_roads(codes)
    check_tile_size(tile_size)
    checked_objects = check_objects(objects or (), *grid.shape)
    tiles = []
    for row in grid.tolist():
        tiles.append([_TILE_OF_CODE.get(code, "grass") for code in row])
    # A float32 would be long as a Python number: 0.585 is 0.5849999785423279.
    metres = np.format_float_positional(tile_size, trim="0")
    head = f"tile_size: {metres}\ntiles:\n{_table(tiles)}"
    return head + write_objects(checked_objects, len(grid), float(tile_size))


def _table(tiles: list[list[str]]) -> str:
    """Returns the lines of a table of tiles, in columns of one width."""
    width = max(len(tile) for row in tiles for tile in row)
    lines = []
    for row in tiles:
        cells = [f"{tile},".ljust(width + 2) for tile in row]
        line = "".join(cells).rstrip(", ")
        lines.append(f"- [{line}]\n")
    return "".join(lines)


def check_roads(codes: ArrayLike) -> Int8[np.ndarray, "H W"]:
    """Returns a grid that Duckietown can have, int8 ``[H, W]``.

    Raises `InputError` for dead ends.
    """
    grid = known_grid(codes)
    dead_ends = np.argwhere(CONNECTIONS[grid] == 1).tolist()
    if dead_ends:
        places = [describe_cell(row, column) for row, column in dead_ends]
        cells = list_some(places, 8)
        expected = "tiles with two or more connections, as in Duckietown"
        hint = "dead_ends='grass' or without_dead_ends removes these roads"
        raise InputError("grid", expected, f"dead ends at {cells}", hint)
    return grid


def read_duckietown(text: str) -> tuple[Int8[np.ndarray, "H W"], list[MapObject] | None]:
    """Reads the grid of a Duckietown map, and its objects.

    Kinds without a side face east, as in Duckietown's programs. The kinds of ground are ignored:
    all cells without a road are 0.

    Args:
      text: the content of the YAML file.

    Returns:
      int8 ``[H, W]``, and the objects, or None if the file has none.

    Raises:
      InputError: if it is not a Duckietown map, has an unknown kind of tile or of object, or a side
        over 1024 tiles.
    """
    tree = yaml_tree(text)
    values = tree if isinstance(tree, dict) else {}
    grid = _read_tiles(values)
    objects = values.get("objects")
    if not objects or objects in NOTHING:
        return grid, None
    size = values.get("tile_size", TILE_SIZE)
    if isinstance(size, list | dict):
        # A list is shortened here, because the message of the check would contain all of it.
        size = brief(size)
    tile_size = check_named("tile_size", real(0.01, 100, unit="metres"), size)
    return grid, read_objects(objects, len(grid), tile_size)


def _read_tiles(values: Mapping[str, Plain]) -> Int8[np.ndarray, "H W"]:
    """Reads the table of tiles of a file's values."""
    rows = values.get("tiles")
    if rows is None:
        raise InputError("", 'a Duckietown map, {"tiles": [[...], ...]}', 'no "tiles"')
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise InputError("tiles", "rows of kinds of tiles", brief(rows))
    # With aliases a short text may have very many rows, so the sides are checked before the tiles.
    check_sides(rows)
    codes = []
    for row, tiles in enumerate(rows):
        codes.append([_code_of(tile, row, column) for column, tile in enumerate(tiles)])
    return known_grid(codes)


def _code_of(tile: Plain, row: int, column: int) -> int:
    kind = ""
    if isinstance(tile, str):
        parts = [part.strip() for part in tile.split("/")]
        kind = "/".join(parts)
    if kind not in _CODE:
        kinds = ", ".join([*_ROADS, *GROUNDS])
        expected = f"one of {kinds}, alone or with /N, /E, /S or /W"
        raise InputError("tiles", expected, f"{brief(tile)} at {describe_cell(row, column)}")
    return _CODE[kind]


def without_dead_ends(codes: ArrayLike) -> Int8[np.ndarray, "H W"]:
    """Removes roads that lead nowhere, each up to the last crossing, which loses that side.

    The rest has no dead end as `measure` counts them: every tile has two connections or more, all
    returned.

    Args:
      codes: integer codes ``[H, W]``.

    Returns:
      int8 ``[H, W]``; zeros if all roads lead nowhere.

    Raises:
      InputError: for a bad grid.
    """
    grid = known_grid(codes)
    links = linked_neighbours(grid)
    cut_dead_ends(links)
    codes_left = np.zeros_like(grid)
    for tile, neighbours in links.items():
        codes_left[tile] = sum(side_towards(tile, neighbour).bit for neighbour in neighbours)
    return codes_left
