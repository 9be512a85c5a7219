"""Rendering: pictures, masks and labels go together, at every size."""

import json

import numpy as np
import pytest

from elitelanes_jax import InputError, random_grids, repair, rotate
from elitelanes_jax.render import LABEL_COLOURS, LABELS, Picture, choose_tiles, overlay, recall_tiles, render
from elitelanes_jax.roadmap import Drawn, RoadMap
from elitelanes_jax.tilesets import TileSet

RNG = np.random.default_rng(12)
GRID = np.array(repair(RNG.integers(0, 16, (4, 6)).astype(np.int8), fill=True))


@pytest.fixture(params=["drawn_tiles", "real_tiles"])
def tiles(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("size", [16, 31, 64, 384, 400, 512])
def test_shapes_types_and_values(tiles, size):
    picture = render(GRID[:2, :3], tiles, tile_px=size)
    assert picture.image.shape == (2 * size, 3 * size, 3)
    for name, pixels in picture._asdict().items():
        assert pixels.dtype == np.uint8
        assert pixels.shape[:2] == (2 * size, 3 * size)
        if name in ("road", "red", "yellow"):
            assert set(np.unique(pixels)) <= {0, 255}
    assert picture.labels.max() < len(LABELS) == len(LABEL_COLOURS)


def test_labels_are_lines_over_road_over_background(tiles):
    picture = render(GRID, tiles, tile_px=40)
    for row, column in np.ndindex(picture.labels.shape):
        expected = 0
        for label, mask in enumerate((picture.road, picture.red, picture.yellow), start=1):
            if mask[row, column]:
                expected = label
        assert picture.labels[row, column] == expected
    assert set(np.unique(picture.labels)) == {0, 1, 2, 3}


def test_each_cell_is_its_tile_turned(drawn_tiles):
    picture = render(GRID, drawn_tiles, tile_px=384, seed=4)
    chosen = choose_tiles(GRID, drawn_tiles, seed=4)
    for row, column in np.ndindex(GRID.shape):
        place, turns = chosen[row, column]
        tile = drawn_tiles.tiles[place]
        here = np.s_[row * 384 : (row + 1) * 384, column * 384 : (column + 1) * 384]
        np.testing.assert_array_equal(picture.image[here], np.rot90(tile.image, turns))
        for name in ("road", "red", "yellow"):
            np.testing.assert_array_equal(getattr(picture, name)[here] > 0, np.rot90(getattr(tile, name), turns))


def test_roads_go_on_over_every_seam_and_end_at_every_border(drawn_tiles):
    for seed in range(3):
        grid = np.array(repair(random_grids_one(seed), fill=True))
        for size in (16, 50, 384):
            road = render(grid, drawn_tiles, tile_px=size, seed=seed).road > 0
            assert not (road[0].any() or road[-1].any() or road[:, 0].any() or road[:, -1].any())
            for column in range(1, grid.shape[1]):
                west, east = road[:, column * size - 1], road[:, column * size]
                np.testing.assert_array_equal(west, east)
                linked = np.repeat(grid[:, column] & 1, size) > 0
                assert not (west & ~linked).any()
                assert west.any() == linked.any()
            for row in range(1, grid.shape[0]):
                np.testing.assert_array_equal(road[row * size - 1], road[row * size])


def random_grids_one(seed):
    import jax

    return random_grids(jax.random.key(seed), 1, (5, 4))[0]


def test_thin_lines_stay_at_every_size(drawn_tiles):
    grid = np.array([[6, 5, 7, 3], [10, 6, 13, 11], [14, 13, 5, 11], [12, 5, 5, 9]])
    large = render(grid, drawn_tiles, tile_px=384)
    for size in (16, 20, 24, 32, 33, 48, 64, 100, 200, 300):
        small = render(grid, drawn_tiles, tile_px=size)
        for name in ("road", "red", "yellow"):
            share, expected = (getattr(picture, name).mean() / 255 for picture in (small, large))
            assert 0.6 * expected < share < 1.6 * expected, (name, size)


def test_variants_are_drawn_at_random_and_the_same_every_time(drawn_tiles):
    grid = np.full((30, 30), 10)
    chosen = choose_tiles(grid, drawn_tiles, seed=1)
    np.testing.assert_array_equal(chosen, choose_tiles(grid, drawn_tiles, seed=1))
    assert (chosen != choose_tiles(grid, drawn_tiles, seed=2)).any()
    draws, counts = np.unique(chosen.reshape(-1, 2), axis=0, return_counts=True)
    assert {tuple(draw) for draw in draws} == set(drawn_tiles.turned[10])
    assert (abs(counts - 900 / 8) < 5 * np.sqrt(900 / 8)).all()
    one, other = render(grid, drawn_tiles, tile_px=16, seed=1), render(grid, drawn_tiles, tile_px=16, seed=1)
    for left, right in zip(one, other, strict=True):
        np.testing.assert_array_equal(left, right)


def test_a_turned_map_is_the_turned_picture(drawn_tiles):
    chosen = choose_tiles(GRID, drawn_tiles)
    turned = np.rot90(chosen, axes=(0, 1)).copy()
    turned[..., 1] = (turned[..., 1] + 1) % 4
    picture = render(GRID, drawn_tiles, tile_px=32, chosen=chosen)
    quarter = render(rotate(GRID), drawn_tiles, tile_px=32, chosen=turned)
    for left, right in zip(picture, quarter, strict=True):
        np.testing.assert_array_equal(np.rot90(left), right)


def test_an_overlay_colours_each_label(drawn_tiles):
    picture = render(GRID, drawn_tiles, tile_px=32)
    solid = overlay(picture, opacity=1)
    for label, colour in enumerate(LABEL_COLOURS):
        assert (solid[picture.labels == label] == colour).all()
    np.testing.assert_array_equal(overlay(picture, opacity=0), picture.image)


def test_tiles_are_recalled_where_they_still_fit(drawn_tiles):
    chosen = choose_tiles(GRID, drawn_tiles, seed=3)
    names = [[drawn_tiles.tiles[place].name for place, _ in row] for row in chosen]
    drawn = Drawn(drawn_tiles.name, names, chosen[..., 1].tolist())
    road_map = RoadMap(GRID, drawn=drawn)
    np.testing.assert_array_equal(recall_tiles(road_map, drawn_tiles), chosen)
    other_codes = rotate(GRID, 2)
    other_set = TileSet("another", "", drawn_tiles.tiles)
    fewer = TileSet(drawn_tiles.name, "", drawn_tiles.tiles[4:])
    for changed, tile_set in (
        (RoadMap(GRID), drawn_tiles),
        (road_map._replace(codes=other_codes), drawn_tiles),
        (road_map._replace(codes=GRID[:2]), drawn_tiles),
        (road_map, other_set),
        (road_map, fewer),
    ):
        assert recall_tiles(changed, tile_set) is None


def test_what_has_no_picture_is_named(drawn_tiles):
    with pytest.raises(ValueError, match=r"codes 3, 5, .*\), got 8 \(stub\) at row 1, column 0"):
        render([[6, 3], [8, 9]], drawn_tiles)
    partial = TileSet("partial", "", tuple(tile for tile in drawn_tiles.tiles if tile.code != 15))
    with pytest.raises(ValueError, match=r"the set 'partial' can draw .* got 15 \(crossing4\)"):
        choose_tiles([[15, 15], [15, 15]], partial)


@pytest.mark.parametrize("seed", ["a", -1, 2.5])
def test_bad_seeds_are_refused(drawn_tiles, seed):
    with pytest.raises(InputError, match="seed: expected whole numbers, 0 or more, got"):
        render(GRID, drawn_tiles, seed=seed)


@pytest.mark.parametrize("size", [15, 513, 0, -4, 32.0, "64"])
def test_sizes_out_of_range_are_refused(drawn_tiles, size):
    with pytest.raises(ValueError, match="tile_px: expected 16 to 512 pixels a tile"):
        render(GRID, drawn_tiles, tile_px=size)


def test_pictures_are_plain_arrays(drawn_tiles):
    assert Picture._fields == ("image", "road", "red", "yellow", "labels")
    assert json.dumps(LABELS)


def test_a_choice_that_does_not_show_the_grid_is_refused(drawn_tiles):
    chosen = choose_tiles(GRID, drawn_tiles)
    wrong = chosen.copy()
    wrong[1, 2, 1] = (wrong[1, 2, 1] + 1) % 4 if GRID[1, 2] != 15 else 7
    outside = chosen.copy()
    outside[0, 0, 0] = 99
    for choice, message in (
        (chosen[:2], r"chosen: expected integers of shape \(4, 6, 2\), got int64 of shape \(2, 6, 2\)"),
        (chosen * 1.0, r"chosen: expected integers of shape \(4, 6, 2\), got float64"),
        (outside, "chosen: expected a tile of the set .* at row 0, column 0, got tile 99"),
        (-1 - chosen, "chosen: expected a tile of the set .* at row 0, column 0"),
        (wrong, "chosen: expected a tile of the set .* at row 1, column 2, got tile"),
    ):
        with pytest.raises(InputError, match=message):
            render(GRID, drawn_tiles, chosen=choice)


def test_what_is_no_grid_is_refused(drawn_tiles):
    for grid, message in (([[6.0, 3.0], [12.0, 9.0]], "integer tile codes"), ([6, 3], "two dimensions")):
        with pytest.raises(InputError, match=f"grid: expected {message}"):
            render(grid, drawn_tiles)
