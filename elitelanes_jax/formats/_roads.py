"""Roads from node to node: their tiles, and their middles as lines and arcs.

Positions are as in `lanes`.
"""

import math
from itertools import pairwise

from elitelanes_jax.lanes.curves import Curve, middle_of_side, moved
from elitelanes_jax.lanes.links import side_towards, walk_roads
from elitelanes_jax.lanes.movements import LaneNode, Movement, turn_between
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.links import Cell


def cut_roads(links: dict[Cell, list[Cell]], nodes: set[Cell]) -> list[list[Cell]]:
    """Lists the tiles of each road from node to node, as `walk_roads` does.

    A road back to its own start, such as a ring, has a further node halfway.
    """
    cuts = set(nodes)
    for road in walk_roads(links, nodes):
        if road[0] == road[-1]:
            cuts |= {road[0], road[len(road) // 2]}
    return walk_roads(links, cuts)


def arrival(road: list[Cell]) -> LaneNode:
    """Returns the node at the end of a road."""
    return LaneNode(*road[-1], SIDES.index(side_towards(road[-2], road[-1])))


def middle_of_road(path: list[Cell], links: dict[Cell, list[Cell]], inset: float) -> list[Curve]:
    """Returns the middle of a road, across all tiles of a path but the first and the last.

    It also leads to the middle of a dead end at an end of the path. Between adjacent crossings it
    leads `inset` tiles into both.
    """
    headings = [SIDES.index(side_towards(tile, next_tile)) for tile, next_tile in pairwise(path)]
    first_lead, last_lead = _leads(path, links, inset)
    first_border = middle_of_side(path[0], headings[0])
    # The road starts inside its first tile if it leads there.
    x, y = moved(first_border, headings[0], -first_lead)
    pieces = [Curve(x, y, headings[0], first_lead)]
    # The tiles between the ends have two links, so a road crosses each of them in one way.
    for (row, column), (heading, exit_heading) in zip(path[1:-1], pairwise(headings), strict=True):
        pieces += middle_across_tile(
            Movement(row, column, heading, turn_between(heading, exit_heading))
        )
    x, y = middle_of_side(path[-1], (headings[-1] + 2) % 4)
    pieces.append(Curve(x, y, headings[-1], last_lead))
    return _joined_lines(pieces)


def _leads(path: list[Cell], links: dict[Cell, list[Cell]], inset: float) -> tuple[float, float]:
    """Returns how far a road leads into its first and its last tile."""
    # A tile with one link is a dead end, which the road reaches at the middle of the tile.
    first = 0.5 if len(links[path[0]]) == 1 else 0.0
    last = 0.5 if len(links[path[-1]]) == 1 else 0.0
    # Between adjacent crossings is no tile, so without a lead the road would have no length.
    are_adjacent_crossings = len(path) == 2 and first == last == 0
    return (inset, inset) if are_adjacent_crossings else (first, last)


def _joined_lines(pieces: list[Curve]) -> list[Curve]:
    """Joins the lines that follow each other, and leaves out pieces without length."""
    joined: list[Curve] = []
    for piece in pieces:
        if piece.length == 0:
            continue
        continues_line = bool(joined) and piece.curvature == 0 and joined[-1].curvature == 0
        if continues_line:
            line = joined.pop()
            piece = line._replace(length=line.length + piece.length)
        joined.append(piece)
    return joined


def middle_across_tile(movement: Movement, inset: float = 0.0, outset: float = 0.0) -> list[Curve]:
    """Returns the road's middle across the tile of a movement.

    It starts and ends at the borders, or `inset` and `outset` tiles inside them. The turn is not
    `BACK`.
    """
    tile, heading, exit_heading = movement.node.tile, movement.heading, movement.exit
    entry = middle_of_side(tile, (heading + 2) % 4)
    exit_point = middle_of_side(tile, exit_heading)
    start_x, start_y = moved(entry, heading, inset)
    # The arc bends to the left by this factor: -1 right, 0 straight, 1 left.
    bend = movement.turn - 1
    if bend == 0:
        return [Curve(start_x, start_y, heading, 1 - inset - outset)]
    # A quarter circle is equally far from both borders. The side with the smaller inset therefore
    # also has a line.
    deepest = max(inset, outset)
    radius = 0.5 - deepest
    arc_x, arc_y = moved(entry, heading, deepest)
    end_x, end_y = moved(exit_point, exit_heading, -deepest)
    pieces = [
        Curve(start_x, start_y, heading, deepest - inset),
        Curve(arc_x, arc_y, heading, radius * math.pi / 2, bend / radius),
        Curve(end_x, end_y, exit_heading, deepest - outset),
    ]
    return [piece for piece in pieces if piece.length > 0]
