"""Duckietown's map files, for gym-duckietown and duckietown-world: YAML with a table of tiles, the first row north.

A tile is a kind and the side that it faces, such as ``curve_left/W``. Both programs drive along the sides that a kind
opens: gym-duckietown's ``_get_curve`` and duckietown-world's ``tile_template``. They agree on all kinds except
``3way_right``, to which gym-duckietown gives the curves of ``3way_left``. We read it like duckietown-world, because
only then the tiles of existing maps fit together, and never write it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_real, real
from elitelanes_jax._util.errors import InputError, brief, shorten
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.formats._duckietown_objects import read_objects, write_objects
from elitelanes_jax.formats._yaml_tree import yaml_tree
from elitelanes_jax.formats.objects import MapObject, check_objects
from elitelanes_jax.lanes.links import linked_tiles, side_towards
from elitelanes_jax.network.checks import check_grid, check_sides
from elitelanes_jax.network.codes import CONNECTIONS, rotate_codes

TILE_SIZE = 0.585
"""The side of Duckietown's tiles in metres."""

GROUNDS = ("grass", "floor", "asphalt", "empty")
"""The kinds of tiles without a road. We write grass."""

# The sides that each kind opens when it faces south, and the quarter turns counter-clockwise to other sides.
_ROADS = {"straight": 10, "curve_left": 12, "curve_right": 9, "3way_left": 14, "3way_right": 11, "4way": 15}
_TURNS = {"S": 0, "E": 1, "N": 2, "W": 3}
_CODE = {
    **{f"{kind}/{side}": rotate_codes(code, turns) for kind, code in _ROADS.items() for side, turns in _TURNS.items()},
    **{kind: rotate_codes(code, _TURNS["E"]) for kind, code in _ROADS.items()},
    **{kind + side: 0 for kind in (*GROUNDS, "calibration_tile") for side in ("", "/S", "/E", "/N", "/W")},
}

# The tile that is written for each code.
_TILE = {_CODE[tile]: tile for tile in ("straight/N", "straight/E", "4way")} | {
    _CODE[f"{kind}/{side}"]: f"{kind}/{side}" for kind in ("curve_left", "3way_left") for side in _TURNS
}


def check_tile_size(tile_size: UserValue, least: float = 0.01, most: float = 100) -> None:
    """Raises an `InputError` unless the side of a tile is a number of metres in a range."""
    if not is_real(tile_size) or not least <= tile_size <= most:
        got = shorten(repr(tile_size))
        raise InputError(f"tile_size: expected metres, a number from {least:g} to {most:g}, got {got}")


@name_wrong_arguments
def to_duckietown(
    codes: ArrayLike,
    *,
    objects: Sequence[MapObject] | None = None,
    tile_size: float = TILE_SIZE,
) -> str:
    """Returns a grid as the text of a Duckietown map.

    A road that leaves the grid, or that the neighbour does not return, is written unchanged: gym-duckietown draws it,
    duckietown-world loads it, but makes no graph of its lanes.

    Args:
      codes: integer codes ``[H, W]``.
      objects: of the map. Tags are written of signs and tags on the floor only.
      tile_size: in metres, 0.01 to 100. duckietown-world rounds positions to centimetres where lanes meet: sizes in
        whole centimetres work at any extent, 0.585 up to 37 tiles a side.

    Raises:
      InputError: for a bad grid, object or size, or tiles with one connection, which Duckietown
        lacks; the message names them, and `without_dead_ends` removes them.
    """
    grid = check_roads(codes)
    check_tile_size(tile_size)
    things = check_objects(objects or (), *grid.shape)
    kinds = [[_TILE.get(code, "grass") for code in row] for row in grid.tolist()]
    width = max(len(kind) for row in kinds for kind in row) + 1
    rows = ["".join(f"{kind},".ljust(width + 1) for kind in row).rstrip(", ") for row in kinds]
    metres = np.format_float_positional(tile_size, trim="0")  # also short for a float32
    table = "".join(f"- [{row}]\n" for row in rows)
    return f"tile_size: {metres}\ntiles:\n{table}" + write_objects(things, len(grid), float(tile_size))


