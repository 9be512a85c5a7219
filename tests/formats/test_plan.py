"""The plan of a map: tapes that meet at the sides of tiles, counts that are the map's, files that hold both."""

import re
import sys
from math import atan2, pi

import cv2
import numpy as np
import pytest
from conftest import grids
from hypothesis import given
from refusals import refused

from elitelanes_jax import RoadMap
from elitelanes_jax._util.cells import cell_name
from elitelanes_jax.formats import make_plan, plan_drawing, plan_pages, without_dead_ends
from elitelanes_jax.formats.tapes import REFERENCE, tapes_of
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.network.codes import KINDS, ROAD_ALPHABET, SIDES, rotate_codes
from elitelanes_jax.network.plain_metrics import plain_measure

RING = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
SIZE = 0.6


def middle(side):
    return np.array([0.5 + side.right / 2, 0.5 + side.down / 2]) * SIZE


def place(code):
    """The tile of a code in a plan: in the middle of a ring of road that returns its connections."""
    codes = np.array([[6, 5, 3], [10, code, 10], [12, 5, 9]], np.int8)
    for side in SIDES:
        if code & side.bit:
            codes[1 + side.down, 1 + side.right] |= side.opposite
    (placed,) = (tile for tile in make_plan(codes).placed if (tile.row, tile.column) == (1, 1))
    return placed


@pytest.mark.parametrize("code", ROAD_ALPHABET)
def test_tapes_meet_those_of_the_next_tile(code):
    """On an open side white tape ends 24.6 cm from the middle, yellow tape in it; on a closed side none ends."""
    placed = place(code)
    assert placed.quarter_turns < len(KINDS[placed.kind])
    tapes = tapes_of(placed.kind, placed.quarter_turns, SIZE)
    for side in SIDES:
        along = np.array([abs(side.down), abs(side.right)])
        ends = {"white": [], "yellow": []}
        for tape in tapes:
            for end in (tape.points[0], tape.points[-1]):
                off = np.array(end) - middle(side)
                if tape.colour in ends and abs(off @ [side.right, side.down]) < 1e-9:
                    ends[tape.colour].append(round(float(off @ along), 6))
        closed = not code & side.bit
        neighbours = [other for other in SIDES if other.bit & code]
        # A tape along a closed side of a straight or crossing ends on the two sides beside it.
        assert sorted(ends["white"]) == ([] if closed else [-0.246, 0.246]) or (closed and len(neighbours) == 3)
        assert ends["yellow"] == ([] if closed else [0.0])


@pytest.mark.parametrize("code", [code for code in ROAD_ALPHABET if code.bit_count() > 2])
def test_stop_lines_cross_the_right_lane_into_a_crossing(code):
    placed = place(code)
    red = [tape for tape in tapes_of(placed.kind, placed.quarter_turns, SIZE) if tape.colour == "red"]
    assert len(red) == code.bit_count()
    for side in SIDES:
        lines = [np.mean(tape.points, axis=0) - middle(side) for tape in red]
        inward, right = -np.array([side.right, side.down]), np.array([side.down, -side.right])
        found = [line for line in lines if abs(line @ inward - 0.024) < 1e-9]
        assert len(found) == bool(code & side.bit)
        for line in found:
            assert line @ right == pytest.approx(0.012 + 0.105)


def test_tapes_of_a_ring():
    plan = make_plan(RING, tile_size=SIZE)
    quarter = pi / 2
    outer, inner = 10 * (0.3 + 0.246) * np.sin(quarter / 10), 6 * (0.3 - 0.246) * np.sin(quarter / 6)
    assert plan.tape["white"] == pytest.approx(4 * (2 * SIZE + outer + inner), abs=1e-3)
    assert plan.tape["yellow"] == pytest.approx(4 * SIZE + 4 * 0.3 * quarter, abs=4e-3)
    assert plan.tape["red"] == 0 and plan.floor == pytest.approx((1.8, 1.8))
    assert plan.tiles == {"straight": 4, "turn": 4, "crossing3": 0, "crossing4": 0, "empty": 1}


@given(grids())
def test_a_plan_is_the_map(grid):
    codes = np.pad(without_dead_ends(grid), ((0, 3), (0, 3)))
    codes[-2:, -2:] = [[6, 3], [12, 9]]  # most grids have no other road
    plan = make_plan(codes)
    rebuilt, metrics = np.zeros_like(codes), plain_measure(codes)
    for tile in plan.placed:
        rebuilt[tile.row, tile.column] = rotate_codes(REFERENCE[tile.kind], tile.quarter_turns)
    np.testing.assert_array_equal(rebuilt, codes)
    assert {kind: (np.isin(codes, KINDS[kind])).sum() for kind in plan.tiles} == plan.tiles
    assert plan.tape["red"] == pytest.approx(0.21 * (3 * plan.tiles["crossing3"] + 4 * plan.tiles["crossing4"]))
    assert metrics["tiles"] == len(plan.placed) == sum(plan.tiles.values()) - metrics["empty_cells"]


@pytest.fixture(scope="module")
def furnished():
    stop = {"kind": "sign_stop", "x": 1.0, "y": 1.0, "angle": pi / 2, "tag": 25}
    return RoadMap(RING, objects=[stop, {"kind": "duckie", "x": 1.5, "y": 1.5}])


