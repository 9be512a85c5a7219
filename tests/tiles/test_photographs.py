"""Photographs of tiles: what is found in them, at which pixels, and what is refused."""

import json
import struct
import zlib

import cv2
import numpy as np
import photographed
import pytest

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.main import main
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.tiles import (
    Proposal,
    TileSet,
    cut_tiles,
    load_tiles,
    propose_masks,
    propose_tiles,
    render,
)
from elitelanes_jax.tiles.photographs import borders, kinds, proposals, reading
from elitelanes_jax.tiles.photographs.comparison import find_differences, turn_floor, turn_to_plan
from elitelanes_jax.tiles.photographs.cutting import mask_cut, write_cuts
from elitelanes_jax.tiles.photographs.proposals import SURE
from elitelanes_jax.tiles.photographs.reading import Photograph, read_lens
from elitelanes_jax.tiles.photographs.views import FloorView, places_of, view_of
from elitelanes_jax.tiles.sides import describe_lanes, measure_sides

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
    return away / proposal.view.tile_pixels(*np.shape(proposal.codes))


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
    with pytest.raises(InputError, match="wall: expected tiles that stand out from the floor, found none"):
        propose_tiles(Photograph("wall", np.full((300, 400, 3), 128, np.uint8)))


TURNS = np.array([[6, 3, 6, 3], [10, 12, 9, 10], [12, 5, 5, 9]], np.int8)


