"""Makes starts of guessed corners, to be fitted: views in all directions that tiles may have."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax.photographs._areas import Area
from elitelanes_jax.photographs._cells import guessed_cells
from elitelanes_jax.photographs._kinds import read_kinds
from elitelanes_jax.photographs._views import FloorView, Points, view_of
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.tileset import TileSet

# The tiles from the border to the outer white lines, at which some guesses end.
_TAPE_INSET = 0.07


class Start(NamedTuple):
    """A guess of a view.

    Attributes:
      support: the mean correlation of the cells with pictures of their codes, up to 1.
      view: the guessed view of the floor.
      codes: int8 ``[H, W]``, the codes of the floor in this view; 0 is a cell without a tile.
    """

    support: float
    view: FloorView
    codes: NDArray[np.int8]


def check_corners(photograph: Photograph, corners: Points) -> Points:
    """Checks four corners in pixels ``[4, 2]``.

    They must be in the photograph, clockwise, around a convex area.
    """
    points = np.asarray(corners, np.float64)
    name = f"{photograph.name}: corners"
    if points.shape != (4, 2):
        raise InputError(name, "four points x, y", list(points.shape))
    if not np.isfinite(points).all():
        raise InputError(name, "finite numbers", shorten(str(points.tolist())))
    height, width = photograph.image.shape[:2]
    # Corners may be outside of the photograph by 2 % of its width.
    outside = (points < -0.02 * width) | (points > np.array([width, height]) + 0.02 * width)
    if outside.any():
        size = f"{width} x {height} pixels"
        if photograph.shrunk > 1:
            size += f" at 1/{photograph.shrunk} of the file's size"
        raise InputError(name, f"points in the photograph, {size}", shorten(str(points.tolist())))
    x, y = points.T
    # In pixels, whose y points down, corners in clockwise order have a positive area.
    area = (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() / 2
    if not cv2.isContourConvex(points.astype(np.float32)) or abs(area) < 100:
        raise InputError(
            name, "the corners of a convex area in order around it", "lines that cross"
        )
    if area < 0:
        raise InputError(name, "them clockwise, as in the photograph", "them counter-clockwise")
    return points


def turn_quad(quad: Points, shape: tuple[int, int], *, is_map: bool) -> list[Points]:
    """Returns a quadrangle ``[4, 2]`` in all directions that the tiles may have."""
    if shape == (1, 1):
        return [quad]
    if is_map:
        # A map may be laid in each of the four directions.
        return [np.roll(quad, -turn, axis=0) for turn in range(4)]
    # Rows may run along either pair of sides. Of the two other directions, the one that begins
    # nearer to the top left counts.
    turned = np.roll(quad, -1, axis=0)
    upright = min(turned, np.roll(turned, -2, axis=0), key=lambda corners: corners[0].sum())
    return [quad] if shape[0] == shape[1] else [quad, upright]


def quads_of(
    area: Area, corners: Points, image: NDArray[np.uint8], *, is_map: bool
) -> list[Points]:
    """Returns the quadrangles ``[4, 2]`` of an area that a user may mean by four corners.

    The corners may be those of the area, or those of the whole map in any direction.
    """
    quads = turn_quad(corners, area.shape, is_map=is_map)
    if not area.is_whole:
        height, width = image.shape[:2]
        quads += [
            area.corners_in(np.roll(corners, -turn, axis=0), width, height) for turn in range(4)
        ]
    return quads


def starts_of(
    image: NDArray[np.uint8],
    quad: Points,
    shape: tuple[int, int],
    codes: NDArray[np.int8] | None,
    tiles: TileSet,
    *,
    is_found: bool,
) -> list[Start]:
    """Returns the views of a quadrangle whose first corner is that of the first tile."""
    rows, columns = shape
    starts = []
    for inset in (0.0, _TAPE_INSET) if is_found and shape != (1, 1) else (0.0,):
        view = view_of(quad, rows, columns, image.shape[1], image.shape[0])
        if inset:
            # If the guess ends at the white lines, the border is outside of it.
            low, right, bottom = -inset, columns + inset, rows + inset
            outer = np.array([[low, low], [right, low], [right, bottom], [low, bottom]])
            view = view_of(view.pixels_of(outer), rows, columns, view.width, view.height)
        kinds = read_kinds(guessed_cells(image, view, shape), tiles)
        laid = kinds.codes if codes is None else codes
        if laid.any():
            starts.append(Start(float(kinds.alike(laid).mean()), view, laid))
    return starts
