"""The curves of lanes: lines and quarter circles across a tile; and the road that they lie on.

A movement follows the centre of its lane, by default 0.2 tile to the right of the road's middle: a
line, or a quarter circle about the near corner (radius 0.3) or the far one (0.7). All functions
take another offset: 0 is the road's middle.
"""

from functools import cache
from math import pi
from typing import NamedTuple, TypeGuard

import numpy as np
from jaxtyping import Float
from numpy.typing import DTypeLike

from elitelanes_jax._util.checks import is_real
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import ArrayT, UserValue
from elitelanes_jax.lanes.movements import BACK, Movement
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.links import Cell

# Half of the yellow tape, 0.012 m, and half of the lane, 0.105 m, are 0.2 of a tile's 0.585 m.
LANE_OFFSET = 0.2
"""The distance from the road's middle to the centre of a lane, in tiles.

This is half of the yellow tape and half of the lane.
"""

# Duckietown's tiles have a side of 0.585 m. The 0.222 m are half of the yellow tape, 0.012 m, and
# the lane, 0.21 m.
HALF_ROAD = 0.222 / 0.585
"""The distance from the road's middle to the inner edge of the white tape, in tiles.

This is half of the yellow tape and the lane.
"""

# The middle of a chord is nearer to the circle's middle: 1 - cos(pi / 64) is 0.0012.
CHORDS = 16
"""The chords of a quarter circle in formats that have no arcs: 0.12 % of its radius from it."""


def is_lane_offset(value: UserValue) -> TypeGuard[float]:
    """Returns whether a value is a distance from the road's middle to the centre of a lane.

    The distance is in tiles, over 0 and under 0.5.
    """
    # At 0.5 tiles, the lane would be on the tile's edge, and a right turn would have no radius.
    return is_real(value) and 0 < value < 0.5


def check_lane_offset(value: UserValue) -> float:
    """Checks a distance from the road's middle to the centre of a lane, in tiles."""
    if not is_lane_offset(value):
        raise InputError("", "tiles, a number over 0 and under 0.5", quote(value))
    return float(value)


def lane_bends(dtype: DTypeLike = np.float64) -> Float[np.ndarray, "3"]:
    """Returns how often each turn bends to the left: -1 right, 0 straight, 1 left."""
    return np.array([-1, 0, 1], dtype)


def lane_radii(
    offset: float = LANE_OFFSET, dtype: DTypeLike = np.float64
) -> Float[np.ndarray, "3"]:
    """Returns the radius of the lane of each turn in tiles: right, straight and left.

    The radius of straight is 0.5, which has no meaning.
    """
    # The road's middle is half a tile from the corner of a turn. The lane is nearer to this corner
    # in a right turn, and farther from it in a left turn.
    return 0.5 + offset * lane_bends(dtype)


def lane_lengths(
    offset: float = LANE_OFFSET, dtype: DTypeLike = np.float64
) -> Float[np.ndarray, "3"]:
    """Returns the length of the lane of each turn in tiles: right, straight and left."""
    # A turn is a quarter of a circle, and straight on is one tile.
    is_straight = lane_bends() == 0
    quarter_circles = lane_radii(offset, dtype) * np.pi / 2
    return np.where(is_straight, 1, quarter_circles).astype(dtype)


class Curve(NamedTuple):
    """A line or an arc.

    Attributes:
      x: the position of its start, in tiles east of the grid's north-west corner.
      y: the position of its start, in tiles south of that corner.
      heading: the heading at its start: 0 north, 1 east, 2 south, 3 west.
      length: tiles.
      curvature: 1 / tiles, to the left; 0 for a line.
    """

    x: float
    y: float
    heading: int
    length: float
    curvature: float = 0.0

    def points(self, shares: Float[np.ndarray, " S"]) -> Float[np.ndarray, "S 2"]:
        """Returns x and y of points; `shares` are the parts of its length before them, 0 to 1."""
        # Points are computed in the frame of the start, forward and to the left, as if it headed
        # north.
        along = shares * self.length
        if self.curvature:
            # The angle of a point on an arc is its curvature times the length before the point.
            forward = np.sin(along * self.curvature) / self.curvature
            left = (1 - np.cos(along * self.curvature)) / self.curvature
        else:
            forward, left = along, np.zeros_like(along)
        ahead = SIDES[self.heading]
        # Forward and left are turned to the heading. y points south.
        x = self.x + forward * ahead.right + left * ahead.down
        y = self.y + forward * ahead.down - left * ahead.right
        return np.stack([x, y], axis=1)


def middle_of_side(tile: Cell, side: int) -> tuple[float, float]:
    """Returns x and y of the middle of a side of a tile."""
    return tile[1] + 0.5 + SIDES[side].right / 2, tile[0] + 0.5 + SIDES[side].down / 2


