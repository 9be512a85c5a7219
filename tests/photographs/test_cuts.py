"""Tiles that are cut out of photographs, and floors that are compared with a plan."""

import numpy as np
import photographed
import pytest

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.main import main
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.photographs import Photograph, cut_tiles, propose_tiles, write_cuts
from elitelanes_jax.photographs.comparison import find_differences, turn_floor, turn_to_plan
from elitelanes_jax.photographs.cutting import mask_cut
from elitelanes_jax.photographs.proposals import SURE

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
    with pytest.raises(InputError, match="cuts: expected each name once, got turn_1 2 times"):
        write_cuts(tmp_path / "set", [*cuts, *cut_tiles(shot, proposal)])
    assert not (tmp_path / "set").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 5}, "floor: expected a proposal for this photograph, got another one"),
        ({"sure": [[1.0]]}, "floor: expected a proposal for this photograph, got another one"),
        ({"codes": [[16] * 3] * 3}, "proposal: codes: grid: expected tile codes 0 to 15, got 16"),
    ],
)
def test_a_proposal_for_another_photograph_is_refused(shot, proposal, change, message):
    """Its tiles were cut somewhere else in the photograph, without a word."""
    with pytest.raises(InputError, match=message):
        cut_tiles(shot._replace(name="floor"), proposal._replace(**change))


def test_the_stop_line_of_a_neighbour_leaves_no_notch_in_the_road_of_a_turn(shot, proposal):
    turn = next(cut for cut in cut_tiles(shot, proposal) if cut.code == 6)
    size = len(turn.image)
    stained = turn.image.copy()
    # Mixed with asphalt, on a part of the side E where the road leaves the tile.
    stained[size // 2 : round(0.85 * size), -3:] = (150, 96, 95)
    masks, plain = (mask_cut(turn._replace(image=image)) for image in (stained, turn.image))
    np.testing.assert_array_equal(masks["road"][:, -1], plain["road"][:, -1])
    assert not masks["red"].any()


@pytest.mark.parametrize("change", [lambda image: image.astype(np.uint16) * 257, lambda image: image / 255])
def test_a_photograph_of_another_type_is_refused(change):
    """A user who makes a photograph of 16 bits or of shares got tiles of noise or in black."""
    image = np.full((300, 300, 3), 200, np.uint8)
    corners = np.array([[50, 50], [250, 50], [250, 250], [50, 250]])
    proposal = propose_tiles(Photograph("frame", image), corners=corners, codes=np.array([[6]]), fit=False)
    with pytest.raises(InputError, match=r"photograph: image: expected uint8 \[H, W, 3\]"):
        cut_tiles(Photograph("frame", change(image)), proposal)


def test_floors_are_compared_with_their_plan():
    floor = turn_floor(np.array([[6, 3], [10, 10], [12, 9]], np.int8), 3)
    plan = np.array([[6, 3], [10, 5], [12, 9]], np.int8)
    assert floor.shape == (2, 3)
    turned = turn_floor(floor, turn_to_plan(floor, plan))
    assert find_differences(turned, plan) == [(1, 1, 5, 10)]
    assert (
        str(find_differences(turned, plan)[0])
        == "row 2, column 2: expected a straight that opens EW, got it turned: NS"
    )
    with pytest.raises(InputError, match="plan: expected 2 x 3 tiles like the floor, got 2 x 2"):
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
    assert sorted(entry.name for entry in out.iterdir()) == ["sheet.png", "turn_1"]


def test_photographs_of_the_same_name_are_named_with_their_folders(tmp_path, capsys):
    """Each folder of a tile set has its picture as image.png."""
    wall = np.full((300, 400, 3), 128, np.uint8)
    noise = np.random.default_rng(0).integers(0, 256, (300, 400, 3), np.uint8)
    turn = photographed.photograph(np.array([[3]], np.int8))
    for name, picture in (("turn", turn), ("noise", noise), ("wall", wall)):
        (tmp_path / name).mkdir()
        photographed.write(tmp_path / name / "image.png", picture)
    files = {name: str(tmp_path / name / "image.png") for name in ("turn", "noise", "wall")}
    for refused in ("noise", "wall"):
        line = ["tiles", "cut", files["turn"], files[refused], "--out", str(tmp_path / refused / "out")]
        assert main(line) == 2
        assert f"{files[refused]}: " in capsys.readouterr().err
    assert main(["tiles", "read", files["wall"], "--size", "2", "2"]) == 2
    assert capsys.readouterr().err.startswith(f"elitelanes: {files['wall']}: expected tiles that stand out")
