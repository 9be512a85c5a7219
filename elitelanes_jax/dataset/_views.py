"""Views of a map: one transform for its picture and its masks (paper, section "Method").

Geometry is one 3 x 3 matrix for all layers, applied by OpenCV's warps: the picture by linear
interpolation, masks and labels by the nearest pixel, so that their values stay exact. Light,
colour, blur and noise change the picture alone.

Points are (x, y) in pixels from the picture's top left corner, so that the first pixel reaches from
(0, 0) to (1, 1).
"""

from collections.abc import Sequence
from statistics import NormalDist
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.dataset._transforms import Transforms

# The scale below which a picture is first scaled down by area. Linear interpolation reads 2 x 2
# pixels, and skips others below 1/2. Perspective shrinks parts of a view more than its middle, so
# the limit is higher. On turned views of a town with 64 pixels a tile, the colours of both
# ways are there off by 3.9 (linear) and 4.8 (area) levels from the mean of all pixels that a pixel
# shows; at a scale of 0.4 by 6.9 and 8.0, and at 0.3 by 9.6 and 8.6.
_SHRUNK = 0.6

# The 256 quantiles of a normal distribution, one for each random byte.
_NORMAL = np.array([NormalDist().inv_cdf((part + 0.5) / 256) for part in range(256)])


class DrawnTransform(NamedTuple):
    """One drawn transform.

    Attributes:
      matrix: float64 ``[3, 3]``, maps points of the plain map to points of the view.
      size: (height, width) of the view in pixels.
      gains: float ``[3]``, factors of the channels R, G, B relative to mid-grey.
      offset: grey levels added to all channels.
      blur: standard deviation in pixels.
      noise: standard deviation in grey levels.
      noise_seed: the seed of the noise.
    """

    matrix: NDArray[np.float64]
    size: tuple[int, int]
    gains: tuple[float, float, float]
    offset: float
    blur: float
    noise: float
    noise_seed: int


def draw_view(
    rng: np.random.Generator, transforms: Transforms, size: tuple[int, int]
) -> DrawnTransform:
    """Draws a view of a map of (height, width) pixels.

    Raises `InputError` for a crop larger than the map at the smallest scale.
    """
    height, width = size
    smallest = min(1.0, transforms.scale[0])
    if transforms.crop > min(size) * smallest:
        shown = f"{width * smallest:g} x {height * smallest:g} pixels at the smallest scale"
        raise InputError("transforms", f"a crop within the map, {shown}", transforms.crop)
    # All numbers are always drawn, and scaled by the ranges afterwards. Therefore a change of one
    # range does not change the others.
    quarters = int(rng.integers(4))
    turn, zoom = rng.uniform(-1, 1), rng.uniform()
    bends, position = rng.uniform(-1, 1, (4, 2)), rng.uniform(0, 1, 2)
    light, contrast, *colours = rng.uniform(-1, 1, 5).tolist()
    blur, noise = rng.uniform(0, 1, 2).tolist()
    noise_seed = int(rng.integers(2**63))
    turns, angle = quarters * transforms.quarter_turns, turn * transforms.rotation
    low, high = transforms.scale
    # The logarithm of the scale is uniform.
    scale = low * (high / low) ** zoom
    # An odd number of quarter turns swaps the height and the width.
    frame = (width, height) if turns % 2 else (height, width)
    # The map's middle stays the middle of the view: rotation and scale are about it, and the
    # perspective moves the corners.
    matrix = _shift(-width / 2, -height / 2)
    matrix = _turn(90 * turns + angle) @ np.diag([scale, scale, 1]) @ matrix
    matrix = (
        _bend(bends * transforms.perspective, frame) @ _shift(frame[1] / 2, frame[0] / 2) @ matrix
    )
    # The window is placed after all other changes, so that its position is in pixels of the view.
    if transforms.crop:
        sides = np.array([frame[1], frame[0]])
        # The middle part of the frame, which the map covers.
        shown = sides * min(1.0, scale)
        first = np.ceil((sides - shown) / 2)
        last = np.maximum(first, np.floor((sides + shown) / 2 - transforms.crop))
        x, y = np.floor(first + position * (last - first + 1))
        matrix, frame = _shift(-x, -y) @ matrix, (transforms.crop, transforms.crop)
    # Contrast and colours are factors around mid-grey, which itself does not change.
    gain = 1 + contrast * transforms.contrast
    red, green, blue = (gain * (1 + colour * transforms.colour) for colour in colours)
    return DrawnTransform(
        # The matrix is scaled to a last entry of 1, so that equal views have equal matrices in the
        # metadata.
        matrix=matrix / matrix[2, 2],
        size=frame,
        gains=(red, green, blue),
        # Brightness changes by a share of mid-grey, 128 of 255 levels.
        offset=128 * light * transforms.light,
        blur=blur * transforms.blur,
        noise=noise * transforms.noise,
        noise_seed=noise_seed,
    )


