"""What does not fit in a map that somebody drew or changed by hand.

The faults are roads that end, signs of other roads, and crossings and streets that lack signs.
"""

from collections.abc import Iterable
from math import floor
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import pluralize
from elitelanes_jax._util.progress import announce, announce_at_end
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.signals import crossing_of, heading_of_reader
from elitelanes_jax.lanes.links import ends_of_roads
from elitelanes_jax.maps.furnishing.signs import (
    CONTROLS,
    LIGHT,
    TOPOLOGIES,
    crossings,
    has_free_corners,
    topology_sign,
)
from elitelanes_jax.maps.furnishing.space import has_road
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.maps.furnishing.street_names import street_name_faults
from elitelanes_jax.network.links import Cell


def warn_of_faults(name: str, road_map: RoadMap) -> None:
    """Prints what does not fit in a map in one line, at the end of a command that is not quiet."""
    for fault in _ends_of_roads(road_map.codes) + _wrong_signs(road_map):
        announce_at_end(name, fault)


def _ends_of_roads(codes: Int8[np.ndarray, "H W"]) -> list[str]:
    """Says at which tiles roads end."""
    ends = ends_of_roads(codes)
    if not ends:
        return []
    first = describe_cell(*ends[0])
    return [f"roads end at {pluralize(len(ends), 'tile')}, the first at {first}"]


class SignFaults(NamedTuple):
    """How the signs and lights of a map differ from what its crossings and streets need.

    Crossings lack signs only if the map has signs of crossings, and streets lack names only if the
    map has street names.

    Attributes:
      signs: the number of signs and lights of crossings, and of street names.
      wrong: the number of signs and lights that fit no crossing or road, or are on a road.
      crossings: the number of crossings.
      lacking: the number of crossings that have room for signs, and lack one at a stop line.
      without_room: the number of crossings that lack signs, and have no room for them.
      nameless: the number of roads and turns that have room for a street name and none.
    """

    signs: int
    wrong: int
    crossings: int
    lacking: int
    without_room: int
    nameless: int


def count_sign_faults(road_map: RoadMap) -> SignFaults:
    """Counts the signs that do not fit the roads, and the crossings and roads that lack signs.

    A stop line needs one sign of each class that the map has: topologies, and controls. A map may
    have lights without signs. Then its crossings lack none.
    """
    arms = crossings(road_map.codes)
    objects = road_map.objects or ()
    signs = [item for item in objects if _class_of(item) or item.kind == LIGHT]
    wrong = 0
    # The classes of the signs at each stop line: the crossing, and the side of the road.
    present: set[tuple[Cell, int, str]] = set()
    for sign in signs:
        tile = crossing_of(sign, arms)
        is_on_road = has_road(road_map.codes, (floor(sign.y), floor(sign.x)))
        if tile is None or is_on_road or not _fits(sign, arms[tile]):
            wrong += 1
        else:
            present.add((tile, (heading_of_reader(sign) + 2) % 4, _class_of(sign)))
    classes = {_class_of(sign) for sign in signs} - {""}
    lacking = without_room = 0
    for tile, sides in arms.items():
        needed = {(tile, side, name) for side in sides for name in classes}
        if needed <= present:
            continue
        if has_free_corners(road_map.codes, tile):
            lacking += 1
        else:
            without_room += 1
    names = street_name_faults(road_map.codes, objects)
    return SignFaults(
        signs=len(signs) + names.signs,
        wrong=wrong + names.wrong,
        crossings=len(arms),
        lacking=lacking,
        without_room=without_room,
        nameless=names.missing,
    )


def _wrong_signs(road_map: RoadMap) -> list[str]:
    """Says which signs do not fit the roads, and how many crossings and streets lack signs."""
    faults = count_sign_faults(road_map)
    parts = []
    if faults.wrong:
        verb = "does" if faults.wrong == 1 else "do"
        parts.append(f"{faults.wrong} of {faults.signs:,} signs {verb} not fit the roads")
    if faults.lacking:
        verb = "lacks" if faults.lacking == 1 else "lack"
        parts.append(f"{faults.lacking} of {pluralize(faults.crossings, 'crossing')} {verb} signs")
    if faults.nameless:
        verb = "lacks" if faults.nameless == 1 else "lack"
        parts.append(f"{pluralize(faults.nameless, 'street')} {verb} a name")
    texts = []
    if parts:
        texts.append(f"{' and '.join(parts)}, furnish places signs again")
    if faults.without_room:
        texts.append(_describe_without_room(faults.without_room, faults.crossings, "signs"))
    return texts


def announce_without_room(maps: Iterable[RoadMap], spec: FurnishSpec | None) -> None:
    """Announces how many crossings get no signs or lights because of a road at a corner."""
    if spec is None:
        return
    # With signs at all crossings, a crossing without room is an error.
    things = ["signs"] if spec.signs == "possible" else []
    things += ["lights"] if spec.lights else []
    if not things:
        return
    has_room = [
        has_free_corners(road_map.codes, tile)
        for road_map in maps
        for tile in crossings(road_map.codes)
    ]
    missing = has_room.count(False)
    if missing:
        announce(_describe_without_room(missing, len(has_room), " and ".join(things)))


def _describe_without_room(missing: int, count: int, things: str) -> str:
    """Returns a text: how many of a number of crossings have no room for signs or lights."""
    verb = "has" if missing == 1 else "have"
    crossing_words = pluralize(count, "crossing")
    return (
        f"{missing} of {crossing_words} {verb} no room for {things}, because a road is at a corner"
    )


def _class_of(item: MapObject) -> str:
    """Returns the class of a sign of crossings; "" for other objects."""
    if item.kind in TOPOLOGIES:
        return "topology"
    return "control" if item.kind in CONTROLS else ""


def _fits(sign: MapObject, sides: list[int]) -> bool:
    """Returns whether a sign fits its crossing.

    A driver at the end of an arm of the crossing has to read it, and it has to show that crossing.
    A traffic light always fits.
    """
    if sign.kind == LIGHT:
        return True
    heading = heading_of_reader(sign)
    if (heading + 2) % 4 not in sides:
        return False
    return sign.kind in CONTROLS or sign.kind == topology_sign(sides, heading)
