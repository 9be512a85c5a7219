"""One elementary tile, in memory."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Tile(NamedTuple):
    """One elementary tile.

    Attributes:
      name: of its folder, ``<kind>_<n>``.
      code: the sides it opens, as a tile code.
      image: uint8 ``[S, S, 3]``, RGB.
      road: bool ``[S, S]``, the drivable surface.
      red: bool ``[S, S]``, the stop lines.
      yellow: bool ``[S, S]``, the lane separators.
      layers: bool ``[S, S]``, further masks, by name.
      points: float64 ``[N, 2]``, x to the right and y down in pixels from the top left corner of the image, by name.
    """

    name: str
    code: int
    image: NDArray[np.uint8]
    road: NDArray[np.bool_]
    red: NDArray[np.bool_]
    yellow: NDArray[np.bool_]
    layers: Mapping[str, NDArray[np.bool_]] = {}
    points: Mapping[str, NDArray[np.float64]] = {}