def warp(
    layer: NDArray[np.uint8], view: DrawnTransform, outside: int | Sequence[int] = 0
) -> NDArray[np.uint8]:
    """Warps a layer into the view, with a value or colour beyond the map.

    A picture, uint8 ``[H, W, 3]``, by linear interpolation, or by area if it shrinks much; a mask
    or labels, uint8 ``[H, W]``, by the nearest pixel.
    """
    height, width = view.size
    # A view that changes nothing needs no copy.
    if layer.shape[:2] == view.size and np.array_equal(view.matrix, np.eye(3)):
        return layer
    matrix = view.matrix
    scale = _middle_scale(matrix, view.size)
    if layer.ndim == 3 and scale < _SHRUNK:
        # Interpolation uses the nearest pixels only, and would skip all others between.
        before = layer.shape[:2]
        layer = np.asarray(
            cv2.resize(layer, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8
        )
        # The rounded size of the smaller layer, not the scale itself, leads to the matrix for it.
        matrix = matrix @ np.diag([before[1] / layer.shape[1], before[0] / layer.shape[0], 1])
    return np.asarray(
        cv2.warpPerspective(
            layer,
            # OpenCV's coordinates refer to the centres of pixels.
            _shift(-0.5, -0.5) @ matrix @ _shift(0.5, 0.5),
            (width, height),
            flags=cv2.INTER_LINEAR if layer.ndim == 3 else cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=np.broadcast_to(outside, 3).tolist(),
        ),
        np.uint8,
    )


def photograph(image: NDArray[np.uint8], view: DrawnTransform) -> NDArray[np.uint8]:
    """Applies the view's light, blur and noise to a warped picture, uint8 ``[h, w, 3]``, RGB."""
    if view.gains != (1, 1, 1) or view.offset:
        # A table of 256 levels per channel is faster than arithmetic on all pixels.
        levels = np.arange(256)[:, None] - 128.0
        table = np.clip(np.rint(levels * view.gains + 128 + view.offset), 0, 255).astype(np.uint8)
        image = np.asarray(cv2.LUT(image, table[None]), np.uint8)
    if view.blur > 0.1:
        # A smaller blur changes no pixel.
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), view.blur), np.uint8)
    if view.noise:
        # Random bytes mapped to 256 quantiles of a normal distribution are four times as fast as
        # drawing from it.
        random_bytes = np.random.default_rng(view.noise_seed).bytes(image.size)
        grain = np.frombuffer(random_bytes, np.uint8).reshape(image.shape)
        table = np.rint(_NORMAL * view.noise).astype(np.int16)
        image = np.asarray(cv2.add(image, cv2.LUT(grain, table), dtype=cv2.CV_8U), np.uint8)
    return image


def _middle_scale(matrix: NDArray[np.float64], size: tuple[int, int]) -> float:
    """Returns the mean scale of a transform along both axes, in the middle of the view."""
    height, width = size
    middle = np.array([width / 2, height / 2, 1.0])
    # A point with coordinates p = A x + t and the divisor w = h x + 1 is drawn at p / w. The
    # derivative by x is (A - (p / w) h) / w.
    point = np.linalg.solve(matrix, middle)
    divisor = matrix[2] @ (point / point[2])
    derivative = (matrix[:2, :2] - np.outer(middle[:2], matrix[2, :2])) / divisor
    # The root of the change of area is the mean scale.
    return float(np.sqrt(abs(np.linalg.det(derivative))))


def _shift(x: float, y: float) -> NDArray[np.float64]:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


def _turn(degrees: float) -> NDArray[np.float64]:
    """Returns a rotation counter-clockwise, as seen with y downward; exact for quarter turns."""
    # Cosines of quarter turns are not exact. Therefore quarters are powers of a matrix of whole
    # numbers.
    quarters, rest = divmod(degrees, 90)
    cos, sin = np.cos(np.radians(rest)), np.sin(np.radians(rest))
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    quarter = np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]])
    return np.asarray(np.linalg.matrix_power(quarter, int(quarters) % 4) @ turn)


def _bend(bends: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """Returns the perspective that moves the corners by shares ``[4, 2]`` of the sides."""
    if not bends.any():
        return np.eye(3)
    # OpenCV finds the perspective from the corners before and after the shift.
    sides = np.array([size[1], size[0]], np.float64)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    return np.asarray(
        cv2.getPerspectiveTransform(
            (corners * sides).astype(np.float32), ((corners + bends) * sides).astype(np.float32)
        ),
        np.float64,
    )
