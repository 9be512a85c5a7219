"""Signs and lights at crossings, by the appearance specification of Duckietown's operation manual.

"Traffic signs", Placement: from each stop line two signs are visible. The control is a stop sign,
or says that a traffic light is ahead. The topology is 4-way, or the T that fits. They are on the
opposite side of the crossing, on the corners of the cells next to it. These cells have no road or
are outside the map. The figure of a 4-way crossing has the topology at the far right corner. It has
the control at the far left corner, farther from the crossing's own corner.

"Traffic lights", Placement: the stand is outside the driving region, on a diagonal of the crossing,
and the lights are 0.2 m above its middle.
"""

from collections.abc import Mapping
from math import atan2

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.lanes.links import linked_tiles, side_towards
from elitelanes_jax.maps.furnishing.space import has_road, make_object
from elitelanes_jax.network.codes import CORNERS, SIDES
from elitelanes_jax.network.links import Cell

# These are the distances of the first sign, the second sign and the stand of a light. They are in
# tiles from the corner of the crossing, along both sides of the cell next to it. Signs of
# human-made maps have 0.04 to 0.08. Here 0.08 keeps the whole foot on the cell, and 0.2 keeps the
# second sign clear of the first one.
_FIRST_SIGN, _SECOND_SIGN, _LIGHT_STAND = 0.08, 0.2, 0.25

# The kind of a topology sign, by the way that is closed. Ways count quarter turns clockwise: 0 is
# straight on, 1 right, 3 left.
_TOPOLOGY = {0: "sign_T_intersect", 1: "sign_left_T_intersect", 3: "sign_right_T_intersect"}

TOPOLOGIES = (*_TOPOLOGY.values(), "sign_4_way_intersect")
"""The kinds of signs that show which ways a crossing has."""

CONTROLS = ("sign_stop", "sign_t_light_ahead")
"""The kinds of signs that say how a crossing is controlled."""

LIGHT = "trafficlight"
"""The kind of traffic lights."""


def crossings(codes: NDArray[np.int8]) -> dict[Cell, list[int]]:
    """Returns the sides by which each crossing is linked, as indices of `SIDES`.

    The crossings are in the order of rows.
    """
    arms = {}
    for tile, neighbours in linked_tiles(codes).items():
        if len(neighbours) > 2:
            arms[tile] = [SIDES.index(side_towards(tile, neighbour)) for neighbour in neighbours]
    return arms


def has_free_corners(codes: NDArray[np.int8], crossing: Cell) -> bool:
    """Returns whether no cell diagonally next to a crossing has a road."""
    row, column = crossing
    return not any(has_road(codes, (row + down, column + right)) for down, right in CORNERS)


def place_signs(
    arms: Mapping[Cell, list[int]], free: set[Cell], which: str, lit: set[Cell]
) -> list[MapObject]:
    """Returns the signs of all crossings, without tags.

    Each stop line has the topology sign first, then the control sign. `arms` has the sides of the
    roads at each crossing. The crossings in `lit` have traffic lights. Crossings that are not
    `free`, because a road is at a corner, are left out if `which` is "possible", and raise
    `InputError` if it is "all".
    """
    signs = []
    for crossing, sides in arms.items():
        if crossing in free:
            control = "sign_t_light_ahead" if crossing in lit else "sign_stop"
            for side in sides:
                signs += _signs_for(crossing, sides, (side + 2) % 4, control)
        elif which == "all":
            raise InputError(
                "signs",
                "no roads at the four corners of each crossing",
                f"one at {describe_cell(*crossing)}",
                "signs=possible leaves such crossings out",
            )
    return signs


def place_light(crossing: Cell, corner: int) -> MapObject:
    """Returns the traffic light of a crossing whose stand is at one of its four corners."""
    down, right = CORNERS[corner]
    x, y = (
        crossing[1] + 0.5 + right * (0.5 + _LIGHT_STAND),
        crossing[0] + 0.5 + down * (0.5 + _LIGHT_STAND),
    )
    # The arm points back over the crossing. y points south, but angles are counter-clockwise.
    return make_object(LIGHT, x, y, atan2(down, -right))


def sign_kinds(code: int, lights: float) -> set[str]:
    """Returns the kinds of signs at crossings of a code.

    `lights` is the share of the crossings that have traffic lights.
    """
    sides = [index for index, side in enumerate(SIDES) if code & side.bit]
    # A driver may enter by each side, with the heading to the opposite one.
    kinds = {topology_sign(sides, (side + 2) % 4) for side in sides}
    stop, light_ahead = CONTROLS
    if lights < 1:
        kinds.add(stop)
    if lights:
        kinds.add(light_ahead)
    return kinds


def topology_sign(sides: list[int], heading: int) -> str:
    """Returns the kind of sign that shows a crossing with these sides.

    The sign is for a driver who enters the crossing with a heading.
    """
    # A crossing has three or four arms, so at most one way is closed.
    closed = [(side - heading) % 4 for side in range(4) if side not in sides]
    return _TOPOLOGY[closed[0]] if closed else "sign_4_way_intersect"


def _signs_for(crossing: Cell, sides: list[int], heading: int, control: str) -> list[MapObject]:
    """Returns the two signs that a driver reads who enters a crossing with a heading."""
    ahead, right = SIDES[heading], SIDES[(heading + 1) % 4]
    topology = topology_sign(sides, heading)
    # The sign faces back towards the driver. y points south, but angles are counter-clockwise.
    angle = atan2(ahead.down, -ahead.right)
    signs = []
    # Both signs are on the opposite side, the topology to the right of the road and the control to
    # the left.
    for kind, to_right in ((topology, 0.5 + _FIRST_SIGN), (control, -0.5 - _SECOND_SIGN)):
        x = crossing[1] + 0.5 + (0.5 + _FIRST_SIGN) * ahead.right + to_right * right.right
        y = crossing[0] + 0.5 + (0.5 + _FIRST_SIGN) * ahead.down + to_right * right.down
        signs.append(make_object(kind, x, y, angle))
    return signs
