"""Signs and lights of a map, the crossings that they rule, and their signals.

The signals are those of OpenDRIVE that the signs and lights become.
"""

from collections.abc import Collection
from itertools import count, product
from math import cos, floor, hypot, pi, sin
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64

from elitelanes_jax.formats._roads import arrival
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.movements import LaneNode
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.links import Cell

# A sign at this distance in tiles, or farther away, belongs to no crossing.
_FAR = 1.5

# The right of way that a sign or a light at a crossing gives.
_RULES = {"sign_stop": "allway_stop", "trafficlight": "traffic_light"}
_KINDS = {rule: kind for kind, rule in _RULES.items()}

# The ends of the names of signs that belong to crossings.
_OF_CROSSINGS = ("_stop", "_yield", "_t_light_ahead", "_intersect")

# The distance in tiles by which a sign is moved towards its road. Signs beside straight roads are
# 0.08 outside their tiles.
_ASIDE = 0.3


class _Passage(NamedTuple):
    """A lane on a tile. Positions are complex: x east, y north.

    Attributes:
      middle: the middle of the tile.
      ahead: the direction of the lane, of size 1.
      starts: whether its road starts there.
      end: the node at the end of its road.
    """

    middle: complex
    ahead: complex
    starts: bool
    end: LaneNode


class Signal(NamedTuple):
    """A sign, or the light for one road.

    Attributes:
      number: the number of the signal, from 1.
      kind: one of `OBJECT_KINDS`.
      item: the object of the map; None if the right of way asks for a signal.
      heading: the direction of its reader, in radians counter-clockwise from east.
    """

    number: int
    kind: str
    item: MapObject | None = None
    heading: float = 0.0


def rights_of_way(road_map: RoadMap, links: dict[Cell, list[Cell]], usual: str) -> dict[Cell, str]:
    """Returns the right of way of each crossing.

    The lights or the stop signs of a crossing decide. Without them, the right of way is the `usual`
    one. `links` are the linked neighbours of each tile.
    """
    rules = {tile: usual for tile, neighbours in links.items() if len(neighbours) > 2}
    # In alphabetical order lights come after signs, which they overrule.
    for sign in sorted(_signs(road_map), key=lambda sign: sign.kind):
        crossing = crossing_of(sign, rules)
        if crossing and sign.kind in _RULES:
            rules[crossing] = _RULES[sign.kind]
    return rules


def list_signals(
    road_map: RoadMap, rights: dict[Cell, str], roads: list[list[Cell]]
) -> dict[LaneNode, list[Signal]]:
    """Lists the signals at the ends of roads, by the nodes where their drivers arrive.

    A sign is a signal for the drivers who read it. A light is a signal at all ends of its crossing.

    `rights` is the right of way of each crossing. It has signs or lights at all ends if the map has
    none there. `roads` are the tiles of all roads, with both ends. A sign of a crossing is at the
    road that leads there with the heading of its reader. Any other sign is at the road beside it; a
    street name is at the road that it faces.
    """
    numbers = count(1)
    # The tiles of each road in the direction of its traffic, by the node where that traffic
    # arrives.
    ways: dict[LaneNode, list[Cell]] = {}
    ends_at: dict[Cell, list[LaneNode]] = {}
    for road in roads:
        for way in (road[::-1], road):
            end = arrival(way)
            ways[end] = way
            ends_at.setdefault(end.tile, []).append(end)
    signals: dict[LaneNode, list[Signal]] = {end: [] for end in ways}
    passages = _passages(ways)
    middles = np.array([passage.middle for passage in passages])
    ruled_by_signs = set()
    for sign in _signs(road_map):
        crossing = crossing_of(sign, rights)
        if sign.kind in _RULES:
            ruled_by_signs.add(crossing)
        # One light of the map becomes a signal at each end, for the drivers who arrive there.
        if sign.kind == "trafficlight" and crossing:
            for end in ends_at[crossing]:
                angle = (1 - end.heading) * pi / 2
                signals[end].append(Signal(next(numbers), sign.kind, sign, angle))
            continue
        at_crossing: LaneNode | None = None
        # A sign of a crossing belongs to the drivers who read it. The crossing may have no road
        # with their heading.
        if crossing and sign.kind.endswith(_OF_CROSSINGS):
            at_crossing = LaneNode(*crossing, heading_of_reader(sign))
        if at_crossing in ways:
            end = at_crossing
        else:
            end = _end_of_road(sign, passages, middles)
        signals[end].append(Signal(next(numbers), sign.kind, sign, sign.angle + pi))
    # Crossings whose right of way asks for signs or lights get them if the map has none there.
    for end, signals_there in signals.items():
        kind = _KINDS.get(rights.get(end.tile, ""))
        if kind and end.tile not in ruled_by_signs:
            signals_there.append(Signal(next(numbers), kind))
    return signals


