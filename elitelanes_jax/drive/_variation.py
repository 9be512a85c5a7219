"""What differs between views of one scene: background, shadows, lens and colours.

`dataset --transform` varies them in the same way. First `draw_look` draws the numbers of a view.
Then `lay_background` and `photograph` make the picture. Colours are rounded once, in the last step.

XLA for processors repeats a formula for each of its uses. Therefore whatever several pixels or all
colours use is computed by `once`.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt32
from numpy.typing import NDArray

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._hashing import fork, hash_bits, hash_normal, uniform
from elitelanes_jax.drive.camera_options import Camera, Variation
from elitelanes_jax.network.xla import once

# The grains of a background's coarse and middle noise along each side of a picture.
_COARSE = (4, 16)

# The approximate number of grains of a background's finest noise along the rows of a picture.
_FINEST = 64
# The grains of a shadow along each side.
_SHADOWS = 5
# The least and the largest steepness of a shadow's edge, as powers of 2: 4 and 64.
_SOFT, _HARD = 2, 6
# The range of the grey level that the ground or the sky of a changed picture has in common, and the
# deviations of each channel's mean and of its noise from it.
_DARK, _BRIGHT = 10, 245
_TINT, _GRAIN = 30, 50
# The most rectangles of a background.
_RECTANGLES = 5
# The least and the largest side of a rectangle, as shares of the picture's side.
_NARROW, _BROAD = 0.02, 0.4
# The number of the seed of a sky's haze, among those that are forked from the seed of a look.
_HAZE = 1000
# Contrast changes colours around this level.
_MID_GREY = 128
# The samples along a streak of motion blur.
_STREAK = 25
# The pixels that a blur reaches in each direction.
_LENS = 2
# The bits of a float32 for its fraction.
_MANTISSA = 23
# The bits of the root of a half as a float32.
_ROOT_HALF_BITS = 0x3F3504F3
# Of log2((1 + x) / (1 - x)) / x in powers of x²; error 2e-7 for fractions.
_LOG2 = (2.885391, 0.9614714, 0.5989572)

# The coefficients of 2**x from -0.5 to 0.5 in powers of x. The error is 4e-6.
_EXP2 = (0.9999992, 0.693122, 0.2402498, 0.05591704, 0.00956051)


HORIZONS = np.array([(115, 210, 255), (165, 150, 125), (40, 40, 40), (235, 235, 235)], np.float32)
"""Gym-duckietown's horizons: a blue sky, a wall, darkness, a white hall; RGB."""


Planes: TypeAlias = list[Float[Array, "rows columns"]]
"""Red, green and blue of a picture, 0 to 255.

Separate arrays, because XLA fuses arithmetic on each into one loop.
"""

Colour: TypeAlias = Sequence[Numeric]
"""Red, green and blue, 0 to 255."""


class Background(NamedTuple):
    """The numbers of the patterns of one picture's ground and sky.

    Attributes:
      below: float32 ``[3]``, what the noise adds to the ground's colour.
      above: float32 ``[3]``, what the noise adds to the sky's colour.
      weights: float32 ``[3]``, of the noise, from coarse to fine.
      rectangles: float32 ``[5, 4]``, first row, first column, and those after the last; empty ones
        are not drawn.
      paints: float32 ``[5, 3]``, their colours.
    """

    below: Float[Array, "3"]
    above: Float[Array, "3"]
    weights: Float[Array, "3"]
    rectangles: Float[Array, "5 4"]
    paints: Float[Array, "5 3"]


class Look(NamedTuple):
    """The numbers of one picture's variation. A None is a step that is left out.

    Attributes:
      seed: uint32, of all patterns and the noise.
      ground: float32 ``[3]``, its mean colour.
      sky: float32 ``[3]``, its mean colour.
      haze: float32 ``[3]``, what the sky's colour at the picture's upper edge has more than at the
        horizon.
      background: the patterns of ground and sky; None for plain ones.
      shadow: float32 ``[3]``, its depth, the level where it begins, and its steepness.
      vignette: float32, the share of the light that the corners lose.
      exponent: float32, of the tone curve.
      mixing: float32 ``[3, 3]``, for each colour the factor of itself, the factor of the mean, and
        an addend.
      kernel: float32 ``[5, 5]``, of the blur.
      noise: float32, standard deviation.
      gains: float32 ``[3]``, factors of the colours around mid-grey.
      offset: float32, grey levels that are added to all colours.
      blur: float32, standard deviation of the lens's blur in pixels.
    """

    seed: UInt32[Array, ""]
    ground: Float[Array, "3"]
    sky: Float[Array, "3"]
    haze: Float[Array, "3"] | None
    background: Background | None
    shadow: Float[Array, "3"] | None
    vignette: Float[Array, ""] | None
    exponent: Float[Array, ""] | None
    mixing: Float[Array, "3 3"] | None
    kernel: Float[Array, "5 5"] | None
    noise: Float[Array, ""] | None
    gains: Float[Array, "3"]
    offset: Float[Array, ""]
    blur: Float[Array, ""]


# The uniform numbers of a look by what they are for. All are always drawn, so that a range changes
# no other value.
_NUMBERS = {
    "horizon": 2,
    "changed": 1,
    "bases": 2,
    "tints": 48,
    "weights": 3,
    "rectangles": 20,
    "paints": 15,
    "amount": 1,
    "shadow": 3,
    "vignette": 1,
    "gamma": 1,
    "saturation": 1,
    "warmth": 1,
    "light": 1,
    "contrast": 1,
    "colour": 3,
    "motion": 2,
    "blur": 1,
    "noise": 1,
}

LOOK_NUMBERS = sum(_NUMBERS.values())
"""The number of uniform numbers that a look needs."""


def draw_look(
    seed: UInt32[Array, ""], uniforms: Float[Array, " N"], variation: Variation, camera: Camera
) -> Look:
    """Draws the numbers of one picture of a camera.

    They follow from a seed and `LOOK_NUMBERS` uniform numbers.
    """
    parts = jnp.split(uniforms, np.cumsum(list(_NUMBERS.values()))[:-1])
    numbers = dict(zip(_NUMBERS, parts, strict=True))
    ground, sky = (
        jnp.stack([jnp.asarray(part) for part in colour]) for colour in (camera.ground, camera.sky)
    )
    if variation.horizon is not None:
        other, horizon = numbers["horizon"]
        # The first number says whether the horizon is replaced, and the second one by which.
        chosen = jnp.asarray(HORIZONS)[(horizon * len(HORIZONS)).astype(jnp.int32)]
        sky = jnp.where(other < variation.horizon, chosen, sky)
    haze = None
    if variation.haze is not None:
        haze = _signed(uniform(hash_bits(fork(seed, _HAZE), (3,)))) * variation.haze
    # A changed picture replaces the plain colours by means of its own, which patterns vary.
    background = None
    if variation.background is not None:
        changed = numbers["changed"][0] < variation.background
        means, background = _draw_background(numbers, changed, (camera.rows, camera.columns))
        ground, sky = (
            jnp.where(changed, mean, plain)
            for mean, plain in zip(means, (ground, sky), strict=True)
        )
    shadow = None
    if variation.shadow is not None:
        depth, steepness, level = numbers["shadow"]
        # The steepness is drawn on a logarithmic scale.
        power = _SOFT + (_HARD - _SOFT) * steepness
        shadow = jnp.stack([depth * variation.shadow, level, 2**power])
    vignette = None if variation.vignette is None else numbers["vignette"][0] * variation.vignette
    exponent = (
        None if variation.gamma is None else 2 ** (_signed(numbers["gamma"][0]) * variation.gamma)
    )
    mixing, gains, offset = _mix_colours(numbers, variation)
    blur = numbers["blur"][0] * (0 if variation.blur is None else variation.blur)
    kernel = _draw_kernel(numbers["motion"], blur, variation)
    noise = None
    if variation.noise is not None or camera.noise is not None:
        drawn = numbers["noise"][0] * (0 if variation.noise is None else variation.noise)
        # Independent noises add up by their variances.
        noise = jnp.hypot(drawn, 0 if camera.noise is None else camera.noise)
    return Look(
        *(seed, ground, sky, haze, background, shadow, vignette, exponent, mixing, kernel, noise),
        *(gains, offset, blur),
    )


def _signed(number: Array) -> Array:
    return 2 * number - 1