def check_roads(codes: ArrayLike) -> NDArray[np.int8]:
    """Returns a grid that Duckietown can have, int8 ``[H, W]``; raises `InputError` for dead ends."""
    grid = np.asarray(check_grid(codes))
    stubs = np.argwhere(CONNECTIONS[grid] == 1).tolist()
    if stubs:
        cells = "; ".join(f"row {row}, column {column}" for row, column in stubs[:8])
        more = f" and {len(stubs) - 8} more" if len(stubs) > 8 else ""
        got = f"got dead ends at {cells}{more}; dead_ends='grass' or without_dead_ends removes these roads"
        raise InputError(f"grid: expected tiles with two or more connections, as in Duckietown, {got}")
    return grid


@name_wrong_arguments
def from_duckietown(text: str) -> NDArray[np.int8]:
    """Reads the grid of a Duckietown map.

    Kinds without a side face east, as in Duckietown's programs. The map's `tile_size` and kinds of ground are ignored:
    all cells without a road are 0. `read_map` reads the objects too.

    Args:
      text: the content of the YAML file.

    Returns:
      int8 ``[H, W]``.

    Raises:
      InputError: if it is not a Duckietown map, has an unknown kind of tile, or a side over 1024 tiles.
    """
    return read_duckietown(text)[0]


def read_duckietown(text: str) -> tuple[NDArray[np.int8], list[MapObject] | None]:
    """Reads the grid of a Duckietown map, as `from_duckietown` does, and its objects; None if the file has none."""
    if not isinstance(text, str):
        raise InputError(f"text: expected the content of a YAML file, got {shorten(repr(text))}")
    values = yaml_tree(text)
    rows = values.get("tiles") if isinstance(values, dict) else None
    if rows is None:
        hint = "" if "\n" in text or isinstance(values, dict) else "; read_map reads the map of a file"
        raise InputError(f'expected a Duckietown map, {{"tiles": [[...], ...]}}, got no "tiles"{hint}')
    if not isinstance(rows, list) or not all(isinstance(row, list) for row in rows):
        raise InputError(f"tiles: expected rows of kinds of tiles, got {brief(rows)}")
    check_sides(rows)  # aliases may name the same row many times
    grid = np.array(check_grid([[_code(tile, y, x) for x, tile in enumerate(row)] for y, row in enumerate(rows)]))
    if not values.get("objects"):
        return grid, None
    size = values.get("tile_size", TILE_SIZE)
    text = brief(size) if isinstance(size, list | dict) else size
    tile_size = check_named("tile_size", real(0.01, 100, unit="metres"), text)
    return grid, read_objects(values["objects"], len(grid), tile_size)


def _code(tile: Plain, row: int, column: int) -> int:
    kind = "/".join(part.strip() for part in tile.split("/")) if isinstance(tile, str) else ""
    if kind not in _CODE:
        kinds = ", ".join((*_ROADS, *GROUNDS))
        position = f"at row {row}, column {column}"
        got = brief(tile)
        raise InputError(f"tiles: expected one of {kinds}, alone or with /N, /E, /S or /W, got {got} {position}")
    return _CODE[kind]


@name_wrong_arguments
def without_dead_ends(codes: ArrayLike) -> NDArray[np.int8]:
    """Removes roads that lead nowhere, each up to the last crossing, which loses that side.

    The rest has no dead end as `measure` counts them: every tile has two connections or more, all returned.

    Args:
      codes: integer codes ``[H, W]``.

    Returns:
      int8 ``[H, W]``; zeros if all roads lead nowhere.

    Raises:
      InputError: for a bad grid.
    """
    grid = np.asarray(check_grid(codes))
    links = linked_tiles(grid)
    ends = [tile for tile, others in links.items() if len(others) < 2]
    while ends:
        tile = ends.pop()
        for other in links.pop(tile, []):
            links[other].remove(tile)
            ends += [other] * (len(links[other]) < 2)
    left = np.zeros_like(grid)
    for tile, others in links.items():
        left[tile] = sum(side_towards(tile, other).bit for other in others)
    return left
