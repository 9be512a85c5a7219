"""Makes starts, to be fitted, of guessed or given corners: views in all directions that tiles may have."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax.photographs._areas import Area
from elitelanes_jax.photographs._cells import guessed_cells
from elitelanes_jax.photographs._kinds import read_kinds
from elitelanes_jax.photographs._outline import find_corners
from elitelanes_jax.photographs._views import FloorView, Points, view_of
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.tileset import TileSet

# The tiles from the border to the outer white lines, at which some guesses end.
_TAPE_INSET = 0.07


class Task(NamedTuple):
    """What is looked for in a photograph.

    Attributes:
      photograph: the photograph.
      area: the part of a map that the photograph shows.
      codes: int8 ``[H, W]``, the codes of the area; None if they are to be read.
      corners: float ``[4, 2]``, the user's corners of the area or of the whole map, in pixels; None
        if they are to be found.
      tiles: pictures that kinds are read with.
      fit: whether the corners are fitted to the photograph, or taken as they are.
    """

    photograph: Photograph
    area: Area
    codes: NDArray[np.int8] | None
    corners: Points | None
    tiles: TileSet
    fit: bool


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


def find_starts(task: Task, *, lacks_corner: bool = False) -> list[Start]:
    """Returns the starts of a task, sorted: cells of the first one look most like tiles.

    `lacks_corner` says whether a corner of the floor is known to have no tile, see `find_corners`.

    Raises:
      InputError: if the user's corners are wrong, or nothing like tiles is there.
    """
    photograph, shape, is_found = task.photograph, task.area.shape, task.corners is None
    starts = [
        start
        for quad in _quads_of(task, lacks_corner=lacks_corner)
        for start in _starts_of(task, quad)
    ]
    if not starts:
        floor = f"{shape[0]} x {shape[1]} road tiles"
        size = "check the size" if shape != (1, 1) else "give the size of a floor of several tiles"
        hint = f"{size}, and {'give' if is_found else 'check'} the corners"
        raise InputError(photograph.name, floor, "none", hint)
    return sorted(starts, key=lambda start: -start.support)


def _quads_of(task: Task, *, lacks_corner: bool) -> list[Points]:
    """Returns quadrangles ``[4, 2]`` around the tiles, in all directions that these may have.

    The user's corners may be those of the area, or those of the whole map in any direction.
    """
    photograph, area, is_map = task.photograph, task.area, task.codes is not None
    if task.corners is not None:
        corners = _check_corners(photograph, task.corners)
        quads = _turn_quad(corners, area.shape, is_map=is_map)
        if not area.is_whole:
            height, width = photograph.image.shape[:2]
            quads += [
                area.corners_in(np.roll(corners, -turn, axis=0), width, height) for turn in range(4)
            ]
        return quads
    found = find_corners(photograph.image, lacks_corner=lacks_corner)
    if not found:
        raise InputError(
            photograph.name,
            "tiles that stand out from the floor",
            "none",
            "give their corners, or photograph them on a floor of another colour",
        )
    return [turned for quad in found for turned in _turn_quad(quad, area.shape, is_map=is_map)]


def _check_corners(photograph: Photograph, corners: Points) -> Points:
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
        if photograph.lens is not None:
            size += " after the lens's distortion is removed"
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


def _turn_quad(quad: Points, shape: tuple[int, int], *, is_map: bool) -> list[Points]:
    """Returns a quadrangle ``[4, 2]`` in all directions that the tiles may have."""
    if is_map:
        # A map may be laid in each of the four directions.
        return [np.roll(quad, -turn, axis=0) for turn in range(4)]
    if shape == (1, 1):
        return [quad]
    # Rows may run along either pair of sides. Of the two other directions, the one that begins
    # nearer to the top left counts.
    turned = np.roll(quad, -1, axis=0)
    upright = min(turned, np.roll(turned, -2, axis=0), key=lambda corners: corners[0].sum())
    return [quad] if shape[0] == shape[1] else [quad, upright]


def _starts_of(task: Task, quad: Points) -> list[Start]:
    """Returns the views of a quadrangle whose first corner is that of the first tile."""
    image, (rows, columns) = task.photograph.image, task.area.shape
    insets = [0.0]
    if task.corners is None and task.area.shape != (1, 1):
        insets.append(_TAPE_INSET)
    starts = []
    for inset in insets:
        view = view_of(quad, rows, columns, image.shape[1], image.shape[0])
        if inset:
            # If the guess ends at the white lines, the border is outside of it.
            low, right, bottom = -inset, columns + inset, rows + inset
            outer = np.array([[low, low], [right, low], [right, bottom], [low, bottom]])
            view = view_of(view.pixels_of(outer), rows, columns, view.width, view.height)
        kinds = read_kinds(guessed_cells(image, view), task.tiles)
        laid = kinds.codes if task.codes is None else task.codes
        if laid.any():
            starts.append(Start(float(kinds.alike(laid).mean()), view, laid))
    return starts
