"""Where an object fits on a map.

Footprints of objects are on the cells without road, and objects keep clear of each other.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from math import floor, hypot

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import OBJECT_KINDS, MapObject, corners_of
from elitelanes_jax.network.links import Cell

Point = tuple[float, float]

# The least distance between footprints, in tiles.
_CLEARANCE = 0.01


def make_object(kind: str, x: float, y: float, angle: float, *, static: bool = True) -> MapObject:
    """Returns an object of its kind's usual height, with its position rounded to six digits."""
    return MapObject(
        kind, round(x, 6), round(y, 6), angle, OBJECT_KINDS[kind].height, static=static
    )


def has_road(codes: NDArray[np.int8], cell: Cell) -> bool:
    """Returns whether a cell has a road. Cells outside the map have none."""
    row, column = cell
    height, width = codes.shape
    return 0 <= row < height and 0 <= column < width and codes[cell] > 0


def outline_of(thing: MapObject) -> list[Point]:
    """Returns the four corners of an object's footprint, in tiles.

    If the object is round, they are the corners of the square around it.
    """
    half_length, half_width = (side / 2 / TILE_SIZE for side in thing.footprint)
    return corners_of(thing.x, thing.y, half_length, half_width, thing.angle)


def _are_close(rectangle: Sequence[Point], other: Sequence[Point]) -> bool:
    """Returns whether two rectangles overlap or nearly touch along the sides of one of them."""
    # Two rectangles are apart if their projections on a line along one of their sides are apart.
    # Two sides of each rectangle are enough.
    for corners in (rectangle, other):
        for index in (0, 1):
            (ax, ay), (bx, by) = corners[index], corners[index + 1]
            size = hypot(bx - ax, by - ay)
            nx, ny = (bx - ax) / size, (by - ay) / size
            first = [x * nx + y * ny for x, y in rectangle]
            second = [x * nx + y * ny for x, y in other]
            if max(first) + _CLEARANCE <= min(second) or max(second) + _CLEARANCE <= min(first):
                return False
    return True


class Space:
    """The objects that are on a map, in the order in which they were placed."""

    def __init__(self, codes: NDArray[np.int8]) -> None:
        self.codes = codes
        self.objects: list[MapObject] = []
        # The outlines near each cell, so a new object is compared with its neighbours alone.
        self._outlines: dict[Cell, list[list[Point]]] = defaultdict(list)

    def place(self, thing: MapObject, *, in_lane: bool = False) -> bool:
        """Adds an object if it fits; returns whether it fits.

        An object fits if it is off all roads, or in a lane, and clear of the other objects.
        """
        fits = (in_lane or all(map(self._is_free, _cells(outline_of(thing))))) and self.is_clear(
            thing
        )
        if fits:
            self.add(thing)
        return fits

    def is_clear(self, thing: MapObject) -> bool:
        """Returns whether an object keeps clear of those that were added."""
        corners = outline_of(thing)
        return not any(
            _are_close(corners, other) for cell in _cells(corners) for other in self._outlines[cell]
        )

    def add(self, thing: MapObject) -> None:
        """Adds an object without checking whether it fits."""
        self.objects.append(thing)
        corners = outline_of(thing)
        # The margin also reaches cells that the object nearly touches.
        for cell in _cells(corners, _CLEARANCE):
            self._outlines[cell].append(corners)

    def _is_free(self, cell: Cell) -> bool:
        height, width = self.codes.shape
        return 0 <= cell[0] < height and 0 <= cell[1] < width and not self.codes[cell]


def _cells(corners: Sequence[Point], margin: float = 0.0) -> Iterator[Cell]:
    """Returns the cells that the box around some points touches."""
    xs, ys = [x for x, _ in corners], [y for _, y in corners]
    for row in range(floor(min(ys) - margin), floor(max(ys) + margin) + 1):
        for column in range(floor(min(xs) - margin), floor(max(xs) + margin) + 1):
            yield row, column
