"""Fits the lattice of tiles to a photograph of a floor.

Tiles of a kind look alike, in all rotations. So the floor itself, seen from above, is the template:
each cell is compared with the mean of all other cells of its kind, turned to its direction. Where
the room's floor around the tiles has another colour, the border of the floor is a second
measurement. Both are linear in a small change of the view, and one least-squares problem: Gauss and
Newton's method (Lucas and Kanade 1981 for pictures), with Tukey's weights.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from elitelanes_jax.network.codes import KIND_OF, KINDS, SIDES, rotate_codes
from elitelanes_jax.photographs._borders import (
    ALONG,
    Border,
    Sides,
    colour_border,
    contrasts,
    outer_sides,
    shadow_width,
)
from elitelanes_jax.photographs._views import (
    FloorView,
    Points,
    flatten,
    floor_corners,
    places_of,
)
from elitelanes_jax.tiles.light import ground_of

Field = NDArray[np.float32]

# The sizes of the fit, from coarse to fine: pixels of a tile, reach of the border in tiles, and
# most rounds.
_STEPS = ((24, 0.14, 6), (48, 0.06, 5), (64, 0.03, 5))
# The width around the floor, in tiles, that the border's colours are read from.
_MARGIN = 0.4
# The least change of colour at an edge, as a multiple of that in the floor's texture.
_CLEAR = 4.0
# The width of the ring outside of the search, in tiles, in which the floor's colour is measured.
# Light differs further away.
_RING = 0.16
# The distance from the floor's colour, in standard deviations, above which a colour is another one.
_AWAY = 4.0
# The deviation of the points of a sharp border from a line, in tiles.
_EDGE_NOISE = 0.0015
# The number of pixels that count as one measurement, because texture and tape are larger than a
# pixel.
_GRAIN = 1000.0
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
# The deviation of a border by colours, in tiles. Six points of a side count as independent.
_COLOUR_NOISE = 0.01
# The rounds of Gauss and Newton's method at each reach.
_COLOUR_ROUNDS = 3
# The least contrast, of 6, of a side whose border is looked for by colours.
_CLEAR_COLOURS = 2.5
# The weight of the first guess. Parameters that nothing measures stay within a standard deviation
# of 0.2, in the units of `_basis`.
_WEAK = 25.0
# The least change, in tiles, after which a further one is made at the same size.
_STILL = 3e-4
# The usual radial distortion of a lens.
_BEND = 0.06
# The distance between two places across the border, in tiles.
_STEP = 1 / 160
# The distance within which a point is on the border, in tiles.
_ON_BORDER = 0.008
# The least side of a tile in a photograph, in pixels. In smaller tiles nothing is seen.
_LEAST_PX = 16
_RIGHT, _DOWN = np.eye(2)


class Fit(NamedTuple):
    """A fitted view.

    Attributes:
      view: the view of the floor.
      spread: float ``[9, 9]``, the covariance of the view's parameters, as `_basis` has them.
      alike: the correlation of the cells with the mean of their kind, 0 to 1; 0 if nothing can be
        compared.
      border: float ``[4]``, the share of points on the borders to the north, east, south and west
        where a border is seen within 0.8 % of a tile.
    """

    view: FloorView
    spread: NDArray[np.float64]
    alike: float
    border: NDArray[np.float64]


UNFITTED_SPREAD = np.eye(9)
"""The spread of a view that could not be fitted. It is too large for any corner to be sure."""


def fit_view(image: NDArray[np.uint8], view: FloorView, codes: NDArray[np.int8]) -> Fit:
    """Fits the view of a floor of several tiles to a photograph.

    Args:
      image: uint8 ``[H, W, 3]``, RGB.
      view: a first guess, off by up to a tenth of a tile.
      codes: the codes of the tiles ``[rows, columns]``; 0 is a cell without a tile.
    """
    groups = _groups(codes)
    fit = Fit(view, UNFITTED_SPREAD, 0.0, np.zeros(4))
    # Small pictures reach far, and large ones are exact.
    for tile_px, reach, rounds in _STEPS:
        fit = _refine(image, fit, codes, groups, tile_px, reach, rounds, np.ones(4, bool))
    # Cells alone fit the view a second time, to check the border.
    alone = _refine(image, fit, codes, groups, tile_px, reach, rounds, np.zeros(4, bool))
    cells_tell = largest_spread(alone, *codes.shape) <= _VAGUE
    if cells_tell:
        # Tape along the border of a floor that is as dark as asphalt looks like a border, but cells
        # say where it is.
        offsets = _border_offsets(image, alone.view, codes, reach).offsets
        trusted = _are_where_cells_have_them(_by_direction(codes, offsets))
        fit = _refine(image, alone, codes, groups, tile_px, reach, rounds, trusted)
    if largest_spread(fit, *codes.shape) <= _EXACT:
        return fit
    coloured = _fit_colours(image, fit, codes, groups)
    # The fit that tells the corners better is returned.
    return min(fit, coloured, key=lambda candidate: largest_spread(candidate, *codes.shape))


def _are_where_cells_have_them(side_offsets: list[NDArray[np.float64]]) -> NDArray[np.bool_]:
    """Returns whether the border of each side is where cells have it, or is not seen.

    `side_offsets` are in tiles.
    """
    medians = [
        np.nanmedian(offsets) if np.isfinite(offsets).any() else 0.0 for offsets in side_offsets
    ]
    return np.abs(medians) < _CONFLICT


def _fit_colours(
    image: NDArray[np.uint8],
    fit: Fit,
    codes: NDArray[np.int8],
    groups: list[list["_Seen"]],
) -> Fit:
    """Fits the border by colours, where no edge is seen at single points.

    This happens on floors that are nearly as dark as asphalt. Returns `fit` itself, which is by
    edges, if the colours do not say where the border is.
    """
    fit_by_edges = fit
    rows, columns = codes.shape
    tile_px = _STEPS[-1][0]
    for reach, has_shadow in _COLOUR_STEPS:
        sides = _clear_sides(image, fit.view, codes)
        # A shadow under the tiles moves the border by colours outwards. If its width is unknown,
        # this border does not count.
        shadow = shadow_width(image, fit.view, sides, reach) if sides and has_shadow else 0.0
        if not sides or np.isnan(shadow):
            return fit_by_edges
        for _ in range(_COLOUR_ROUNDS):
            matrix, vector = begin_equations(fit.view)
            alike = _add_cells(matrix, vector, image, fit.view, codes.shape, groups, tile_px)
            border = colour_border(image, fit.view, sides, reach)
            border = border._replace(offsets=border.offsets - shadow)
            add_offsets(matrix, vector, fit.view, border, rows, columns, noise=_COLOUR_NOISE)
            step = solve_equations(fit.view, matrix, vector, rows, columns)
            if step is None:
                return fit_by_edges
            fit = fit._replace(view=step.view, spread=step.spread, alike=alike)
            if step.size < _STILL:
                break
    return fit


def _clear_sides(image: NDArray[np.uint8], view: FloorView, codes: NDArray[np.int8]) -> Sides:
    """Returns the outer sides whose colours tell the tile from the floor."""
    sides = outer_sides(codes)
    clear = contrasts(image, view, sides) >= _CLEAR_COLOURS
    return [side for side, is_clear in zip(sides, clear, strict=True) if is_clear]


def _refine(
    image: NDArray[np.uint8],
    fit: Fit,
    codes: NDArray[np.int8],
    groups: list[list["_Seen"]],
    tile_px: int,
    reach: float,
    rounds: int,
    trusted: NDArray[np.bool_],
) -> Fit:
    """Takes Gauss-Newton steps at one size.

    `trusted` says which of the borders to the north, east, south and west count.
    """
    rows, columns = codes.shape
    for _ in range(rounds):
        # Each round begins with what is known before, and adds the cells and the trusted borders at
        # the view so far.
        matrix, vector = begin_equations(fit.view)
        alike = _add_cells(matrix, vector, image, fit.view, codes.shape, groups, tile_px)
        border = _add_border(matrix, vector, image, fit.view, codes, reach, trusted)
        step = solve_equations(fit.view, matrix, vector, rows, columns)
        if step is None:
            return fit._replace(spread=UNFITTED_SPREAD, border=np.zeros(4))
        fit = Fit(step.view, step.spread, alike, border)
        if step.size < _STILL:
            break
    return fit


def begin_equations(view: FloorView) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns the normal equations of what is known before the pixels are read.

    These are a guess of the view, and the usual bend of a lens.
    """
    matrix, vector = np.diag([_WEAK] * 8 + [_BEND**-2]), np.zeros(9)
    vector[8] = -view.radial * matrix[8, 8]
    return matrix, vector