def test_turns_of_a_lab_are_read_by_each_other():
    """Turns without white tape look like ends to the drawn turns, but like the lab's other turns."""
    worn = photographed.worn_tiles(0.55, 0.3, bare=("turn_2", "turn_3", "turn_4"))
    flat = render(TURNS, worn, tile_px=kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.asarray(flat), *(kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = kinds.read_kinds(flat, 3, 4, load_tiles())
    np.testing.assert_array_equal(read.codes, TURNS)
    assert read.margins.min() > 0.3


def test_a_cell_of_the_floor_counts_less_than_a_picture_of_the_set():
    """Crossings of three and of four ways are more like each other than any other kinds are."""
    cell = render(np.array([[10]], np.int8), tile_px=kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.hstack([cell, cell]), *(kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    scores = np.zeros((1, 2, 16))
    scores[0, 0, 10] = 0.9
    compared = kinds._compare_cells(flat, scores)[0]
    assert compared[0, 10] == 0.9 and 0.8 < compared[1, 10] <= 0.85


def test_a_straight_that_is_laid_across_the_road_is_read():
    codes = np.array([[6, 7, 10, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
    flat = render(codes, tile_px=kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.asarray(flat), *(kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = kinds.read_kinds(flat, 3, 4, load_tiles())
    assert read.codes[0, 2] == 10 and read.margins[0, 2] > 0.2


def test_a_road_to_a_bare_cell_is_read_with_a_set_without_ends():
    codes = np.array([[6, 5, 3], [14, 5, 10], [12, 5, 9]], np.int8)
    set_without_ends = TileSet("no-ends", "", tuple(tile for tile in load_tiles().tiles if tile.code in ROAD_ALPHABET))
    flat = np.array(render(codes, set_without_ends, tile_px=kinds.READ_PX, seed=0).image, float)
    middle = flat[kinds.READ_PX : 2 * kinds.READ_PX, kinds.READ_PX : 2 * kinds.READ_PX]
    middle[:] = middle.mean((0, 1)) + 0.04 * (middle - middle.mean((0, 1)))  # a straight that is hardly there
    flat = cv2.copyMakeBorder(flat.round().astype(np.uint8), *(kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = kinds.read_kinds(flat, 3, 3, set_without_ends)
    np.testing.assert_array_equal(read.codes, [[6, 5, 3], [14, 0, 10], [12, 5, 9]])


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


@pytest.mark.slow
def test_a_tile_that_is_laid_otherwise_than_the_map_says_is_left_out(shot):
    plan = TOWN.copy()
    plan[1, 0] = 5
    proposal = propose_tiles(shot, codes=plan)
    assert proposal.score > SURE
    unsure = np.argwhere(np.array(proposal.sure) < SURE)
    assert unsure.tolist() == [[1, 0]]
    assert len(cut_tiles(shot, proposal)) == 8


def test_cells_that_differ_are_not_believed_where_no_border_is_seen():
    """By cells alone, corners of hand-taped tiles were off by 1.5 % and by 1.9 %."""
    seen = {"alike": 0.9, "edge": 0.9, "handed": 0.8, "out_of_square": 0.001}
    for evidence in (
        {"repeats": 0.9465, "spread": 0.0052, "border": 0.0},
        {"repeats": 0.8843, "spread": 0.005, "border": 0.4},
    ):
        assert proposals._judge(seen | evidence, "floor", ())[0] < SURE
    drawn = {"repeats": 0.97, "spread": 0.0056, "border": 0.22}
    assert proposals._judge(seen | drawn, "floor", ())[0] > 0.9


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


def test_a_single_tile_may_lie_in_any_direction():
    photo = Photograph("turn", photographed.photograph(np.array([[3]], np.int8)))
    proposal = propose_tiles(photo)
    assert proposal.codes == [[3]] and proposal.score > 0.9
    assert off(proposal, photographed.corners_of(1, 1)) < 0.01


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


def square_on_a_dark_floor(shadow):
    """A square of asphalt, 200 pixels wide, on a floor nearly as dark, which the square shades by a share."""
    y, x = np.mgrid[:400, :400]
    away = np.maximum(np.abs(x - 199.5), np.abs(y - 199.5)) - 100
    floor = np.array([76, 79, 86]) * (1 - shadow * np.exp(-np.maximum(away, 0) / 6))[..., None]
    picture = cv2.GaussianBlur(np.where((away < 0)[..., None], photographed.ASPHALT, floor), (0, 0), 0.8)
    noise = np.random.default_rng(0).normal(0, 6, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def square_view(off=0.0):
    """The view of that square, with each side `off` tiles outside of where it is."""
    half = 100 + 200 * off
    corners = 199.5 + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return view_of(corners, 1, 1, 400, 400)


def test_a_border_is_seen_by_colours_where_no_edge_is():
    picture = square_on_a_dark_floor(0.0)
    sides = borders.outer_sides(np.ones((1, 1), np.int8))
    for off in (0.0, 0.015):
        offsets = borders.colour_border(picture, square_view(off), sides, 0.04).offsets
        np.testing.assert_allclose(np.nanmean(offsets, axis=1), -off, atol=0.003)
    assert (borders.contrasts(picture, square_view(), sides) > 5).all()
    assert (borders.contrasts(picture, square_view(0.04), sides) < 3).all()


def test_a_shadow_under_tiles_moves_the_border_by_colours_but_not_the_sharpest_edge():
    picture = square_on_a_dark_floor(0.1)
    sides = borders.outer_sides(np.ones((1, 1), np.int8))
    by_colours = borders.colour_border(picture, square_view(), sides, 0.04).offsets
    assert np.nanmean(by_colours) > 0.007
    shadow = borders.shadow_width(picture, square_view(), sides, 0.04)
    np.testing.assert_allclose(np.nanmean(by_colours) - shadow, 0, atol=0.002)
    # An edge beyond the reach is not seen: nothing says how wide the shadow is.
    assert np.isnan(borders.shadow_width(picture, square_view(0.03), sides, 0.04))


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
    ("corners", "message"),
    [
        ([[0, 0], [300, 300], [300, 0], [0, 300]], "lines that cross"),
        ([[0, 0], [0, 300], [300, 300], [300, 0]], "counter-clockwise"),
        ([[0, 0], [3000, 0], [300, 300], [0, 300]], "points within floor, 800 x 640 pixels"),
        ([[0, 0], [300, 0], [300, 300]], "four points"),
        ([[0, 0], [300, 0], [300, np.nan], [0, 300]], r"corners: expected finite numbers, got .* \[300.0, nan\]"),
    ],
)
def test_bad_corners_are_named(shot, corners, message):
    with pytest.raises(InputError, match=message):
        propose_tiles(shot, corners=np.array(corners))


def test_the_size_of_a_photograph_that_was_shrunk_is_explained(shot):
    """Corners are in pixels of the file for the command, whose message had another size without a word."""
    message = "expected points within floor, 800 x 640 pixels at 1/2 of the file's size$"
    with pytest.raises(InputError, match=message):
        propose_tiles(shot._replace(name="floor", shrunk=2), shape=(3, 3), corners=CORNERS + 9999)


def test_a_view_bends_and_scales():
    view = view_of(CORNERS, 3, 3, 800, 640)
    np.testing.assert_allclose(view.pixels_of(np.array([[0, 0], [3, 3]], float)), CORNERS[[0, 2]], atol=1e-3)
    bent = view._replace(radial=0.05)
    step = (bent.pixels_of(places_of(3, 3, 4, 0)) - view.pixels_of(places_of(3, 3, 4, 0))) / 0.05
    np.testing.assert_allclose(view.bend(places_of(3, 3, 4, 0)), step, atol=1e-6)
    double = FloorView(*bent).scaled(2)
    place = np.array([[1.0, 2.0]])
    np.testing.assert_allclose(double.pixels_of(place), bent.pixels_of(place) * 2 + 0.5, atol=1e-6)


def test_photographs_are_upright_and_large_ones_smaller(tmp_path, monkeypatch):
    picture = photographed.photograph(TOWN)
    photographed.write(tmp_path / "plain.jpg", picture)
    content = (tmp_path / "plain.jpg").read_bytes()
    turned = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    (tmp_path / "turned.jpg").write_bytes(
        content[:2] + b"\xff\xe1" + (len(turned) + 2).to_bytes(2) + turned + content[2:]
    )
    plain = Photograph.read(tmp_path / "plain.jpg")
    upright = Photograph.read(tmp_path / "turned.jpg")
    np.testing.assert_array_equal(upright.image, np.rot90(plain.image, -1))
    monkeypatch.setattr(reading, "_MOST_READ", 800 * 640 / 3)
    small = Photograph.read(tmp_path / "plain.jpg")
    assert small.image.shape == (320, 400, 3) and small.shrunk == 2
    np.testing.assert_allclose(small.pixels_of(np.array([[100.5, 200.5]])), [[50, 100]])


def jpeg_with(stray, size=(300, 400)):
    """A grey JPEG file with some bytes after its first segment."""
    content = cv2.imencode(".jpg", np.full(size, 128, np.uint8))[1].tobytes()
    end = 4 + int.from_bytes(content[4:6])
    return content[:end] + stray + content[end:]


@pytest.mark.parametrize("stray", [b"", b"\0", b"\0\0\xff\0", b"\xff\xff", b"\xff\x01"])
def test_the_size_of_a_jpeg_is_read_as_its_decoder_reads_it(stray, tmp_path, monkeypatch):
    """Decoders skip bytes between segments: files with such bytes had no size, and were read without a limit."""
    (tmp_path / "stray.jpg").write_bytes(jpeg_with(stray))
    monkeypatch.setattr(reading, "_MOST_READ", 60_000)
    with pytest.raises(InputError, match="at least 200 pixels a side, got 200 x 150"):  # read at a half
        Photograph.read(tmp_path / "stray.jpg")
    monkeypatch.setattr(reading, "_MOST_PIXELS", 100_000)
    message = "expected at most 0.1 megapixels, got 400 x 300; save it smaller$"
    with pytest.raises(InputError, match=message):
        Photograph.read(tmp_path / "stray.jpg")


def test_a_jpeg_without_a_frame_header_is_refused(tmp_path):
    content = jpeg_with(b"")
    (tmp_path / "cut.jpg").write_bytes(content[: content.index(b"\xff\xc0")] + b"\xff\xd9")
    with pytest.raises(InputError, match="cut.jpg: expected a photograph, .* got one that cannot be read"):
        Photograph.read(tmp_path / "cut.jpg")


@pytest.mark.parametrize("damage", ["unfinished", "changed"])
def test_a_damaged_png_is_refused_without_complaints_of_the_decoder(damage, tmp_path, capfd):
    """The decoder's own lines stood before the message of a command."""
    photographed.write(tmp_path / "floor.png", photographed.photograph(TOWN))
    content = bytearray((tmp_path / "floor.png").read_bytes())
    if damage == "unfinished":
        content = content[: len(content) // 2]
    else:
        content[len(content) // 2] ^= 1
    (tmp_path / "floor.png").write_bytes(content)
    capfd.readouterr()
    with pytest.raises(InputError, match="floor.png: expected a photograph, .* got one that cannot be read"):
        Photograph.read(tmp_path / "floor.png")
    assert capfd.readouterr() == ("", "")


def test_a_png_is_turned_upright(tmp_path):
    """Its EXIF data are a part of the file beside those that hold pixels."""
    photographed.write(tmp_path / "plain.png", photographed.photograph(TOWN))
    content = (tmp_path / "plain.png").read_bytes()
    exif = b"eXIf" + b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    # The header ends at byte 33.
    part = (len(exif) - 4).to_bytes(4) + exif + zlib.crc32(exif).to_bytes(4)
    (tmp_path / "turned.png").write_bytes(content[:33] + part + content[33:])
    plain, upright = (Photograph.read(tmp_path / name).image for name in ("plain.png", "turned.png"))
    np.testing.assert_array_equal(upright, np.rot90(plain, -1))


def test_a_png_with_a_wrong_profile_of_colours_is_read_without_complaints(tmp_path, capfd):
    """The decoder warned of this part on the terminal if the file had an opacity."""
    file = tmp_path / "floor.png"
    assert cv2.imwrite(str(file), np.full((300, 300, 4), 255, np.uint8))
    content = file.read_bytes()
    profile = b"iCCP" + b"x\0\0" + zlib.compress(b"none")
    part = (len(profile) - 4).to_bytes(4) + profile + zlib.crc32(profile).to_bytes(4)
    file.write_bytes(content[:33] + part + content[33:])
    capfd.readouterr()
    assert Photograph.read(file).image.shape == (300, 300, 3)
    assert capfd.readouterr() == ("", "")


def test_a_photograph_with_transparent_pixels_is_refused(tmp_path):
    """What was erased in a picture editor was once seen again."""
    picture = np.full((300, 300, 4), 255, np.uint8)
    file = tmp_path / "floor.png"
    assert cv2.imwrite(str(file), picture)
    assert Photograph.read(file).image.shape == (300, 300, 3)
    picture[:9, :9, 3] = 0
    assert cv2.imwrite(str(file), picture)
    with pytest.raises(InputError, match="floor.png: expected a photograph without transparent pixels"):
        Photograph.read(file)


@pytest.mark.parametrize("depth", [1, 2, 4, 8, 16])
def test_a_grey_photograph_with_one_transparent_grey_is_refused(depth, tmp_path):
    """OpenCV drops the grey that a file declares transparent, at every depth of its greys."""
    most = 2**depth - 1
    greys = np.full((300, 300), most)
    greys[:9, :9] = most // 2
    bits = np.unpackbits(greys.astype(">u2").view(np.uint8).reshape(300, 300, 2), axis=2)[..., 16 - depth :]
    rows = np.packbits(bits.reshape(300, -1), axis=1)
    head = struct.pack(">IIBBBBB", 300, 300, depth, 0, 0, 0, 0)
    pixels = zlib.compress(np.pad(rows, ((0, 0), (1, 0))).tobytes())

    def write(transparent):
        parts = {b"IHDR": head, b"tRNS": struct.pack(">H", transparent), b"IDAT": pixels, b"IEND": b""}
        content = b"\x89PNG\r\n\x1a\n"
        for kind, data in parts.items():
            content += struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        (tmp_path / "floor.png").write_bytes(content)
        return tmp_path / "floor.png"

    with pytest.raises(InputError, match="floor.png: expected a photograph without transparent pixels"):
        Photograph.read(write(most // 2))
    if depth > 1:  # no pixel has the declared grey
        assert (Photograph.read(write(most // 2 + 1)).image[20:] == 255).all()


@pytest.mark.parametrize("change", [lambda image: image.astype(np.uint16) * 257, lambda image: image / 255])
def test_a_photograph_of_another_type_is_refused(change):
    """A user who makes a photograph of 16 bits or of shares got tiles of noise or in black."""
    image = np.full((300, 300, 3), 200, np.uint8)
    corners = np.array([[50, 50], [250, 50], [250, 250], [50, 250]])
    proposal = propose_tiles(Photograph("frame", image), corners=corners, codes=np.array([[6]]), fit=False)
    with pytest.raises(InputError, match=r"photograph: image: expected uint8 \[H, W, 3\]"):
        cut_tiles(Photograph("frame", change(image)), proposal)


@pytest.mark.parametrize("suffix", [".png", pytest.param(".jpg", marks=pytest.mark.slow)])
def test_a_grey_photograph_is_refused_because_its_crossings_look_straight(suffix, tmp_path):
    file = tmp_path / f"floor{suffix}"
    picture = photographed.photograph(TOWN)
    assert cv2.imwrite(str(file), cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY))
    grey = Photograph.read(file)
    message = f"floor{suffix}: expected a photograph in colours, .* got a grey one"
    with pytest.raises(InputError, match=message):
        propose_tiles(grey, shape=TOWN.shape)
    assert main(["tiles", "read", str(file), "--size", *map(str, TOWN.shape)]) == 2
    np.testing.assert_array_equal(propose_tiles(grey, codes=TOWN).codes, TOWN)  # a map tells its kinds
    file = tmp_path / f"coloured{suffix}"
    photographed.write(file, picture)
    np.testing.assert_array_equal(propose_tiles(Photograph.read(file), shape=TOWN.shape).codes, TOWN)


def test_a_calibrated_lens_is_straightened(tmp_path):
    (tmp_path / "camera.yaml").write_text(
        "image_width: 400\nimage_height: 320\ndistortion_model: plumb_bob\n"
        "camera_matrix: {rows: 3, cols: 3, data: [450, 0, 200, 0, 450, 160, 0, 0, 1]}\n"
        "distortion_coefficients: {rows: 1, cols: 5, data: [-0.25, 0.05, 0, 0, 0]}\n"
    )
    lens = read_lens(tmp_path / "camera.yaml")
    dots = np.zeros((640, 800, 3), np.uint8)
    cv2.circle(dots, (120, 90), 4, (255, 255, 255), -1)
    photographed.write(tmp_path / "dots.png", dots)
    shot = Photograph.read(tmp_path / "dots.png", lens)
    np.testing.assert_array_equal(Photograph.read(tmp_path / "dots.png", tmp_path / "camera.yaml").image, shot.image)
    seen = np.argwhere(shot.image[..., 0] > 128).mean(axis=0)[::-1]
    np.testing.assert_allclose(shot.pixels_of(np.array([[120.0, 90.0]]))[0], seen, atol=0.3)
    assert np.linalg.norm(seen - [120, 90]) > 5
    photographed.write(tmp_path / "other.png", dots[:, :500])
    with pytest.raises(
        InputError, match=r"other.png: expected a photograph of the camera's ratio 400 x 320, got 500 x"
    ):
        Photograph.read(tmp_path / "other.png", lens)


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        ("[.nan, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        (f"[1{'0' * 400}, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        ("[f, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected data, a list of 9 numbers"),
        ("[0, 0, 200, 0, 450, 160, 0, 0, 1]", "camera_matrix: expected focal lengths over 0, got 0 and 450"),
        ("[450, 0, 200, 0, 450, 160, 0, 0, 0]", "camera_matrix: expected a last row of 0, 0, 1, got 0, 0, 0"),
    ],
)
def test_a_lens_that_shows_nothing_is_refused(matrix, message, tmp_path):
    """Photographs were straightened to one colour, and the message said that no tiles were found."""
    (tmp_path / "camera.yaml").write_text(
        f"image_width: 400\nimage_height: 320\ncamera_matrix: {{data: {matrix}}}\n"
        "distortion_coefficients: {data: [0, 0, 0, 0]}\n"
    )
    with pytest.raises(InputError, match=f"camera.yaml: {message}"):
        read_lens(tmp_path / "camera.yaml")


def test_numbers_without_a_point_are_read(tmp_path):
    """PyYAML reads 1e-05 as text, but yaml-cpp, by which ROS writes calibrations, writes it."""
    (tmp_path / "camera.yaml").write_text(
        "image_width: 400\nimage_height: 320\ncamera_matrix: {data: [4.5e+02, 0, 2e2, 0, 450, 160, 0, 0, 1]}\n"
        "distortion_coefficients: {data: [1e-05, -1e-3, 0, 0]}\n"
    )
    lens = read_lens(tmp_path / "camera.yaml")
    assert lens.matrix[0].tolist() == [450, 0, 200]
    assert lens.distortion.tolist() == [1e-5, -1e-3, 0, 0]


def test_a_size_that_unfolds_to_a_long_text_is_told_in_short(tmp_path):
    """Aliases of YAML made a message of 15 MB, and with a few more lines one that filled the memory."""
    aliases = "".join(f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 6))
    (tmp_path / "camera.yaml").write_text(
        f"a0: &a0 [1, 1]\n{aliases}image_width: *a5\nimage_height: 1\n"
        "camera_matrix: {data: [450, 0, 200, 0, 450, 160, 0, 0, 1]}\ndistortion_coefficients: {data: [0, 0, 0, 0]}\n"
    )
    with pytest.raises(InputError, match="expected image_width and image_height in pixels, got ") as caught:
        read_lens(tmp_path / "camera.yaml")
    assert len(str(caught.value)) < 400


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


def test_sides_are_measured_as_they_are_drawn(drawn_tiles):
    for tile in drawn_tiles.tiles:
        for side in measure_sides(tile):
            assert side.road == pytest.approx((0.13, 0.87), abs=0.004)
            assert side.white == pytest.approx((0.09, 0.91), abs=0.006)
            if side.separator is not None:
                assert side.separator == pytest.approx(0.5, abs=0.01)
                assert side.lane == pytest.approx(0.195, abs=0.003)


def test_sides_without_a_separator_tell_no_offset_where_others_have_one(drawn_tiles):
    tile = next(tile for tile in drawn_tiles.tiles if tile.yellow.any())
    bare = tile._replace(yellow=np.zeros_like(tile.yellow))
    alone, both, without = (describe_lanes(tiles, 0.2).splitlines()[-1] for tiles in ([tile], [tile, bare], [bare]))
    assert both == alone != without


def test_a_sliver_of_the_floor_is_no_road(drawn_tiles):
    """White tape near the border, and a dark sliver outside of it that worn tape joins to the road."""
    image = np.full((200, 200, 3), 70, np.uint8)
    image[:, 3:17] = image[:, -17:-3] = 220
    image[120:126, 3:17] = 70
    road = propose_masks(image)["road"]
    assert road[:, 0].mean() < 0.1
    assert road[0, 40:160].all() and road[-1, 40:160].all()
    image[:, :17] = image[:, -17:] = 70
    image[:, :4] = image[:, -4:] = 220  # all that is left of the tape
    road = propose_masks(image)["road"]
    assert not road[:, 0].any() and not road[:, -1].any()


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
