"""Fits a single tile to a photograph by the colours that tell its ground from the floor around it.

A single tile has no other cells to be compared with, so that its four sides alone say where it is.
"""

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.photographs._borders import colour_border, outer_sides, sharpest_border
from elitelanes_jax.photographs._registration import (
    UNFITTED_SPREAD,
    Fit,
    add_offsets,
    begin_equations,
    solve_equations,
)
from elitelanes_jax.photographs._views import FloorView

SIDES_OF_TILE = outer_sides(np.ones((1, 1), np.int8))
"""The sides of a single tile, to the north, east, south and west."""

# The reaches, in tiles, in which a side is looked for by colours, one after the other.
_REACHES = (0.1, 0.05, 0.03)
# The rounds of Gauss and Newton's method at each reach.
_ROUNDS = 4
# The least change, in tiles, after which a further one is made at the same reach.
_LEAST_CHANGE = 3e-4


def fit_tile(image: NDArray[np.uint8], view: FloorView) -> Fit:
    """Fits the view of a single tile.

    Args:
      image: uint8 ``[H, W, 3]``, RGB.
      view: a first guess, off by up to a tenth of a tile.
    """
    fit = Fit(view, UNFITTED_SPREAD, 0.0, np.zeros(4))
    for reach in (*_REACHES, None):
        for _ in range(_ROUNDS):
            matrix, vector = begin_equations(fit.view)
            # The last rounds use the sharpest edge. It is exact, but only looked for close to the
            # side.
            if reach is None:
                border = sharpest_border(image, fit.view, SIDES_OF_TILE)
                add_offsets(matrix, vector, fit.view, border, rows=1, columns=1)
            else:
                # One side may be off by the whole reach, and the others by nothing.
                border = colour_border(image, fit.view, SIDES_OF_TILE, reach)
                add_offsets(matrix, vector, fit.view, border, rows=1, columns=1, noise=reach / 3)
            step = solve_equations(fit.view, matrix, vector, rows=1, columns=1)
            if step is None:
                return fit._replace(spread=UNFITTED_SPREAD)
            fit = fit._replace(view=step.view, spread=step.spread)
            if step.size < _LEAST_CHANGE:
                break
    return fit
