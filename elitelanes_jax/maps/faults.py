"""What does not fit in a map that somebody drew or changed by hand.

The faults are roads that end, and signs of other crossings.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.errors import pluralize
from elitelanes_jax._util.progress import announce_at_end
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.formats.signals import crossing_of, heading_of_reader
from elitelanes_jax.lanes.links import ends_of_roads
from elitelanes_jax.maps.furnishing.signs import (
    CONTROLS,
    TOPOLOGIES,
    crossings,
    has_free_corners,
    topology_sign,
)


def warn_of_faults(name: str, road_map: RoadMap) -> None:
    """Prints what does not fit in a map in one line, at the end of a command that is not quiet."""
    for fault in _ends_of_roads(road_map.codes) + _wrong_signs(road_map):
        announce_at_end(name, fault)


def _ends_of_roads(codes: Int8[np.ndarray, "H W"]) -> list[str]:
    """Says at which tiles roads end."""
    ends = ends_of_roads(codes)
    if not ends:
        return []
    row, column = ends[0]
    return [f"roads end at {pluralize(len(ends), 'tile')}, the first at row {row}, column {column}"]


class SignFaults(NamedTuple):
    """How the signs and lights of a map differ from what its crossings need.

    Attributes:
      signs: the number of signs and lights of crossings.
      wrong: the number of signs and lights that fit no crossing.
      crossings: the number of crossings.
      bare: the number of crossings that have room for signs and none, on a map that has signs.
    """

    signs: int
    wrong: int
    crossings: int
    bare: int


def count_sign_faults(road_map: RoadMap) -> SignFaults:
    """Counts the signs that do not fit the crossings, and the crossings without signs.

    Crossings without signs count if other crossings have signs.
    """
    arms = crossings(road_map.codes)
    # A crossing without free corners has no room for signs, so it cannot lack them.
    bare = {tile for tile in arms if has_free_corners(road_map.codes, tile)}
    kinds = {*CONTROLS, *TOPOLOGIES, "trafficlight"}
    signs = [item for item in road_map.objects or () if item.kind in kinds]
    wrong = 0
    for sign in signs:
        tile = crossing_of(sign, arms)
        # Even a wrong sign shows that somebody signed this crossing.
        bare.discard(tile)
        if tile is None or not _fits(sign, arms[tile]):
            wrong += 1
    # A map may have lights without signs. Then its crossings lack no signs.
    has_signs = any(sign.kind != "trafficlight" for sign in signs)
    return SignFaults(len(signs), wrong, len(arms), len(bare) if has_signs else 0)


def _wrong_signs(road_map: RoadMap) -> list[str]:
    """Says how many signs do not fit the crossings, and how many crossings have no signs.

    Crossings without signs count if other crossings have signs.
    """
    faults = count_sign_faults(road_map)
    parts = []
    if faults.wrong:
        verb = "does" if faults.wrong == 1 else "do"
        parts.append(f"{faults.wrong} of {faults.signs:,} signs {verb} not fit the crossings")
    if faults.bare:
        parts.append(f"{pluralize(faults.bare, 'crossing')} of {faults.crossings} without signs")
    if not parts:
        return []
    return [f"{' and '.join(parts)}, furnish places signs again"]


def _fits(sign: MapObject, sides: list[int]) -> bool:
    """Returns whether a sign fits its crossing.

    A driver at the end of an arm of the crossing has to read it, and it has to show that crossing.
    A traffic light always fits.
    """
    if sign.kind == "trafficlight":
        return True
    heading = heading_of_reader(sign)
    if (heading + 2) % 4 not in sides:
        return False
    return sign.kind in CONTROLS or sign.kind == topology_sign(sides, heading)