class Step(NamedTuple):
    """A step of Gauss and Newton's method.

    Attributes:
      view: the view after the step.
      spread: the covariance of the parameters, ``[9, 9]``.
      size: the largest change of a parameter, in tiles.
    """

    view: FloorView
    spread: NDArray[np.float64]
    size: float


def solve_equations(
    view: FloorView,
    matrix: NDArray[np.float64],
    vector: NDArray[np.float64],
    rows: int,
    columns: int,
) -> Step | None:
    """Takes the step that solves the normal equations at a view.

    Returns None if the step leaves the photograph.
    """
    spread = np.asarray(np.linalg.inv(matrix), np.float64)
    change = spread @ vector
    moved = _moved_view(view, change, rows, columns)
    if not _is_seen(moved, rows, columns):
        return None
    return Step(moved, spread, float(np.abs(change[:8]).max() * max(rows, columns)))


def _is_seen(view: FloorView, rows: int, columns: int) -> bool:
    """Returns whether a view is one of a convex floor near the photograph.

    A fit to pixels that show no tiles may leave the photograph.
    """
    corners = view.pixels_of(floor_corners(rows, columns))
    if not np.isfinite(corners).all() or np.abs(corners).max() > 4 * max(view.width, view.height):
        return False
    return (
        cv2.isContourConvex(corners.astype(np.float32))
        and view.tile_pixels(rows, columns) > _LEAST_PX
    )


