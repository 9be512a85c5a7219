"""Proposes where the tiles in a photograph are, which kind each is, and how sure that is."""

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, floor_shape, instance
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.photographs._areas import Area
from elitelanes_jax.photographs._borders import contrasts
from elitelanes_jax.photographs._cells import fitted_cells
from elitelanes_jax.photographs._fitting import SIDES_OF_TILE, Fit, fit_view
from elitelanes_jax.photographs._grey import check_grey_tiles, in_grey, is_grey
from elitelanes_jax.photographs._judging import (
    CORNERS_GIVEN,
    LACKS_CORNER,
    SURE,
    judge,
    least_alike_edge,
    out_of_square,
    sigmoid,
)
from elitelanes_jax.photographs._kinds import Kinds, read_kinds
from elitelanes_jax.photographs._starts import Start, Task, find_starts
from elitelanes_jax.photographs._views import FloorView, Points
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.files import check_picture
from elitelanes_jax.tiles.tileset import TileSet, own_tiles

# The most guesses that are fitted.
_STARTS = 3
# The score at which no other guess is tried.
_ENOUGH = 0.9
# The margin of a kind that is believed against a map.
_SURELY = 0.1
# The largest share of a floor's tiles that are laid otherwise than a map says.
_FEW = 0.25


@keeps_copies
class Proposal(NamedTuple):
    """Where the tiles in a photograph are.

    All values are plain, as in JSON: `Proposal(**values)` reads them.

    Attributes:
      photo: the name of the photograph.
      width: the width of the photograph in pixels.
      height: the height of the photograph in pixels.
      corners: the corners of the tiles in pixels, x and y, ``[4][2]``: clockwise, from the first
        row's first tile. A map's empty border is outside of them.
      homography: ``[3][3]``, from tiles (x to the right, y down) to pixels without distortion.
      radial: distortion of the lens: a point at the distance r from the photograph's centre, in
        half diagonals, is seen at r + radial * r**3.
      codes: the codes of the tiles ``[H][W]``; 0 is a cell without a tile.
      sure: how sure each cell's code is ``[H][W]``, 0 to 1. `cut_tiles` cuts the cells from 0.5 on.
      score: how sure it is that the corners of every tile are within 1 % of a tile, 0 to 1.
      evidence: measurements by name. Most of them make the score.
      advice: what is wrong and what to do if the score is below 0.5, otherwise empty.
    """

    photo: str
    width: int
    height: int
    corners: list[list[float]]
    homography: list[list[float]]
    radial: float
    codes: list[list[int]]
    sure: list[list[float]]
    score: float
    evidence: dict[str, float]
    advice: str

    @property
    def is_sure(self) -> bool:
        """Whether the score is at least 0.5, so that the tiles can be cut."""
        return self.score >= SURE

    @property
    def refusal(self) -> str:
        """A line that says why the tiles are not cut; empty if they are."""
        return "" if self.is_sure else f"{self.photo}: {self.advice}"

    @property
    def unsure_cells(self) -> list[list[int]]:
        """The row and the column, from 0, of each cell whose code is unsure."""
        return np.argwhere(np.array(self.sure) < SURE).tolist()

    @property
    def view(self) -> FloorView:
        """The camera's view of the tiles."""
        rows, columns = np.shape(self.codes)
        homography = np.array(self.homography)
        return FloorView(homography, self.radial, self.width, self.height, (rows, columns))