def moved(point: tuple[float, float], heading: int, distance: float) -> tuple[float, float]:
    """Returns the point at a distance in tiles, in the direction of a heading."""
    ahead = SIDES[heading]
    return point[0] + distance * ahead.right, point[1] + distance * ahead.down


def lane_curves(movement: Movement, offset: float = LANE_OFFSET) -> list[Curve]:
    """Returns the curves of a single movement across its tile.

    They are `offset` tiles to the right of the road's middle. There is one curve. A movement back
    has three: a line to the tile's middle, a half circle about it, whose radius is the offset, and
    a line back. Its offset is not 0.
    """
    heading = movement.heading
    # A movement enters by the side behind its heading, on the right of the road's middle.
    entry = middle_of_side(movement.node.tile, (heading + 2) % 4)
    start = moved(entry, (heading + 1) % 4, offset)
    if movement.turn == BACK:
        middle = moved(start, heading, 0.5)
        # The way back is on the other side of the road's middle, two offsets to the left.
        end = moved(middle, (heading + 3) % 4, 2 * offset)
        # The half circle bends to the left, because traffic keeps right.
        around = Curve(*middle, heading, offset * pi, 1 / offset)
        return [Curve(*start, heading, 0.5), around, Curve(*end, (heading + 2) % 4, 0.5)]
    # Straight on has no bend, and so the curvature 0.
    length = lane_lengths(offset)[movement.turn]
    curvature = lane_bends()[movement.turn] / lane_radii(offset)[movement.turn]
    return [Curve(*start, heading, float(length), float(curvature))]


def lane_polyline(movement: Movement, offset: float = LANE_OFFSET) -> Float[np.ndarray, "P 2"]:
    """Returns x and y of points along the curves of a single movement (see `lane_curves`).

    The points include both ends. A line has its ends alone, an arc the ends of `CHORDS` equal
    chords for each quarter circle.
    """
    # The grid's first tile is at the origin, so the position of a tile is its column and row.
    line = _polyline_in_tile(movement.heading, movement.turn, offset)
    return line + np.array([movement.column, movement.row])


@cache
def _polyline_in_tile(heading: int, turn: int, offset: float) -> Float[np.ndarray, "P 2"]:
    # Polylines are made once on the first tile, and then shifted to all others.
    curves = lane_curves(Movement(0, 0, heading, turn), offset)
    parts: list[Float[np.ndarray, "S 2"]] = []
    for curve in curves:
        # A line has no quarter circle, and so one chord.
        quarters = round(abs(curve.curvature) * curve.length / (pi / 2))
        shares = np.linspace(0, 1, max(quarters * CHORDS, 1) + 1)
        # A curve starts where the last one ends.
        parts.append(curve.points(shares if not parts else shares[1:]))
    # The result is shared by all callers of the cache, and none of them changes it.
    return np.concatenate(parts)


def on_road(code: ArrayT, east: ArrayT, south: ArrayT) -> ArrayT:
    """Returns whether points are on the road of their tile.

    The road is between the inner edges of the white tape. The road keeps the same distance, 0.5 -
    `HALF_ROAD` tiles, from closed sides and from the corners between open sides. On a turn the road
    is a ring about the corner between the two open sides. A stub has one open side, so its road
    ends at this distance from the opposite side.

    Args:
      code: codes of tiles.
      east: tiles from their western sides, 0 to 1.
      south: tiles from their northern sides, 0 to 1.

    Returns:
      bool. The arguments are arrays of NumPy or JAX, or numbers, that broadcast against each other.
    """
    # The road keeps this distance from a closed side of the tile.
    edge = 0.5 - HALF_ROAD
    # The depth from each side, clockwise from north.
    depths = (south, 1 - east, 1 - south, east)
    road = (code > 0) & (code < 16)
    for depth, side in zip(depths, SIDES, strict=True):
        # A closed side keeps the road away, and an open side lets the road reach the tile's edge.
        is_open = (code & side.bit) > 0
        road = road & (is_open | (depth >= edge))
    # Neighbouring sides meet in a corner: the second one follows the first one clockwise.
    for first, second in ((0, 1), (1, 2), (2, 3), (3, 0)):
        square = depths[first] * depths[first] + depths[second] * depths[second]
        # Between two open sides the corner is grass, a quarter circle about it.
        both = SIDES[first].bit | SIDES[second].bit
        road = road & (((code & both) != both) | (square >= edge * edge))
        # On a turn the road also ends at the outer edge, a larger circle about the same corner.
        road = road & ((code != both) | (square <= (1 - edge) * (1 - edge)))
    return road
