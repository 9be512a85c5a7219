"""Coherent transforms: one view of a map for its picture, its masks and its points (paper, section "Method").

Geometry is one 3 x 3 matrix for all layers, done by OpenCV's warps: the picture by linear interpolation, masks and
labels by the nearest pixel, so that their values stay exact. Light, colour, blur and noise are for the picture alone.

Places are (x, y) in pixels from the picture's top left corner, so that the first pixel reaches from (0, 0) to (1, 1).
"""

from collections.abc import Sequence
from statistics import NormalDist
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.errors import InputError

__all__ = [
    "STANDARD",
    "Transforms",
    "View",
    "check_transforms",
    "draw_view",
    "map_points",
    "photograph",
    "read_transforms",
    "warp",
]


class Transforms(NamedTuple):
    """How much views may vary; each is drawn uniformly from its range. By default nothing does.

    Attributes:
      quarter_turns: whether maps are turned by quarters.
      rotation: most degrees of a free turn, either way, 0 to 180.
      scale: smallest and largest factor, 0.25 to 4.
      perspective: most that each corner moves, as a share of the map's side, 0 to 0.2: a camera not quite overhead.
      crop: side in pixels of a square window, 16 or more, or 0 for the whole picture. It lies where the map does.
      light: most that brightness changes, either way, as a share, 0 to 1.
      contrast: likewise.
      colour: likewise, of each channel by itself.
      blur: largest standard deviation of a Gaussian blur in pixels, 0 to 20.
      noise: largest standard deviation of Gaussian noise in grey levels, 0 to 64.
    """

    quarter_turns: bool = False
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)
    perspective: float = 0.0
    crop: int = 0
    light: float = 0.0
    contrast: float = 0.0
    colour: float = 0.0
    blur: float = 0.0
    noise: float = 0.0


STANDARD = Transforms(
    quarter_turns=True,
    rotation=5.0,
    scale=(0.9, 1.1),
    perspective=0.04,
    light=0.2,
    contrast=0.2,
    colour=0.06,
    blur=0.8,
    noise=2.0,
)
"""What a camera over a real floor sees, about."""

_LIMITS = {
    "rotation": (0, 180),
    "scale": (0.25, 4),
    "perspective": (0, 0.2),
    "crop": (16, 2**15 - 1),
    "light": (0, 1),
    "contrast": (0, 1),
    "colour": (0, 1),
    "blur": (0, 20),
    "noise": (0, 64),
}


# Under this scale a picture is first made smaller by area.
_SHRUNK = 0.6

_NORMAL = np.array([NormalDist().inv_cdf((part + 0.5) / 256) for part in range(256)])


class View(NamedTuple):
    """One drawn transform.

    Attributes:
      matrix: float64 ``[3, 3]``, takes places of the plain map to places of the view.
      size: (height, width) of the view in pixels.
      gains: float ``[3]``, factors of the channels R, G, B about mid-grey.
      offset: grey levels added to all.
      blur: standard deviation in pixels.
      noise: standard deviation in grey levels.
      noise_seed: of the noise.
    """

    matrix: NDArray[np.float64]
    size: tuple[int, int]
    gains: tuple[float, float, float]
    offset: float
    blur: float
    noise: float
    noise_seed: int


def read_transforms(texts: Sequence[str]) -> Transforms:
    """Reads transforms such as ``["standard", "noise=0"]`` or ``["quarter-turns", "scale=0.5..1.5"]``.

    Args:
      texts: words of which ``standard`` starts from `STANDARD`, ``none`` and ``quarter-turns`` speak for themselves,
        all others are ``NAME=NUMBER`` of `Transforms`, for ``scale`` also ``scale=LOW..HIGH``. Later ones win.

    Raises:
      InputError: for anything else, or a number out of its range.
    """
    transforms = Transforms()
    for text in texts:
        name, equals, value = text.partition("=")
        if text == "none":
            transforms = Transforms()
        elif text == "standard":
            transforms = STANDARD
        elif text == "quarter-turns":
            transforms = transforms._replace(quarter_turns=True)
        elif equals and name in _LIMITS:
            transforms = transforms._replace(**{name: _value(name, value, text)})
        else:
            words = ", ".join(("none", "standard", "quarter-turns", *(f"{known}=..." for known in _LIMITS)))
            raise InputError(f"transform: expected some of {words}, got {text!r}")
    return transforms


