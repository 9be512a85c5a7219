"""Where tiles are in a photograph: a homography, and the radial distortion of the lens.

Positions in tiles are x to the right and y down. A floor of H x W tiles covers 0 to W and 0 to H.
Positions in pixels are OpenCV's: the middle of the first pixel is (0, 0).
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

# The least side of a tile in a photograph, in pixels. In smaller tiles nothing is seen.
_LEAST_PX = 16
# The most rows that are read at once. OpenCV takes fewer than 2**15.
_MOST_ROWS = 30_000


class FloorView(NamedTuple):
    """A camera's view of a floor.

    Attributes:
      homography: float ``[3, 3]``, from tiles to pixels without distortion.
      radial: a point at the distance r from the photograph's centre, in half diagonals, is seen at
        r + radial·r³.
      width: the width of the photograph in pixels.
      height: the height of the photograph in pixels.
      shape: the rows and columns of the floor.
    """

    homography: NDArray[np.float64]
    radial: float
    width: int
    height: int
    shape: tuple[int, int]

    @property
    def corners(self) -> Points:
        """The floor's corners in tiles ``[4, 2]``, see `floor_corners`."""
        return floor_corners(*self.shape)

    def pixels_of(self, places: Points) -> Points:
        """Returns the pixels ``[..., 2]`` of positions ``[..., 2]`` in tiles."""
        away = self._from_centre(places)
        seen = away * (1 + self.radial * (away**2).sum(axis=-1, keepdims=True))
        return np.asarray(seen * self._half + self._centre, np.float64).reshape(places.shape)

    def bend(self, places: Points) -> Points:
        """Returns how pixels ``[..., 2]`` of positions in tiles move for each unit of `radial`."""
        away = self._from_centre(places)
        return np.asarray(away * (away**2).sum(axis=-1, keepdims=True) * self._half).reshape(
            places.shape
        )

    def moves(self, places: Points) -> NDArray[np.float64]:
        """Returns how each parameter of a change moves positions ``[..., 2]``: ``[9, ..., 2]``.

        Positions and movements are in tiles. The first eight parameters are a homography's, in
        units of half the floor. The last is the radial distortion.
        """
        half = np.array(self.shape[::-1]) / 2
        u, v = np.moveaxis(places / half - 1, -1, 0)
        one, none = np.ones_like(u), np.zeros_like(u)
        moves = [
            (one, none),
            (u, none),
            (v, none),
            (none, one),
            (none, u),
            (none, v),
            (u * u, u * v),
            (u * v, v * v),
        ]
        flat = np.stack([np.stack(move, axis=-1) * half for move in moves])
        # The lens moves points in pixels. Solved by the derivative of the view, which is measured
        # over a small step, the movement is in tiles.
        step = 1e-3
        right, down = (
            (self.pixels_of(places + step * along) - self.pixels_of(places - step * along))
            / (2 * step)
            for along in np.eye(2)
        )
        derivative = np.stack([right, down], axis=-1)
        bent = np.linalg.solve(derivative, self.bend(places)[..., None])[..., 0]
        return np.concatenate([flat, bent[None]])

    def changed(self, change: NDArray[np.float64]) -> "FloorView":
        """Applies a change ``[9]`` of the parameters of `moves`."""
        rows, columns = self.shape
        a, b, c, d, e, f, g, h = change[:8]
        small = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1]])
        # The change is a homography of the floor in coordinates from -1 to 1.
        unit = np.array([[2 / columns, 0, -1], [0, 2 / rows, -1], [0, 0, 1]])
        homography = self.homography @ np.linalg.inv(unit) @ small @ unit
        return self._replace(
            homography=homography / homography[2, 2], radial=self.radial + change[8]
        )

    @property
    def is_near_photograph(self) -> bool:
        """Whether the floor is convex, near the photograph, and large enough to see its tiles.

        A fit to pixels that show no tiles may leave the photograph.
        """
        pixels = self.pixels_of(self.corners)
        if not np.isfinite(pixels).all() or np.abs(pixels).max() > 4 * max(self.width, self.height):
            return False
        seen = self.tile_pixels(self.corners.mean(axis=0))
        return cv2.isContourConvex(pixels.astype(np.float32)) and seen > _LEAST_PX

    def scaled(self, scale: float) -> "FloorView":
        """Returns the view of the same photograph in another size."""
        width, height = round(self.width * scale), round(self.height * scale)
        homography = scaling(width / self.width, height / self.height) @ self.homography
        return self._replace(homography=homography, width=width, height=height)

    def tile_pixels(self, middle: Points) -> float:
        """Returns the side in pixels of a tile with its middle at a position ``[2]`` in tiles."""
        corners = middle + (floor_corners(1, 1) - 0.5)
        return float(np.sqrt(cv2.contourArea(self.pixels_of(corners).astype(np.float32))))

    def _from_centre(self, places: Points) -> Points:
        """Returns positions ``[1, N, 2]`` from the photograph's centre, in half diagonals."""
        flat = np.ascontiguousarray(places, np.float64).reshape(1, -1, 2)
        return (cv2.perspectiveTransform(flat, self.homography) - self._centre) / self._half

    @property
    def _centre(self) -> Points:
        return np.array([self.width - 1, self.height - 1]) / 2

    @property
    def _half(self) -> float:
        return float(np.hypot(self.width, self.height) / 2)


