"""Where tiles are found in photographs, and what is refused."""

import json

import cv2
import numpy as np
import photographed
import pytest
from refusals import refused

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.main import main
from elitelanes_jax.photographs import (
    Photograph,
    Proposal,
    cut_tiles,
    propose_tiles,
)
from elitelanes_jax.photographs._judging import SURE, judge
from elitelanes_jax.photographs._views import view_of
from elitelanes_jax.photographs.laid import turn_floor
from elitelanes_jax.photographs.lenses import Lens

TOWN = photographed.TOWN
CORNERS = photographed.corners_of(3, 3)


@pytest.fixture(scope="module")
def shot():
    return Photograph("floor", photographed.photograph(TOWN))


@pytest.fixture(scope="module")
def proposal(shot):
    return propose_tiles(shot, shape=(3, 3))


def off(proposal, corners=CORNERS):
    """The largest distance of a proposed corner from the true one, in tiles."""
    away = np.linalg.norm(np.array(proposal.corners) - corners, axis=1).max()
    return away / proposal.view.tile_pixels(proposal.view.corners.mean(axis=0))


def test_a_floor_is_found_and_read(proposal):
    assert off(proposal) < 0.01
    np.testing.assert_array_equal(proposal.codes, TOWN)
    assert proposal.score > 0.9 and proposal.advice == ""
    assert np.min(proposal.sure) > 0.9


def test_a_proposal_is_plain(proposal):
    assert Proposal(**json.loads(json.dumps(proposal._asdict()))) == proposal


def test_rough_corners_and_a_turned_map_are_fitted(shot):
    rough = CORNERS + np.array([[9, -7], [-8, 6], [5, 9], [-9, -4]])
    turned = turn_floor(TOWN, 1)
    proposal = propose_tiles(shot, corners=rough, codes=turned)
    np.testing.assert_array_equal(proposal.codes, turned)
    # A quarter turn of the map puts its first corner at another corner of the floor.
    assert min(off(proposal, np.roll(CORNERS, turns, axis=0)) for turns in range(4)) < 0.01
    as_given = propose_tiles(shot, shape=(3, 3), corners=rough, fit=False)
    np.testing.assert_allclose(as_given.corners, rough, atol=0.01)


def score_of(photo, shape):
    """The score of a photograph's proposal, 0 if nothing is found."""
    try:
        return propose_tiles(photo, shape=shape).score
    except InputError:
        return 0.0


def test_a_wrong_size_and_noise_are_refused(shot):
    assert score_of(shot, (2, 4)) < SURE
    noise = np.random.default_rng(0).integers(0, 255, (300, 400, 3)).astype(np.uint8)
    assert score_of(Photograph("noise", noise), (1, 1)) < SURE
    with refused("wall", "none"):
        propose_tiles(Photograph("wall", np.full((300, 400, 3), 128, np.uint8)))


TURNS = np.array([[6, 3, 6, 3], [10, 12, 9, 10], [12, 5, 5, 9]], np.int8)


@pytest.mark.slow
def test_a_floor_whose_tiles_differ_is_right_where_its_border_is_seen():
    picture = photographed.photograph(TURNS, tiles=photographed.worn_tiles(0.5, 0.75))
    proposal = propose_tiles(Photograph("worn", picture), shape=(3, 4))
    np.testing.assert_array_equal(proposal.codes, TURNS)
    assert off(proposal, photographed.corners_of(3, 4)) < 0.01
    assert proposal.evidence["repeats"] < 0.85 and proposal.score > 0.9


@pytest.mark.parametrize(
    "move", [(1, 0), *(pytest.param(move, marks=pytest.mark.slow) for move in ((-1, 0), (0, 1), (0, -1)))]
)
def test_corners_a_whole_tile_beside_the_floor_are_refused(move):
    codes = np.array([[6, 7, 5, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
    true = photographed.corners_of(3, 4)
    shifted = view_of(true, 3, 4, 800, 640).pixels_of(np.array([[0, 0], [4, 0], [4, 3], [0, 3.0]]) + move)
    photo = Photograph("floor", photographed.photograph(codes))
    proposal = propose_tiles(photo, shape=(3, 4), corners=np.clip(shifted, 0, [800, 640]))
    assert proposal.score < SURE
    assert proposal.advice.startswith("no tiles are seen along one side of the floor")


@pytest.mark.parametrize("codes", [pytest.param(TOWN, marks=pytest.mark.slow), np.array([[15]], np.int8)])
def test_a_mirrored_photograph_is_refused(codes):
    picture = np.ascontiguousarray(photographed.photograph(codes)[:, ::-1])
    proposal = propose_tiles(Photograph("mirror", picture), shape=codes.shape)
    assert proposal.score < SURE
    assert proposal.advice.startswith("the photograph is mirrored or shows left-hand traffic")


def test_cells_that_differ_are_not_believed_where_no_border_is_seen():
    """By cells alone, corners were off by 1.5 %, 1.9 % and 1.3 %."""
    seen = {"alike": 0.9, "edge": 0.9, "handed": 0.8, "out_of_square": 0.001}
    for evidence in (
        {"repeats": 0.9465, "spread": 0.0052, "border": 0.0},
        {"repeats": 0.8843, "spread": 0.005, "border": 0.4},
        {"repeats": 0.9794, "spread": 0.0055, "border": 0.1528},
    ):
        assert judge(seen | evidence, "floor", ())[0] < SURE
    drawn = {"repeats": 0.97, "spread": 0.0056, "border": 0.22}
    assert judge(seen | drawn, "floor", ())[0] > 0.9


GOOD = {
    "alike": 0.9,
    "edge": 0.9,
    "handed": 0.8,
    "out_of_square": 0.001,
    "repeats": 0.97,
    "spread": 0.001,
    "border": 0.6,
}


def test_a_score_of_one_means_a_small_spread():
    """A corner was off by 1.17 % of a tile with a score of 1.00."""
    scores = [judge(GOOD | {"spread": spread}, "floor", ())[0] for spread in (0.001, 0.003, 0.005, 0.007, 0.009)]
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > 0.995 > scores[1] > 0.98 > scores[2] > 0.9 and scores[3] > 0.8 and scores[4] < SURE + 0.01


@pytest.mark.parametrize(
    ("evidence", "reason"),
    [
        ({"spread": 0.012}, "too few lines and too little of the border are seen"),
        ({"spread": 0.006, "border": 0.1}, "the border of the floor is not seen"),
        ({"repeats": 0.8, "border": 0.2}, "the tiles do not repeat in this grid"),
        # Tiles that differ enlarge the spread, and the advice was to photograph from closer.
        ({"repeats": 0.83, "spread": 0.003, "border": 0.3}, "the tiles do not repeat in this grid"),
        ({"repeats": 0.24, "spread": 0.019, "border": 0.0}, "the tiles do not repeat in this grid"),
        ({"edge": 0.2}, "no tiles are seen along one side of the floor"),
        ({"alike": 0.3}, "the outlined area does not look like road tiles"),
        ({"handed": -0.3}, "the photograph is mirrored"),
    ],
)
def test_a_view_that_fits_badly_is_not_called_out_of_square(evidence, reason):
    """A floor of squares was refused because its tiles "are no squares in space"."""
    for out_of_square in (0.001, 0.05, 0.5):
        score, advice = judge(GOOD | evidence | {"out_of_square": out_of_square}, "floor", ())
        assert score < SURE and advice.startswith(reason)
    advice = judge(GOOD | {"out_of_square": 0.05}, "floor", ())[1]
    assert advice.startswith("the outlined tiles are no squares in space")


@pytest.mark.parametrize("evidence", [{"repeats": 0.2}, {"edge": 0.1}, {"alike": 0.1}])
def test_corners_that_were_given_are_not_asked_for(evidence):
    seen = GOOD | evidence
    assert judge(seen, "floor", ())[1].endswith("and give the corners")
    assert judge(seen, "floor", {"out_of_square"})[1].endswith("and check the corners")
    assert judge(seen, "floor", {"out_of_square", "contrast"})[1].endswith("and check the corners")


def test_a_floor_whose_size_was_not_given_is_told_to_give_it():
    """`tiles cut floor.jpg` said "check the size", where none was given."""
    tile = {"alike": 0.3, "out_of_square": 0.001, "handed": 0.8, "contrast": 9.0, "spread": 0.001}
    score, advice = judge(tile, "tile", ())
    assert score < SURE and "a floor of several tiles needs its size, rows and columns" in advice


def test_a_single_tile_may_lie_in_any_direction():
    photo = Photograph("turn", photographed.photograph(np.array([[3]], np.int8)))
    proposal = propose_tiles(photo)
    assert proposal.codes == [[3]] and proposal.score > 0.9
    assert off(proposal, photographed.corners_of(1, 1)) < 0.01


def test_a_map_of_one_tile_may_be_laid_in_any_direction():
    """The tile was refused, because it was read in the direction of the map alone."""
    photo = Photograph("turn", photographed.photograph(np.array([[12]], np.int8)))
    proposal = propose_tiles(photo, codes=np.pad([[6]], 1))
    assert proposal.score > SURE and proposal.unsure_cells == []
    assert off(proposal, np.roll(photographed.corners_of(1, 1), 1, axis=0)) < 0.01


@pytest.mark.parametrize(("code", "ground"), [(5, (58, 70, 95)), (10, (120, 118, 116))])
def test_a_border_is_found_next_to_white_tape(code, ground):
    """Between the border and the tape is a narrow strip of asphalt, whose edge to the tape is the stronger one."""
    codes = np.array([[code]], np.int8)
    proposal = propose_tiles(Photograph("straight", photographed.photograph(codes, ground=ground)))
    assert proposal.codes == [[code]] and proposal.score > SURE
    assert off(proposal, photographed.corners_of(1, 1)) < 0.01


def test_one_side_of_a_single_tile_may_be_off_by_a_twelfth():
    """The floor is coarse and nearly as dark as asphalt, so that its edge is seen at few points of a side."""
    rng, corners = np.random.default_rng(3), photographed.corners_of(1, 1).astype(float)
    picture = photographed.photograph(np.array([[6]], np.int8), ground=(82, 88, 96)).astype(float)
    coarse = cv2.resize(rng.normal(0, 6, (64, 80)), (photographed.WIDTH, photographed.HEIGHT))
    photo = Photograph("turn", np.clip(picture + coarse[..., None], 0, 255).astype(np.uint8))
    guess = corners.copy()
    guess[:2] += (corners[[3, 2]] - corners[:2]) / 12
    for proposal in (propose_tiles(photo), propose_tiles(photo, corners=guess)):
        assert proposal.codes == [[6]] and proposal.score > SURE
        assert off(proposal, corners) < 0.01


def test_cells_without_a_tile_are_no_tiles():
    codes = np.array([[6, 5, 3], [10, 0, 10], [10, 0, 10], [12, 5, 9]], np.int8)
    proposal = propose_tiles(Photograph("ring", photographed.photograph(codes, ground=(215, 212, 208))), shape=(4, 3))
    assert proposal.score > SURE
    sure = np.array(proposal.sure) >= SURE
    np.testing.assert_array_equal(np.array(proposal.codes)[sure], codes[sure])
    assert sure[codes > 0].all()


@pytest.mark.parametrize(("hole", "is_planned"), [((1, 0), False), pytest.param((0, 1), True, marks=pytest.mark.slow)])
def test_a_missing_tile_that_roads_lead_to_is_no_tile(hole, is_planned):
    """Its neighbours once made a straight or a crossing of it, that counted as sure."""
    plan = np.array([[6, 7, 3], [10, 12, 11], [12, 5, 9]], np.int8)
    laid = plan.copy()
    laid[hole] = 0
    shot = Photograph("floor", photographed.photograph(laid))
    proposal = propose_tiles(shot, shape=(3, 3), codes=plan if is_planned else None)
    is_sure = np.array(proposal.sure) >= SURE
    assert (np.array(proposal.codes) == laid)[is_sure].all()
    assert is_sure.sum() == 8
    assert proposal.score >= SURE


def test_a_floor_as_dark_as_asphalt_needs_exact_corners():
    codes, corners = np.array([[6]], np.int8), photographed.corners_of(1, 1)
    photo = Photograph("turn", photographed.photograph(codes, ground=photographed.ASPHALT))
    assert score_of(photo, (1, 1)) < SURE
    assert propose_tiles(photo, corners=corners).score < SURE
    exact = propose_tiles(photo, corners=corners, fit=False)
    assert exact.score > SURE and exact.codes == [[6]]


@pytest.mark.parametrize(
    ("corners", "got", "expected"),
    [
        ([[0, 0], [300, 300], [300, 0], [0, 300]], "lines that cross", ""),
        ([[0, 0], [0, 300], [300, 300], [300, 0]], "them counter-clockwise", ""),
        (
            [[0, 0], [3000, 0], [300, 300], [0, 300]],
            "[[0.0, 0.0], [3000.0, 0.0], ...",
            "800 x 640",
        ),
        ([[0, 0], [300, 0], [300, 300]], "[3, 2]", ""),
        ([[0, 0], [300, 0], [300, np.nan], [0, 300]], "...[300.0, nan]...", ""),
    ],
)
def test_bad_corners_are_named(shot, corners, got, expected):
    with refused("floor: corners", got, expected):
        propose_tiles(shot, corners=np.array(corners))


def test_the_size_of_a_photograph_that_was_shrunk_is_explained(shot):
    """Corners are in pixels of the file for the command, whose message had another size without a word."""
    with refused("floor: corners", expected="800 x 640 pixels at 1/2"):
        propose_tiles(shot._replace(name="floor", shrunk=2), shape=(3, 3), corners=CORNERS + 9999)
    lens = Lens(np.eye(3), np.zeros(5), False, 800, 640)
    with refused("floor: corners", expected="800 x 640 pixels after the lens's distortion is removed"):
        propose_tiles(shot._replace(name="floor", lens=lens), shape=(3, 3), corners=CORNERS + 9999)


@pytest.mark.parametrize("suffix", [".png", pytest.param(".jpg", marks=pytest.mark.slow)])
def test_a_grey_photograph_is_refused_because_its_crossings_look_straight(suffix, tmp_path):
    file = tmp_path / f"floor{suffix}"
    picture = photographed.photograph(TOWN)
    assert cv2.imwrite(str(file), cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    grey = Photograph.read(file)
    with refused(file, "a grey one"):
        propose_tiles(grey, shape=TOWN.shape)
    assert main(["tiles", "read", str(file), "--size", *map(str, TOWN.shape)]) == 2
    file = tmp_path / f"coloured{suffix}"
    photographed.write(file, picture)
    np.testing.assert_array_equal(propose_tiles(Photograph.read(file), shape=TOWN.shape).codes, TOWN)


def in_grey(image):
    return np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_a_map_tells_the_kinds_of_a_grey_photograph(seed):
    """Its crossings were unsure, and `tiles cut` made a set without crossings."""
    codes = np.array([[6, 7, 3], [14, 15, 11], [12, 5, 9]], np.int8)
    picture = in_grey(photographed.photograph(codes, seed=seed))
    proposal = propose_tiles(Photograph("grey", picture), codes=codes)
    assert proposal.score > SURE and proposal.unsure_cells == []
    assert sorted(cut.code for cut in cut_tiles(Photograph("grey", picture), proposal)) == sorted(codes.ravel())
    # A tile that is laid otherwise than the map says is left out, as in colours.
    plan = codes.copy()
    plan[2, 1] = 13
    assert len(propose_tiles(Photograph("grey", picture), codes=plan).unsure_cells) == 1


def test_a_mirrored_grey_photograph_is_refused():
    """The map is its own mirror image. Red stop lines are a little brighter than asphalt."""
    codes = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    picture = np.ascontiguousarray(in_grey(photographed.photograph(codes))[:, ::-1])
    proposal = propose_tiles(Photograph("grey", picture), codes=codes)
    assert proposal.score < SURE and proposal.advice.startswith("the photograph is mirrored")


def test_tiles_beside_a_bright_gap_look_alike():
    """A white floor in an empty cell changed the ground of its neighbours, and the photograph was refused."""
    codes = np.array([[6, 5, 5, 3], [10, 0, 0, 10], [10, 0, 0, 10], [12, 5, 5, 9]], np.int8)
    corners = photographed.corners_of(4, 4)
    repeats = []
    for ground in ((75, 80, 90), (252, 250, 247)):
        picture = photographed.photograph(codes, corners, ground=ground)
        proposal = propose_tiles(Photograph("gaps", picture), corners=corners, codes=codes)
        assert proposal.score > 0.9
        repeats.append(proposal.evidence["repeats"])
    assert repeats[1] > repeats[0] - 0.02
