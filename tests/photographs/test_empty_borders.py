"""Maps with empty rows and columns at their border, which lie outside of the floor that anybody sees."""

import json

import numpy as np
import photographed
import pytest
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.network.plain_metrics import cut_to_roads
from elitelanes_jax.photographs import Photograph, cut_tiles, propose_tiles
from elitelanes_jax.photographs._areas import Area
from elitelanes_jax.photographs._views import view_of
from elitelanes_jax.photographs.laid import read_laid, turn_floor
from elitelanes_jax.photographs.sheet import draw_laid, draw_proposal
from elitelanes_jax.tiles.contact_sheet import PAPER

TOWN = np.array([[6, 7, 5, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
MAP = np.pad(TOWN, ((0, 1), (1, 0)))
CORNERS = photographed.corners_of(3, 4, away=3.4)
WHOLE = view_of(CORNERS, 3, 4, photographed.WIDTH, photographed.HEIGHT).pixels_of(
    np.array([[-1, 0], [4, 0], [4, 4], [-1, 4.0]])
)


@pytest.fixture(scope="module")
def shot():
    return Photograph("floor", photographed.photograph(TOWN, CORNERS))


@pytest.fixture(scope="module")
def proposal(shot):
    return propose_tiles(shot, codes=MAP)


def corner_of_tiles(proposal, codes):
    """Where the view has the first corner of the first tile's row and column, in pixels."""
    area = Area.of_roads(codes)
    return proposal.view.pixels_of(area.first)


def test_a_map_finds_its_tiles_and_keeps_its_cells(shot, proposal):
    np.testing.assert_array_equal(proposal.codes, MAP)
    assert proposal.score > 0.9 and proposal.unsure_cells == []
    np.testing.assert_allclose(proposal.corners, CORNERS, atol=1)
    np.testing.assert_allclose(corner_of_tiles(proposal, MAP), CORNERS[0], atol=1)
    cuts = cut_tiles(shot, proposal)
    assert [(cut.row, cut.column) for cut in cuts] == [tuple(cell) for cell in np.argwhere(MAP).tolist()]
    without_border = cut_tiles(shot, propose_tiles(shot, codes=TOWN))
    for cut, other in zip(cuts, without_border, strict=True):
        assert (cut.name, cut.code) == (other.name, other.code)
        np.testing.assert_array_equal(cut.image, other.image)


@pytest.mark.parametrize("turns", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("corners", [CORNERS, WHOLE], ids=["of the tiles", "of the whole map"])
@pytest.mark.parametrize("fit", [True, False])
def test_corners_are_those_of_the_tiles_or_of_the_whole_map_in_any_direction(shot, turns, corners, fit):
    turned = turn_floor(MAP, turns)
    rough = corners + np.array([[5, -4], [-4, 3], [3, 5], [-5, -2]]) * fit
    proposal = propose_tiles(shot, codes=turned, corners=rough, fit=fit)
    np.testing.assert_array_equal(proposal.codes, turned)
    assert proposal.score > 0.9 and proposal.unsure_cells == []
    # A quarter turn counter-clockwise makes the second corner the first one.
    np.testing.assert_allclose(corner_of_tiles(proposal, turned), np.roll(CORNERS, -turns, axis=0)[0], atol=1)


def test_cells_that_differ_are_named_as_on_the_whole_map(shot, tmp_path):
    plan = turn_floor(MAP, 3)
    plan[1, 1] = 5
    laid = read_laid(propose_tiles(shot, shape=TOWN.shape), plan)
    assert laid.codes.shape == plan.shape == (5, 4)
    assert [(difference.row, difference.column) for difference in laid.differences] == [(1, 1)]
    # A row or a column of names is beside each side of the tiles.
    picture = draw_laid(shot, propose_tiles(shot, shape=TOWN.shape), laid)
    assert picture.shape[2] == 3


def test_lines_below_a_tall_photograph_are_not_cut_off(shot, proposal):
    """Each ended in the middle of a word."""
    tall = Photograph("tall", np.pad(shot.image, ((0, 2400), (0, 0), (0, 0))))
    plan = MAP.copy()
    plan[0, 2] = 10
    picture = draw_laid(tall, proposal._replace(height=len(tall.image)), read_laid(proposal, plan))
    lines = picture[1200:]
    assert picture.shape[1] > 1200 / len(tall.image) * tall.image.shape[1]
    assert (lines != PAPER).any() and (lines[:, -9:] == PAPER).all()


def test_the_names_of_cells_are_beside_the_tiles(shot, proposal):
    """Names beside the whole map would be outside of most photographs."""
    with_border, without_border = (draw_proposal(shot, found) for found in (proposal, propose_tiles(shot, codes=TOWN)))
    changed = np.argwhere((with_border != without_border).any(axis=2))
    # Other names are in the places of those without a border.
    assert 0 < len(changed) < 2000


def test_a_floor_of_another_shape_than_the_plan_is_refused(proposal):
    with refused("plan", "2 x 4", expected="4 x 5"):
        read_laid(proposal, np.pad(TOWN[:2], 1))


@pytest.mark.parametrize("line", [[], ["--corners"], ["--corners", "--exact"]])
def test_the_command_reads_a_floor_by_its_map(shot, line, tmp_path, capsys):
    photographed.write(tmp_path / "floor.png", shot.image)
    (tmp_path / "map.json").write_text(json.dumps({"codes": MAP.tolist()}))
    if line:
        line = [line[0], *(f"{value:.2f}" for value in WHOLE.ravel()), *line[1:]]
    files = ["--against", str(tmp_path / "map.json"), "--out", str(tmp_path / "laid.json")]
    assert main(["tiles", "read", str(tmp_path / "floor.png"), *files, *line]) == 0
    assert f"0 tiles of {MAP.size} differ" in capsys.readouterr().out
    assert json.loads((tmp_path / "laid.json").read_text())["codes"] == MAP.tolist()


def test_a_tile_that_lies_in_the_empty_border_is_named(tmp_path, capsys):
    """The plan's last column is empty, and the floor has a tile there."""
    plan = np.array([[6, 3, 0], [10, 10, 0], [12, 9, 0]], np.int8)
    laid = plan.copy()
    laid[1, 2] = 5
    corners = photographed.corners_of(3, 3)
    photographed.write(tmp_path / "floor.png", photographed.photograph(laid, corners))
    (tmp_path / "plan.json").write_text(json.dumps({"codes": plan.tolist()}))
    line = ["tiles", "read", str(tmp_path / "floor.png"), "--against", str(tmp_path / "plan.json")]
    assert main([*line, "--corners", *map(str, corners.ravel())]) == 0
    printed = capsys.readouterr().out
    assert "C2 ([1, 2]): expected no tile, got a straight that opens EW" in printed
    assert "1 tile of 9 differs" in printed


GAP = np.array([[6, 3, 0, 0, 0], [10, 12, 5, 3, 0], [12, 5, 5, 9, 0]], np.int8)


@pytest.mark.slow
def test_a_floor_without_a_tile_in_a_corner_is_found_by_its_map(tmp_path, capsys):
    """The smallest quadrangle around the tiles cuts across the gap."""
    corners = photographed.corners_of(3, 4)
    picture = photographed.photograph(GAP[:, :4], corners)
    proposal = propose_tiles(Photograph("gap", picture), codes=GAP)
    assert proposal.score > 0.9 and proposal.unsure_cells == []
    np.testing.assert_allclose(proposal.corners, corners, atol=1.5)
    photographed.write(tmp_path / "floor.png", picture)
    (tmp_path / "plan.json").write_text(json.dumps({"codes": GAP.tolist()}))
    assert main(["tiles", "read", str(tmp_path / "floor.png"), "--against", str(tmp_path / "plan.json")]) == 0
    assert f"0 tiles of {GAP.size} differ" in capsys.readouterr().out


@pytest.mark.slow
def test_corners_that_a_gap_hides_are_asked_for():
    """A user was told that the border is not seen, or that the tiles do not repeat."""
    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    proposal = propose_tiles(Photograph("noise", noise), codes=GAP)
    assert proposal.score < 0.5
    assert proposal.advice.endswith("a corner of the floor has no tile, which hides the floor's corners: give them")


def test_an_area_is_cut_and_put_back():
    area = Area.of_roads(MAP)
    assert area == (0, 1, (3, 4), (4, 5), False) and not area.is_whole
    np.testing.assert_array_equal(area.cut(MAP), cut_to_roads(MAP))
    np.testing.assert_array_equal(area.put_back(TOWN, 0), MAP)
    assert Area.of_roads(TOWN).is_whole and Area.of_roads(0 * TOWN).is_whole
    assert Area.shown(MAP, (4, 3)) == area and Area.shown(MAP, (5, 4)).is_whole
    assert area.put_back(np.full((3, 4), 0.2), 1.0).tolist()[0] == [1.0, 0.2, 0.2, 0.2, 0.2]
