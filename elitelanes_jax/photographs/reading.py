"""Reads photographs of phones and cameras, upright and without the distortion of a known lens."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax.photographs._picture_files import read_picture
from elitelanes_jax.photographs._upright import Turn
from elitelanes_jax.photographs.lenses import Lens, read_lens


@keeps_copies
class Photograph(NamedTuple):
    """A photograph. It has a read-only copy of its image.

    Attributes:
      name: the name of its file with its folder, for messages.
      image: uint8 ``[H, W, 3]``, RGB, upright.
      shrunk: how many times smaller than the file's picture it is.
      lens: the calibrated lens whose distortion was removed, for pictures of this size as the
        sensor has them; None if there is none.
      turn: how the sensor's picture became upright.
    """

    name: str
    image: NDArray[np.uint8]
    shrunk: int = 1
    lens: Lens | None = None
    turn: Turn = Turn()

    @staticmethod
    @name_wrong_arguments
    def read(file: str | Path, lens: Lens | str | Path | None = None) -> "Photograph":
        """Reads a JPEG or PNG file of a photograph, turned upright as its EXIF data say.

        Args:
          file: the file, of at most 128 MiB. A JPEG of more than 26 megapixels is read at a half, a
            quarter or an eighth of its size.
          lens: the calibration of the camera, a YAML file of ROS, Duckietown, OpenCV or Kalibr. The
            distortion of its lens is removed.

        Raises:
          InputError: for another file, transparent pixels, or a side below 200 or over 32,766
            pixels; the message says what to do.
        """
        file = Path(check_named("file", path, file))
        if isinstance(lens, str | Path):
            lens = read_lens(check_named("lens", path, lens))
        sensor, shrunk, exif = read_picture(file)
        if lens is not None:
            # The lens bends the sensor's picture, before anything turns it.
            lens = check_named(str(file), lens.scaled, sensor)
            sensor = lens.straighten_image(sensor)
        turn = Turn.of_exif(exif)
        image = turn.picture(sensor)
        # An array that is new and read-only is not copied.
        image.flags.writeable = False
        return Photograph(str(file), image, shrunk, lens, turn)

    def pixels_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` of the file's picture, seen upright, are in `image`."""
        # Whole numbers are the centres of pixels. Therefore half a pixel is added before sizes are
        # divided.
        pixels = (np.asarray(points, np.float64) + 0.5) / self.shrunk - 0.5
        if self.lens is None:
            return pixels
        height, width = self.image.shape[:2]
        sensor = self.lens.straighten(self.turn.sensor_pixels(pixels, width, height))
        return self.turn.pixels(sensor, width, height)
