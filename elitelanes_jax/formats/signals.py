"""Signs and lights of a map: the crossings that they rule, and the signals of OpenDRIVE that they become."""

from collections.abc import Collection
from itertools import count
from math import cos, hypot, pi, sin
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.lanes.links import Cell, linked_tiles, side_towards
from elitelanes_jax.network.codes import SIDES

_FAR = 1.5  # tiles from a crossing, where signs no longer belong to it
_RULES = {"sign_stop": "allway_stop", "trafficlight": "traffic_light"}
_KINDS = {rule: kind for kind, rule in _RULES.items()}
_OF_CROSSINGS = ("_stop", "_yield", "_t_light_ahead", "_intersect")  # ends of the names of their signs
_ASIDE = 0.3  # tiles from a sign towards its road: signs beside straight roads are 0.08 outside their tiles
_TYPES = {  # of the German road traffic regulations (StVO), and subtypes
    "sign_stop": ("206", "-1"),
    "sign_yield": ("205", "-1"),
    "sign_t_light_ahead": ("131", "-1"),
    "sign_do_not_enter": ("267", "-1"),
    "sign_oneway_left": ("220", "10"),
    "sign_oneway_right": ("220", "20"),
    "sign_pedestrian": ("350", "-1"),
    "sign_parking": ("314", "-1"),
}

Arrival = tuple[Cell, Cell]  # where a road ends: the tile that it leads to, and the tile before
_Passage = tuple[complex, complex, bool, Arrival]  # of a lane on a tile: see `_passages`


class Signal(NamedTuple):
    """A sign, or the light for one road."""

    number: int  # from 1
    kind: str  # one of `OBJECT_KINDS`
    thing: MapObject | None = None  # of the map; None if the right of way asks for a signal
    heading: float = 0.0  # of its reader, in radians counter-clockwise from east


def rights_of_way(road_map: RoadMap, streets: Streets) -> dict[Cell, str]:
    """Returns the right of way of each crossing: by its lights or stop signs, otherwise that of the streets.

    Raises:
      InputError: for `streets` that are not `Streets`.
    """
    check_named("streets", instance(Streets), streets)
    rules = {tile: streets.right_of_way for tile, others in linked_tiles(road_map.codes).items() if len(others) > 2}
    for thing in sorted(_signs(road_map), key=lambda thing: thing.kind):  # lights last: they overrule signs
        tile = crossing_of(thing, rules)
        if tile and thing.kind in _RULES:
            rules[tile] = _RULES[thing.kind]
    return rules


def list_signals(road_map: RoadMap, rules: dict[Cell, str], paths: list[list[Cell]]) -> dict[Arrival, list[Signal]]:
    """Lists the signals at the ends of roads: a sign for the drivers who read it, a light at all ends of its crossing.

    `rules` is the right of way of each crossing. It has signs or lights at all ends if the map has none there. `paths`
    are the tiles of all roads, with both ends. A sign of a crossing is at the road that leads there with the heading of
    its reader. Any other sign is at the road beside it; a street name is at the road that it faces.
    """
    numbers, own = count(1), set()
    ways = {(way[-1], way[-2]): way for path in paths for way in (path[::-1], path)}
    found: dict[Arrival, list[Signal]] = {end: [] for end in ways}
    headings = {(tile, before): SIDES.index(side_towards(before, tile)) for tile, before in found}
    passages = _passages(ways)
    middles = np.array([middle for middle, *_ in passages])
    for thing in _signs(road_map):
        tile = crossing_of(thing, rules)
        if thing.kind in _RULES:
            own.add(tile)
        if thing.kind == "trafficlight" and tile:
            for end in (end for end in found if end[0] == tile):
                found[end].append(Signal(next(numbers), thing.kind, thing, (1 - headings[end]) * pi / 2))
            continue
        heading = heading_of_reader(thing) if thing.kind.endswith(_OF_CROSSINGS) else None
        arrivals = [end for end in found if (end[0], headings[end]) == (tile, heading)]
        end = arrivals[0] if arrivals else _end_of_road(thing, passages, middles)
        found[end].append(Signal(next(numbers), thing.kind, thing, thing.angle + pi))
    for end in found:
        kind = _KINDS.get(rules.get(end[0], ""))
        if kind and end[0] not in own:
            found[end].append(Signal(next(numbers), kind))
    return found


