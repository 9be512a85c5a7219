"""Pictures of AprilTags."""

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.tags import LARGEST_TAG


def draw_tag(number: UserValue) -> NDArray[np.uint8]:
    """Draws an AprilTag of the family 36h11, uint8 ``[8, 8]``, 0 or 255: its black square, a pixel for each bit.

    Raises:
      InputError: for a number that is not 0 to 586.
    """
    number = check_named("tag", whole(0, LARGEST_TAG), number)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    # OpenCV has the family upside down: only then is the first row of tag 0 the first six bits of its code.
    return np.asarray(cv2.aruco.generateImageMarker(family, number, 8)[::-1, ::-1], np.uint8)
