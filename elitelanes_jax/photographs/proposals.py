"""Proposes where the tiles in a photograph are, which kind each is, and how sure that is."""

from collections.abc import Collection, Sequence
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
from elitelanes_jax.photographs._equations import largest_spread
from elitelanes_jax.photographs._fitting import SIDES_OF_TILE, Fit, fit_tile, fit_view
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
from elitelanes_jax.photographs._outline import find_corners
from elitelanes_jax.photographs._starts import Start, check_corners, quads_of, starts_of, turn_quad
from elitelanes_jax.photographs._views import (
    FloorView,
    Points,
    floor_corners,
)
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.files import check_picture
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

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
      evidence: measurements by name. The score is made of most, the others are on the sheet.
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
    def unsure_cells(self) -> list[list[int]]:
        """The row and the column, from 0, of each cell whose code is unsure."""
        return np.argwhere(np.array(self.sure) < SURE).tolist()

    @property
    def view(self) -> FloorView:
        """The camera's view of the tiles."""
        return FloorView(np.array(self.homography), self.radial, self.width, self.height)


@name_wrong_arguments
def propose_tiles(
    photograph: Photograph,
    *,
    shape: tuple[int, int] = (1, 1),
    corners: Points | None = None,
    codes: NDArray[np.int8] | None = None,
    tiles: TileSet | None = None,
    fit: bool = True,
) -> Proposal:
    """Proposes where the tiles in a photograph are.

    Args:
      photograph: the photograph, from `Photograph.read`.
      shape: the rows and columns of tiles, 1 to 40; those of `codes`, if they are given. A single
        tile may lie in any direction.
      corners: the corners of all tiles in pixels of `photograph.image` ``[4, 2]``, clockwise from
        the first row's first tile, off by up to a tenth of a tile. By default they are found. The
        image of a photograph that was read with a lens is straightened. They may also be the
        corners of the whole map of `codes`, with its empty border.
      codes: the codes of the map that is laid, ``[H, W]``, in any of the four directions. Nothing
        is looked for in the empty rows and columns at its border. By default the codes are read.
      tiles: pictures that kinds are read with; by default the package's own.
      fit: whether the corners are fitted to the photograph, or taken as they are.

    Raises:
      InputError: if corners cross, no tile is found, a side has more than 40 tiles, or the
        photograph is not uint8 ``[H, W, 3]``; and for a grey photograph without `codes`, unless
        `tiles` are grey too.
    """
    check_named("photograph: image", check_picture, photograph.image)
    if tiles is None:
        tiles = load_tiles()
    check_named("tiles", instance(TileSet), tiles)
    if codes is None:
        area = Area.whole(check_named("shape", floor_shape, shape))
        return _propose(photograph, area, corners, None, tiles, fit=fit)
    codes = np.asarray(check_named("codes", check_grid, codes))
    check_named("codes", floor_shape, codes.shape)
    area = Area.of_roads(codes)
    proposal = _propose(photograph, area, corners, area.cut(codes), tiles, fit=fit)
    return _on_map(proposal, area)


def propose_plan(
    photograph: Photograph,
    plan: NDArray[np.int8],
    *,
    corners: Points | None,
    tiles: TileSet,
    fit: bool,
) -> Proposal:
    """Proposes where the tiles of a planned floor are, and reads their kinds.

    The proposal has the cells of the plan's part with roads only. If tiles lie in the plan's empty
    border, it has all cells.

    Args:
      photograph: the photograph, from `Photograph.read`.
      plan: the codes of the map that is planned ``[H, W]``. It does not tell the kinds.
      corners: as for `propose_tiles`.
      tiles: pictures that kinds are read with.
      fit: whether the corners are fitted to the photograph, or taken as they are.

    Raises:
      InputError: as `propose_tiles` without `codes`.
    """
    roads = Area.of_roads(plan)
    # If the user gives the corners of the whole plan, tiles in its empty border are seen too.
    if corners is not None:
        larger = _propose_larger(photograph, roads, corners, tiles, fit=fit)
        if larger is not None:
            return larger
    proposal = _propose(photograph, roads, corners, None, tiles, fit=fit)
    if corners is None and proposal.score < SURE:
        larger = _propose_larger(photograph, roads, corners, tiles, fit=fit)
        if larger is not None:
            return larger
    return proposal


