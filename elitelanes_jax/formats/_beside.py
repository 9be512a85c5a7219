"""Where objects are beside roads: the length along a road, and the distance to its left."""

import math
from collections.abc import Iterable
from itertools import product
from typing import NamedTuple

from elitelanes_jax.lanes.curves import Curve
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.links import Cell


class Place(NamedTuple):
    """A place beside a way. Lengths are in tiles.

    Attributes:
      distance: the distance from the way, by which places are compared.
      way: the index of the way.
      along: the length of the way before the place.
      left: the distance to the left of the way.
      angle: the direction of the way there, in radians counter-clockwise from east.
    """

    distance: float
    way: int
    along: float
    left: float
    angle: float


class Ways:
    """Ways of lines and arcs, and the tiles that each passes."""

    def __init__(self, curves: list[list[Curve]], tiles: list[list[Cell]]) -> None:
        self._curves = curves
        self._ways_at: dict[Cell, list[int]] = {}
        for way, passed in enumerate(tiles):
            for tile in passed:
                self._ways_at.setdefault(tile, []).append(way)

    def place_beside(self, x: float, y: float) -> Place | None:
        """Returns the place of a point beside the nearest way with a perpendicular to it, or None."""
        row, column = math.floor(y), math.floor(x)
        cells = product(range(row - 1, row + 2), range(column - 1, column + 2))
        near = {way for cell in cells for way in self._ways_at.get(cell, ())}
        # All ways are tried if no way near the point has a perpendicular to it. Few points need
        # this.
        places = self._places(near, x, y) or self._places(range(len(self._curves)), x, y)
        return min(places, default=None)

    def _places(self, ways: Iterable[int], x: float, y: float) -> list[Place]:
        places: list[Place] = []
        for way in ways:
            before = 0.0
            for curve in self._curves[way]:
                foot = _foot_on(curve, x, y)
                if foot is not None:
                    along, left = foot
                    angle = (1 - curve.heading) * math.pi / 2 + along * curve.curvature
                    places.append(Place(abs(left), way, before + along, left, angle))
                before += curve.length
        return places


def _foot_on(curve: Curve, x: float, y: float) -> tuple[float, float] | None:
    """Returns where a point is beside a curve: the length along it, and the distance to the left.

    Returns None if no perpendicular of the curve leads to the point.
    """
    ahead = SIDES[curve.heading]
    east, south = x - curve.x, y - curve.y
    along = east * ahead.right + south * ahead.down
    left = east * ahead.down - south * ahead.right
    if curve.curvature:
        # The middle of the circle is at this distance to the left of the start.
        radius = 1 / curve.curvature
        bend = math.copysign(1, radius)
        along, left = (
            abs(radius) * math.atan2(along, bend * (radius - left)),
            radius - bend * math.hypot(along, radius - left),
        )
    # A foot at an end of the curve may be beyond it by the rounding.
    is_beside = -1e-9 <= along <= curve.length + 1e-9
    return (min(max(along, 0.0), curve.length), left) if is_beside else None
