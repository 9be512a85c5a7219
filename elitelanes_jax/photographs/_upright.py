"""Turns pictures upright, as their EXIF data say."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

# The tag of the orientation in EXIF data.
_ORIENTATION = 0x0112
# The bytes of an entry of EXIF data, and of the number of entries before the first one.
_ENTRY, _COUNT = 12, 2


class Turn(NamedTuple):
    """How a picture of the sensor becomes upright.

    Attributes:
      transposed: whether rows and columns are exchanged first.
      mirrored: whether left and right are exchanged then.
      flipped: whether top and bottom are exchanged then.
    """

    transposed: bool = False
    mirrored: bool = False
    flipped: bool = False

    @staticmethod
    def of_exif(exif: bytes) -> "Turn":
        """Reads the turn from EXIF data. Without a valid orientation nothing is turned."""
        orientation = _orientation_of(exif)
        return Turn(orientation >= 5, orientation in (2, 3, 6, 7), orientation in (3, 4, 7, 8))

    def picture(self, sensor: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Returns the upright picture ``[H, W, ...]`` of the sensor's one."""
        upright = sensor.swapaxes(0, 1) if self.transposed else sensor
        upright = upright[:, ::-1] if self.mirrored else upright
        return np.ascontiguousarray(upright[::-1] if self.flipped else upright)

    def pixels(self, sensor: NDArray[np.float64], width: int, height: int) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` of the sensor are in the upright picture.

        `width` and `height` are the upright picture's.
        """
        return self._exchanged(sensor[:, ::-1] if self.transposed else sensor, width, height)

    def sensor_pixels(
        self, upright: NDArray[np.float64], width: int, height: int
    ) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` of the upright picture are on the sensor, see `pixels`."""
        pixels = self._exchanged(upright, width, height)
        return pixels[:, ::-1] if self.transposed else pixels

    def _exchanged(
        self, pixels: NDArray[np.float64], width: int, height: int
    ) -> NDArray[np.float64]:
        # An exchange of sides is its own inverse.
        x, y = pixels.T
        x = width - 1 - x if self.mirrored else x
        y = height - 1 - y if self.flipped else y
        return np.stack([x, y], axis=1)


def _orientation_of(exif: bytes) -> int:
    """Returns the orientation in EXIF data: 1 to 8, and 1 if they have none."""
    order: Literal["little", "big"] = "little" if exif[:2] == b"II" else "big"
    # The entries of the first table follow their number. Bytes 4 to 8 say where that is.
    table = int.from_bytes(exif[4:8], order)
    count = int.from_bytes(exif[table : table + _COUNT], order)
    for start in range(table + _COUNT, table + _COUNT + count * _ENTRY, _ENTRY):
        if int.from_bytes(exif[start : start + 2], order) == _ORIENTATION:
            # The value follows the tag, the type and the number of values.
            orientation = int.from_bytes(exif[start + 8 : start + 10], order)
            return orientation if 1 <= orientation <= 8 else 1
    return 1
