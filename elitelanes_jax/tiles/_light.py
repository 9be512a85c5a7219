"""Light of photographs: the brightness of the ground without the tape on it."""

import cv2
import numpy as np
from numpy.typing import NDArray

_BRIGHTEST = 90.0  # asphalt in daylight, of 255
# The side of a tile at which the ground is measured: the time grows with its fourth power.
_MOST_PX = 96
_LEAST_GAIN = 0.6  # by which light is dimmed at most: brighter ground is no asphalt


def ground_of(image: NDArray[np.uint8], tile_px: float) -> NDArray[np.float32]:
    """Returns the brightness of the ground at each pixel of an RGB picture, smooth, without the bright lines.

    `tile_px` is the side of a tile in pixels. Lines are narrower than a fifth of a tile.
    """
    value = image.max(axis=2).astype(np.float32) + 4
    size = value.shape[1], value.shape[0]
    shrink = max(1.0, tile_px / _MOST_PX)
    tile_px /= shrink
    small = size if shrink == 1 else tuple(max(1, round(side / shrink)) for side in size)
    value = cv2.resize(value, small, interpolation=cv2.INTER_AREA)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(tile_px / 9) + 1,) * 2)
    ground = cv2.GaussianBlur(cv2.morphologyEx(value, cv2.MORPH_OPEN, disc), (0, 0), tile_px / 10)
    return np.asarray(cv2.resize(ground, size, interpolation=cv2.INTER_LINEAR), np.float32)


def even_light(image: NDArray[np.uint8], darkest: float) -> NDArray[np.uint8]:
    """Returns an RGB picture of a tile whose ground is nowhere darker than `darkest`, or brighter than asphalt is."""
    ground = ground_of(image, image.shape[0])
    gain = np.maximum(np.clip(ground, darkest, _BRIGHTEST) / ground, _LEAST_GAIN)
    return np.clip(np.rint(image * gain[..., None]), 0, 255).astype(np.uint8)
