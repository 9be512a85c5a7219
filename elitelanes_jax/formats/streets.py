"""The measures of the streets that tiles become."""

from dataclasses import dataclass

from elitelanes_jax._util.checks import coordinates, one_of, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, option


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
