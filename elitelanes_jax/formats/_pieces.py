"""The middles of roads as lines and arcs, exactly where the tiles have them."""

import math
from itertools import pairwise
from typing import NamedTuple

from elitelanes_jax.formats.graph import Cell, side_towards
from elitelanes_jax.formats.streets import AHEAD, Streets, Way, middle_of_side
from elitelanes_jax.network.codes import SIDES

# From the border of a crossing to its junction, in tiles, if the next tile is a crossing too. Where its lanes turn they
# are 0.0002 tiles out of place, 6 mm on tiles of 30 m.
_INSET = 2.0**-11


class Piece(NamedTuple):
    """A line or an arc of a road's middle: where it starts, its heading, its length and its curvature, in tiles."""

    start: complex
    heading: int
    length: float
    curvature: float = 0.0


def middle(path: list[Cell], links: dict[Cell, list[Cell]], height: int) -> list[Piece]:
    """Returns the middle of a road, across all tiles of a path but the first and the last.

    It also leads to the middle of a dead end at an end of the path, and between adjacent crossings into both.
    """
    headings = [SIDES.index(side_towards(*pair)) for pair in pairwise(path)]
    leads = [0.5 if len(links[tile]) == 1 else 0.0 for tile in (path[0], path[-1])]
    if len(path) == 2 and not any(leads):
        leads = [_INSET, _INSET]
    first = middle_of_side(path[0], headings[0], height) - leads[0] * AHEAD[headings[0]]
    pieces = [Piece(first, headings[0], leads[0])]
    for tile, into, out in zip(path[1:-1], headings[:-1], headings[1:], strict=True):
        pieces += across(Way(*tile, into, (into - out + 1) % 4), height=height)
    pieces.append(Piece(middle_of_side(path[-1], headings[-1] - 2, height), headings[-1], leads[1]))
    merged: list[Piece] = []
    for piece in (piece for piece in pieces if piece.length):
        if merged and not piece.curvature and not merged[-1].curvature:
            merged[-1] = merged[-1]._replace(length=merged[-1].length + piece.length)
        else:
            merged.append(piece)
    return merged


def across(way: Way, from_crossing: bool = False, to_crossing: bool = False, *, height: int) -> list[Piece]:
    """Returns the middle of a way across its tile, between points as far from the borders as junctions begin."""
    inset, outset = _INSET * from_crossing, _INSET * to_crossing
    start = middle_of_side(way.tile, way.heading - 2, height) + inset * AHEAD[way.heading]
    bend = way.turn - 1
    if not bend:
        return [Piece(start, way.heading, 1 - inset - outset)]
    deepest = max(inset, outset)
    radius = 0.5 - deepest
    end = middle_of_side(way.tile, way.exit, height) - deepest * AHEAD[way.exit]
    pieces = [
        Piece(start, way.heading, deepest - inset),
        Piece(start + (deepest - inset) * AHEAD[way.heading], way.heading, radius * math.pi / 2, bend / radius),
        Piece(end, way.exit, deepest - outset),
    ]
    return [piece for piece in pieces if piece.length]


def back(way: Way, streets: Streets, height: int) -> list[Piece]:
    """Returns the half circle that is the centre of the lane around a dead end."""
    radius = streets.lane / streets.tile / 2
    middle = middle_of_side(way.tile, way.heading - 2, height) + AHEAD[way.heading] / 2
    return [Piece(middle - radius * 1j * AHEAD[way.heading], way.heading, radius * math.pi, 1 / radius)]