def test_files_hold_the_plan(furnished, tmp_path):
    for kind in ("pdf", "svg", "png"):
        first, second = tmp_path / f"first.{kind}", tmp_path / f"second.{kind}"
        plan = make_plan(furnished)
        plan.save(first)
        plan.save(second)
        assert plan == make_plan(furnished)
        assert first.read_bytes() == second.read_bytes()
    words = re.findall(r"<text[^>]*>(.*?)</text>|<tspan[^>]*>(.*?)</tspan>", (tmp_path / "first.svg").read_text())
    words = [one or other for one, other in words]
    for tile in make_plan(furnished).placed:
        assert cell_name(tile.row, tile.column) in words
    assert {"turn 90°", "1.755 m", "1 x stop, tag 25", "1 x duckie", "4 x turn"} <= set(words)
    assert len(re.findall(rb"/Type /Page\b", (tmp_path / "first.pdf").read_bytes())) == 2


def test_objects_are_numbered_from_north_to_south_and_arrows_point_ahead():
    places = [(0.5, 2.0), (1.5, 0.2), (2.5, 0.2)]
    buses = [{"kind": "bus", "x": x, "y": y, "angle": 1.0} for x, y in places]
    plan = make_plan(RoadMap(RING, objects=buses))
    assert [(item.x, item.y) for item in plan.objects] == [places[1], places[2], places[0]]
    page = plan_pages._map_page(plan)
    arrows = [words for words in page.axes[0].texts if words.get_zorder() == plan_drawing._ARROWS]
    assert len(arrows) == 3
    for arrow in arrows:
        east, south = np.subtract(arrow.xy, arrow.xyann)
        assert np.arctan2(-south, east) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["duckie", "floor_tag"])
def test_objects_on_roads_hide_tape_and_labels(kind, tmp_path):
    def green(x, y):
        """Counts the pixels of an object on the ring."""
        thing = {"kind": kind, "x": x, "y": y} | ({"tag": 3} if kind == "floor_tag" else {})
        make_plan(RoadMap(RING, objects=[thing])).save(tmp_path / "plan.png")
        picture = cv2.imread(str(tmp_path / "plan.png")).astype(int)
        return (np.abs(picture[..., ::-1] - [0x3D, 0x7A, 0x3A]).max(axis=-1) < 8).sum()

    on_ground, on_label, on_tape = green(1.5, 1.5), green(0.5, 1.5), green(1.5, 0.09)
    assert on_ground > 100
    assert on_label == pytest.approx(on_ground, rel=0.1)
    assert on_tape == pytest.approx(on_ground, rel=0.1)


@pytest.mark.parametrize(("x", "y"), [(-1, 1.5), (5, 1.5), (2, -1), (2, 4)])
def test_objects_far_beyond_the_map_are_on_the_page(x, y, tmp_path):
    """A bus that faces away reaches farther than any other object; it was cut off, or over the title."""

    bus = {"kind": "bus", "x": x, "y": y, "angle": atan2(1.5 - y, x - 2)}
    make_plan(RoadMap([[6, 5, 5, 3], [10, 0, 0, 10], [12, 5, 5, 9]], objects=[bus])).save(tmp_path / "plan.png")
    seen = cv2.imread(str(tmp_path / "plan.png"))[..., ::-1].astype(int)

    def is_colour(pixels, colour):
        return np.abs(pixels - colour).max(axis=-1) < 8

    is_bus = is_colour(seen, [0x3D, 0x7A, 0x3A])
    rows, columns = (np.flatnonzero(is_bus.any(axis=axis)) for axis in (1, 0))
    long, wide = sorted([np.ptp(rows) + 1, np.ptp(columns) + 1], reverse=True)
    # The length is 0.44 m with an arrow of 7 cm ahead, and the width is 0.137 m.
    assert long / wide == pytest.approx((0.44 + 0.07) / 0.137, rel=0.05)
    # No text and no measure is near it.
    around = seen[rows[0] - 3 : rows[-1] + 4, columns[0] - 3 : columns[-1] + 4]
    assert not is_colour(around, [0x1D, 0x20, 0x26]).any()


@pytest.mark.parametrize("kind", ["pdf", "svg", "png"])
def test_a_character_that_the_font_lacks_is_no_warning(kind, tmp_path):
    make_plan(RoadMap(RING, objects=[{"kind": "other:\u76f4", "x": 1.0, "y": 1.0}])).save(tmp_path / f"plan.{kind}")
    assert kind != "svg" or "\u76f4" in (tmp_path / "plan.svg").read_text(encoding="utf-8")


def test_a_large_map_has_a_larger_sheet_and_more_lists(tmp_path):
    grid = linked_codes(np.full((14, 14), 15, np.int8))
    make_plan(grid).save(tmp_path / "plan.pdf")
    text = (tmp_path / "plan.pdf").read_bytes()
    heights = [float(box.split()[3]) for box in re.findall(rb"/MediaBox \[([^\]]*)\]", text)]
    assert heights[0] > heights[1] and len(heights) == 1 + -(-(14 * 16 + 6) // (56 * 3))


@pytest.mark.parametrize(
    ("grid", "got", "expected"),
    [
        (np.zeros((3, 3), np.int8), "none", ""),
        (np.full((3, 65), 15, np.int8), "3 x 65", ""),
        ([[4, 1]], "a dead end at A1 ([0, 0])", ""),
        ([RING, RING], "2", "one map"),
    ],
)
def test_maps_that_cannot_be_built_are_refused(grid, got, expected):
    with refused("map", got, expected):
        make_plan(grid)


@pytest.mark.skipif(sys.platform == "win32", reason="no limit of a file's size")
def test_a_full_disk_is_an_error_of_the_system(tmp_path):
    import resource

    make_plan(RING).save(tmp_path / "whole.pdf")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"File too large.*plan\.pdf"):
            make_plan(RING).save(tmp_path / "plan.pdf")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [file.name for file in tmp_path.iterdir()] == ["whole.pdf"]
