"""What differs between pictures of one scene from above: background, light, colours, compression.

Compression and motion are also those of robots' views.

Each step takes a random generator and a picture, uint8 ``[h, w, 3]``, RGB. Sizes of patterns are
shares of the picture's sides, so that small and large pictures vary alike. A step samples all its
values, so that a change of one range does not change the others.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax.dataset._transforms import VARIATION, Transforms

# The grains of a pattern along each side, from coarse to fine.
_GRAINS = (4, 16, 64)
# The number of samples along a streak of motion blur.
_STREAK_SAMPLES = 25


def varies(transforms: Transforms) -> bool:
    """Checks whether the functions of this module change anything."""
    return any(getattr(transforms, name) for name in VARIATION)


def vary_background(
    rng: np.random.Generator,
    image: UInt8[NDArray, "h w 3"],
    ground: Bool[NDArray, "h w"],
    share: float,
) -> UInt8[NDArray, "h w 3"]:
    """Shows a random pattern instead of plain ground, in a share of the pictures.

    `ground` has the pixels of the ground that may change. The generator is this step's own: a
    picture that keeps its background leaves the pattern unsampled.
    """
    rows = np.flatnonzero(ground.any(axis=1))
    if rng.uniform() >= share or not len(rows):
        return image
    shown = image.copy()
    # Only the rows that are shown are painted.
    below = slice(rows[0], rows[-1] + 1)
    carpet = _paint_pattern(rng, ground.shape, below)
    # OpenCV copies in a tenth of the time of an assignment.
    cv2.copyTo(carpet, ground[below].view(np.uint8), shown[below])
    return shown


def vary_light(
    rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], transforms: Transforms
) -> UInt8[NDArray, "h w 3"]:
    """Changes the light and the colours of a picture.

    These are shadows, the light of the corners, the tone curve, saturation and colour temperature.
    """
    depth, edge, level, corners = rng.uniform(size=4) * (
        transforms.shadow,
        1,
        1,
        transforms.vignette,
    )
    # A coarse noise of 5 x 5 grains gives few, large shadows.
    field = _noise(rng, image.shape[:2], 5)
    # The edge of the shadow has a steepness from 4 to 64, evenly in its logarithm.
    light = _make_light(field, depth, level, 2 ** (2 + 4 * edge), corners)
    gamma, saturation, warmth = rng.uniform(-1, 1, 3) * (
        transforms.gamma,
        transforms.saturation,
        transforms.warmth,
    )
    # Warmth raises red as much as it lowers blue, and leaves green.
    channels = 1 + warmth, 1.0, 1 - warmth
    return _apply_tone(image, light, 2**gamma, 1 + saturation, channels)


def _make_light(
    field: Float[NDArray, "h w"], depth: float, level: float, steepness: float, corners: float
) -> Float[NDArray, "h w"]:
    """Returns (1 - depth * shadow) * (1 - corners * away), float64.

    The shadow is a sigmoid of the field, and `away` is half the square of the distance from the
    middle. Each step overwrites the last one, because new arrays of this size take longer than most
    steps.
    """
    light = np.subtract(field, level, dtype=np.float64)
    light *= -steepness
    # Beyond -30 to 30, the sigmoid differs from 0 or 1 by less than 1e-13.
    np.minimum(light, 30, out=light)
    np.maximum(light, -30, out=light)
    np.exp(light, out=light)
    light += 1
    # Up to here, `light` is the denominator of the sigmoid.
    np.divide(depth, light, out=light)
    np.subtract(1, light, out=light)
    # Each axis takes half of the loss, so that the corners lose the full share.
    rows, columns = (
        ((np.arange(side) + 0.5) / side * 2 - 1) ** 2 / 2 * corners for side in field.shape
    )
    away = 1 - rows[:, None] - columns
    light *= away
    return light


def _apply_tone(
    image: UInt8[NDArray, "h w 3"],
    light: Float[NDArray, "h w"],
    exponent: float,
    saturation: float,
    channels: tuple[float, float, float],
) -> UInt8[NDArray, "h w 3"]:
    """Applies light, a tone curve with white at 255, saturation, and factors of the channels.

    Each channel is an array, because loops over the last axis would have three steps.
    """
    # The curve of a product is the product of the curves of colour and light. The first of them has
    # 256 values.
    curve, share = 255 * (np.arange(256) / 255) ** exponent, light**exponent
    planes = [cv2.LUT(plane, curve) * share for plane in cv2.split(image)]
    # The mean of the channels has no colour, so it stays when the saturation changes.
    grey = (planes[0] + planes[1] + planes[2]) / 3
    for index, factor in enumerate(channels):
        colours = (grey + (planes[index] - grey) * saturation) * factor
        planes[index] = np.clip(np.rint(colours), 0, 255).astype(np.uint8)
    return np.asarray(cv2.merge(planes), np.uint8)


def vary_motion(
    rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], motion: float
) -> UInt8[NDArray, "h w 3"]:
    """Smears the picture along a random direction, by at most `motion` pixels."""
    length, angle = rng.uniform(0, motion), rng.uniform(0, np.pi)
    # The kernel has the streak's half length on each side of its middle.
    reach = int(np.ceil(length / 2))
    if not reach:
        return image
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    # Each sample along the streak counts for its nearest pixel.
    along = np.linspace(-length / 2, length / 2, _STREAK_SAMPLES)
    x, y = (np.rint(reach + along * part).astype(int) for part in (np.cos(angle), np.sin(angle)))
    # Several samples may be in one pixel. An assignment would count them once.
    np.add.at(kernel, (y, x), 1 / _STREAK_SAMPLES)
    if np.count_nonzero(kernel) == 1:
        # The streak is within a pixel.
        return image
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE), np.uint8)


def compress(
    rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], most: float
) -> UInt8[NDArray, "h w 3"]:
    """Writes and reads the picture as JPEG, of a quality between 100 and 100 - 90 `most`."""
    # The number is drawn also without compression, as all others are.
    quality = round(100 - 90 * rng.uniform(0, most))
    if not most:
        return image
    # OpenCV writes and reads channels in the order blue, green, red.
    blue_first = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, coded = cv2.imencode(".jpg", blue_first, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(
        cv2.cvtColor(np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR)), cv2.COLOR_BGR2RGB), np.uint8
    )


def _noise(rng: np.random.Generator, shape: tuple[int, ...], grains: int) -> Float[NDArray, "h w"]:
    """Makes smooth noise between -1 and 1, with `grains` grains along each side."""
    grid = rng.uniform(-1, 1, (grains, grains)).astype(np.float32)
    # Linear interpolation between the grid's numbers makes the noise smooth.
    return np.asarray(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_LINEAR))


def _paint_pattern(
    rng: np.random.Generator, shape: tuple[int, int], rows: slice
) -> UInt8[NDArray, "r w 3"]:
    """Paints some rows of something like grass, carpet or concrete.

    A pattern has one colour, and coarse to fine noise of another one.
    """
    # Both colours have one grey level in common, from which the channels differ.
    colour = rng.uniform(10, 245) + rng.normal(size=(2, 3)) * [[30], [50]]
    # Squares make weak noise more frequent than strong noise.
    weights = rng.uniform(size=len(_GRAINS)) ** 2
    first, *others = (_noise(rng, shape, grains)[rows] for grains in _GRAINS)
    field = weights[0] * first
    for weight, noise in zip(weights[1:], others, strict=True):
        field += weight * noise
    # A colour at a time, because loops over the last axis would have three steps. OpenCV rounds as
    # `np.rint` does.
    planes = [cv2.add(field * grain, base, dtype=cv2.CV_8U) for base, grain in colour.T.tolist()]
    return np.asarray(cv2.merge(planes), np.uint8)