def scaling(across: float, down: float) -> NDArray[np.float64]:
    """Returns the matrix ``[3, 3]`` from the pixels of a picture to those of the scaled picture."""
    # Whole numbers are the centres of pixels. Therefore a scale also shifts by a part of a pixel.
    return np.array([[across, 0, (across - 1) / 2], [0, down, (down - 1) / 2], [0, 0, 1]])


def floor_corners(rows: int, columns: int) -> Points:
    """Returns the corners of a floor in tiles, x and y ``[4, 2]``.

    The order is clockwise, from the first row's first tile.
    """
    return np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)


def view_of(corners: Points, rows: int, columns: int, width: int, height: int) -> FloorView:
    """Returns the view in which a floor's corners are at pixels ``[4, 2]``, clockwise.

    The view has no distortion.
    """
    places = floor_corners(rows, columns).astype(np.float32)
    homography = cv2.getPerspectiveTransform(places, np.asarray(corners, np.float32))
    return FloorView(np.asarray(homography, np.float64), 0.0, width, height, (rows, columns))


def places_of(rows: int, columns: int, tile_px: int, margin: int) -> Points:
    """Returns the positions in tiles of the pixels of a floor seen from above.

    A margin of `margin` pixels is around the floor.
    """
    x = (np.arange(-margin, columns * tile_px + margin) + 0.5) / tile_px
    y = (np.arange(-margin, rows * tile_px + margin) + 0.5) / tile_px
    return np.stack(np.meshgrid(x, y), axis=-1)


def flatten(
    image: NDArray[np.uint8], view: FloorView, places: Points, tile_px: float
) -> NDArray[np.uint8]:
    """Returns the pixels of a photograph ``[H, W, 3]`` at positions ``[..., 2]`` in tiles.

    A tile's side has `tile_px` positions. The photograph is first reduced to about this scale, so
    that nothing aliases.
    """
    seen = view.tile_pixels(places.reshape(-1, 2).mean(axis=0))
    if seen > 2 * tile_px:
        view = view.scaled(1.4 * tile_px / seen)
        image = np.asarray(
            cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_AREA), np.uint8
        )
    x, y = np.moveaxis(view.pixels_of(places).astype(np.float32), -1, 0)
    parts = [
        cv2.remap(
            image,
            x[first : first + _MOST_ROWS],
            y[first : first + _MOST_ROWS],
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for first in range(0, len(x), _MOST_ROWS)
    ]
    return np.asarray(np.concatenate(parts), np.uint8)