@name_wrong_arguments
def propose_tiles(
    photograph: Photograph,
    *,
    shape: tuple[int, int] | None = None,
    corners: Points | None = None,
    codes: NDArray[np.int8] | None = None,
    tiles: TileSet | None = None,
    fit: bool = True,
) -> Proposal:
    """Proposes where the tiles in a photograph are.

    Args:
      photograph: the photograph, from `Photograph.read`.
      shape: the rows and columns of tiles, 1 to 40. By default those of `codes`, or 1 and 1 without
        `codes`. With `codes`, it must be the shape of the map, or of its part with roads.
      corners: the corners of all tiles in pixels of `photograph.image` ``[4, 2]``, clockwise from
        the first row's first tile, off by up to a tenth of a tile. By default they are found. The
        image of a photograph that was read with a lens is straightened. They may also be the
        corners of the whole map of `codes`, with its empty border.
      codes: the codes of the map that is laid, ``[H, W]``, in any of the four directions. Nothing
        is looked for in the empty rows and columns at its border. By default the codes are read,
        and a single tile may lie in any direction.
      tiles: pictures that kinds are read with; by default the package's own.
      fit: whether the corners are fitted to the photograph, or taken as they are. Corners that are
        found are always fitted.

    Raises:
      InputError: if corners cross, no tile is found, a side has more than 40 tiles, `shape` is not
        that of `codes`, or the photograph is not uint8 ``[H, W, 3]``. Also for `fit=False` without
        corners, and for a grey photograph without `codes`, unless `tiles` are grey too.
    """
    check_named("photograph: image", check_picture, photograph.image)
    tiles = own_tiles() if tiles is None else check_named("tiles", instance(TileSet), tiles)
    # The score takes corners that are not fitted for exact. Corners that are found are off by up to
    # a tenth of a tile before they are fitted.
    if not fit and corners is None:
        raise InputError("fit", "True, or corners to take as they are", fit)
    if shape is not None:
        shape = check_named("shape", floor_shape, shape)
    if codes is None:
        area = Area.whole(shape or (1, 1))
        return _propose(Task(photograph, area, None, corners, tiles, fit))
    codes = np.asarray(check_named("codes", check_grid, codes))
    check_named("codes", floor_shape, codes.shape)
    area = Area.of_roads(codes)
    if shape is not None and shape not in (area.map_shape, area.shape):
        shapes = dict.fromkeys((area.map_shape, area.shape))
        expected = " or ".join(f"{rows} x {columns}" for rows, columns in shapes)
        raise InputError("shape", f"{expected} like codes", f"{shape[0]} x {shape[1]}")
    proposal = _propose(Task(photograph, area, area.cut(codes), corners, tiles, fit))
    return _on_map(proposal, area)


def propose_plan(
    photograph: Photograph,
    plan: NDArray[np.int8],
    *,
    corners: Points | None,
    tiles: TileSet | None,
    fit: bool,
) -> Proposal:
    """Proposes where the tiles of a planned floor are, and reads their kinds.

    The proposal has the cells of the plan's part with roads only. If tiles lie in the plan's empty
    border, it has all cells.

    Args:
      photograph: the photograph, from `Photograph.read`.
      plan: the codes of the map that is planned ``[H, W]``. It does not tell the kinds.
      corners: as for `propose_tiles`.
      tiles: as for `propose_tiles`.
      fit: whether the corners are fitted to the photograph, or taken as they are.

    Raises:
      InputError: as `propose_tiles` without `codes`.
    """
    task = Task(photograph, Area.of_roads(plan), None, corners, tiles or own_tiles(), fit)
    # If the user gives the corners of the whole plan, tiles in its empty border are seen too.
    if corners is not None:
        return _propose_whole(task) or _propose(task)
    proposal = _propose(task)
    if proposal.is_sure:
        return proposal
    return _propose_whole(task) or proposal


def _propose_whole(task: Task) -> Proposal | None:
    """Proposes a floor as large as the whole map.

    Tiles that were laid in the map's empty border by mistake make such a floor. Returns None if
    that is not sure.
    """
    if task.area.is_whole:
        return None
    with suppress(InputError):
        proposal = _propose(task._replace(area=Area.whole(task.area.map_shape)))
        if proposal.is_sure:
            return proposal
    return None


def _on_map(proposal: Proposal, area: Area) -> Proposal:
    """Returns the proposal of a map's part with the cells of the whole map.

    Nobody sees the cells of the map's empty border. They are empty in the proposal, and sure.
    """
    to_part = np.eye(3)
    to_part[:2, 2] = -area.first
    return proposal._replace(
        homography=(np.array(proposal.homography) @ to_part).tolist(),
        codes=area.put_back(np.array(proposal.codes, np.int8), 0).tolist(),
        sure=area.put_back(np.array(proposal.sure), 1.0).tolist(),
    )


