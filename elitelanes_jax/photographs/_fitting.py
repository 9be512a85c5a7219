"""Fits the view of a floor, or of a single tile, to a photograph.

Tiles of a kind look alike, in all rotations. Therefore the cells of a floor measure its view. If the
room's floor around the tiles has another colour, the border is a second measurement. Both are
linear in a small change of the view, and one least-squares problem: Gauss and Newton's method
(Lucas and Kanade 1981 for pictures), with Tukey's weights. A single tile has its border alone.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.photographs._borders import (
    Sides,
    colour_border,
    contrasts,
    outer_sides,
    shadow_width,
    sharpest_border,
)
from elitelanes_jax.photographs._edges import edge_border
from elitelanes_jax.photographs._equations import measure_border, take_step, tukey
from elitelanes_jax.photographs._repeats import AlikeCells, alike_cells, compare_cells
from elitelanes_jax.photographs._views import FloorView

SIDES_OF_TILE = outer_sides(np.ones((1, 1), np.int8))
"""The sides of a single tile, to the north, east, south and west."""


class _Size(NamedTuple):
    """A size of the floor at which it is fitted.

    Attributes:
      tile_px: the pixels of a tile.
      reach: the reach of the border in tiles.
      rounds: the most steps.
    """

    tile_px: int
    reach: float
    rounds: int


# Small pictures reach far, and large ones are exact.
_SIZES = (_Size(24, 0.14, 6), _Size(48, 0.06, 5), _Size(64, 0.03, 5))
_FINEST = _SIZES[-1]
# The largest standard deviation of the corners, in tiles, with which cells judge the border.
_VAGUE = 0.01
# The distance between a border and where cells have it, in tiles, from which on it is none. Cells
# are right within 0.007.
_CONFLICT = 0.011
# The largest standard deviation of the corners, in tiles, to which the border by colours adds
# nothing.
_EXACT = 0.003
# The steps of the fit by colours: the reach in tiles, and whether a shadow is taken off.
_COLOUR_STEPS = ((0.04, False), (0.02, True), (0.02, True))
# The deviation of a border by colours, in tiles.
_COLOUR_NOISE = 0.01
# The rounds of Gauss and Newton's method at each reach of the fit by colours.
_COLOUR_ROUNDS = 3
# The least contrast, of 6, of a side whose border is looked for by colours.
_CLEAR_COLOURS = 2.5
# The spread of a view that could not be fitted. It is too large for any corner to be sure.
_UNKNOWN_SPREAD = np.eye(9)
# The spread of exact corners, which are nearly sure.
_NO_SPREAD = np.eye(9) * 1e-7
# The least change, in half tiles, after which a further one is made at the same size.
_STILL = 3e-4
# The distance within which a point is on the border, in tiles.
_ON_BORDER = 0.008
# A side of a single tile is looked for by colours within these reaches in tiles, one after the
# other. Each reach has a number of rounds.
_TILE_REACHES, _TILE_ROUNDS = (0.1, 0.05, 0.03), 4


class Fit(NamedTuple):
    """A fitted view.

    Attributes:
      view: the view of the floor.
      spread: float ``[9, 9]``, the covariance of the view's parameters.
      alike: the correlation of the cells with the mean of their kind, 0 to 1; 0 if nothing can be
        compared.
      border: float ``[4]``, for the borders to the north, east, south and west. Each is the share
        of points where a border is seen within 0.8 % of a tile.
    """

    view: FloorView
    spread: NDArray[np.float64]
    alike: float = 0.0
    border: NDArray[np.float64] = np.zeros(4)

    @staticmethod
    def exact(view: FloorView) -> "Fit":
        """Returns the fit of an exact view. All of its border counts as seen."""
        return Fit(view, _NO_SPREAD, 1.0, np.ones(4))

    @property
    def corner_spread(self) -> float:
        """The standard deviation of the least sure corner, in tiles."""
        moves = self.view.moves(self.view.corners)
        variances = np.einsum("icd,ij,jcd->c", moves, self.spread, moves)
        return float(np.sqrt(variances.max()))


class _Floor(NamedTuple):
    """What of a photographed floor is measured.

    Attributes:
      image: the photograph.
      laid: bool ``[rows, columns]``, the cells that have a tile.
      alike: the cells of each kind.
      sides: the sides of tiles without a neighbour.
      directions: int ``[S]``, the direction of each side: 0 to 3 for north, east, south and west.
    """

    image: NDArray[np.uint8]
    laid: NDArray[np.bool_]
    alike: AlikeCells
    sides: Sides
    directions: NDArray[np.int_]

    @staticmethod
    def of(image: NDArray[np.uint8], codes: NDArray[np.int8]) -> "_Floor":
        sides = outer_sides(codes)
        order = [(side.right, side.down) for side in SIDES]
        directions = np.array([order.index(normal) for _, normal in sides], int)
        return _Floor(image, codes > 0, alike_cells(codes), sides, directions)


def fit_view(image: NDArray[np.uint8], view: FloorView, codes: NDArray[np.int8]) -> Fit:
    """Fits the view of a floor to a photograph.

    Args:
      image: uint8 ``[H, W, 3]``, RGB.
      view: a first guess, off by up to a tenth of a tile.
      codes: the codes of the tiles ``[rows, columns]``; 0 is a cell without a tile.
    """
    if codes.size == 1:
        return _fit_tile(image, view)
    floor = _Floor.of(image, codes)
    fit = Fit(view, _UNKNOWN_SPREAD)
    for size in _SIZES:
        fit = _refine(floor, fit, size, np.ones(4, bool))
    # Cells alone fit the view a second time, to check the border.
    alone = _refine(floor, fit, _FINEST, np.zeros(4, bool))
    if alone.corner_spread <= _VAGUE:
        # Tape along the border of a floor that is as dark as asphalt looks like a border, but cells
        # say where it is.
        fit = _refine(floor, alone, _FINEST, _borders_where_cells_have_them(floor, alone.view))
    if fit.corner_spread <= _EXACT:
        return fit
    # The fit that tells the corners better is returned.
    return min(fit, _fit_colours(floor, fit), key=lambda fitted: fitted.corner_spread)


def _refine(floor: _Floor, fit: Fit, size: _Size, trusted: NDArray[np.bool_]) -> Fit:
    """Takes steps at one size.

    `trusted` says which of the borders to the north, east, south and west count.
    """
    for _ in range(size.rounds):
        cells, alike = compare_cells(floor.image, fit.view, floor.alike, floor.laid, size.tile_px)
        border = edge_border(floor.image, fit.view, floor.sides, size.reach)
        near = tukey(np.nan_to_num(border.offsets / size.reach, nan=1.0))
        trust = near * trusted[floor.directions][:, None]
        step = take_step(fit.view, cells, measure_border(fit.view, border, trust))
        if step is None:
            return Fit(fit.view, _UNKNOWN_SPREAD, fit.alike)
        offsets = np.abs(np.nan_to_num(border.offsets, nan=1.0))
        seen = [(part < _ON_BORDER).mean() for part in _by_direction(floor, offsets)]
        fit = Fit(step.view, step.spread, alike, np.array(seen))
        if step.size < _STILL:
            break
    return fit


def _borders_where_cells_have_them(floor: _Floor, view: FloorView) -> NDArray[np.bool_]:
    """Returns whether the border to each direction is where cells have it, or is not seen."""
    offsets = edge_border(floor.image, view, floor.sides, _FINEST.reach).offsets
    medians = [
        np.nanmedian(part) if np.isfinite(part).any() else 0.0
        for part in _by_direction(floor, offsets)
    ]
    return np.abs(medians) < _CONFLICT


def _by_direction(floor: _Floor, values: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Returns values ``[S, A]`` of the outer sides to the north, east, south and west."""
    return [values[floor.directions == direction] for direction in range(4)]


