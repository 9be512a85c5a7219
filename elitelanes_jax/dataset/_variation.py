"""What differs between pictures of one scene: background, shadows, lens, colours and compression.

Each step takes a random generator and a picture, uint8 ``[h, w, 3]``, RGB. Sizes of patterns are
shares of the picture's sides, so that small and large pictures vary alike. A step samples all its
values, so that a change of one range does not change the others.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy.typing import NDArray

from elitelanes_jax.dataset._transforms import VARIATION, Transforms

# The grains of a pattern along each side, from coarse to fine.
_GRAINS = (4, 16, 64)
# The most rectangles on a background.
_RECTANGLES = 5
# The distance from the middle of two grey levels, in grey levels, below which 32 bits may round to
# the wrong one.
_DOUBT = 0.002
# The number of samples along a streak of motion blur.
_STREAK_SAMPLES = 25


def varies(transforms: Transforms) -> bool:
    """Checks whether the functions of this module change anything."""
    return any(getattr(transforms, name) for name in VARIATION)


def vary_background(
    rng: np.random.Generator,
    image: UInt8[NDArray, "h w 3"],
    ground: Bool[NDArray, "h w"],
    sky: Bool[NDArray, "h w"],
    transforms: Transforms,
) -> UInt8[NDArray, "h w 3"]:
    """Shows random patterns instead of plain ground and sky.

    The share `background` of the pictures gets them. `ground` has the pixels of the ground that may
    change, and `sky` those above the horizon. The generator is this step's own: a picture that
    keeps its background leaves the patterns unsampled.
    """
    if rng.uniform() >= transforms.background:
        return image
    shown = image.copy()
    # All is sampled, but only the rows that are shown are painted.
    carpet, wall = _sample_pattern(rng, ground.shape), _sample_pattern(rng, ground.shape)
    clutter = _sample_clutter(rng, sky.shape)
    below, above = _rows_of(ground), _rows_of(sky)
    # The sky is shown separately, because only its pattern has rectangles.
    if below.stop:
        _show(shown[below], carpet.paint(below), ground[below])
    if above.stop:
        behind = wall.paint(slice(above.stop))
        clutter.paint(behind)
        _show(shown[above], behind[above], sky[above])
    return shown


def _rows_of(mask: Bool[NDArray, "h w"]) -> slice:
    """Returns the rows from the first to the last one that has pixels; none for an empty mask."""
    rows = np.flatnonzero(mask.any(axis=1))
    return slice(rows[0], rows[-1] + 1) if len(rows) else slice(0, 0)


def _show(
    image: UInt8[NDArray, "h w 3"], other: UInt8[NDArray, "h w 3"], mask: Bool[NDArray, "h w"]
) -> None:
    """Copies the pixels of a mask to an image, in a tenth of the time of an assignment."""
    cv2.copyTo(other, mask.view(np.uint8), image)


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
    tone = _Tone(2**gamma, 1 + saturation, np.array([1 + warmth, 1, 1 - warmth]))
    return tone.apply(image, light)


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


class _Tone(NamedTuple):
    """A change of colours.

    Attributes:
      exponent: the exponent of the tone curve, over 0.
      saturation: the factor of the colours' distance from grey, 0 or more.
      channels: float ``[3]``, the factors of red, green and blue.
    """

    exponent: float
    saturation: float
    channels: Float[NDArray, " 3"]

    def compute(
        self, image: UInt8[NDArray, "*n 3"], light: Float[NDArray, "*n"]
    ) -> UInt8[NDArray, "*n 3"]:
        """Applies the tone to pixels under a light, in 64 bits."""
        # The tone curve is applied to the light that reaches the camera, with white at 255.
        colours = 255 * (image * light[..., None] / 255) ** self.exponent
        # The mean of the channels has no colour, so it stays when the saturation changes.
        grey = colours.mean(axis=-1, keepdims=True)
        return _to_bytes((grey + (colours - grey) * self.saturation) * self.channels)

    def apply(
        self, image: UInt8[NDArray, "h w 3"], light: Float[NDArray, "h w"]
    ) -> UInt8[NDArray, "h w 3"]:
        """Returns what `compute` returns, in a fifth of the time.

        Of the power of a product, one factor has 256 values. The rest is computed in 32 bits, with
        an error of at most 0.001 grey levels. Pixels that are closer than `_DOUBT` to the middle of
        two grey levels are computed anew. Each channel is an array, because loops over the last
        axis would have three steps.
        """
        # The curve of a product is the product of the curves of colour and light.
        curve = (255 * (np.arange(256) / 255) ** self.exponent).astype(np.float32)
        share = light.astype(np.float32) ** np.float32(self.exponent)
        planes = np.empty((3, *light.shape), np.float32)
        for plane, channel in zip(planes, cv2.split(image), strict=True):
            np.multiply(cv2.LUT(channel, curve), share, out=plane)
        # The distance from grey is scaled: a part of the colour and a part of the mean are added.
        grey = planes[0] + planes[1]
        grey += planes[2]
        grey *= np.float32((1 - self.saturation) / 3)
        for plane, factor in zip(planes, self.channels.astype(np.float32), strict=True):
            plane *= np.float32(self.saturation)
            plane += grey
            plane *= factor
        # The fraction that rounding removes tells which pixels are in doubt.
        rounded = np.rint(planes)
        planes -= rounded
        np.abs(planes, out=planes)
        pixels = np.flatnonzero(planes > 0.5 - _DOUBT) % light.size
        np.clip(rounded, 0, 255, out=rounded)
        shown = np.asarray(cv2.merge([*rounded.astype(np.uint8)]), np.uint8)
        # Few pixels are in doubt, so the slow computation of these costs little.
        shown.reshape(-1, 3)[pixels] = self.compute(
            image.reshape(-1, 3)[pixels], light.reshape(-1)[pixels]
        )
        return shown


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


def _to_bytes(colours: Float[NDArray, "*n"]) -> UInt8[NDArray, "*n"]:
    return np.asarray(np.clip(np.rint(colours), 0, 255), np.uint8)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], grains: int) -> Float[NDArray, "h w"]:
    """Makes smooth noise between -1 and 1, with `grains` grains along each side."""
    grid = rng.uniform(-1, 1, (grains, grains)).astype(np.float32)
    # Linear interpolation between the grid's numbers makes the noise smooth.
    return np.asarray(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_LINEAR))


class _Pattern(NamedTuple):
    """Something like grass, carpet, concrete or a wall.

    A pattern has one colour, and coarse to fine noise of another one.

    Attributes:
      colour: float ``[2, 3]``, the mean colour, and the colour of the noise, RGB.
      weights: float ``[grains]``, the weight of the noise of each grain, 0 to 1.
      noises: float ``[h, w]`` for each grain, the noise from -1 to 1.
    """

    colour: Float[NDArray, "2 3"]
    weights: Float[NDArray, " grains"]
    noises: list[Float[NDArray, "h w"]]

    def paint(self, rows: slice) -> UInt8[NDArray, "r w 3"]:
        """Paints some rows."""
        first, *others = (noise[rows] for noise in self.noises)
        field = self.weights[0] * first
        for weight, noise in zip(self.weights[1:], others, strict=True):
            field += weight * noise
        # A colour at a time, because loops over the last axis would have three steps. OpenCV rounds
        # as `np.rint` does.
        planes = [
            cv2.add(field * grain, base, dtype=cv2.CV_8U) for base, grain in self.colour.T.tolist()
        ]
        return np.asarray(cv2.merge(planes), np.uint8)


def _sample_pattern(rng: np.random.Generator, shape: tuple[int, ...]) -> _Pattern:
    # Both colours have one grey level in common, from which the channels differ.
    colour = rng.uniform(10, 245) + rng.normal(size=(2, 3)) * [[30], [50]]
    # Squares make weak noise more frequent than strong noise.
    weights = rng.uniform(size=len(_GRAINS)) ** 2
    return _Pattern(colour, weights, [_noise(rng, shape, grains) for grains in _GRAINS])


class _Clutter(NamedTuple):
    """Rectangles on a picture: furniture, doors and windows.

    Attributes:
      corners: int ``[N, 2, 2]``, row and column of the first pixel, and of the one after the last.
      colours: uint8 ``[N, 3]``.
    """

    corners: Int[NDArray, "N 2 2"]
    colours: UInt8[NDArray, "N 3"]

    def paint(self, image: UInt8[NDArray, "h w 3"]) -> None:
        """Paints the rectangles on a picture, or on its upper rows."""
        for (low, high), colour in zip(self.corners, self.colours, strict=True):
            image[low[0] : high[0], low[1] : high[1]] = colour


def _sample_clutter(rng: np.random.Generator, shape: tuple[int, ...]) -> _Clutter:
    """Samples up to 5 rectangles for a picture of (rows, columns)."""
    # All rectangles are sampled, and the first ones are shown.
    count = rng.integers(_RECTANGLES + 1)
    centres, sides = rng.uniform(size=(_RECTANGLES, 2)), rng.uniform(0.02, 0.4, (_RECTANGLES, 2))
    colours = rng.uniform(0, 255, (_RECTANGLES, 3))
    # Slices from a negative index would count from the other edge, so the corners are clipped.
    corners = (
        (np.stack([centres - sides / 2, centres + sides / 2], axis=1) * shape).clip(0).astype(int)
    )
    return _Clutter(corners[:count], _to_bytes(colours[:count]))