def largest_spread(fit: Fit, rows: int, columns: int) -> float:
    """Returns the standard deviation of the least sure corner of a fitted floor, in tiles."""
    basis = _basis(fit.view, floor_corners(rows, columns), rows, columns)
    variances = np.einsum("icd,ij,jcd->c", basis, fit.spread, basis)
    return float(np.sqrt(variances.max()))


def tape_of(flat: NDArray[np.uint8], tile_px: int) -> Field:
    """Returns how much brighter than the ground around it each pixel is.

    The result is a logarithm. It shows tape without the light.
    """
    value = flat.max(axis=2).astype(np.float32) + 4
    tape = np.clip(
        np.log(cv2.GaussianBlur(value, (0, 0), tile_px / 40) / ground_of(flat, tile_px)), -0.2, 1.2
    )
    return np.asarray(cv2.GaussianBlur(tape, (0, 0), tile_px / 40), np.float32)


class _Seen(NamedTuple):
    """A cell of a kind.

    Attributes:
      row: the row of the cell on the floor, from 0.
      column: the column of the cell on the floor, from 0.
      turns: the quarter turns counter-clockwise that bring the cell to the first code of its kind;
        several for kinds with symmetries.
    """

    row: int
    column: int
    turns: tuple[int, ...]


def _groups(codes: NDArray[np.int8]) -> list[list[_Seen]]:
    """Returns the cells of each kind with at least two comparable pictures."""
    groups: dict[str, list[_Seen]] = {}
    for row, column in np.argwhere(codes > 0).tolist():
        kind = KIND_OF[int(codes[row, column])]
        first = KINDS[kind][0]
        turns = tuple(
            turn for turn in range(4) if rotate_codes(int(codes[row, column]), turn) == first
        )
        groups.setdefault(kind, []).append(_Seen(row, column, turns))
    return [cells for cells in groups.values() if sum(len(cell.turns) for cell in cells) > 1]


