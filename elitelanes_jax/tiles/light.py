"""Light of photographs: the brightness and the colour of the ground without the tape on it."""

import cv2
import numpy as np
from numpy.typing import NDArray

# Asphalt in daylight: its least and its largest brightness, of 255, and its colour, red, green and
# blue as parts of red. The colour is that of four photographs.
_DARKEST = 65.0
_BRIGHTEST = 90.0
_ASPHALT = np.array([1.0, 0.93, 0.82])
# The side of a tile at which the ground is measured: the time grows with its fourth power.
_MOST_PX = 96
# The largest brightness of a pixel without tape, as a multiple of the ground's.
_BARE = 1.2
# The largest ratio between the channels of a light. More is a ground in a colour of its own.
_MOST_TINT = 3.0
# The least factor of light: ground that would have to be darker is no asphalt.
_LEAST_GAIN = 0.6


def ground_of(image: NDArray[np.uint8], tile_px: float) -> NDArray[np.float32]:
    """Returns the brightness of the ground at each pixel of an RGB picture.

    The result is smooth, and does not contain the bright lines. `tile_px` is the side of a tile in
    pixels. Lines are narrower than a fifth of a tile.
    """
    # Noise is as large in dark pixels as in bright ones. The 4 grey levels keep quotients of dark
    # pixels near 1.
    value = image.max(axis=2).astype(np.float32) + 4
    size = value.shape[1], value.shape[0]
    shrink = max(1.0, tile_px / _MOST_PX)
    tile_px /= shrink
    small = size if shrink == 1 else tuple(max(1, round(side / shrink)) for side in size)
    value = cv2.resize(value, small, interpolation=cv2.INTER_AREA)
    # An opening by a disc that is wider than a line removes the lines.
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * round(tile_px / 9) + 1,) * 2)
    ground = cv2.GaussianBlur(cv2.morphologyEx(value, cv2.MORPH_OPEN, disc), (0, 0), tile_px / 10)
    return np.asarray(cv2.resize(ground, size, interpolation=cv2.INTER_LINEAR), np.float32)


def colours_on_ground(
    image: NDArray[np.uint8], tile_px: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Returns the colours of a picture relative to the ground, and how red and how yellow they are.

    The colours are ``[H, W, 3]``, and the others ``[H, W]``. Red exceeds both other channels in red
    tape. Red and green exceed blue in yellow tape. `tile_px` is that of `ground_of`.
    """
    relative = (image.astype(np.float32) + 4) / ground_of(image, tile_px)[..., None]
    red, green, blue = np.moveaxis(relative, -1, 0)
    return relative, red - np.maximum(green, blue), np.minimum(red, green) - blue


def even_light(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns an RGB picture of a tile in daylight.

    Its ground is everywhere as bright as asphalt.
    """
    ground = ground_of(image, image.shape[0])
    # Ground between the least and the largest brightness of asphalt keeps its light.
    gain = np.maximum(np.clip(ground, _DARKEST, _BRIGHTEST) / ground, _LEAST_GAIN)
    daylight = _whiten(image, ground) * gain[..., None]
    return np.clip(np.rint(daylight), 0, 255).astype(np.uint8)


def _whiten(image: NDArray[np.uint8], ground: NDArray[np.float32]) -> NDArray[np.float32]:
    """Divides the channels of a picture by the colour of its light; none gets darker."""
    bare = image.max(axis=2) + np.float32(4) < _BARE * ground
    if not bare.any():
        return image.astype(np.float32)
    # The median of bare ground, divided by the colour of asphalt, is the colour of the light.
    light = (np.median(image[bare], axis=0) + 2) / _ASPHALT
    gains = np.minimum(light.max() / light, _MOST_TINT).astype(np.float32)
    white = image * gains
    # A channel at its limit was brighter than the camera could say: otherwise a yellow line whose
    # red is at the limit would become green.
    brightest = white.max(axis=2, keepdims=True)
    return np.where(image == 255, brightest, white)
