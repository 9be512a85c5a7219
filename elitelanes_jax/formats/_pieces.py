"""The middles of roads as lines and arcs, exactly where the tiles have them; positions as in `lanes`."""

import math
from itertools import pairwise

from elitelanes_jax.lanes.curves import Curve, middle_of_side, moved
from elitelanes_jax.lanes.links import Cell, side_towards
from elitelanes_jax.lanes.movements import Movement, turn_between
from elitelanes_jax.network.codes import SIDES

# From the border of a crossing to its junction, in tiles, if the next tile is a crossing too. Where its lanes turn they
# are 0.0002 tiles out of place, 6 mm on tiles of 30 m.
_INSET = 2.0**-11


def middle(path: list[Cell], links: dict[Cell, list[Cell]]) -> list[Curve]:
    """Returns the middle of a road, across all tiles of a path but the first and the last.

    It also leads to the middle of a dead end at an end of the path, and between adjacent crossings into both.
    """
    headings = [SIDES.index(side_towards(*pair)) for pair in pairwise(path)]
    leads = [0.5 if len(links[tile]) == 1 else 0.0 for tile in (path[0], path[-1])]
    if len(path) == 2 and not any(leads):
        leads = [_INSET, _INSET]
    start = moved(middle_of_side(path[0], headings[0]), headings[0], -leads[0])
    pieces = [Curve(*start, headings[0], leads[0])]
    for (row, column), heading, exit_heading in zip(path[1:-1], headings[:-1], headings[1:], strict=True):
        pieces += across(Movement(row, column, heading, turn_between(heading, exit_heading)))
    end = middle_of_side(path[-1], (headings[-1] + 2) % 4)
    pieces.append(Curve(*end, headings[-1], leads[1]))
    merged: list[Curve] = []
    for piece in pieces:
        if not piece.length:
            continue
        if merged and not piece.curvature and not merged[-1].curvature:
            merged[-1] = merged[-1]._replace(length=merged[-1].length + piece.length)
        else:
            merged.append(piece)
    return merged


def across(movement: Movement, from_crossing: bool = False, to_crossing: bool = False) -> list[Curve]:
    """Returns the road's middle across the tile of a movement, between points as far from the borders as junctions."""
    inset, outset = _INSET * from_crossing, _INSET * to_crossing
    heading, exit_heading, tile = movement.heading, movement.exit, movement.node.tile
    entry = middle_of_side(tile, (heading + 2) % 4)
    bend = movement.turn - 1
    if not bend:
        return [Curve(*moved(entry, heading, inset), heading, 1 - inset - outset)]
    deepest = max(inset, outset)
    radius = 0.5 - deepest
    pieces = [
        Curve(*moved(entry, heading, inset), heading, deepest - inset),
        Curve(*moved(entry, heading, deepest), heading, radius * math.pi / 2, bend / radius),
        Curve(*moved(middle_of_side(tile, exit_heading), exit_heading, -deepest), exit_heading, deepest - outset),
    ]
    return [piece for piece in pieces if piece.length]