def _basis(view: FloorView, places: Points, rows: int, columns: int) -> NDArray[np.float64]:
    """Returns how each parameter moves positions ``[..., 2]`` in tiles: ``[9, ..., 2]``.

    The first eight are a homography's, in units of half the floor. The last is the radial
    distortion.
    """
    half = np.array([columns, rows]) / 2
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
    basis = np.stack([np.stack(move, axis=-1) * half for move in moves])
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
    return np.concatenate([basis, bent[None]])


def _moved_view(view: FloorView, change: NDArray[np.float64], rows: int, columns: int) -> FloorView:
    """Applies a change of the parameters of `_basis`."""
    a, b, c, d, e, f, g, h = change[:8]
    small = np.array([[1 + b, c, a], [e, 1 + f, d], [-g, -h, 1]])
    # The change is a homography of the floor in coordinates from -1 to 1.
    unit = np.array([[2 / columns, 0, -1], [0, 2 / rows, -1], [0, 0, 1]])
    homography = view.homography @ np.linalg.inv(unit) @ small @ unit
    return view._replace(homography=homography / homography[2, 2], radial=view.radial + change[8])


def _add_cells(
    matrix: NDArray[np.float64],
    vector: NDArray[np.float64],
    image: NDArray[np.uint8],
    view: FloorView,
    shape: tuple[int, ...],
    groups: list[list[_Seen]],
    tile_px: int,
) -> float:
    """Adds the comparison of cells to the normal equations.

    Returns the correlation of the cells with the mean of their kind. Without groups it adds
    nothing, and returns 0.
    """
    if not groups:
        return 0.0
    rows, columns = shape
    places = places_of(rows, columns, tile_px, 0)
    tape = tape_of(flatten(image, view, places, tile_px), tile_px)
    basis = _basis(view, places, rows, columns)
    # The first layer is the picture, and nine others are its derivatives by the parameters.
    down, right = np.gradient(tape)
    moves = (basis[..., 0] * right + basis[..., 1] * down) * tile_px
    layers = np.concatenate([tape[None], moves]).astype(np.float32)
    away, means = [], []
    for cells in groups:
        windows = [
            layers[
                :,
                cell.row * tile_px : (cell.row + 1) * tile_px,
                cell.column * tile_px : (cell.column + 1) * tile_px,
            ]
            for cell in cells
        ]
        # A cell is turned to the first code of its kind, in each way that does so.
        turned = [
            [np.rot90(window, turn, (1, 2)) for turn in cell.turns]
            for cell, window in zip(cells, windows, strict=True)
        ]
        total, count = sum(sum(pictures) for pictures in turned), sum(map(len, turned))
        for pictures in turned:
            for picture in pictures:
                # A picture is compared with the mean of all others, so that it is not compared with
                # itself.
                others = (total - picture) / (count - 1)
                # A cell with several rotations counts as one.
                away.append((picture - others).reshape(10, -1) / np.sqrt(len(pictures)))
                means.append(others[0].ravel())
    rest = np.concatenate(away, axis=1)
    mean = np.concatenate(means)
    # In normal noise, 1.48 times the median of absolute values is the standard deviation.
    scale = max(1.48 * float(np.median(np.abs(rest[0]))), 0.02)
    # Larger pictures have more pixels, but not more measurements.
    weight = _tukey(rest[0] / (4 * scale)) / (scale**2 * _GRAIN * (tile_px / 64) ** 2)
    weighted = rest[1:] * weight
    matrix += weighted @ rest[1:].T
    vector -= weighted @ rest[0]
    return float(np.clip(1 - rest[0].var() / max(mean.var() + rest[0].var() / 2, 1e-6), 0, 1))


