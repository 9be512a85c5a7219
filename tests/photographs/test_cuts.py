"""Tiles that are cut out of photographs, and floors that are compared with a plan."""

from pathlib import Path

import cv2
import numpy as np
import photographed
import pytest
from refusals import refused

from elitelanes_jax.cli.main import main
from elitelanes_jax.cli.photographs import _describe_set
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.network.codes import CONNECTIONS, ROAD_ALPHABET
from elitelanes_jax.photographs import Photograph, cut_tiles, propose_tiles, write_cuts
from elitelanes_jax.photographs._judging import SURE
from elitelanes_jax.photographs.cutting import mask_cut
from elitelanes_jax.photographs.floors import CutFloors, Floor, cut_floors
from elitelanes_jax.photographs.laid import find_differences, turn_floor, turn_to_plan
from elitelanes_jax.tiles import inspect_tiles, load_tiles, sides
from elitelanes_jax.tiles.sides import measure_lanes
from elitelanes_jax.tiles.strips import MIXED, find_strips

TOWN = photographed.TOWN
CORNERS = photographed.corners_of(3, 3)


@pytest.fixture(scope="module")
def shot():
    return Photograph("floor", photographed.photograph(TOWN))


@pytest.fixture(scope="module")
def proposal(shot):
    return propose_tiles(shot, shape=(3, 3))


@pytest.mark.slow
def test_a_tile_that_is_laid_otherwise_than_the_map_says_is_left_out(shot):
    plan = TOWN.copy()
    plan[1, 0] = 5
    proposal = propose_tiles(shot, codes=plan)
    assert proposal.score > SURE
    unsure = np.argwhere(np.array(proposal.sure) < SURE)
    assert unsure.tolist() == [[1, 0]]
    assert len(cut_tiles(shot, proposal)) == 8


def test_cuts_are_squares_of_their_kind_and_copies_are_named(shot, proposal):
    cuts = cut_tiles(shot, proposal)
    assert [cut.code for cut in cuts] == TOWN.ravel().tolist()
    assert [cut.name for cut in cuts[:4]] == ["turn_1", "crossing3_1", "turn_2", "straight_1"]
    assert len({cut.name for cut in cuts}) == 9
    assert all(cut.image.shape == (128, 128, 3) for cut in cuts)
    again = cut_tiles(shot, proposal, cuts)
    assert [cut.name for cut in again[:2]] == ["turn_5", "crossing3_3"]
    assert all(cut.copy_of for cut in again)
    originals = {cut.name for cut in cuts if not cut.copy_of}
    assert {cut.copy_of for cut in cut_tiles(shot, proposal, [*again, *cuts])} <= originals
    unsure = proposal._replace(sure=np.zeros((3, 3)).tolist())
    assert cut_tiles(shot, unsure) == []


def test_no_two_tiles_get_one_name(shot, proposal, tmp_path):
    """Without the copies among earlier tiles, a new tile got the name of another one and replaced its files."""
    cuts = cut_tiles(shot, proposal)
    turns = [cut for cut in cuts if cut.code in (3, 6, 9, 12)]
    further = cut_tiles(shot, proposal, turns[2:])
    names = [cut.name for cut in (*turns[2:], *further)]
    assert len(names) == len(set(names)) == 11
    with refused("cuts", "turn_1 2 times"):
        write_cuts(tmp_path / "set", [*cuts, *cut_tiles(shot, proposal)])
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("change", "subject", "got"),
    [
        ({"width": 5}, "floor", "one for 5 x 640"),
        ({"sure": [[1.0]]}, "proposal: sure", "[1, 1]"),
        ({"homography": [[1.0]]}, "proposal: homography", "[1, 1]"),
        ({"codes": [[16] * 3] * 3}, "proposal: codes: grid", "16 at A1 ([0, 0])"),
    ],
)
def test_a_proposal_for_a_photograph_of_another_size_is_refused(shot, proposal, change, subject, got):
    """Its tiles were cut somewhere else in the photograph, without a word."""
    with refused(subject, got):
        cut_tiles(shot._replace(name="floor"), proposal._replace(**change))


def test_the_masks_of_cuts_are_those_of_the_tiles_that_were_photographed(shot, proposal):
    """A strip of a neighbour's stop line was in most cut tiles: a notch of the road, or a line on it."""
    for cut in cut_tiles(shot, proposal):
        masks = mask_cut(cut)
        assert list(find_strips(cut.image, cut.code, MIXED)) == []
        assert masks["red"].any() == (CONNECTIONS[cut.code] > 2)


