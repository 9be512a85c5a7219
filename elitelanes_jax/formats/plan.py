"""Makes a plan to build a map from: which tile lies where, what tape it needs, and what stands on it."""

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.checks import check_named, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.plan_pages import PlacedTile, Plan
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.tapes import REFERENCE, TAPE_WIDTHS, tapes_of
from elitelanes_jax.lanes.links import ends_of_roads
from elitelanes_jax.network.codes import list_turned
from elitelanes_jax.network.loops import gridlock_loop

LONGEST_PLAN = 64
"""The longest side of maps that a plan can show, in tiles."""

# The kind and the quarter turns of each code.
_TILE = list_turned(REFERENCE)


@name_wrong_arguments
def make_plan(road_map: UserValue, *, tile_size: float = TILE_SIZE) -> Plan:
    """Lists what it takes to build a map.

    Args:
      road_map: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      tile_size: the pitch of the tiles in metres, 0.55 to 2.

    Raises:
      InputError: for anything else, a map without roads or with a side over 64, or a tile with one
        connection or one that its neighbour does not return, because Duckietown has no tile for the
        end of a road.
    """
    size = check_named("tile_size", real(0.55, 2, unit="metres"), tile_size)
    checked_map = as_map(road_map)
    codes, objects = checked_map.codes, checked_map.objects or ()
    height, width = codes.shape
    has_roads = codes.any()
    if max(height, width) > LONGEST_PLAN or not has_roads:
        got = f"{height} x {width}" if has_roads else "none"
        raise InputError("map", f"roads on at most {LONGEST_PLAN} x {LONGEST_PLAN} tiles", got)
    _check_ends(codes)
    placed = []
    for row, column in np.argwhere(codes).tolist():
        kind, quarter_turns = _TILE[int(codes[row, column])]
        placed.append(PlacedTile(row, column, kind, quarter_turns))
    tiles = {kind: sum(tile.kind == kind for tile in placed) for kind in REFERENCE}
    # All tiles of a kind have equal tape, however they are turned.
    tape = dict.fromkeys(TAPE_WIDTHS, 0.0)
    for kind, count in tiles.items():
        for strip in tapes_of(kind, 0, size):
            tape[strip.colour] += count * strip.length
    return Plan(
        shape=(height, width),
        tile_size=size,
        floor=(round(width * size, 3), round(height * size, 3)),
        placed=tuple(placed),
        tiles=tiles | {"empty": height * width - len(placed)},
        tape={colour: round(total, 3) for colour, total in tape.items()},
        objects=tuple(sorted(objects, key=lambda item: (item.y, item.x, item.kind))),
        loop=tuple(gridlock_loop(codes)),
    )


def _check_ends(codes: NDArray[np.int8]) -> None:
    """Raises `InputError` for a tile where a road ends."""
    ends = ends_of_roads(codes)
    if ends:
        row, column = ends[0]
        expected = (
            "tiles with two or more connections that their neighbours return, as Duckietown has"
        )
        raise InputError("map", expected, f"a dead end at {describe_cell(row, column)}")