def _propose_larger(
    photograph: Photograph, roads: Area, corners: Points | None, tiles: TileSet, *, fit: bool
) -> Proposal | None:
    """Proposes a floor as large as the whole map.

    Tiles that were laid in the map's empty border by mistake make such a floor. Returns None if
    that is not sure.
    """
    if roads.is_whole:
        return None
    with suppress(InputError):
        whole = Area.whole(roads.map_shape)
        proposal = _propose(photograph, whole, corners, None, tiles, fit=fit)
        if proposal.score >= SURE:
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


def _propose(
    photograph: Photograph,
    area: Area,
    corners: Points | None,
    codes: NDArray[np.int8] | None,
    tiles: TileSet,
    *,
    fit: bool,
) -> Proposal:
    """Proposes where the tiles of an area are, whose codes ``[H, W]`` may be known."""
    image, is_map = photograph.image, codes is not None
    if is_map and is_grey(image):
        # Coloured pictures have stop lines that a grey crossing lacks.
        tiles = in_grey(tiles)
    if corners is not None:
        quads = quads_of(area, check_corners(photograph, corners), image, is_map=is_map)
        return _propose_at(photograph, quads, area, codes, tiles, fit=fit, is_found=False)
    quads = _find_quads(image, area, is_map=is_map, lacks_corner=False)
    if not quads:
        raise InputError(
            photograph.name,
            "tiles that stand out from the floor",
            "none",
            "give their corners, or photograph them on a floor of another colour",
        )
    proposal = _propose_at(photograph, quads, area, codes, tiles, fit=fit, is_found=True)
    if proposal.score >= SURE or not area.lacks_corner:
        return proposal
    # Larger quadrangles are many. They are tried only if the smallest ones do not fit.
    quads = _find_quads(image, area, is_map=is_map, lacks_corner=True)
    larger = _propose_at(photograph, quads, area, codes, tiles, fit=fit, is_found=True)
    proposal = max(proposal, larger, key=lambda found: found.score)
    if proposal.score >= SURE:
        return proposal
    return proposal._replace(advice=f"{proposal.advice}; {LACKS_CORNER}")


def _find_quads(
    image: NDArray[np.uint8], area: Area, *, is_map: bool, lacks_corner: bool
) -> list[Points]:
    """Returns guessed quadrangles ``[4, 2]`` in all directions that the tiles may have."""
    return [
        turned
        for quad in find_corners(image, lacks_corner=lacks_corner)
        for turned in turn_quad(quad, area.shape, is_map=is_map)
    ]


def _propose_at(
    photograph: Photograph,
    quads: Sequence[Points],
    area: Area,
    codes: NDArray[np.int8] | None,
    tiles: TileSet,
    *,
    fit: bool,
    is_found: bool,
) -> Proposal:
    """Proposes where the tiles of an area are, near one of some quadrangles.

    `is_found` says whether the program found the quadrangles. Otherwise the user gave them.
    """
    image, shape, is_map = photograph.image, area.shape, codes is not None
    starts = [
        start
        for quad in quads
        for start in starts_of(image, quad, shape, codes, tiles, is_found=is_found)
    ]
    if not starts:
        floor = f"{shape[0]} x {shape[1]} road tiles"
        size = "check the size" if shape != (1, 1) else "give the size of a floor of several tiles"
        hint = f"{size}, and {'give' if is_found else 'check'} the corners"
        raise InputError(photograph.name, floor, "none", hint)
    if not is_map and is_grey(image):
        check_grey_tiles(photograph, tiles)
    # The user's corners replace this evidence, see `judge`.
    ignored: set[str] = set()
    if not is_found:
        ignored |= CORNERS_GIVEN
    if not fit:
        ignored.add("contrast")
    # The guesses in which cells look most like tiles are fitted first.
    starts.sort(key=lambda start: -start.support)
    proposals = []
    for start in starts[: _STARTS if fit else 1]:
        if fit:
            fitted, kinds = _fit(image, start, shape, tiles, is_map=is_map)
        else:
            # Exact corners have nearly no spread, and all of their border counts as seen.
            fitted = Fit(start.view, np.eye(9) * 1e-7, 1.0, np.ones(4))
            kinds = read_kinds(fitted_cells(image, fitted.view, shape), tiles)
        proposals.append(_proposal(photograph, fitted, kinds, codes, ignored))
        if proposals[-1].score > _ENOUGH:
            break
    return max(proposals, key=lambda proposal: proposal.score)