def _value(name: str, value: str, text: str) -> Any:
    low, high = _LIMITS[name]
    parts = value.split("..") if name == "scale" else [value]
    try:
        numbers = [int(part) if name == "crop" else float(part) for part in parts]
    except ValueError:
        numbers = []
    fits = len(numbers) in (1, 2) and all(low <= number <= high for number in numbers)
    if name == "crop" and numbers == [0]:
        return 0
    if not fits or numbers != sorted(numbers):
        kind = "a whole number" if name == "crop" else "a number or LOW..HIGH" if name == "scale" else "a number"
        raise InputError(f"transform: expected {name} to be {kind}, {low} to {high}, got {text!r}")
    return (numbers[0], numbers[-1]) if name == "scale" else numbers[0]


def check_transforms(transforms: Transforms) -> None:
    """Raises InputError for transforms out of their ranges."""
    for name, (low, high) in _LIMITS.items():
        value = getattr(transforms, name)
        numbers = value if name == "scale" else (value,)
        if not all(low <= number <= high for number in numbers) and not (name == "crop" and value == 0):
            raise InputError(f"transform: expected {name} within {low} to {high}, got {value!r}")
    if list(transforms.scale) != sorted(transforms.scale):
        raise InputError(f"transform: expected scale to be the smallest and the largest, got {transforms.scale!r}")


def draw_view(rng: np.random.Generator, transforms: Transforms, size: tuple[int, int]) -> View:
    """Draws a view of a map.

    Args:
      rng: the same state gives the same view.
      transforms: what may vary.
      size: (height, width) of the map in pixels; at the smallest scale a crop is at most as large.

    Raises:
      InputError: for transforms out of their ranges, or a crop larger than the map.
    """
    check_transforms(transforms)
    height, width = size
    if transforms.crop > min(size) * min(1.0, transforms.scale[0]):
        raise InputError(
            f"transform: expected a crop within the map's {width} x {height} pixels, got {transforms.crop}"
        )
    # All are drawn whatever is wanted, so that a change of one leaves the others as they were.
    turns = int(rng.integers(4)) * transforms.quarter_turns
    angle = rng.uniform(-1, 1) * transforms.rotation
    low, high = transforms.scale
    scale = low * (high / low) ** rng.uniform()
    bends = rng.uniform(-1, 1, (4, 2)) * transforms.perspective
    place = rng.uniform(0, 1, 2)
    light, contrast, *colours = rng.uniform(-1, 1, 5)
    blur, noise = rng.uniform(0, 1, 2) * (transforms.blur, transforms.noise)
    noise_seed = int(rng.integers(2**63))

    turned = (width, height) if turns % 2 else (height, width)
    matrix = _shift(-width / 2, -height / 2)
    matrix = _turn(90 * turns + angle) @ np.diag([scale, scale, 1]) @ matrix
    matrix = _bend(bends, turned) @ _shift(turned[1] / 2, turned[0] / 2) @ matrix
    if transforms.crop:
        frame = np.array([turned[1], turned[0]])
        shown = frame * min(1.0, scale)  # of the frame, about its middle
        first = np.ceil((frame - shown) / 2)
        last = np.maximum(first, np.floor((frame + shown) / 2 - transforms.crop))
        x, y = np.floor(first + place * (last - first + 1))
        matrix, turned = _shift(-x, -y) @ matrix, (transforms.crop, transforms.crop)
    gain = 1 + contrast * transforms.contrast
    red, green, blue = (gain * (1 + colour * transforms.colour) for colour in colours)
    return View(
        matrix / matrix[2, 2], turned, (red, green, blue), 128 * light * transforms.light, blur, noise, noise_seed
    )