def _fit_colours(floor: _Floor, fit: Fit) -> Fit:
    """Fits the border by colours, where no edge is seen at single points.

    This happens on floors that are nearly as dark as asphalt. Returns `fit` itself, which is by
    edges, if the colours do not say where the border is.
    """
    fit_by_edges = fit
    for reach, has_shadow in _COLOUR_STEPS:
        # Only sides whose colours tell the tile from the floor count.
        clear = contrasts(floor.image, fit.view, floor.sides) >= _CLEAR_COLOURS
        sides = [side for side, is_clear in zip(floor.sides, clear, strict=True) if is_clear]
        # A shadow under the tiles moves the border by colours outwards. If its width is unknown,
        # this border does not count.
        shadow = 0.0
        if sides and has_shadow:
            shadow = shadow_width(floor.image, fit.view, sides, reach)
        if not sides or np.isnan(shadow):
            return fit_by_edges
        for _ in range(_COLOUR_ROUNDS):
            cells, alike = compare_cells(
                floor.image, fit.view, floor.alike, floor.laid, _FINEST.tile_px
            )
            border = colour_border(floor.image, fit.view, sides, reach)
            border = border._replace(offsets=border.offsets - shadow)
            offsets = measure_border(fit.view, border, noise=_COLOUR_NOISE)
            step = take_step(fit.view, cells, offsets)
            if step is None:
                return fit_by_edges
            fit = fit._replace(view=step.view, spread=step.spread, alike=alike)
            if step.size < _STILL:
                break
    return fit


def _fit_tile(image: NDArray[np.uint8], view: FloorView) -> Fit:
    """Fits the view of a single tile by the colours that tell its ground from the floor around it."""
    fit = Fit(view, _UNKNOWN_SPREAD)
    for reach in (*_TILE_REACHES, None):
        for _ in range(_TILE_ROUNDS):
            # The last rounds use the sharpest edge. It is exact, but only looked for close to the
            # side.
            if reach is None:
                border = sharpest_border(image, fit.view, SIDES_OF_TILE)
                offsets = measure_border(fit.view, border)
            else:
                # One side may be off by the whole reach, and the others by nothing.
                border = colour_border(image, fit.view, SIDES_OF_TILE, reach)
                offsets = measure_border(fit.view, border, noise=reach / 3)
            step = take_step(fit.view, offsets)
            if step is None:
                return Fit(fit.view, _UNKNOWN_SPREAD)
            fit = Fit(step.view, step.spread)
            if step.size < _STILL:
                break
    return fit
