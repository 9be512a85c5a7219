"""Moves a view of a floor to where measurements have it, by linear least squares.

A measurement says how far points are from where the view has them. A step is Gauss and Newton's: the
measurements are linear in a small change of the view.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.photographs._borders import ALONG, Border
from elitelanes_jax.photographs._views import FloorView

# The weight of the first guess. Parameters that nothing measures stay within a standard deviation
# of 0.2, in the units of `FloorView.moves`.
_WEAK = 25.0
# The usual radial distortion of a lens.
_BEND = 0.06
# The deviation of the points of a sharp border from a line, in tiles.
_EDGE_NOISE = 0.0015
# The points along a side that count as independent.
_INDEPENDENT = 6


class Measurement(NamedTuple):
    """How far N points are from where a view has them.

    Attributes:
      moves: ``[9, N]``, how each parameter of the view moves the points, see `FloorView.moves`.
      offsets: ``[N]``, the distances.
      weights: ``[N]``, the inverses of their variances.
    """

    moves: NDArray
    offsets: NDArray
    weights: NDArray


class Step(NamedTuple):
    """A step of Gauss and Newton's method.

    Attributes:
      view: the view after the step.
      spread: the covariance of the parameters, ``[9, 9]``, as `FloorView.moves` has them.
      size: the largest change of a parameter of the homography, in half tiles. The parameters are in
        halves of the floor, see `FloorView.moves`.
    """

    view: FloorView
    spread: NDArray[np.float64]
    size: float


def measure_border(
    view: FloorView,
    border: Border,
    trust: NDArray[np.float64] | float = 1.0,
    noise: float = _EDGE_NOISE,
) -> Measurement:
    """Returns how far a border is from where a view has it.

    Offsets of more than four times the usual one, or of `noise` in tiles if that is more, do not
    count. `trust` says how far each point is trusted, 0 to 1.
    """
    seen = np.isfinite(border.offsets)
    offsets = np.where(seen, border.offsets, 1.0)
    usual = 1.48 * float(np.median(np.abs(offsets[seen]))) if seen.any() else 1.0
    scale = max(usual, noise)
    weights = trust * seen * tukey(offsets / (4 * scale)) / (scale**2 * ALONG / _INDEPENDENT)
    moves = (view.moves(border.points) * border.outwards).sum(axis=-1)
    return Measurement(moves.reshape(9, -1), offsets.ravel(), weights.ravel())


def take_step(view: FloorView, *measurements: Measurement) -> Step | None:
    """Solves for the change of a view. Returns None if the changed view leaves the photograph."""
    # Before pixels are read, the view and the usual bend of a lens are known.
    matrix, vector = np.diag([_WEAK] * 8 + [_BEND**-2]), np.zeros(9)
    vector[8] = -view.radial * matrix[8, 8]
    for moves, offsets, weights in measurements:
        weighted = moves * weights
        matrix = matrix + weighted @ moves.T
        vector = vector + weighted @ offsets
    spread = np.asarray(np.linalg.inv(matrix), np.float64)
    change = spread @ vector
    moved = view.changed(change)
    if not moved.is_near_photograph:
        return None
    return Step(moved, spread, float(np.abs(change[:8]).max() * max(view.shape)))


def tukey(ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns Tukey's weights: 1 at 0, 0 from 1 on."""
    return np.asarray(np.maximum(1 - ratio**2, 0) ** 2)
