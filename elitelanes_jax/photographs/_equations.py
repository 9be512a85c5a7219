"""Moves a view of a floor to where measurements have it, by linear least squares.

A measurement says how far a point is from where the view has it. A step is Gauss and Newton's: the
measurements are linear in a small change of the view.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.photographs._borders import ALONG, Border
from elitelanes_jax.photographs._views import FloorView, Points, floor_corners

# The weight of the first guess. Parameters that nothing measures stay within a standard deviation
# of 0.2, in the units of `basis`.
_WEAK = 25.0
# The usual radial distortion of a lens.
_BEND = 0.06
# The deviation of the points of a sharp border from a line, in tiles.
_EDGE_NOISE = 0.0015
# The points along a side that count as independent.
_INDEPENDENT = 6
# The least side of a tile in a photograph, in pixels. In smaller tiles nothing is seen.
_LEAST_PX = 16
_RIGHT, _DOWN = np.eye(2)

UNKNOWN_SPREAD = np.eye(9)
"""The spread of a view that could not be fitted. It is too large for any corner to be sure."""


class Step(NamedTuple):
    """A step of Gauss and Newton's method.

    Attributes:
      view: the view after the step.
      spread: the covariance of the parameters, ``[9, 9]``, as `basis` has them.
      size: the largest change of a parameter, in tiles.
    """

    view: FloorView
    spread: NDArray[np.float64]
    size: float


class Equations(NamedTuple):
    """The normal equations of a change of a view.

    Attributes:
      view: the view that changes.
      shape: the rows and columns of the floor.
      matrix: float ``[9, 9]``.
      vector: float ``[9]``.
    """

    view: FloorView
    shape: tuple[int, int]
    matrix: NDArray[np.float64]
    vector: NDArray[np.float64]

    @staticmethod
    def before(view: FloorView, shape: tuple[int, int]) -> "Equations":
        """Returns what is known before pixels are read: the view, and the usual bend of a lens."""
        matrix, vector = np.diag([_WEAK] * 8 + [_BEND**-2]), np.zeros(9)
        vector[8] = -view.radial * matrix[8, 8]
        return Equations(view, shape, matrix, vector)

    def plus(self, moves: NDArray, offsets: NDArray, weights: NDArray) -> "Equations":
        """Adds N equations ``moves.T @ change = offsets``.

        Args:
          moves: ``[9, N]``, how each parameter moves the measured points.
          offsets: ``[N]``, how far these are from where the view has them.
          weights: ``[N]``, the inverses of their variances.
        """
        weighted = moves * weights
        return self._replace(
            matrix=self.matrix + weighted @ moves.T, vector=self.vector + weighted @ offsets
        )

    def plus_border(
        self, border: Border, trust: NDArray[np.float64] | float = 1.0, noise: float = _EDGE_NOISE
    ) -> "Equations":
        """Adds where a border is seen.

        Offsets of more than four times the usual one, or of `noise` in tiles if that is more, do
        not count. `trust` says how far each point is trusted, 0 to 1.
        """
        seen = np.isfinite(border.offsets)
        offsets = np.where(seen, border.offsets, 1.0)
        usual = 1.48 * float(np.median(np.abs(offsets[seen]))) if seen.any() else 1.0
        scale = max(usual, noise)
        weights = trust * seen * tukey(offsets / (4 * scale)) / (scale**2 * ALONG / _INDEPENDENT)
        moves = (basis(self.view, border.points, self.shape) * border.outwards).sum(axis=-1)
        return self.plus(moves.reshape(9, -1), offsets.ravel(), weights.ravel())

    def solve(self) -> Step | None:
        """Takes the step. Returns None if it leaves the photograph."""
        spread = np.asarray(np.linalg.inv(self.matrix), np.float64)
        change = spread @ self.vector
        moved = self._moved(change)
        if not _is_seen(moved, self.shape):
            return None
        return Step(moved, spread, float(np.abs(change[:8]).max() * max(self.shape)))

    def _moved(self, change: NDArray[np.float64]) -> FloorView:
        """Applies a change of the parameters of `basis`."""
        rows, columns = self.shape
        a, b, c, d, e, f, g, h = change[:8]
        small = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1]])
        # The change is a homography of the floor in coordinates from -1 to 1.
        unit = np.array([[2 / columns, 0, -1], [0, 2 / rows, -1], [0, 0, 1]])
        homography = self.view.homography @ np.linalg.inv(unit) @ small @ unit
        return self.view._replace(
            homography=homography / homography[2, 2], radial=self.view.radial + change[8]
        )


def _is_seen(view: FloorView, shape: tuple[int, int]) -> bool:
    """Returns whether a view is one of a convex floor near the photograph.

    A fit to pixels that show no tiles may leave the photograph.
    """
    corners = view.pixels_of(floor_corners(*shape))
    if not np.isfinite(corners).all() or np.abs(corners).max() > 4 * max(view.width, view.height):
        return False
    return cv2.isContourConvex(corners.astype(np.float32)) and view.tile_pixels(*shape) > _LEAST_PX


def basis(view: FloorView, places: Points, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Returns how each parameter moves positions ``[..., 2]`` in tiles: ``[9, ..., 2]``.

    The first eight are a homography's, in units of half the floor. The last is the radial
    distortion.
    """
    half = np.array(shape[::-1]) / 2
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
    # The lens moves points in pixels. Solved by the derivative of the view, which is measured over
    # a small step, the movement is in tiles.
    step = 1e-3
    right = (view.pixels_of(places + step * _RIGHT) - view.pixels_of(places - step * _RIGHT)) / (
        2 * step
    )
    down = (view.pixels_of(places + step * _DOWN) - view.pixels_of(places - step * _DOWN)) / (
        2 * step
    )
    bent = np.linalg.solve(np.stack([right, down], axis=-1), view.bend(places)[..., None])[..., 0]
    return np.concatenate([flat, bent[None]])


def largest_spread(view: FloorView, spread: NDArray[np.float64], shape: tuple[int, int]) -> float:
    """Returns the standard deviation of the least sure corner of a fitted floor, in tiles."""
    moves = basis(view, floor_corners(*shape), shape)
    variances = np.einsum("icd,ij,jcd->c", moves, spread, moves)
    return float(np.sqrt(variances.max()))


def tukey(ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns Tukey's weights: 1 at 0, 0 from 1 on."""
    return np.asarray(np.maximum(1 - ratio**2, 0) ** 2)