def _draw_background(
    numbers: dict[str, Array], changed: Bool[Array, ""], size: tuple[int, int]
) -> tuple[Float[Array, "2 3"], Background]:
    """Returns the mean colours of ground and sky, and their patterns.

    If they are not changed, patterns add nothing.
    """
    # Sums of four uniform numbers have nearly a normal distribution: mean 2, variance 1 / 3.
    normal = (numbers["tints"].reshape(4, 2, 2, 3).sum(axis=0) - 2) * np.float32(np.sqrt(3))
    bases = _DARK + (_BRIGHT - _DARK) * numbers["bases"][:, None]
    means = bases + _TINT * normal[0]
    below, above = jnp.where(changed, _GRAIN * normal[1], 0)
    centres, sides = numbers["rectangles"].reshape(2, _RECTANGLES, 2)
    # Centres and sides are shares of the picture's sides.
    sides = _NARROW + (_BROAD - _NARROW) * sides
    corners = jnp.concatenate([centres - sides / 2, centres + sides / 2], axis=1) * np.tile(
        np.array(size, np.float32), 2
    )
    amount = jnp.where(changed, numbers["amount"] * (_RECTANGLES + 1), 0).astype(jnp.int32)
    drawn = jnp.arange(_RECTANGLES) < amount
    # A rectangle without area covers no pixel.
    rectangles = jnp.where(drawn[:, None], jnp.floor(jnp.maximum(corners, 0)), 0)
    paints = 255 * numbers["paints"].reshape(_RECTANGLES, 3)
    return means, Background(below, above, numbers["weights"] ** 2, rectangles, paints)


def _mix_colours(
    numbers: dict[str, Array], variation: Variation
) -> tuple[Array | None, Array, Array]:
    """Returns saturation, warmth, contrast, colour and light as one linear step.

    Warmth and saturation come first, then contrast around mid-grey; without clipping in between.
    Also returns the gains of contrast and colour, and the offset of the light.
    """
    ranges = (
        variation.saturation,
        variation.warmth,
        variation.light,
        variation.contrast,
        variation.colour,
    )

    def draw(name: str) -> Array:
        span = getattr(variation, name)
        return jnp.zeros_like(numbers[name]) if span is None else _signed(numbers[name]) * span

    saturation, warmth = draw("saturation")[0], draw("warmth")[0]
    gain = (1 + draw("contrast")) * (1 + draw("colour"))
    warm = 1 + warmth * jnp.array([1.0, 0.0, -1.0])
    # Saturation moves a colour away from the mean of the three colours.
    itself, mean = gain * warm * (1 + saturation), -gain * warm * saturation
    offset = _MID_GREY * draw("light")
    addend = _MID_GREY - _MID_GREY * gain + offset
    mixing = jnp.stack([itself, mean, addend], axis=-1)
    return None if all(span is None for span in ranges) else mixing, gain, offset[0]


def _draw_kernel(motion: Array, blur: Array, variation: Variation) -> Array | None:
    """Returns the kernel of a lens's blur after a streak of motion; None for neither."""
    if variation.motion is None and variation.blur is None:
        return None
    reach = jnp.arange(-_LENS, _LENS + 1)
    # A deviation of 0 would divide by 0. This small one leaves a single tap.
    deviation = jnp.maximum(blur, 1e-3)
    taps = jnp.exp(-0.5 * (reach / deviation) ** 2)
    taps = taps / taps.sum()
    length, turn = motion
    length = length * (0 if variation.motion is None else variation.motion)
    # Samples along the streak are rounded to pixels. A streak of at most 2.9 pixels reaches no
    # farther than the eight neighbours.
    along = jnp.linspace(-0.5, 0.5, _STREAK) * length
    down, right = jnp.round(along * jnp.sin(np.pi * turn)), jnp.round(along * jnp.cos(np.pi * turn))
    kernel = jnp.zeros((2 * _LENS + 1, 2 * _LENS + 1))
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            # The streak shifts the Gaussian to each pixel, weighted by the samples that fall there.
            share = ((down == row) & (right == column)).mean()
            kernel += share * jnp.outer(_shifted(taps, row), _shifted(taps, column))
    # Taps that a shift moves out of the kernel are lost. The division makes up for them.
    return kernel / kernel.sum()


def _shifted(taps: Array, by: int) -> Array:
    return jnp.pad(taps, 1)[1 - by : len(taps) + 1 - by]


def _spread(size: int, grains: int) -> Float[NDArray, "size grains"]:
    """Returns the matrix that stretches `grains` values over `size` pixels.

    Values are interpolated linearly between the centres of the grains.
    """
    # The positions are the centres of the pixels, counted in grains from the first grain's centre.
    positions = (np.arange(size) + 0.5) * grains / size - 0.5
    weights = [np.interp(positions, np.arange(grains), grain) for grain in np.eye(grains)]
    return np.stack(weights, axis=1).astype(np.float32)