def _passages(ways: dict[LaneNode, list[Cell]]) -> list[_Passage]:
    """Lists each lane on each tile."""
    passages: list[_Passage] = []
    for end, way in ways.items():
        middles = [complex(column + 0.5, -row - 0.5) for row, column in way]
        for index, middle in enumerate(middles):
            # The first and the last tile of a road have one neighbour on it.
            before, after = max(index - 1, 0), min(index + 1, len(way) - 1)
            ahead = middles[after] - middles[before]
            passages.append(_Passage(middle, ahead / abs(ahead), index == 0, end))
    return passages


def _end_of_road(
    sign: MapObject, passages: list[_Passage], middles: Complex128[np.ndarray, " P"]
) -> LaneNode:
    """Returns the end of the road at which a sign is, in the direction of its reader.

    If the sign faces the road, this is the direction that has the sign on its right. Numbers are
    rounded so that a turned map has the same ends.
    """
    place, front = complex(sign.x, -sign.y), complex(cos(sign.angle), sin(sign.angle))

    def gaps(*places: complex) -> Float64[np.ndarray, "N P"]:
        """Returns the distances of places from the tiles of all passages."""
        # A tile is a square of side 1. The distance of a point inside is 0.
        apart = np.array(places)[:, None] - middles
        beyond_x = np.maximum(abs(apart.real) - 0.5, 0)
        beyond_y = np.maximum(abs(apart.imag) - 0.5, 0)
        return np.hypot(beyond_x, beyond_y).round(6)

    if sign.kind == "sign_street_name":
        away = gaps(place + _ASIDE * front)
    else:
        away = gaps(place)
        # A sign on a road belongs to this road. Other signs are moved towards the roads on both
        # sides.
        if away.min():
            # What is left of the reader comes first, because traffic keeps right.
            left = _ASIDE * 1j * front
            away = gaps(place - left, place + left)

    def preference(index: int) -> tuple[float, ...]:
        passage = passages[index]
        # Of equally near lanes, the best leads most directly against the sign. Then the one nearer
        # to the first position counts, then the one that has the sign farther to its right.
        against = (-front / passage.ahead).real
        right = (1j * (place - passage.middle) / passage.ahead).real
        return -round(against, 3), away[0, index], -round(right, 3), passage.starts

    nearest = np.flatnonzero(away.min(0) == away.min()).tolist()
    return passages[min(nearest, key=preference)].end


def is_signal(item: MapObject) -> bool:
    """Returns whether an object is a sign or a light."""
    return item.kind.startswith("sign_") or item.kind == "trafficlight"


def _signs(road_map: RoadMap) -> list[MapObject]:
    """Returns the signs and lights of a map."""
    return [item for item in road_map.objects or () if is_signal(item)]


def crossing_of(sign: MapObject, crossings: Collection[Cell]) -> Cell | None:
    """Returns the crossing that a sign or a light belongs to, if a crossing is near.

    Of equally near crossings, returns the first. Returns None if no crossing is near.
    """
    row, column = floor(sign.y), floor(sign.x)
    # Crossings outside this window are at least `_FAR` away. A large map has too many to measure
    # them all.
    cells = product(range(row - 2, row + 3), range(column - 2, column + 3))
    near = [cell for cell in cells if cell in crossings]
    nearest = min(near, key=lambda tile: _distance(sign, tile), default=None)
    if nearest and _distance(sign, nearest) < _FAR:
        return nearest
    return None


def _distance(sign: MapObject, tile: Cell) -> float:
    """Returns the distance in tiles of a sign or a light from a crossing.

    The distance of a light is from the middle of the tile. That of a sign is from the far side, as
    the reader of the sign sees it.
    """
    ahead = SIDES[heading_of_reader(sign)]
    # Signs are on the opposite side of the crossing, half a tile beyond its middle.
    share = 0 if sign.kind == "trafficlight" else 0.5
    x = tile[1] + 0.5 + share * ahead.right
    y = tile[0] + 0.5 + share * ahead.down
    return hypot(x - sign.x, y - sign.y)


def heading_of_reader(sign: MapObject) -> int:
    """Returns the heading of who drives towards a sign: 0 north, 1 east, 2 south, 3 west."""
    # The reader drives against the sign's angle. Headings are clockwise from north, and angles
    # counter-clockwise from east.
    return round(-1 - sign.angle / (pi / 2)) % 4