TOUCHING = np.array([[6, 7, 7, 3], [14, 15, 15, 11], [12, 13, 13, 9]], np.int8)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 6))])
def test_floors_whose_crossings_touch_need_no_hand(seed, tmp_path):
    """The stop line of the next crossing was taken for one on the outgoing lane."""
    corners = photographed.corners_of(3, 4, tilt=35, turn=-6 * seed)
    picture = photographed.photograph(TOUCHING, corners * 2, seed=seed, size=(1600, 1280))
    floor = Photograph("floor", cv2.GaussianBlur(picture, (0, 0), 1.2))
    proposal = propose_tiles(floor, codes=TOUCHING)
    assert proposal.score >= SURE
    write_cuts(tmp_path / "set", cut_tiles(floor, proposal))
    # The floor has no straight.
    assert [
        line for line in inspect_tiles(tmp_path / "set", lines=True)[1] if "every kind a map needs" not in line
    ] == []


def test_cutting_writes_where_the_lanes_run(shot, proposal, tmp_path, drawn_tiles):
    """The set had the default, and poses beside the lane's middle were off by 1 cm."""
    write_cuts(tmp_path / "set", cut_tiles(shot, proposal))
    tiles = load_tiles(tmp_path / "set")
    assert tiles.lane_offset == pytest.approx(measure_lanes(drawn_tiles.tiles).offset, abs=0.003)
    assert tiles.lane_offset != LANE_OFFSET and tiles.lane_offset_spread < 0.01
    # A file of the user is not replaced.
    (tmp_path / "set" / "tileset.toml").write_text("lane_offset = 0.25\n")
    write_cuts(tmp_path / "set", cut_tiles(shot, proposal))
    assert load_tiles(tmp_path / "set").lane_offset == 0.25


def test_an_offset_that_the_sides_do_not_agree_on_is_not_written(shot, proposal, tmp_path, monkeypatch):
    monkeypatch.setattr(sides, "_LARGEST_SPREAD", 0.0)
    write_cuts(tmp_path / "set", cut_tiles(shot, proposal))
    assert load_tiles(tmp_path / "set").lane_offset_spread is None


@pytest.mark.parametrize("change", [lambda image: image.astype(np.uint16) * 257, lambda image: image / 255])
def test_a_photograph_of_another_type_is_refused(change):
    """A user who makes a photograph of 16 bits or of shares got tiles of noise or in black."""
    image = np.full((300, 300, 3), 200, np.uint8)
    corners = np.array([[50, 50], [250, 50], [250, 250], [50, 250]])
    proposal = propose_tiles(Photograph("frame", image), corners=corners, codes=np.array([[6]]), fit=False)
    with refused("photograph: image", "... [300, 300, 3]", expected="uint8"):
        cut_tiles(Photograph("frame", change(image)), proposal)


def test_an_empty_cell_that_is_unsure_is_no_tile_that_was_left_out(proposal):
    """A user looked for the tile."""
    sure = [[1.0, 1.0, 1.0], [1.0, 0.1, 0.1], [1.0, 1.0, 1.0]]
    codes = [proposal.codes[0], [10, 0, 10], proposal.codes[2]]
    cut = CutFloors([], [], [proposal._replace(codes=codes, sure=sure)], [])
    assert _describe_set(cut, Path("mine"))[2:] == [
        "floor: left out B2 ([1, 1]), unsure whether a tile is there",
        "floor: left out the tile at C2 ([1, 2]), its kind is unsure",
    ]


def test_floors_are_compared_with_their_plan():
    floor = turn_floor(np.array([[6, 3], [10, 10], [12, 9]], np.int8), 3)
    plan = np.array([[6, 3], [10, 5], [12, 9]], np.int8)
    assert floor.shape == (2, 3)
    turned = turn_floor(floor, turn_to_plan(floor, plan))
    assert find_differences(turned, plan) == [(1, 1, 5, 10)]
    assert str(find_differences(turned, plan)[0]) == "B2 ([1, 1]): expected a straight that opens EW, got it turned: NS"
    with refused("plan", "2 x 2", expected="2 x 3"):
        turn_to_plan(floor, plan[:2])
    for turns in range(5):
        assert set(turn_floor(np.array([ROAD_ALPHABET] * 2, np.int8), turns).ravel()) == set(ROAD_ALPHABET)


