"""The tapes of Duckietown's tiles.

They are those of Duckietown's appearance specification, sections "Layer - Tilemap" and "Assembly -
Road Tiles".
"""

from itertools import pairwise
from math import cos, fsum, hypot, pi, sin
from typing import NamedTuple

import numpy as np

from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.network.codes import NORTH, SOUTH, WEST

TAPE_WIDTHS = {"white": 0.048, "yellow": 0.024, "red": 0.048}
"""The width of each colour of tape in metres."""

REFERENCE = {
    "straight": NORTH | SOUTH,
    "turn": SOUTH | WEST,
    "crossing3": NORTH | SOUTH | WEST,
    "crossing4": 15,
}
"""The code of each kind of tile without a rotation."""

# The width of a lane, and the length of the yellow tape at each entry of a crossing, in metres.
_LANE, _STUB = 0.21, 0.05
# The distance from the middle of the road to the middle of its white tape, in metres.
_EDGE = TAPE_WIDTHS["yellow"] / 2 + _LANE + TAPE_WIDTHS["white"] / 2


class Tape(NamedTuple):
    """A strip of tape on a tile: straight pieces join the points of its middle line.

    Attributes:
      colour: white, yellow or red.
      points: metres east and south of the tile's north-west corner.
    """

    colour: str
    points: tuple[tuple[float, float], ...]

    @property
    def length(self) -> float:
        """The length in metres, with the gaps that are cut into yellow tape."""
        # The plain sum of floats has other last bits from Python 3.12 on.
        return fsum(hypot(x - u, y - v) for (x, y), (u, v) in pairwise(self.points))


def tapes_of(kind: str, quarter_turns: int, tile_size: float = TILE_SIZE) -> tuple[Tape, ...]:
    """Returns the tapes of a tile, the red ones first, since the others lie on them.

    White tape has five pieces outside a turn and three inside, as in the corners of a crossing.
    Stop lines cross the lane into a crossing, where traffic keeps to the right. `quarter_turns` are
    counter-clockwise from the tile in `REFERENCE`.
    """
    half, right = tile_size / 2, tile_size / 2 - TAPE_WIDTHS["yellow"] / 2
    # Each strip is defined once, and rotated below. This one is the tape along the western side.
    side = Tape("white", ((half - _EDGE, 0.0), (half - _EDGE, tile_size)))
    corner = _arc("white", half - _EDGE, 3, tile_size)
    # Traffic from the north keeps to the western half.
    stop = Tape("red", ((right - _LANE, TAPE_WIDTHS["red"] / 2), (right, TAPE_WIDTHS["red"] / 2)))
    stub = Tape("yellow", ((half, 0.0), (half, _STUB)))
    middle_line = Tape("yellow", ((half, 0.0), (half, tile_size)))
    # Each strip has the quarter turns from where it is defined.
    if kind == "straight":
        strips = [(middle_line, 0), (side, 0), (side, 2)]
    elif kind == "turn":
        outer = _arc("white", half + _EDGE, 5, tile_size)
        strips = [(outer, 0), (corner, 0), (_arc("yellow", half, 16, tile_size), 0)]
    elif kind == "crossing3":
        strips = [(stop, 0), (stop, 1), (stop, 2), (stub, 0), (stub, 1), (stub, 2)]
        strips += [(corner, 0), (corner, 3), (side, 2)]
    else:
        strips = [(stop, 0), (stop, 1), (stop, 2), (stop, 3)]
        strips += [(stub, 0), (stub, 1), (stub, 2), (stub, 3)]
        strips += [(corner, 0), (corner, 3), (corner, 1), (corner, 2)]
    return tuple(_turned(strip, turns + quarter_turns, tile_size) for strip, turns in strips)


def _arc(colour: str, radius: float, pieces: int, tile_size: float) -> Tape:
    """Returns tape around the south-western corner of a tile.

    The tape leads from the western to the southern side.
    """
    points = []
    for angle in np.linspace(0, pi / 2, pieces + 1).tolist():
        points.append((radius * sin(angle), tile_size - radius * cos(angle)))
    return Tape(colour, tuple(points))


def _turned(tape: Tape, quarter_turns: int, tile_size: float) -> Tape:
    points = tape.points
    for _ in range(quarter_turns % 4):
        # A quarter turn counter-clockwise takes east to north. y points south.
        points = tuple((y, tile_size - x) for x, y in points)
    return tape._replace(points=points)
