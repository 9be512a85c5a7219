"""Where tiles are in a photograph: a homography, and the radial distortion of the lens.

Positions in tiles are x to the right and y down. A floor of H x W tiles covers 0 to W and 0 to H.
Positions in pixels are OpenCV's: the middle of the first pixel is (0, 0).
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]


class FloorView(NamedTuple):
    """A camera's view of a floor.

    Attributes:
      homography: float ``[3, 3]``, from tiles to pixels without distortion.
      radial: a point at the distance r from the photograph's centre, in half diagonals, is seen at
        r + radial·r³.
      width: the width of the photograph in pixels.
      height: the height of the photograph in pixels.
    """

    homography: NDArray[np.float64]
    radial: float
    width: int
    height: int

    def pixels_of(self, places: Points) -> Points:
        """Returns the pixels ``[..., 2]`` of positions ``[..., 2]`` in tiles."""
        flat = np.ascontiguousarray(places, np.float64).reshape(1, -1, 2)
        away = (cv2.perspectiveTransform(flat, self.homography) - self._centre) / self._half
        seen = away * (1 + self.radial * (away**2).sum(axis=-1, keepdims=True))
        return np.asarray(seen * self._half + self._centre, np.float64).reshape(places.shape)

    def bend(self, places: Points) -> Points:
        """Returns how pixels ``[..., 2]`` of positions in tiles move for each unit of `radial`."""
        flat = np.ascontiguousarray(places, np.float64).reshape(1, -1, 2)
        away = (cv2.perspectiveTransform(flat, self.homography) - self._centre) / self._half
        return np.asarray(away * (away**2).sum(axis=-1, keepdims=True) * self._half).reshape(
            places.shape
        )

    def scaled(self, scale: float) -> "FloorView":
        """Returns the view of the same photograph in another size."""
        size = round(self.width * scale), round(self.height * scale)
        stretch = np.diag([size[0] / self.width, size[1] / self.height, 1.0])
        # Whole numbers are the centres of pixels. Therefore a scale also shifts by a part of a
        # pixel.
        stretch[:2, 2] = (stretch[0, 0] - 1) / 2, (stretch[1, 1] - 1) / 2
        return FloorView(stretch @ self.homography, self.radial, *size)

    def tile_pixels(self, rows: int, columns: int) -> float:
        """Returns the side in pixels of a tile in the floor's middle."""
        middle = np.array([columns, rows]) / 2 + np.array(
            [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]
        )
        return float(np.sqrt(cv2.contourArea(self.pixels_of(middle).astype(np.float32))))

    @property
    def _centre(self) -> Points:
        return np.array([self.width - 1, self.height - 1]) / 2

    @property
    def _half(self) -> float:
        return float(np.hypot(self.width, self.height) / 2)


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
    return FloorView(np.asarray(homography, np.float64), 0.0, width, height)


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
    # A floor with twice these rows and columns has its middle at the mean of the positions.
    middle = places.reshape(-1, 2).mean(axis=0) * 2
    if view.tile_pixels(middle[1], middle[0]) > 2 * tile_px:
        view = view.scaled(1.4 * tile_px / view.tile_pixels(middle[1], middle[0]))
        image = np.asarray(
            cv2.resize(image, (view.width, view.height), interpolation=cv2.INTER_AREA), np.uint8
        )
    x, y = np.moveaxis(view.pixels_of(places).astype(np.float32), -1, 0)
    return np.asarray(
        cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )
