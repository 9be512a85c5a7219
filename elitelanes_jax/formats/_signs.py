"""Which crossing a sign or a light of a map belongs to, and what it says there."""

from collections.abc import Iterable
from math import hypot, pi

from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.formats.graph import Cell, linked_tiles
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.network.codes import SIDES

_FAR = 1.5  # tiles from the middle of a crossing, where signs no longer belong to it
_RULES = {"sign_stop": "allway_stop", "trafficlight": "traffic_light"}


def signs_of(codes: AnyArray) -> list[MapObject]:
    """Returns the signs and lights of a `RoadMap`, in their order; none of plain codes."""
    objects: Iterable[MapObject] = getattr(codes, "objects", None) or ()
    return [thing for thing in objects if thing.kind.startswith("sign_") or thing.kind == "trafficlight"]


def heading_of_reader(sign: MapObject) -> int:
    """Returns the heading of who drives towards a sign: 0 north, 1 east, 2 south, 3 west."""
    return round(-1 - sign.angle / (pi / 2)) % 4


def distance_from(thing: MapObject, tile: Cell) -> float:
    """Returns how far a sign or light is from the crossing that it is for, in tiles.

    A sign is behind the crossing, as its reader sees it: the distance is from the middle of the crossing's far side. A
    light is beside it.
    """
    ahead = SIDES[heading_of_reader(thing)]
    share = 0.0 if thing.kind == "trafficlight" else 0.5
    return hypot(tile[1] + 0.5 + share * ahead.right - thing.x, tile[0] + 0.5 + share * ahead.down - thing.y)


def rights_of_way(codes: AnyArray) -> dict[Cell, str]:
    """Returns the right of way, as `Streets` has it, of crossings where the map has lights or stop signs."""
    crossings = [tile for tile, others in linked_tiles(codes).items() if len(others) > 2]
    rules: dict[Cell, str] = {}
    for thing in sorted(signs_of(codes), key=lambda thing: thing.kind):  # lights last: they overrule signs
        if thing.kind in _RULES and crossings:
            tile = min(crossings, key=lambda tile: distance_from(thing, tile))
            if distance_from(thing, tile) < _FAR:
                rules[tile] = _RULES[thing.kind]
    return rules