def _border_offsets(
    image: NDArray[np.uint8], view: FloorView, codes: NDArray[np.int8], reach: float
) -> Border:
    """Returns where the border is seen on both sides of where a view has it."""
    sides = outer_sides(codes)
    outwards = np.array([normal for _, normal in sides], float)[:, None]
    along = (np.arange(ALONG) + 0.5)[None, :, None] / ALONG - 0.5
    points = np.array([middle for middle, _ in sides])[:, None] + along * outwards[..., ::-1]
    steps = np.arange(_MARGIN, -reach - 0.06, -_STEP)
    # The places go from outside to inside.
    profile = points[:, :, None] + steps[:, None] * outwards[:, :, None]
    colours = flatten(image, view, profile.reshape(-1, len(steps), 2), 1 / _STEP).reshape(
        -1, len(steps), 3
    )
    lab = cv2.cvtColor(colours, cv2.COLOR_RGB2LAB).reshape(*profile.shape[:3], 3).astype(np.float32)
    return Border(points, outwards, _first_edges(lab, steps, reach))


def _directions(codes: NDArray[np.int8]) -> NDArray[np.int_]:
    """Returns the direction of each outer side: 0 to 3 for north, east, south and west."""
    order = [(side.right, side.down) for side in SIDES]
    return np.array([order.index(normal) for _, normal in outer_sides(codes)], int)


def _by_direction(
    codes: NDArray[np.int8], values: NDArray[np.float64]
) -> list[NDArray[np.float64]]:
    """Returns values ``[S, A]`` of the outer sides to the north, east, south and west."""
    directions = _directions(codes)
    return [values[directions == direction] for direction in range(4)]


