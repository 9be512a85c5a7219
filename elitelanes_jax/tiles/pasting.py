"""Pasting flat pictures into a picture, each through a 3 x 3 matrix.

An exact mask says what is seen of each picture. A pixel belongs to an object if its centre is on an
opaque pixel of the object's picture. So masks need no interpolation. Colours are averaged over four
samples a pixel.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import OPAQUE

# The samples of a pixel in each direction.
_FINER = 2
# The most objects of a map.
_MOST = 2**16 - 1


class Placed(NamedTuple):
    """A picture and its place in another picture.

    Attributes:
      pixels: uint8 ``[rows, columns, 4]``, RGB and opacity.
      matrix: float ``[3, 3]``, maps (column, row) of the picture to (x, y) in the other picture.
        The third coordinate is positive in front of the camera.
    """

    pixels: UInt8[NDArray, "rows columns 4"]
    matrix: Float[NDArray, "3 3"]


class Seen(NamedTuple):
    """What is seen of a pasted picture. Boxes are x, y, width and height in pixels.

    Attributes:
      box: the box of what is seen; of width 0 if nothing is.
      whole: the box of all of it, as if nothing hid it and the other picture had no edges.
      visible: the share of its pixels that is seen.
    """

    box: tuple[int, int, int, int]
    whole: tuple[float, float, float, float]
    visible: float


def paste(
    image: UInt8[NDArray, "h w 3"], placed: Sequence[Placed], near: float = 0.0
) -> tuple[NDArray[np.uint16], list[Seen]]:
    """Pastes pictures from back to front into an image, which is changed.

    `near` is the least third coordinate of points that are drawn. Returns uint16 ``[h, w]``, 1 +
    the index of the picture that is seen at each pixel, or 0; and what is seen of each.
    """
    size = image.shape[0], image.shape[1]
    owners = np.zeros(size, np.uint16)
    windows = [_window(item, size, near) for item in placed]
    covered = []
    # Each picture takes the pixels that it covers from the pictures behind it.
    for index, (item, window) in enumerate(zip(placed, windows, strict=True)):
        mask = _cover(item, window, near)
        covered.append(int(mask.sum()))
        if covered[-1]:
            owners[window][mask] = index + 1
            _blend(image[window], item, window, near)
    # What a picture owns at the end is what is seen of it.
    masks = [owners[window] == index + 1 for index, window in enumerate(windows)]
    seen = []
    for item, window, mask, count in zip(placed, windows, masks, covered, strict=True):
        seen.append(_seen(item, window, mask, count, size, near))
    return owners, seen


def outline(pixels: UInt8[NDArray, "rows columns 4"]) -> Int[NDArray, "N 2"]:
    """Returns the corners (column, row) of the opaque pixels at the edges of their rows."""
    opaque = pixels[..., 3] >= OPAQUE
    rows = np.flatnonzero(opaque.any(axis=1))
    first, last = opaque[rows].argmax(axis=1), opaque.shape[1] - opaque[rows, ::-1].argmax(axis=1)
    below = rows + 1
    return np.column_stack(
        [np.concatenate([first, first, last, last]), np.concatenate([rows, below, rows, below])]
    )


def map_points(
    points: Shaped[NDArray, "N 2"], matrix: Float[NDArray, "3 3"]
) -> Float[NDArray, "N 3"]:
    """Returns where a matrix maps points to.

    The result is x, y and the third coordinate. x and y are already divided by it, unless it is 0.
    """
    across = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.column_stack(
        [across[:, :2] / np.where(across[:, 2:] == 0, 1, across[:, 2:]), across[:, 2]]
    )


# The rows and the columns of a part of a picture.
_Window: TypeAlias = tuple[slice, slice]


def _window(item: Placed, size: tuple[int, int], near: float) -> _Window:
    """Returns the rows and columns that a picture can touch."""
    corners = map_points(_corners(item), item.matrix)
    if (corners[:, 2] <= near).all():
        return np.s_[0:0, 0:0]
    if (corners[:, 2] <= near).any():
        # A picture that reaches behind the camera may touch any pixel.
        return np.s_[0 : size[0], 0 : size[1]]
    low, high = np.floor(corners[:, :2].min(axis=0)), np.ceil(corners[:, :2].max(axis=0))
    left, top = (int(part) for part in np.clip(low, 0, size[::-1]))
    right, bottom = (int(part) for part in np.clip(high, 0, size[::-1]))
    return np.s_[top : max(top, bottom), left : max(left, right)]


def _corners(item: Placed) -> Float[NDArray, "4 2"]:
    rows, columns = item.pixels.shape[:2]
    return np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)


def _cover(item: Placed, window: _Window, near: float) -> Bool[NDArray, "h w"]:
    """Returns the pixels of a window whose centres lie on opaque pixels of a picture."""
    rows, columns = item.pixels.shape[:2]
    # The centre of each pixel is mapped back to the picture. The third coordinate is then 1 /
    # depth.
    back = np.linalg.inv(item.matrix)
    y, x = (np.arange(part.start, part.stop) + 0.5 for part in window)
    u, v, inverse_depth = (part[0] * x + part[1] * y[:, None] + part[2] for part in back)
    ahead = (inverse_depth > 0) & (inverse_depth * near < 1)
    depth = 1 / np.where(ahead, inverse_depth, 1)
    u, v = u * depth, v * depth
    inside = ahead & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    u, v = (np.where(inside, part, 0).astype(int) for part in (u, v))
    return inside & (item.pixels[v, u, 3] >= OPAQUE)


def _blend(part: UInt8[NDArray, "h w 3"], item: Placed, window: _Window, near: float) -> None:
    """Blends the colours of a picture into the pixels of a window."""
    height, width = part.shape[:2]
    rows, columns = item.pixels.shape[:2]
    # The samples of the window are a finer picture, which begins at the window's corner.
    shift = np.array(
        [
            [_FINER, 0, -_FINER * window[1].start],
            [0, _FINER, -_FINER * window[0].start],
            [0, 0, 1.0],
        ]
    )
    matrix = shift @ item.matrix
    opacity = item.pixels[..., 3:] / np.float32(255)
    # Colours are multiplied by their opacity first, so that hidden colours of transparent pixels do
    # not shine through.
    paint = np.dstack([item.pixels[..., :3] * opacity, opacity * 255]).astype(np.float32)
    corners = map_points(_corners(item), matrix)
    if (corners[:, 2] > near).all():
        # Interpolation reads the nearest four pixels alone. A picture that becomes much smaller is
        # scaled down by area first.
        shrunk = np.sqrt(cv2.contourArea(corners[:, :2].astype(np.float32)) / (rows * columns))
        if shrunk < 0.7:
            small = max(round(columns * shrunk), 1), max(round(rows * shrunk), 1)
            paint = cv2.resize(paint, small, interpolation=cv2.INTER_AREA).astype(np.float32)
            matrix = matrix @ np.diag([columns / small[0], rows / small[1], 1])
    # OpenCV's positions are those of pixels' centres.
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    size = width * _FINER, height * _FINER
    fine = cv2.warpPerspective(
        paint, np.linalg.inv(half) @ matrix @ half, size, flags=cv2.INTER_LINEAR
    )
    if (corners[:, 2] <= near).any():
        # OpenCV also draws what is behind the camera. These samples are cleared.
        back = np.linalg.inv(matrix)[2]
        inverse = (
            back[0] * (np.arange(size[0]) + 0.5)
            + back[1] * (np.arange(size[1]) + 0.5)[:, None]
            + back[2]
        )
        fine[(inverse <= 0) | (inverse * near >= 1)] = 0
    # The samples of each pixel are averaged.
    seen = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    part[:] = np.clip(np.rint(part * (1 - seen[..., 3:] / 255) + seen[..., :3]), 0, 255).astype(
        np.uint8
    )


def _seen(
    item: Placed,
    window: _Window,
    mask: Bool[NDArray, "h w"],
    covered: int,
    size: tuple[int, int],
    near: float,
) -> Seen:
    """Describes what is seen of a picture.

    `mask` has the pixels of the window that are seen. `covered` is the number of pixels that the
    picture would have alone.
    """
    if not mask.any():
        return Seen((0, 0, 0, 0), (0.0, 0.0, 0.0, 0.0), 0.0)
    rows, columns = (
        np.flatnonzero(mask.any(axis=1 - axis)) + window[axis].start for axis in (0, 1)
    )
    whole, covered = measure_whole(item, covered, size, near)
    box = int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1
    return Seen(box, whole, int(mask.sum()) / covered)


def measure_whole(
    item: Placed,
    covered: int,
    size: tuple[int, int],
    near: float,
    bend: Callable[[Float[NDArray, "N 2"]], Float[NDArray, "N 2"]] = lambda points: points,
) -> tuple[tuple[float, float, float, float], int]:
    """Returns the box of a whole picture, and the number of pixels that it would cover.

    The other picture of `size` shows `covered` of these pixels. `bend` moves points of it as a lens
    does.
    """
    points = map_points(outline(item.pixels), item.matrix)
    points = bend(points[points[:, 2] > near][:, :2])
    low, high = points.min(axis=0), points.max(axis=0)
    # If a part is beyond the edges, the areas of the picture's pixels in the view are added up. The
    # area of one is the determinant divided by the cube of its depth.
    if (low < 0).any() or (high > size[::-1]).any():
        v, u = np.nonzero(item.pixels[..., 3] >= OPAQUE)
        depth = map_points(np.column_stack([u + 0.5, v + 0.5]), item.matrix)[:, 2]
        area = (abs(np.linalg.det(item.matrix)) / depth[depth > near] ** 3).sum()
        covered = max(covered, round(float(area)))
    return (*low.tolist(), *(high - low).tolist()), covered


def paste_objects(
    layers: Mapping[str, NDArray[np.uint8]],
    placed: Sequence[Placed],
    order: Sequence[int],
    near: float = 0.0,
) -> tuple[NDArray[np.uint16], list[Seen]]:
    """Pastes objects into the layers of a picture, which are changed.

    Objects are drawn in "image". In the masks and labels their pixels become 0. `order` has the
    objects' indices on the map. Returns what `paste` does, but with these indices. Raises
    `InputError` for an object beyond the first 65,535, whose index does not fit.
    """
    if max(order, default=0) >= _MOST:
        raise InputError(
            "objects", f"at most {_MOST:,} in pictures of a map", f"{max(order) + 1:,} or more"
        )
    owners, seen = paste(layers["image"], placed, near)
    for name, layer in layers.items():
        if name != "image":
            layer[owners > 0] = 0
    # A table turns the order of pasting into the objects' indices on the map.
    return np.array([0, *(index + 1 for index in order)], np.uint16)[owners], seen
