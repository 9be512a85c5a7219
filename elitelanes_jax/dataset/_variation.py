"""What differs between pictures of one scene: background, shadows, lens, colours and compression.

Each step takes a random state and a picture of floats, 0 to 255, RGB. Sizes of patterns are shares of the picture's
sides, so that small and large pictures vary alike. All values are always drawn, so that a change of one range does not
change the others.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.dataset._transforms import VARIATION, Transforms

_GRAINS = (4, 16, 64)  # of a pattern, from coarse to fine, along each side
_RECTANGLES = 5
_LONGEST = 25  # samples along a streak of motion blur


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
    """Shows random patterns instead of plain ground and sky, in the share `background` of the pictures.

    `ground` has the pixels of the ground that may change, and `sky` those above the horizon.
    """
    changed = rng.uniform() < transforms.background
    patterns = _pattern(rng, ground.shape), _clutter(rng, _pattern(rng, ground.shape))
    if not changed:
        return image
    shown = image.copy()
    for part, pattern in zip((ground, sky), patterns, strict=True):
        shown[part] = np.clip(np.rint(pattern[part]), 0, 255)
    return shown


def vary_light(
    rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], transforms: Transforms
) -> UInt8[NDArray, "h w 3"]:
    """Changes shadows, the light of the corners, the tone curve, saturation and colour temperature."""
    depth, edge, level, corners = rng.uniform(size=4) * (transforms.shadow, 1, 1, transforms.vignette)
    field = _noise(rng, image.shape[:2], 5)
    shadow = 1 / (1 + np.exp(-np.clip((field - level) * 2 ** (2 + 4 * edge), -30, 30)))
    rows, columns = ((np.arange(side) + 0.5) / side * 2 - 1 for side in image.shape[:2])
    away = (rows[:, None] ** 2 + columns**2) / 2
    light = ((1 - depth * shadow) * (1 - corners * away))[..., None]
    gamma, saturation, warmth = rng.uniform(-1, 1, 3) * (transforms.gamma, transforms.saturation, transforms.warmth)
    colours = 255 * (image * light / 255) ** (2**gamma)
    grey = colours.mean(axis=-1, keepdims=True)
    colours = (grey + (colours - grey) * (1 + saturation)) * (1 + warmth, 1, 1 - warmth)
    return np.asarray(np.clip(np.rint(colours), 0, 255), np.uint8)


def vary_motion(rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], motion: float) -> UInt8[NDArray, "h w 3"]:
    """Smears the picture along a random direction, by at most `motion` pixels."""
    length, angle = rng.uniform(0, motion), rng.uniform(0, np.pi)
    reach = int(np.ceil(length / 2))
    if not reach:
        return image
    kernel = np.zeros((2 * reach + 1, 2 * reach + 1), np.float32)
    along = np.linspace(-length / 2, length / 2, _LONGEST)
    x, y = (np.rint(reach + along * part).astype(int) for part in (np.cos(angle), np.sin(angle)))
    np.add.at(kernel, (y, x), 1 / _LONGEST)
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_REPLICATE), np.uint8)


def compress(rng: np.random.Generator, image: UInt8[NDArray, "h w 3"], most: float) -> UInt8[NDArray, "h w 3"]:
    """Writes and reads the picture as JPEG, of a quality between 100 and 100 - 90 `most`."""
    quality = round(100 - 90 * rng.uniform(0, most))
    if not most:
        return image
    _, coded = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR), np.uint8)[..., ::-1]


def _noise(rng: np.random.Generator, shape: tuple[int, ...], grains: int) -> Float[NDArray, "h w"]:
    """Makes smooth noise between -1 and 1, with `grains` grains along each side."""
    grid = rng.uniform(-1, 1, (grains, grains)).astype(np.float32)
    return np.asarray(cv2.resize(grid, shape[::-1], interpolation=cv2.INTER_LINEAR))


def _pattern(rng: np.random.Generator, shape: tuple[int, ...]) -> Float[NDArray, "h w 3"]:
    """Makes something like grass, carpet, concrete or a wall: one colour, and coarse to fine noise of another one."""
    colour = rng.uniform(10, 245) + rng.normal(size=(2, 3)) * [[30], [50]]
    weights: Numeric = rng.uniform(size=len(_GRAINS)) ** 2
    field = sum(weight * _noise(rng, shape, grains) for weight, grains in zip(weights, _GRAINS, strict=True))
    return np.asarray(colour[0] + np.asarray(field)[..., None] * colour[1])


def _clutter(rng: np.random.Generator, image: Float[NDArray, "h w 3"]) -> Float[NDArray, "h w 3"]:
    """Draws up to 5 rectangles on a picture: furniture, doors and windows."""
    count = rng.integers(_RECTANGLES + 1)
    centres, sides = rng.uniform(size=(_RECTANGLES, 2)), rng.uniform(0.02, 0.4, (_RECTANGLES, 2))
    colours = rng.uniform(0, 255, (_RECTANGLES, 3))
    corners = (np.stack([centres - sides / 2, centres + sides / 2], axis=1) * image.shape[:2]).clip(0).astype(int)
    for (low, high), colour in list(zip(corners, colours, strict=True))[:count]:
        image[low[0] : high[0], low[1] : high[1]] = colour
    return image