def _passages(ways: dict[Arrival, list[Cell]]) -> list[_Passage]:
    """Lists each lane on each tile: the tile's middle, the direction, whether its road starts there, its road's end."""
    found: list[_Passage] = []
    for end, way in ways.items():
        middles = [complex(column + 0.5, -row - 0.5) for row, column in way]
        for index, middle in enumerate(middles):
            ahead = middles[min(index + 1, len(way) - 1)] - middles[max(index - 1, 0)]
            found.append((middle, ahead / abs(ahead), not index, end))
    return found


def _end_of_road(sign: MapObject, passages: list[_Passage], middles: NDArray[np.complex128]) -> Arrival:
    """Returns the end of the road at which a sign is, in the direction of its reader.

    If the sign faces the road, this is the direction that has the sign on its right. Numbers are rounded so that a
    turned map has the same ends.
    """
    place, front = complex(sign.x, -sign.y), complex(cos(sign.angle), sin(sign.angle))

    def gaps(*places: complex) -> NDArray[np.float64]:
        apart = np.array(places)[:, None] - middles
        return np.hypot(np.maximum(abs(apart.real) - 0.5, 0), np.maximum(abs(apart.imag) - 0.5, 0)).round(6)

    def preference(index: int) -> tuple[float, ...]:
        middle, ahead, starts, _ = passages[index]
        right = (1j * (place - middle) / ahead).real
        return -round((-front / ahead).real, 3), away[0, index], -round(right, 3), starts

    away = gaps(place + _ASIDE * front) if sign.kind == "sign_street_name" else gaps(place)
    if away.min() and sign.kind != "sign_street_name":  # left of the reader first, because traffic keeps right
        away = gaps(place - _ASIDE * 1j * front, place + _ASIDE * 1j * front)
    return passages[min(np.flatnonzero(away.min(0) == away.min()).tolist(), key=preference)][-1]


def _signs(road_map: RoadMap) -> list[MapObject]:
    objects = road_map.objects or ()
    return [thing for thing in objects if thing.kind.startswith("sign_") or thing.kind == "trafficlight"]


def crossing_of(thing: MapObject, crossings: Collection[Cell]) -> Cell | None:
    """Returns the crossing that a sign or a light belongs to, if one is near."""
    nearest = min(crossings, key=lambda tile: _distance(thing, tile), default=None)
    return nearest if nearest and _distance(thing, nearest) < _FAR else None


def _distance(thing: MapObject, tile: Cell) -> float:
    """Returns the distance in tiles of a light from a tile; of a sign from the far side as its reader sees it."""
    ahead, share = SIDES[heading_of_reader(thing)], 0 if thing.kind == "trafficlight" else 0.5
    return hypot(tile[1] + 0.5 + share * ahead.right - thing.x, tile[0] + 0.5 + share * ahead.down - thing.y)


def heading_of_reader(sign: MapObject) -> int:
    """Returns the heading of who drives towards a sign: 0 north, 1 east, 2 south, 3 west."""
    return round(-1 - sign.angle / (pi / 2)) % 4


def signal_element(signal: Signal, s: float, lane: int, streets: Streets, rows: int) -> str:
    """Returns the element of a signal for the drivers of a lane, at the distance `s` from the start of its road."""
    high = wide = streets.lane / 4
    above, place = 0.7 * streets.lane, ""
    if signal.thing:
        thing, above = signal.thing, 0
        high, wide = (size * streets.tile / TILE_SIZE for size in (thing.height, thing.footprint[1]))
        x, y = thing.x * streets.tile, (rows - thing.y) * streets.tile
        place = f'<positionInertial x="{x:.9g}" y="{y:.9g}" z="0" hdg="{signal.heading:.9g}"/>'
    kind, subtype = _TYPES.get(signal.kind, ("-1", "-1"))
    about = f'country="DE" type="{kind}" subtype="{subtype}" dynamic="no"'
    if signal.kind == "trafficlight":
        about = 'country="OpenDRIVE" type="1000001" subtype="-1" dynamic="yes"'
    return (
        f'<signal s="{s:.12g}" t="{1.25 * lane * streets.lane:.9g}" id="{signal.number}" name="{signal.kind}" '
        f'orientation="{"-" if lane > 0 else "+"}" {about} value="-1" zOffset="{above:.9g}" height="{high:.9g}" '
        f'width="{wide:.9g}"><validity fromLane="{lane}" toLane="{lane}"/>{place}</signal>'
    )