def _propose(task: Task) -> Proposal:
    """Proposes where the tiles of an area are, whose codes may be known."""
    has_colours, is_map = not is_grey(task.photograph.image), task.codes is not None
    if is_map and not has_colours:
        # Coloured pictures have stop lines that a grey crossing lacks.
        task = task._replace(tiles=in_grey(task.tiles))
    starts = find_starts(task)
    if not is_map and not has_colours:
        check_grey_tiles(task.photograph, task.tiles)
    proposal = _propose_best(task, starts)
    if proposal.is_sure or task.corners is not None or not task.area.lacks_corner:
        return proposal
    # Larger quadrangles are many. They are tried only if the smallest ones do not fit.
    larger = _propose_best(task, find_starts(task, lacks_corner=True))
    proposal = max(proposal, larger, key=lambda found: found.score)
    if proposal.is_sure:
        return proposal
    return proposal._replace(advice=f"{proposal.advice}; {LACKS_CORNER}")


def _propose_best(task: Task, starts: Sequence[Start]) -> Proposal:
    """Returns the proposal with the highest score, of the first starts."""
    proposals = []
    for start in starts[: _STARTS if task.fit else 1]:
        fitted, kinds = _fit(task, start)
        proposals.append(_proposal(task, fitted, kinds))
        if proposals[-1].score > _ENOUGH:
            break
    return max(proposals, key=lambda proposal: proposal.score)


def _fit(task: Task, start: Start) -> tuple[Fit, Kinds]:
    """Fits a view to the photograph, and reads the kinds in it."""
    image = task.photograph.image

    def read(fitted: Fit) -> tuple[Fit, Kinds]:
        return fitted, read_kinds(fitted_cells(image, fitted.view), task.tiles)

    if not task.fit:
        return read(Fit.exact(start.view))
    fitted, kinds = read(fit_view(image, start.view, start.codes))
    corrected = _corrected_codes(kinds, start.codes, is_map=task.codes is not None)
    if corrected is None:
        return fitted, kinds
    # Cells were compared with cells of another kind.
    return read(fit_view(image, fitted.view, corrected))


def _corrected_codes(
    kinds: Kinds, codes: NDArray[np.int8], *, is_map: bool
) -> NDArray[np.int8] | None:
    """Returns the codes of a fitted floor if they differ from those of the fit.

    Otherwise returns None. A few tiles that surely differ from a map are laid wrongly; if many
    differ, the map is another. A single tile is compared with no other one.
    """
    if codes.size == 1:
        return None
    differs = kinds.codes != codes
    if is_map:
        # A cell that shows no tile is compared with none, also where that is unsure.
        differs &= (kinds.margins > _SURELY) | (kinds.codes == 0)
        if differs.mean() > _FEW:
            return None
    corrected = np.where(differs, kinds.codes, codes)
    if differs.any() and corrected.any():
        return corrected
    return None


def _proposal(task: Task, fit: Fit, kinds: Kinds) -> Proposal:
    photograph, view = task.photograph, fit.view
    laid = kinds.codes if task.codes is None else task.codes
    corners = view.pixels_of(view.corners)
    alike = kinds.alike(laid)
    evidence = {
        "alike": float(alike[laid > 0].mean()) if laid.any() else 0.0,
        "repeats": fit.alike,
        "spread": fit.corner_spread,
        "out_of_square": out_of_square(view),
        "edge": least_alike_edge(alike * (laid > 0)),
        "handed": kinds.handed,
        "margin": float(kinds.margins.min()),
    }
    if laid.size == 1:
        evidence["contrast"] = float(contrasts(photograph.image, view, SIDES_OF_TILE).min())
    else:
        evidence["border"] = float(fit.border.min())
    # A margin of 0.06 makes a kind sure by one half. A kind that differs from the map is not sure
    # at all.
    sure = np.where(laid == kinds.codes, np.vectorize(sigmoid)((kinds.margins - 0.06) / 0.02), 0.0)
    # The user's corners replace this evidence, see `judge`.
    ignored: set[str] = set()
    if task.corners is not None:
        ignored |= CORNERS_GIVEN
    if not task.fit:
        ignored.add("contrast")
    score, advice = judge(evidence, "tile" if laid.size == 1 else "floor", ignored)
    return Proposal(
        photograph.name,
        view.width,
        view.height,
        np.round(corners, 2).tolist(),
        view.homography.tolist(),
        view.radial,
        laid.tolist(),
        np.round(sure, 3).tolist(),
        round(score, 3),
        {name: round(value, 4) for name, value in evidence.items()},
        advice if score < SURE else "",
    )