def _smooth(
    seed: UInt32[Array, ""], grains: int, shape: tuple[int, ...]
) -> Float[Array, "rows columns"]:
    """Returns smooth noise, -1 to 1, with `grains` grains along each side."""
    rows, columns = shape
    return (
        _spread(rows, grains)
        @ _grid(fork(seed, grains), (grains, grains))
        @ _spread(columns, grains).T
    )


def _fine(seed: UInt32[Array, ""], shape: tuple[int, ...]) -> Float[Array, "rows columns"]:
    """Returns smooth noise with fine grains.

    The side of a grain is a whole number of pixels, about 1/64 of the rows.
    """
    # With whole pixels, a fine grain needs no matrix: all grains are interpolated at the same
    # shares.
    side = max(1, round(shape[0] / _FINEST))
    counts = [-(-pixels // side) + 1 for pixels in shape]
    grid = once(lambda: _grid(fork(seed, _FINEST), (counts[0], counts[1])))
    tall = once(lambda: _interpolate(grid, side, axis=0))
    return once(lambda: _interpolate(tall, side, axis=1)[: shape[0], : shape[1]])


def _interpolate(grid: Array, side: int, axis: int) -> Array:
    """Puts `side` values between neighbours along an axis."""
    last = grid.shape[axis] - 1
    before, after = (
        jax.lax.slice_in_dim(grid, 0, last, axis=axis),
        jax.lax.slice_in_dim(grid, 1, None, axis=axis),
    )
    # The shares are the centres of the pixels between two neighbours.
    shares = (np.arange(side, dtype=np.float32) + np.float32(0.5)) / side
    between = [before * (1 - share) + after * share for share in shares]
    shape = list(before.shape)
    shape[axis] *= side
    return jnp.stack(between, axis + 1).reshape(shape)


def _grid(seed: UInt32[Array, ""], shape: tuple[int, ...]) -> Float[Array, "rows columns"]:
    return _signed(uniform(hash_bits(seed, shape)))


def lay_background(
    road: Planes, paved: Float[Array, "rows columns"], sky: Float[Array, "rows _"], look: Look
) -> Planes:
    """Shows ground and sky where a picture shows neither a road nor an object.

    Args:
      road: the colours of roads and objects, times their share of each pixel.
      paved: the share of roads and objects.
      sky: the share of the sky; one column if it is the same in a row.
      look: the numbers of the picture's variation.
    """
    below, above = list(look.ground), list(look.sky)
    if look.haze is not None:
        # The haze falls evenly from the upper edge to the last row that shows sky.
        rows = jnp.arange(len(sky), dtype=jnp.float32) + 0.5
        horizon = jnp.maximum((sky.max(axis=1) > 0).sum(), 1)
        height = once(lambda: jnp.maximum(1 - rows / horizon, 0)[:, None])
        above = [colour + change * height for colour, change in zip(above, look.haze, strict=True)]
    if (background := look.background) is not None:
        shape = paved.shape
        field = once(lambda: _make_field(look.seed, background.weights, shape))
        number = once(lambda: _number_rectangles(background.rectangles, shape))
        for index in range(3):
            below[index] = jnp.clip(below[index] + background.below[index] * field, 0, 255)
            pattern = jnp.clip(above[index] + background.above[index] * field, 0, 255)
            for rectangle in range(_RECTANGLES):
                pattern = jnp.where(
                    number == rectangle + 1, background.paints[rectangle, index], pattern
                )
            above[index] = pattern
    behind = 1 - paved - sky
    # The shares of road, ground and sky add up to 1 in each pixel.
    planes = [
        colour + low * behind + high * sky
        for colour, low, high in zip(road, below, above, strict=True)
    ]
    return planes if background is None else once(lambda: planes)


def _make_field(
    seed: UInt32[Array, ""], weights: Float[Array, "3"], shape: tuple[int, ...]
) -> Array:
    """Returns the noise of a pattern, from coarse to fine grains."""
    coarse = once(lambda: [_smooth(seed, grains, shape) for grains in _COARSE])
    layers = [*coarse, _fine(seed, shape)]
    return weights[0] * layers[0] + weights[1] * layers[1] + weights[2] * layers[2]


def _number_rectangles(
    rectangles: Float[Array, "5 4"], shape: tuple[int, ...]
) -> Float[Array, "rows columns"]:
    """Returns for each pixel the number of the last rectangle that covers it.

    Numbers start at 1. A pixel that no rectangle covers has 0.
    """
    row, column = (
        jnp.arange(shape[0], dtype=jnp.float32)[:, None],
        jnp.arange(shape[1], dtype=jnp.float32),
    )
    number = jnp.zeros(shape)
    for index in range(_RECTANGLES):
        top, left, bottom, right = rectangles[index]
        covered = (row >= top) & (row < bottom) & (column >= left) & (column < right)
        number = jnp.where(covered, index + 1.0, number)
    return number


def photograph(image: Planes, look: Look) -> list[UInt32[Array, "rows columns"]]:
    """Applies light, colours, blur and noise; returns red, green and blue, 0 to 255."""
    shape = image[0].shape
    if look.shadow is not None or look.vignette is not None:
        light = once(lambda: _light(look, shape))
        image = [plane * light for plane in image]
    if look.exponent is not None:
        image = [_bend(plane, look.exponent) for plane in image]
    if look.mixing is not None:
        image = _mix(image, look.mixing)
    if look.kernel is not None:
        image = _convolve(image, look.kernel)
    if look.noise is not None:
        image = [
            plane + look.noise * hash_normal(fork(look.seed, index), shape)
            for index, plane in enumerate(image)
        ]
    return [jnp.clip(jnp.round(plane), 0, 255).astype(jnp.uint32) for plane in image]


def _bend(plane: Array, exponent: Array) -> Array:
    """Raises shares of 255 to a power, in half the time of `exp` and `log`.

    The relative error is at most 1e-5. A float32 is 2**n times a number whose logarithm is a short
    series. A power of 2 is such a number, too.
    """
    shares = jnp.clip(plane / 255, 1e-6, 1)
    # After the subtraction the upper bits are a whole exponent. The fraction is between the roots
    # of 1/2 and 2, where the series converges fast.
    bits = jax.lax.bitcast_convert_type(shares, jnp.int32) - _ROOT_HALF_BITS
    whole = bits >> _MANTISSA
    fraction = jax.lax.bitcast_convert_type(
        (bits & ((1 << _MANTISSA) - 1)) + _ROOT_HALF_BITS, jnp.float32
    )
    part = (fraction - 1) / (fraction + 1)
    logarithm = whole.astype(jnp.float32) + part * _polynomial(part * part, _LOG2)
    raised = exponent * logarithm
    # The whole part of the exponent becomes the exponent's bits of a float32, whose bias is 127.
    whole = jnp.round(raised)
    scale = jax.lax.bitcast_convert_type((whole.astype(jnp.int32) + 127) << _MANTISSA, jnp.float32)
    return 255 * scale * _polynomial(raised - whole, _EXP2)


def _polynomial(x: Array, coefficients: Sequence[float]) -> Array:
    """Returns a polynomial; its coefficients start with the constant one."""
    # Horner's rule needs one product for each coefficient.
    total = jnp.full_like(x, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * x + np.float32(coefficient)
    return total


def _mix(image: Planes, mixing: Float[Array, "3 3"]) -> Planes:
    planes = once(lambda: image)
    mean = (planes[0] + planes[1] + planes[2]) / 3
    mixed = []
    for plane, (itself, of_mean, addend) in zip(planes, mixing, strict=True):
        mixed.append(jnp.clip(itself * plane + of_mean * mean + addend, 0, 255))
    return mixed


def _light(look: Look, shape: tuple[int, ...]) -> Float[Array, "rows columns"]:
    light = jnp.ones(shape)
    if look.shadow is not None:
        depth, level, steepness = look.shadow
        field = once(lambda: _smooth(look.seed, _SHADOWS, shape))
        # Smooth noise over a level is in the shadow. The sigmoid makes its edge.
        light = 1 - depth * jax.nn.sigmoid((field - level) * steepness)
    if look.vignette is not None:
        # Half of the squared distance from the middle is 1 at the corners.
        rows, columns = ((np.arange(side, dtype=np.float32) + 0.5) / side * 2 - 1 for side in shape)
        light = light * (1 - look.vignette * np.float32(0.5) * (rows[:, None] ** 2 + columns**2))
    return light


def _convolve(image: Planes, kernel: Float[Array, "5 5"]) -> Planes:
    """Blurs planes; beyond their edges the last pixels are repeated."""
    rows, columns = image[0].shape
    planes = once(lambda: image)
    padded = once(lambda: [jnp.pad(plane, _LENS, mode="edge") for plane in planes])
    blurred = []
    for plane in padded:
        total = jnp.zeros((rows, columns))
        for down in range(2 * _LENS + 1):
            for right in range(2 * _LENS + 1):
                total += kernel[down, right] * plane[down : down + rows, right : right + columns]
        blurred.append(total)
    return blurred