def _add_border(
    matrix: NDArray[np.float64],
    vector: NDArray[np.float64],
    image: NDArray[np.uint8],
    view: FloorView,
    codes: NDArray[np.int8],
    reach: float,
    trusted: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Adds the place of the border to the normal equations.

    Returns the share of points where a border is seen, for the sides to the north, east, south and
    west.
    """
    border = _border_offsets(image, view, codes, reach)
    weight = (
        _tukey(np.nan_to_num(border.offsets / reach, nan=1.0))
        * trusted[_directions(codes)][:, None]
    )
    rows, columns = codes.shape
    add_offsets(matrix, vector, view, border, rows, columns, weight)
    offsets = np.nan_to_num(border.offsets, nan=1.0)
    return np.array([(np.abs(part) < _ON_BORDER).mean() for part in _by_direction(codes, offsets)])


def add_offsets(
    matrix: NDArray[np.float64],
    vector: NDArray[np.float64],
    view: FloorView,
    border: Border,
    rows: int,
    columns: int,
    trust: NDArray[np.float64] | float = 1.0,
    noise: float = _EDGE_NOISE,
) -> None:
    """Adds the offsets of a border to the normal equations.

    `trust` says how far each is trusted, 0 to 1. Offsets of more than four times the usual one, or
    of `noise` in tiles if that is more, do not count.
    """
    seen = np.isfinite(border.offsets)
    offsets = np.where(seen, border.offsets, 1.0)
    scale = max(1.48 * float(np.median(np.abs(offsets[seen]))) if seen.any() else 1.0, noise)
    # Six of the points along a side count as independent.
    weight = trust * seen * _tukey(offsets / (4 * scale)) / (scale**2 * ALONG / 6)
    basis = (
        (_basis(view, border.points, rows, columns) * border.outwards).sum(axis=-1).reshape(9, -1)
    )
    weighted = basis * weight.ravel()
    matrix += weighted @ basis.T
    vector += weighted @ offsets.ravel()


def _first_edges(colours: Field, steps: NDArray[np.float64], reach: float) -> NDArray[np.float64]:
    """Returns how far outside the border is at each point ``[S, A]``.

    The distance is in tiles, or NaN where no border is seen. Going inwards, the border is the first
    strong edge where the colour stops to be the ground's for a while.

    Args:
      colours: Lab ``[S, A, T, 3]``, from outside to inside.
      steps: the distance outside of each of the T places.
      reach: the reach of the search in tiles, outside and inside.
    """
    # The colours are averaged over three places across the border.
    blurred = cv2.blur(colours.reshape(-1, *colours.shape[2:]), (3, 1))
    colours = np.asarray(blurred, np.float32).reshape(colours.shape)
    nearest = max(reach, 0.08) + 0.02
    in_ring = (steps > nearest) & (steps < nearest + _RING)
    ring = colours[:, :, in_ring]
    near = sliding_window_view(
        np.pad(ring, ((0, 0), (2, 2), (0, 0), (0, 0)), mode="edge"), 5, axis=1
    )
    # These are the colours of five neighbouring points.
    near = near.swapaxes(3, 4).reshape(*ring.shape[:2], -1, 3)
    ground = np.median(near, axis=2, keepdims=True)
    noise = np.maximum(1.48 * np.median(np.abs(near - ground), axis=2, keepdims=True), 2.0)
    away = np.sqrt((((colours - ground) / noise) ** 2).sum(axis=-1))
    inner = np.flatnonzero((steps <= reach) & (steps >= -reach - 0.05))
    length = max(2, round(0.03 / _STEP))
    # The tile begins where most colours within 0.03 tiles are another one than the floor's.
    lasting = sliding_window_view(away[..., inner] > _AWAY, length, axis=2).mean(axis=-1) > 0.85
    first = inner[0] + np.argmax(lasting, axis=2)
    seen = lasting.any(axis=2) & (first > inner[0])
    # The strength of an edge is the change of colour from the place before to the one after.
    edge = np.linalg.norm(colours[:, :, 2:] - colours[:, :, :-2], axis=-1)
    edge = np.pad(edge, ((0, 0), (0, 0), (1, 1)))
    window = np.clip(first[..., None] + np.arange(-3, length + 1), 1, len(steps) - 2)
    strength = np.take_along_axis(edge, window, 2)
    # The border is at a peak of the strength near this beginning.
    peak = (strength >= np.take_along_axis(edge, window - 1, 2)) & (
        strength >= np.take_along_axis(edge, window + 1, 2)
    )
    # Behind a narrow strip of asphalt, white tape is a stronger edge than the border. It alone is
    # brighter inside.
    rise = np.pad(colours[:, :, 2:, 0] - colours[:, :, :-2, 0], ((0, 0), (0, 0), (1, 1)))
    darkens = np.where(np.take_along_axis(rise, window, 2) < 0.5 * strength, strength, 0).max(
        axis=2, keepdims=True
    )
    texture = np.median(edge[:, :, in_ring], axis=2, keepdims=True)
    largest = strength.max(axis=2, keepdims=True)
    is_clear = darkens >= np.maximum(_CLEAR * texture, 0.15 * largest)
    # A peak has at least half the strength of the strongest edge that darkens. If that does not
    # stand out from the floor's texture, the strongest edge of all counts instead.
    peak &= strength >= 0.5 * np.where(is_clear, darkens, largest)
    # The first strong peak counts. A parabola through three strengths places it between the steps.
    at = np.take_along_axis(window, np.argmax(peak, axis=2)[..., None], 2)
    left, here, right = (np.take_along_axis(edge, at + shift, 2)[..., 0] for shift in (-1, 0, 1))
    bow = np.maximum(2 * here - left - right, 1e-3)
    place = steps[at[..., 0]] - np.clip((right - left) / (2 * bow), -1, 1) * _STEP
    return np.where(seen & peak.any(axis=2), place, np.nan)


def _tukey(ratio: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns Tukey's weights: 1 at 0, 0 from 1 on."""
    return np.asarray(np.maximum(1 - ratio**2, 0) ** 2)
