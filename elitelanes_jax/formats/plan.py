"""A plan to build a map from: which tile lies where, what tape it needs, and what stands on it.

Tapes are those of Duckietown's appearance specification, sections "Layer - Tilemap" and "Assembly - Road Tiles".
"""

from collections import Counter
from math import cos, hypot, pi, sin
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np

from elitelanes_jax._util.checks import check_named, path, real
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import new_file
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import as_maps
from elitelanes_jax.network.codes import KIND_OF, NORTH, SIDES, SOUTH, WEST, rotate_codes

YELLOW, WHITE, LANE, DASH = 0.024, 0.048, 0.21, 0.05
"""Widths of the yellow tape and of the white and red tape, the width of a lane, and the length of a dash, in metres."""

LONGEST_PLAN = 64
"""The longest side of maps that a plan can show, in tiles."""

REFERENCE = {"straight": NORTH | SOUTH, "turn": SOUTH | WEST, "crossing3": NORTH | SOUTH | WEST, "crossing4": 15}
"""The code of each kind of tile without a rotation."""

_Points: TypeAlias = tuple[tuple[float, float], ...]

# From the middle of the road to the middle of its white tape.
_EDGE = YELLOW / 2 + LANE + WHITE / 2


class Tape(NamedTuple):
    """A strip of tape on a tile.

    Attributes:
      colour: white, yellow or red.
      points: of its middle line, metres east and south of the tile's north-west corner. Straight pieces join them.
      dashed: whether gaps are cut out of it, 5 cm of tape between them.
    """

    colour: str
    points: _Points
    dashed: bool = False

    @property
    def length(self) -> float:
        """Metres, with the gaps, which are cut when the tape is on the tile."""
        return sum(hypot(x - u, y - v) for (x, y), (u, v) in zip(self.points, self.points[1:], strict=False))


class PlacedTile(NamedTuple):
    """A tile of a plan.

    Attributes:
      row: from 0 in the north.
      column: from 0 in the west.
      kind: straight, turn, crossing3 or crossing4.
      quarter_turns: counter-clockwise from the tile in `REFERENCE`, the fewest.
    """

    row: int
    column: int
    kind: str
    quarter_turns: int


class Plan(NamedTuple):
    """What it takes to build a map.

    Attributes:
      shape: rows and columns of tiles.
      tile_size: the pitch of the tiles in metres.
      placed: the tiles, row by row.
      tiles: the number of tiles of each kind, and of empty cells.
      tape: metres of each colour of tape.
      objects: what stands on the map, from north to south.
    """

    shape: tuple[int, int]
    tile_size: float
    placed: tuple[PlacedTile, ...]
    tiles: dict[str, int]
    tape: dict[str, float]
    objects: tuple[MapObject, ...]

    @property
    def floor(self) -> tuple[float, float]:
        """The sides of the floor from west to east and from north to south, in metres."""
        return self.shape[1] * self.tile_size, self.shape[0] * self.tile_size

    @property
    def tags(self) -> dict[str, list[int | None]]:
        """The tags of the objects of each kind, in ascending order; None for an object without a tag."""
        kinds = sorted({thing.kind for thing in self.objects})
        by_tag = sorted(self.objects, key=lambda thing: -1 if thing.tag is None else thing.tag)
        return {kind: [thing.tag for thing in by_tag if thing.kind == kind] for kind in kinds}


def make_plan(road_map: UserValue, *, tile_size: float = TILE_SIZE) -> Plan:
    """Lists what it takes to build a map.

    Args:
      road_map: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      tile_size: the pitch of the tiles in metres, 0.55 to 2.

    Raises:
      InputError: for anything else, a map without roads or with a side over 64, or a tile with one connection, which
        Duckietown does not have.
    """
    size = check_named("tile_size", real(0.55, 2, unit="metres"), tile_size)
    maps = as_maps(road_map)
    if len(maps) != 1:
        raise InputError(f"map: expected one map, got {len(maps)}")
    codes, things = maps[0].codes, maps[0].objects or ()
    if max(codes.shape) > LONGEST_PLAN:
        raise InputError(f"map: expected sides of at most {LONGEST_PLAN}, got {codes.shape[0]} x {codes.shape[1]}")
    placed = tuple(_place(row, column, int(codes[row, column])) for row, column in np.argwhere(codes).tolist())
    if not placed:
        raise InputError("map: expected roads, got none")
    counts = Counter(tile.kind for tile in placed)
    tape: Counter[str] = Counter()
    for code in codes[codes > 0].tolist():
        for strip in tapes_of(code, size):
            tape[strip.colour] += strip.length  # type: ignore[assignment]
    return Plan(
        shape=codes.shape,  # type: ignore[arg-type]
        tile_size=size,
        placed=placed,
        tiles={kind: counts[kind] for kind in REFERENCE} | {"empty": int((codes == 0).sum())},
        tape={colour: round(float(tape[colour]), 3) for colour in ("white", "yellow", "red")},
        objects=tuple(sorted(things, key=lambda thing: (thing.y, thing.x, thing.kind))),
    )


