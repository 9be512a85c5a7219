"""The drawn tile set: its figures, its seams, its stop lines, its variants, and that the script draws it."""

import itertools

import cv2
import numpy as np
import pytest
from folders import read_picture

from elitelanes_jax.tiles.tileset import default_tiles
from experiments.perception.draw_tiles import main

CENTIMETRE = 384 / 60


def edge_pixels(picture, side):
    """The row of pixels along a side, 0 to 3 clockwise from north, seen from inside, left to right."""
    return np.rot90(picture, side)[0]


def open_sides(tile):
    return [side for side, bit in enumerate((8, 4, 2, 1)) if tile.code & bit]


@pytest.mark.slow
def test_the_script_draws_the_set(tmp_path):
    assert main(["--out", str(tmp_path)]) == 0
    files = sorted(path.relative_to(tmp_path) for path in tmp_path.rglob("*.png"))
    assert files == sorted(path.relative_to(default_tiles()) for path in default_tiles().rglob("*.png"))
    for file in files:
        drawn, kept = (read_picture(root / file) for root in (tmp_path, default_tiles()))
        # Another machine may round a pixel otherwise.
        different = drawn != kept
        assert different.mean() < 1e-3
        if file.name == "image.png":
            assert np.abs(drawn.astype(int) - kept).max() <= 2


def test_masks_meet_at_every_seam(drawn_tiles):
    """Whatever two tiles meet, turned in whatever way: the road goes on at exactly the same pixels."""
    roads = {}
    for tile in drawn_tiles.tiles:
        for side in open_sides(tile):
            roads[tile.name, side] = edge_pixels(tile.road, side)
            assert not edge_pixels(tile.yellow, side).any()
    for (one, left), (other, right) in itertools.product(roads.items(), repeat=2):
        np.testing.assert_array_equal(left, right[::-1], err_msg=f"{one} {other}")
    profile = next(iter(roads.values()))
    # Two lanes of 21 cm and the yellow tape between them.
    assert profile.sum() == pytest.approx((2 * 21 + 2.4) * CENTIMETRE, abs=1.5)
    np.testing.assert_array_equal(profile, profile[::-1])


def test_pictures_meet_at_every_seam(drawn_tiles):
    """Brightness at the border is the same for all tiles, grain aside, outside the stop lines."""
    profiles = []
    for tile in drawn_tiles.tiles:
        # A stop line lies at every open side of a crossing.
        for side in open_sides(tile) if tile.code in (3, 6, 9, 12, 5, 10, 2) else ():
            strip = np.rot90(tile.image, side)[:4].mean(axis=(0, 2))
            profiles.append(cv2.blur(strip[None], (13, 1))[0])
    assert len(profiles) == 18
    assert np.ptp(np.array(profiles), axis=0).max() < 14


def test_stop_lines_lie_on_the_incoming_lane(drawn_tiles):
    """On crossings only; who comes in through a side keeps to the right."""
    for tile in drawn_tiles.tiles:
        if tile.code not in (11, 15):
            assert not tile.red.any()
            continue
        for side in range(4):
            turned = np.rot90(tile.red, side)  # the side is north now, and who comes in heads south
            lane = turned[: round(5.5 * CENTIMETRE)]
            right, left = lane[:, :192], lane[:, 192:]  # the right hand of who heads south is in the west
            if side not in open_sides(tile):
                assert not lane[0].any()
                continue
            first = np.flatnonzero(lane[0])
            assert not left[0].any()
            assert right[0].sum() == pytest.approx(21 * CENTIMETRE, abs=4)
            assert first[-1] == pytest.approx((30 - 1.2) * CENTIMETRE, abs=4)
            depth = lane[:, first[len(first) // 2]].sum()
            assert depth == pytest.approx(4.8 * CENTIMETRE, abs=4)


def test_yellow_is_on_roads_without_crossings_only_and_in_dashes(drawn_tiles):
    for tile in drawn_tiles.tiles:
        count, _, stats, _ = cv2.connectedComponentsWithStats(tile.yellow.astype(np.uint8))
        dashes = {3: 6, 10: 8, 2: 4}.get(tile.code, 0)
        assert count - 1 == dashes, tile.name
        for *_, area in stats[1:]:
            assert area == pytest.approx(5 * 2.4 * CENTIMETRE**2, rel=0.2)
        assert not (tile.yellow & tile.red).any()
        assert not (tile.yellow & ~tile.road).any()


def test_the_curve_has_the_specifications_radii(drawn_tiles):
    """Centred near the corner: yellow tape from 27.25 cm, outer edge of the road at 50.75 cm."""
    rows, columns = np.mgrid[:384, :384] + 0.5
    centre = 30 - 27.25 - 1.2
    right, up = columns / CENTIMETRE - centre, (384 - rows) / CENTIMETRE - centre
    radius = np.hypot(right, up)[(right > 0) & (up > 0)]
    for tile in drawn_tiles.tiles[:4]:
        inside = tile.yellow[(right > 0) & (up > 0)]
        assert np.median(radius[inside]) == pytest.approx(27.25 + 1.2, abs=0.3)
        road = tile.road[(right > 0) & (up > 0)]
        assert np.quantile(radius[road], 0.995) == pytest.approx(50.65, abs=0.5)
        assert np.quantile(radius[road], 0.005) == pytest.approx(6.25, abs=1.5)


def test_asphalt_and_tapes_have_duckietowns_colours(drawn_tiles):
    for tile in drawn_tiles.tiles:
        asphalt = np.median(tile.image[tile.road & ~tile.red & ~tile.yellow], axis=0)
        assert (asphalt >= (61, 57, 48)).all()
        assert (asphalt <= (94, 91, 86)).all()
        for mask, colour in ((tile.red, (231, 59, 71)), (tile.yellow, (235, 220, 80))):
            if mask.any():
                np.testing.assert_allclose(np.median(tile.image[mask], axis=0), colour, atol=25)