@pytest.mark.parametrize("out", [".", "mine/.."])
def test_the_current_folder_is_not_replaced(out, tmp_path, capsys, monkeypatch):
    """It cannot be renamed; the command ended with a traceback, or with a busy device."""
    (tmp_path / "mine").mkdir()
    photographed.write(tmp_path / "turn.png", photographed.photograph(np.array([[6]], np.int8)))
    monkeypatch.chdir(tmp_path)
    assert main(["tiles", "cut", "turn.png", "--out", out, "--overwrite"]) == 2
    message = f"{out}: expected a folder that can be renamed, got the current one"
    assert message in capsys.readouterr().err
    assert sorted(file.name for file in tmp_path.iterdir()) == ["mine", "turn.png"]


def test_an_earlier_set_is_kept(tmp_path, capsys):
    photographed.write(tmp_path / "turn.png", photographed.photograph(np.array([[3]], np.int8)))
    out = tmp_path / "mine"
    (out / "turn_1").mkdir(parents=True)
    (out / "turn_1" / "image.png").write_bytes(b"by hand")
    line = ["tiles", "cut", str(tmp_path / "turn.png"), "--out", str(out)]
    assert main(line) == 2
    assert main([*line, "--overwrite"]) == 0
    assert (tmp_path / "mine.before" / "turn_1" / "image.png").read_bytes() == b"by hand"
    assert Photograph.read(out / "sheet.png").image.shape[2] == 3
    assert f"the earlier set is kept as {out}.before" in capsys.readouterr().out


def test_refused_photographs_among_others_are_told_by_the_exit_code(tmp_path, capsys):
    """A script took the set for complete. Only the photograph with an outline is on the sheet."""
    photographed.write(tmp_path / "turn.png", photographed.photograph(np.array([[3]], np.int8)))
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    photographed.write(tmp_path / "noise.png", noise)
    photographed.write(tmp_path / "wall.png", np.full((300, 400, 3), 128, np.uint8))
    (tmp_path / "text.jpg").write_text("no photograph")
    out = tmp_path / "mine"
    files = [str(tmp_path / name) for name in ("noise.png", "text.jpg", "turn.png", "wall.png", "none.png")]
    assert main(["tiles", "cut", *files, "--out", str(out)]) == 2
    printed = capsys.readouterr()
    assert printed.out.startswith("1 tile of 1 photograph") and "refused: " not in printed.out
    lines = printed.err.splitlines()
    assert [line.split(": ")[:2] for line in lines] == [["refused", file] for file in files if "turn" not in file]
    assert sorted(entry.name for entry in out.iterdir()) == ["sheet.png", "tileset.toml", "turn_1"]


def test_a_floor_is_given_once_also_in_a_copy_of_its_photograph(tmp_path):
    """A set had each tile twice."""
    photo, copy, other = (tmp_path / name for name in ("floor.jpg", "copy.jpg", "other.jpg"))
    photo.write_text("a photograph")
    copy.write_text("a photograph")
    other.write_text("another one")
    with refused(tmp_path / "copy.jpg", "...floor.jpg again", hint="--corners"):
        cut_floors([Floor(photo), Floor(other), Floor(copy)], None)
    # A photograph may show several floors.
    left, right = np.zeros((4, 2)), np.ones((4, 2))
    assert len(cut_floors([Floor(photo, corners=left), Floor(photo, corners=right)], None).refused) == 2
    with refused(tmp_path / "copy.jpg", "...floor.jpg again"):
        cut_floors([Floor(photo, corners=left), Floor(copy, corners=left)], None)
    assert len(cut_floors([Floor(photo, (1, 2)), Floor(photo, (2, 1))], None).refused) == 2
    assert len(cut_floors([Floor(tmp_path / "none.jpg")] * 2, None).refused) == 2


def test_photographs_of_the_same_name_are_named_with_their_folders(tmp_path, capsys):
    """Each folder of a tile set has its picture as image.png."""
    wall = np.full((300, 400, 3), 128, np.uint8)
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    turn = photographed.photograph(np.array([[3]], np.int8))
    for name, picture in (("turn", turn), ("noise", noise), ("wall", wall)):
        (tmp_path / name).mkdir()
        photographed.write(tmp_path / name / "image.png", picture)
    files = {name: str(tmp_path / name / "image.png") for name in ("turn", "noise", "wall")}
    for name in ("noise", "wall"):
        line = ["tiles", "cut", files["turn"], files[name], "--out", str(tmp_path / name / "out")]
        assert main(line) == 2
        assert f"{files[name]}: " in capsys.readouterr().err
    assert main(["tiles", "read", files["wall"], "--size", "2", "2"]) == 2
    assert capsys.readouterr().err.startswith(f"elitelanes: {files['wall']}: expected tiles that stand out")
