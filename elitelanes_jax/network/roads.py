"""The road and the lanes of a tile, in tiles: their measures, and where the road is. For NumPy and JAX alike."""

from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.codes import SIDES

LANE_OFFSET = 0.2
"""From the road's middle to the centre of a lane, in tiles: half of the yellow tape and half of the lane."""

HALF_ROAD = 0.222 / 0.585
"""From the road's middle to the inner edge of the white tape, in tiles: half of the yellow tape and the lane."""


def on_road(code: AnyArray, east: AnyArray, south: AnyArray) -> AnyArray:
    """Returns whether points are on the road of their tile, between the inner edges of the white tape.

    The road keeps away from closed sides and from the corners between open ones. On a turn it is a ring about the
    corner between its sides. A stub's road ends as far from the closed sides.

    `code` is the code of a tile, `east` and `south` are tiles from its western and northern side, 0 to 1: arrays of
    NumPy or JAX that broadcast against each other. Returns bool.
    """
    edge = 0.5 - HALF_ROAD
    depths = (south, 1 - east, 1 - south, east)  # from each side, clockwise from north
    opens = [(code & side.bit) > 0 for side in SIDES]
    road = (code > 0) & (code < 16)
    for depth, is_open in zip(depths, opens, strict=True):
        road = road & (is_open | (depth >= edge))
    for one, other in ((0, 1), (1, 2), (2, 3), (3, 0)):
        square = depths[one] * depths[one] + depths[other] * depths[other]
        both = SIDES[one].bit | SIDES[other].bit
        road = road & (((code & both) != both) | (square >= edge * edge))
        road = road & ((code != both) | (square <= (1 - edge) * (1 - edge)))
    return road
