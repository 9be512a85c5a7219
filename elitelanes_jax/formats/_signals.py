"""Signs and lights as signals of OpenDRIVE: at the end of the road whose drivers read them, with their own position."""

from collections.abc import Iterable
from itertools import count
from math import pi
from typing import NamedTuple

from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats._signs import distance_from, heading_of_reader, signs_of
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.graph import Cell
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.streets import Streets
from elitelanes_jax.network.codes import SIDE_TOWARDS, SIDES

_KINDS = {"allway_stop": "sign_stop", "traffic_light": "trafficlight"}  # by right of way
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

Arrival = tuple[Cell, Cell]
"""Where a road ends: the tile that it leads to, and the tile before."""


class Signal(NamedTuple):
    """A sign, or the light for one road.

    Attributes:
      number: from 1.
      kind: one of `OBJECT_KINDS`.
      thing: of the map; None if the right of way asks for a signal.
      heading: of its reader, in radians counter-clockwise from east.
    """

    number: int
    kind: str
    thing: MapObject | None = None
    heading: float = 0.0


def list_signals(codes: AnyArray, rules: dict[Cell, str], ends: Iterable[Arrival]) -> dict[Arrival, list[Signal]]:
    """Lists the signals at the ends of roads.

    Args:
      codes: of the map, or a `RoadMap` with signs and lights: each sign is at one end, a light at all ends of its tile.
      rules: the right of way of each crossing where the map has no signs or lights of its own for it.
      ends: of all roads.
    """
    numbers = count(1)
    found: dict[Arrival, list[Signal]] = {end: [] for end in ends}
    headings = {end: SIDES.index(SIDE_TOWARDS[end[0][0] - end[1][0], end[0][1] - end[1][1]]) for end in found}
    towards: dict[int, list[Arrival]] = {}
    for end, heading in headings.items():
        towards.setdefault(heading, []).append(end)
    for thing in signs_of(codes):
        lit = thing.kind == "trafficlight"
        able = found if lit else towards.get(heading_of_reader(thing), found)
        nearest = min(able, key=lambda end: distance_from(thing, end[0]))
        for end in [end for end in found if end[0] == nearest[0]] if lit else [nearest]:
            angle = (1 - headings[end]) * pi / 2 if lit else thing.angle + pi
            found[end].append(Signal(next(numbers), thing.kind, thing, angle))
    for end in found:
        if (kind := _KINDS.get(rules.get(end[0], ""))) is not None:
            found[end].append(Signal(next(numbers), kind))
    return found


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
        f'<signal s="{s:.9g}" t="{1.25 * lane * streets.lane:.9g}" id="{signal.number}" name="{signal.kind}" '
        f'orientation="{"-" if lane > 0 else "+"}" {about} value="-1" zOffset="{above:.9g}" height="{high:.9g}" '
        f'width="{wide:.9g}"><validity fromLane="{lane}" toLane="{lane}"/>{place}</signal>'
    )