def write_plan(road_map: UserValue, file: str | Path, *, tile_size: float = TILE_SIZE) -> Plan:
    """Writes the plan of a map with its bill of materials; a PDF also has a check-list.

    Args:
      road_map: as `make_plan` takes it.
      file: a name that ends in .pdf, .svg or .png; an existing file is replaced.
      tile_size: as `make_plan` takes it.

    Raises:
      InputError: as `make_plan` does, for another ending, or without matplotlib.
      OSError: if the file cannot be written.
    """
    place = check_named("file", path, file)
    if place.suffix.lower() not in (".pdf", ".svg", ".png"):
        raise InputError(f"file: expected a name that ends in .pdf, .svg or .png, got {shorten(repr(str(file)))}")
    plan = make_plan(road_map, tile_size=tile_size)
    from elitelanes_jax.formats._plan_pages import draw_plan

    with new_file(place) as part:
        draw_plan(plan, part)
    return plan


def tapes_of(code: int, tile_size: float = TILE_SIZE) -> tuple[Tape, ...]:
    """Returns the tapes of a tile, the red ones first, since the others lie on them.

    A turn has five pieces of white tape outside and three inside; so has each corner of a crossing inside. Stop lines
    cross the lane into a crossing, where traffic keeps to the right.
    """
    half = tile_size / 2
    if KIND_OF[code] == "turn":
        turns = _quarter_turns("turn", code)
        strips = [
            _arc("white", half + _EDGE, 5, tile_size),
            _arc("white", half - _EDGE, 3, tile_size),
            _arc("yellow", half, 16, tile_size)._replace(dashed=True),
        ]
        return tuple(_turned(strip, turns, tile_size) for strip in strips)
    strips = []
    if KIND_OF[code] == "straight":
        middle = ((half, 0.0), (half, tile_size))
        strips.append(_turned(Tape("yellow", middle, dashed=True), _quarter_turns("straight", code), tile_size))
    for index, side in enumerate(SIDES):
        turns = -index % 4  # counter-clockwise from the north
        if not code & side.bit:  # a closed side
            strips.append(_turned(Tape("white", ((0.0, half - _EDGE), (tile_size, half - _EDGE))), turns, tile_size))
        elif KIND_OF[code].startswith("crossing"):
            right = half - YELLOW / 2  # who comes from the north has the tape on the side of the west
            stop = Tape("red", ((right - LANE, WHITE / 2), (right, WHITE / 2)))
            stub = Tape("yellow", ((half, 0.0), (half, DASH)))
            strips += [_turned(strip, turns, tile_size) for strip in (stop, stub)]
            if code & SIDES[index - 1].bit:  # the corner between this side and the one before: the north-western one
                strips.append(_turned(_arc("white", half - _EDGE, 3, tile_size), turns - 1, tile_size))
    return tuple(sorted(strips, key=lambda strip: strip.colour != "red"))


def _place(row: int, column: int, code: int) -> PlacedTile:
    kind = KIND_OF[code]
    if kind not in REFERENCE:
        raise InputError(
            f"map: expected tiles with two or more connections, got one with one at row {row}, column {column}; "
            "Duckietown has no tile for a dead end"
        )
    return PlacedTile(row, column, kind, _quarter_turns(kind, code))


def _quarter_turns(kind: str, code: int) -> int:
    return next(turns for turns in range(4) if rotate_codes(REFERENCE[kind], turns) == code)


def _arc(colour: str, radius: float, pieces: int, tile_size: float) -> Tape:
    """Returns tape around the south-western corner of a tile, from the western to the southern side."""
    angles = [pi / 2 * piece / pieces for piece in range(pieces + 1)]
    return Tape(colour, tuple((radius * sin(angle), tile_size - radius * cos(angle)) for angle in angles))


def _turned(tape: Tape, quarter_turns: int, tile_size: float) -> Tape:
    points = tape.points
    for _ in range(quarter_turns % 4):
        points = tuple((y, tile_size - x) for x, y in points)
    return tape._replace(points=points)
