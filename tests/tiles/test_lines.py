"""Lines out of place: all that are moved, turned, swapped, turned inside out or left out are found, and no others."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from elitelanes_jax.cli.main import main
from elitelanes_jax.tiles._lines import misplaced_lines
from elitelanes_jax.tiles.sides import describe_lanes, measure_sides
from elitelanes_jax.tiles.tileset import MASKS, inspect_tiles

CROSSINGS, OTHERS = ("crossing3_1", "crossing4_1"), ("turn_1", "straight_1", "end_1")


def faults(tiles, name, **masks):
    """The masks of a tile that are faulty when these take the place of its own."""
    beside = own(tiles, "straight_2")
    found = misplaced_lines([own(tiles, name)._replace(**masks), beside])
    assert {tile for tile, *_ in found} <= {name}
    return {mask for _, mask, _ in found}


def shifted(mask, down, right):
    return cv2.warpAffine(mask.astype(np.uint8), np.float32([[1, 0, right], [0, 1, down]]), mask.shape[::-1]) > 0


def test_lines_that_are_where_they_belong_are_left_alone(drawn_tiles, real_tiles):
    assert misplaced_lines(drawn_tiles.tiles) == misplaced_lines(real_tiles.tiles) == []


def own(tiles, name):
    (tile,) = (tile for tile in tiles.tiles if tile.name == name)
    return tile


@pytest.mark.parametrize("name", [*CROSSINGS, *OTHERS])
def test_lines_of_another_place_are_found(name, drawn_tiles):
    tile, line = own(drawn_tiles, name), "red" if name in CROSSINGS else "yellow"
    mask = getattr(tile, line)
    step = len(mask) // 20
    moved = [shifted(mask, *way) for way in ((step, 0), (-step, 0), (0, step), (0, -step))]
    for wrong in (~mask, np.zeros_like(mask), np.ones_like(mask), *moved):
        assert faults(drawn_tiles, name, **{line: wrong}) == {line}
    if name != "crossing4_1":  # it is the same all around
        assert faults(drawn_tiles, name, **{line: np.rot90(mask)}) == {line}
    assert faults(drawn_tiles, name, red=tile.yellow, yellow=tile.red)
    for other in ("red", "yellow"):
        assert faults(drawn_tiles, name, **{other: np.ones_like(mask)}) == {other}


def test_mirrored_crossings_have_their_stop_lines_on_the_wrong_lane(drawn_tiles):
    for name in CROSSINGS:
        tile = own(drawn_tiles, name)
        red = np.flipud(tile.red)
        mirrored = misplaced_lines([tile._replace(red=red, image=np.flipud(tile.image))])
        assert [words for *_, words in mirrored] == [
            "expected a picture that is not mirrored, of traffic that keeps right, got stop lines on the outgoing lanes"
        ]
        # One line that is beside its lane is no mirror image.
        red = tile.red & (np.arange(len(red))[:, None] > 40) | red & (np.arange(len(red))[:, None] <= 40)
        found = "\n".join(words for *_, words in misplaced_lines([tile._replace(red=red, image=np.flipud(tile.image))]))
        assert "expected" in found and "mirrored" not in found


@pytest.mark.parametrize(("eighth", "wrong"), [(5, {"red"}), (7, set())])
def test_the_line_of_the_next_side_may_begin_at_the_end_of_the_outgoing_lane(eighth, wrong, drawn_tiles):
    tile = own(drawn_tiles, "crossing4_1")
    red, columns = tile.red.copy(), np.flatnonzero(tile.road[0])
    red[: len(red) // 20, np.array_split(columns, 8)[eighth]] = True
    assert faults(drawn_tiles, "crossing4_1", red=red) == wrong


def test_a_road_is_in_the_middle_and_in_one_piece(drawn_tiles):
    tile = own(drawn_tiles, "straight_1")
    assert "road" in faults(drawn_tiles, "straight_1", road=np.roll(tile.road, 20, axis=1))
    torn = tile.road.copy()
    torn[100:110] = False
    ((_, mask, words),) = [fault for fault in misplaced_lines([tile._replace(road=torn)]) if fault[1] == "road"]
    assert (mask, words) == ("road", "expected one road that joins all sides that the tile opens, got pieces")


def test_a_set_may_do_without_separators(drawn_tiles):
    without = [tile._replace(yellow=np.zeros_like(tile.yellow)) for tile in drawn_tiles.tiles]
    assert misplaced_lines(without) == []


def test_check_names_tile_and_mask(folder, capsys):
    red, yellow = folder / "crossing4_1" / "red.png", folder / "turn_1" / "yellow.png"
    cv2.imwrite(str(red), np.zeros((384, 384), np.uint8))
    cv2.imwrite(str(yellow), 255 - cv2.imread(str(yellow), cv2.IMREAD_GRAYSCALE))
    assert main(["tiles", "check", str(folder)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    lane = "expected a stop line across the incoming, right-hand lane, got one on 0% of it at the side"
    assert captured.err.splitlines() == [
        f"{yellow}: expected lane separators on 15% of the tile at most, got them on 98%",
        *(f"{red}: {lane} {side}" for side in "NESW"),
    ]
    # A set may have lines of its own kind: it can be drawn with.
    assert inspect_tiles(folder)[1] == []


def test_photographs_with_proposed_masks_pass(real_tiles, tmp_path, capsys):
    source = Path(__file__).parents[3] / "shared" / "real_tiles"
    for tile in real_tiles.tiles:
        (tmp_path / "tiles" / tile.name).mkdir(parents=True)
        shutil.copy(source / tile.name / "image.png", tmp_path / "tiles" / tile.name)
    assert main(["tiles", "masks", str(tmp_path / "tiles")]) == 0
    assert main(["tiles", "check", str(tmp_path / "tiles")]) == 0
    assert len(list((tmp_path / "tiles").glob("*/*.png"))) == (1 + len(MASKS)) * len(real_tiles.tiles)
    assert not capsys.readouterr().err


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