def warp(layer: NDArray[np.uint8], view: View, outside: Any = 0) -> NDArray[np.uint8]:
    """A layer as the view shows it.

    Args:
      layer: uint8 ``[H, W, 3]``, a picture, by linear interpolation, and by area where it shrinks much; or
        ``[H, W]``, a mask or labels, by the nearest pixel.
      view: which way.
      outside: value, or colour, of what lies beyond the map.

    Returns:
      uint8 ``[h, w]`` or ``[h, w, 3]``, h and w the view's.
    """
    height, width = view.size
    if layer.shape[:2] == view.size and np.array_equal(view.matrix, np.eye(3)):
        return layer
    matrix = view.matrix
    scale = np.sqrt(abs(np.linalg.det(matrix[:2, :2])))
    if layer.ndim == 3 and scale < _SHRUNK:
        # Interpolation sees the nearest pixels only, and would leave out all others between.
        before = layer.shape[:2]
        layer = np.asarray(cv2.resize(layer, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
        matrix = matrix @ np.diag([before[1] / layer.shape[1], before[0] / layer.shape[0], 1])
    return np.asarray(
        cv2.warpPerspective(
            layer,
            _shift(-0.5, -0.5) @ matrix @ _shift(0.5, 0.5),  # OpenCV's places are those of pixels' centres
            (width, height),
            flags=cv2.INTER_LINEAR if layer.ndim == 3 else cv2.INTER_NEAREST,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=np.broadcast_to(outside, 3).tolist(),
        ),
        np.uint8,
    )


def photograph(image: NDArray[np.uint8], view: View) -> NDArray[np.uint8]:
    """A warped picture under the view's light, uint8 ``[h, w, 3]``, RGB."""
    if view.gains != (1, 1, 1) or view.offset:
        levels = np.arange(256)[:, None] - 128.0
        table = np.clip(np.rint(levels * view.gains + 128 + view.offset), 0, 255).astype(np.uint8)
        image = np.asarray(cv2.LUT(image, table[None]), np.uint8)
    if view.blur > 0.1:  # less changes nothing
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), view.blur), np.uint8)
    if view.noise:
        # A byte each, and what a normal distribution has at so many of its 256 parts: four times as fast as drawing it.
        grain = np.frombuffer(np.random.default_rng(view.noise_seed).bytes(image.size), np.uint8).reshape(image.shape)
        table = np.rint(_NORMAL * view.noise).astype(np.int16)
        image = np.asarray(cv2.add(image, cv2.LUT(grain, table), dtype=cv2.CV_8U), np.uint8)
    return image


def map_points(points: Any, matrix: Any) -> NDArray[np.float64]:
    """Places ``[N, 2]`` of the plain map as places ``[N, 2]`` of the view whose matrix it is."""
    points = np.asarray(points, np.float64).reshape(-1, 2)
    across = np.column_stack([points, np.ones(len(points))]) @ np.asarray(matrix, np.float64).T
    return np.asarray(across[:, :2] / across[:, 2:])


def _shift(x: float, y: float) -> NDArray[np.float64]:
    return np.array([[1, 0, x], [0, 1, y], [0, 0, 1.0]])


def _turn(degrees: float) -> NDArray[np.float64]:
    """A turn counter-clockwise, as one sees it with y downward; exact for quarters."""
    quarters, rest = divmod(degrees, 90)
    cos, sin = np.cos(np.radians(rest)), np.sin(np.radians(rest))
    turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1.0]])
    quarter = np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]])
    return np.asarray(np.linalg.matrix_power(quarter, int(quarters) % 4) @ turn)


def _bend(bends: NDArray[np.float64], size: tuple[int, int]) -> NDArray[np.float64]:
    """The perspective that moves the corners by shares ``[4, 2]`` of the sides."""
    if not bends.any():
        return np.eye(3)
    sides = np.array([size[1], size[0]], np.float64)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    return np.asarray(
        cv2.getPerspectiveTransform(
            (corners * sides).astype(np.float32), ((corners + bends) * sides).astype(np.float32)
        ),
        np.float64,
    )
