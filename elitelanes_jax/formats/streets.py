"""The streets that tiles become: their measures, and the bounds of lanes in metres.

Files have positions in metres, x east and y north of the grid's south-west corner. Here such a
position is the complex number x + y·i. A lane's left bound is the middle of the road. Its right
bound is the width of a lane beside it.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Complex128, Float

from elitelanes_jax._util.checks import coordinates, one_of, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, option
from elitelanes_jax.lanes.curves import lane_polyline, middle_of_side
from elitelanes_jax.lanes.movements import BACK, Movement

Line: TypeAlias = Complex128[np.ndarray, " P"]
"""Points in metres, x + y·i."""


@dataclass(frozen=True)
class Streets(Record):
    """Measures of the streets that tiles become.

    The defaults suit SUMO's own cars, 5 m long: between adjacent crossings there is room for two of
    them. On shorter streets waiting cars block the crossings behind them. ``Streets(tile_size=8.43)``
    has the proportions of Duckietown, 58.5 cm a tile and 22.2 cm from the middle of the road to its
    white line; a Duckiebot has 2.6 m there.

    Attributes:
      tile_size: side of a tile in metres, 0.01 to 1000, and more than two lanes.
      lane: width of a lane in metres, 0.001 to 500.
      speed: limit in metres a second, 0.001 to 100.
      right_of_way: the right of way at crossings: "allway_stop", the meaning of stop lines on all
        sides, "priority", "right_before_left" or "traffic_light".
      origin: the latitude, -80 to 72, and the longitude, -180 to 180, of the grid's south-west
        corner, in degrees.
    """

    tile_size: float = option(30.0, real(0.01, 1000))
    lane: float = option(3.2, real(0.001, 500))
    speed: float = option(8.33, real(0.001, 100))
    right_of_way: str = option(
        "allway_stop", one_of("allway_stop", "priority", "right_before_left", "traffic_light")
    )

    origin: tuple[float, float] = option((0.0, 9.0), coordinates)

    def check_together(self) -> None:
        """Checks that a tile has room for two lanes."""
        if self.tile_size <= 2 * self.lane:
            # If the tile has its default size, the user changed the lane.
            if self.tile_size == Streets.tile_size:
                raise InputError(
                    "lane",
                    f"less than half of a tile, {self.tile_size / 2:g} m",
                    f"{self.lane:g} m",
                )
            raise InputError(
                "tile_size", f"more than two lanes, {2 * self.lane:g} m", f"{self.tile_size:g} m"
            )


def to_metres(points: Float[np.ndarray, "P 2"], streets: Streets, height: int) -> Line:
    """Converts points in tiles to metres east + north·i of the grid's south-west corner.

    Points are tiles east and south of the north-west corner. `height` is the grid's number of rows.
    """
    return (points[:, 0] + (height - points[:, 1]) * 1j) * streets.tile_size


def bounds(movement: Movement, streets: Streets, height: int) -> tuple[Line, Line]:
    """Returns the left and the right bound of a movement's lane in metres.

    Both bounds have the same number of points. At a dead end the left bound leads around an island,
    a tenth of a lane wide.
    """
    lane = streets.lane / streets.tile_size
    if movement.turn == BACK:
        # The left bound starts and ends in the middle of the road. Between its ends it is the
        # outline of the island.
        left = lane_polyline(movement, lane / 20)
        left[[0, -1]] = middle_of_side(movement.node.tile, (movement.heading + 2) % 4)
    else:
        left = lane_polyline(movement, 0.0)
    right = lane_polyline(movement, lane)
    return to_metres(left, streets, height), to_metres(right, streets, height)