def _fit(
    image: NDArray[np.uint8],
    start: Start,
    shape: tuple[int, int],
    tiles: TileSet,
    *,
    is_map: bool,
) -> tuple[Fit, Kinds]:
    """Fits a view to the photograph, and reads the kinds in it."""
    if shape == (1, 1):
        fitted = fit_tile(image, start.view)
        return fitted, read_kinds(fitted_cells(image, fitted.view, shape), tiles)
    fitted = fit_view(image, start.view, start.codes)
    kinds = read_kinds(fitted_cells(image, fitted.view, shape), tiles)
    corrected = _corrected_codes(kinds, start.codes, is_map=is_map)
    if corrected is not None:
        # Cells were compared with cells of another kind.
        fitted = fit_view(image, fitted.view, corrected)
        kinds = read_kinds(fitted_cells(image, fitted.view, shape), tiles)
    return fitted, kinds


def _corrected_codes(
    kinds: Kinds, codes: NDArray[np.int8], *, is_map: bool
) -> NDArray[np.int8] | None:
    """Returns the codes of a fitted floor if they differ from those of the fit.

    Otherwise returns None. A few tiles that surely differ from a map are laid wrongly; if many
    differ, the map is another.
    """
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


def _proposal(
    photograph: Photograph,
    fit: Fit,
    kinds: Kinds,
    codes: NDArray[np.int8] | None,
    ignored: Collection[str],
) -> Proposal:
    laid = kinds.codes if codes is None else codes
    rows, columns = laid.shape
    height, width = photograph.image.shape[:2]
    corners = fit.view.pixels_of(floor_corners(rows, columns))
    alike = kinds.alike(laid)
    evidence = {
        "alike": float(alike[laid > 0].mean()) if laid.any() else 0.0,
        "repeats": fit.alike,
        "spread": largest_spread(fit.view, fit.spread, (rows, columns)),
        "out_of_square": out_of_square(fit.view),
        "edge": least_alike_edge(alike * (laid > 0)),
        "handed": kinds.handed,
        "margin": float(kinds.margins.min()),
    }
    if laid.size == 1:
        evidence["contrast"] = float(contrasts(photograph.image, fit.view, SIDES_OF_TILE).min())
    else:
        evidence["border"] = float(fit.border.min()) if len(fit.border) else 0.0
    # A margin of 0.06 makes a kind sure by one half. A kind that differs from the map is not sure
    # at all.
    sure = np.where(laid == kinds.codes, np.vectorize(sigmoid)((kinds.margins - 0.06) / 0.02), 0.0)
    score, advice = judge(evidence, "tile" if laid.size == 1 else "floor", ignored)
    return Proposal(
        photograph.name,
        width,
        height,
        np.round(corners, 2).tolist(),
        fit.view.homography.tolist(),
        fit.view.radial,
        laid.tolist(),
        np.round(sure, 3).tolist(),
        round(score, 3),
        {name: round(value, 4) for name, value in evidence.items()},
        advice if score < SURE else "",
    )
