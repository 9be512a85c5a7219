"""Rendering: pictures, masks and labels go together, at every size."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from folders import read_picture
from refusals import refused

from elitelanes_jax import RoadMap, render, repair, rotate
from elitelanes_jax.formats.road_map import map_to_json, read_map
from elitelanes_jax.tiles import LABEL_COLOURS, LABELS, TileSet, choose_tiles
from elitelanes_jax.tiles.rendering import (
    describe_other_pictures,
    png_of,
    recall_choice,
    record_choice,
    scale_tiles,
)
from elitelanes_jax.tiles.tileset import default_tiles

PIXELS = ("image", "road", "red", "yellow", "labels")
RNG = np.random.default_rng(12)
GRID = np.array(repair(RNG.integers(0, 16, (4, 6)).astype(np.int8), fill=True))


@pytest.fixture(params=["drawn_tiles", "real_tiles"])
def tiles(request):
    return request.getfixturevalue(request.param)


@pytest.mark.parametrize("size", [16, 31, 400])
def test_shapes_types_and_values(tiles, size):
    picture = render(GRID[:2, :3], tiles, tile_px=size)
    assert picture.image.shape == (2 * size, 3 * size, 3)
    for name in PIXELS:
        pixels = getattr(picture, name)
        assert pixels.dtype == np.uint8
        assert pixels.shape[:2] == (2 * size, 3 * size)
        if name in ("road", "red", "yellow"):
            assert set(np.unique(pixels)) <= {0, 255}
    assert picture.labels.max() < len(LABELS) == len(LABEL_COLOURS)


def test_labels_are_lines_over_road_over_background(tiles):
    picture = render(GRID, tiles, tile_px=40)
    lines_first = [mask > 0 for mask in (picture.yellow, picture.red, picture.road)]
    np.testing.assert_array_equal(picture.labels, np.select(lines_first, [3, 2, 1]))
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


SPARSE = np.where(RNG.random((8, 9)) < 0.8, RNG.integers(0, 16, (8, 9)), 0).astype(np.int8)


@pytest.mark.parametrize(("grid", "fill"), [(GRID, True), (SPARSE.T, True), (SPARSE, False)])
@pytest.mark.parametrize("size", [16, 50, 384])
def test_roads_go_on_over_every_seam_and_end_at_every_border(grid, fill, size, drawn_tiles):
    grid = np.array(repair(np.array(grid), fill=fill))
    assert fill or {1, 2, 4, 8} <= set(grid.flat)
    picture = render(grid, drawn_tiles, tile_px=size, seed=3)
    assert ((picture.labels > 0) == (picture.road > 0)).all()
    (height, width), road = grid.shape, picture.road
    road = road.reshape(height, size, width, size).swapaxes(1, 2)
    for row, column in np.ndindex(grid.shape):
        for side, edge in enumerate((8, 4, 2, 1)):
            along = np.rot90(road[row, column], side)[0]
            assert along.any() == bool(grid[row, column] & edge)
            if edge == 4 and along.any():
                np.testing.assert_array_equal(along, road[row, column + 1][:, 0])
            if edge == 2 and along.any():
                np.testing.assert_array_equal(along[::-1], road[row + 1, column][0])


def test_thin_lines_stay_at_every_size(drawn_tiles):
    grid = np.array([[6, 5, 7, 3], [10, 6, 13, 11], [14, 13, 5, 11], [12, 5, 5, 9]])
    large = render(grid, drawn_tiles, tile_px=384)
    for size in (16, 20, 24, 32, 33, 48, 64, 100, 200, 300):
        small = render(grid, drawn_tiles, tile_px=size)
        for name in ("road", "red", "yellow"):
            share, expected = (getattr(picture, name).mean() / 255 for picture in (small, large))
            assert 0.6 * expected < share < 1.6 * expected, (name, size)


def test_a_caller_cannot_change_the_tiles_of_another(drawn_tiles):
    for layer in scale_tiles(drawn_tiles, 16).values():
        with pytest.raises(ValueError, match="read-only"):
            layer[0] = 0


def test_variants_are_drawn_at_random_and_the_same_every_time(drawn_tiles):
    grid = np.full((30, 30), 10)
    chosen = choose_tiles(grid, drawn_tiles, seed=1)
    np.testing.assert_array_equal(chosen, choose_tiles(grid, drawn_tiles, seed=1))
    assert (chosen != choose_tiles(grid, drawn_tiles, seed=2)).any()
    draws, counts = np.unique(chosen.reshape(-1, 2), axis=0, return_counts=True)
    assert {tuple(draw) for draw in draws} == set(drawn_tiles.rotations[10])
    assert (abs(counts - 900 / 8) < 5 * np.sqrt(900 / 8)).all()


def test_a_turned_map_is_the_turned_picture(drawn_tiles):
    chosen = choose_tiles(GRID, drawn_tiles)
    turned = np.rot90(chosen, axes=(0, 1)).copy()
    turned[..., 1] = (turned[..., 1] + 1) % 4
    picture = render(GRID, drawn_tiles, tile_px=32, chosen=chosen)
    quarter = render(rotate(GRID), drawn_tiles, tile_px=32, chosen=turned)
    for name in PIXELS:
        np.testing.assert_array_equal(np.rot90(getattr(picture, name)), getattr(quarter, name))


def test_an_overlay_colours_each_label(drawn_tiles):
    picture = render(GRID, drawn_tiles, tile_px=32)
    solid = picture.overlay(opacity=1)
    for label, colour in enumerate(LABEL_COLOURS):
        assert (solid[picture.labels == label] == colour).all()
    np.testing.assert_array_equal(picture.overlay(opacity=0), picture.image)


@pytest.fixture
def drawn_map(drawn_tiles):
    """A map, and the tiles that it was drawn with."""
    chosen = choose_tiles(GRID, drawn_tiles, seed=3)
    return RoadMap(GRID, drawn=record_choice(drawn_tiles, chosen)), chosen


def test_tiles_are_recalled_where_they_still_fit(drawn_tiles, drawn_map):
    road_map, chosen = drawn_map
    np.testing.assert_array_equal(recall_choice(road_map, drawn_tiles), chosen)
    assert recall_choice(RoadMap(GRID), drawn_tiles) is None
    fewer, other = (TileSet(name, "", drawn_tiles.pictures[4:]) for name in (drawn_tiles.name, "other"))
    turned = SimpleNamespace(codes=rotate(GRID, 2), drawn=road_map.drawn)
    cut = SimpleNamespace(codes=GRID[:2], drawn=road_map.drawn)
    for grid, tile_set in ((turned, drawn_tiles), (cut, drawn_tiles), (road_map, fewer), (road_map, other)):
        assert recall_choice(grid, tile_set) is None


def test_pictures_are_recalled_by_what_they_show(drawn_tiles, drawn_map, tmp_path):
    road_map, chosen = drawn_map
    # The set may have another name, other masks and more tiles, as long as it has these pictures.
    first, *others = drawn_tiles.tiles
    more = first._replace(name=f"{first.name}0")
    masked = first._replace(yellow=np.zeros_like(first.yellow))
    renamed = TileSet("other", "", (masked, *others, more))
    np.testing.assert_array_equal(recall_choice(road_map, renamed), chosen)
    assert describe_other_pictures(road_map, renamed) == ""
    # Under the same names, another cut has other pictures.
    used = drawn_tiles.tiles[chosen[0, 0, 0]]
    darker = used._replace(image=used.image // 2)
    tiles = tuple(darker if tile is used else tile for tile in drawn_tiles.tiles)
    recut = TileSet(drawn_tiles.name, "", tiles)
    assert recall_choice(road_map, recut) is None
    assert describe_other_pictures(road_map, recut).startswith(f"the tile set {drawn_tiles.name!r} has other pictures")
    assert describe_other_pictures(RoadMap(GRID), recut) == ""
    # A map with other codes keeps its record, which says nothing of the set.
    edited = SimpleNamespace(codes=rotate(GRID, 2), drawn=road_map.drawn)
    assert recall_choice(edited, drawn_tiles) is None and describe_other_pictures(edited, drawn_tiles) == ""
    # Map files without digests name the set alone.
    unknown = replace(road_map, drawn=road_map.drawn._replace(digests=None))
    assert recall_choice(unknown, recut) is not None and recall_choice(unknown, renamed) is None
    for one in (road_map, unknown):
        one.save(tmp_path / "map.json")
        assert read_map(tmp_path / "map.json").drawn == one.drawn
    for wrong in ([], {"turn_1": 7}):
        with refused("drawn", "...turn_1..."):
            replace(road_map, drawn=road_map.drawn._replace(digests=wrong))


def test_what_has_no_picture_is_named(drawn_tiles):
    for code, grid, got in (
        (
            2,
            [[6, 3], [8, 9]],
            "8 (end) at A2 ([1, 0]); a tile end_1 ... --dead-ends grass ...",
        ),
        (15, [[15, 15], [15, 15]], "15 (crossing4) at A1 ([0, 0])"),
    ):
        partial = TileSet("partial", "", tuple(tile for tile in drawn_tiles.tiles if tile.code != code))
        with refused("grid", got):
            render(grid, partial)


def test_what_the_command_takes_is_taken(drawn_tiles, drawn_map, tmp_path):
    (road_map, _), file = drawn_map, tmp_path / "map.json"
    file.write_text(map_to_json(road_map))
    expected = render(GRID, drawn_tiles, tile_px=16, seed=3).image
    for given in (road_map, file, str(file)):
        for tiles in (None, drawn_tiles, default_tiles(), str(default_tiles())):
            np.testing.assert_array_equal(render(given, tiles, tile_px=16).image, expected)
    plain = render(GRID, tile_px=16).image
    np.testing.assert_array_equal(render(road_map, tile_px=16, seed=0).image, plain)
    assert (plain != expected).any()
    for wrong, subject, got in (
        (str(tmp_path / "none"), "", f"{tmp_path / 'none'}: ... got none"),
        (3, "tiles", "3"),
    ):
        with refused(subject, got):
            render(GRID, wrong)


def test_wrong_arguments_are_refused(drawn_tiles):
    chosen = choose_tiles(GRID, drawn_tiles)
    wrong, outside = chosen.copy(), chosen.copy()
    wrong[1, 2, 1] = (wrong[1, 2, 1] + 1) % 4 if GRID[1, 2] != 15 else 7
    outside[0, 0, 0] = 99
    for arguments, subject, got, expected in (
        ({"seed": 2.5}, "seed", "2.5", ""),
        ({"seed": True}, "seed", "True", ""),
        ({"seed": RNG}, "seed", "Generator(PCG64) at ...", ""),
        ({"chosen": chosen[:2]}, "chosen", "int64 of shape (2, 6, 2)", ""),
        ({"chosen": chosen * 1.0}, "chosen", "float64 of shape (4, 6, 2)", ""),
        ({"chosen": [[1], [2, 3]]}, "chosen", "[[1], [2, 3]]", ""),
        ({"chosen": outside}, "chosen", "tile 99 rotated 1 times", "at A1"),
        ({"chosen": -1 - chosen}, "chosen", "tile -3 rotated -2 times", ""),
        ({"chosen": wrong}, "chosen", "tile 11 rotated 7 times", "at C2"),
    ):
        with refused(subject, got, expected):
            render(**{"source": GRID, "tiles": drawn_tiles} | arguments)


def test_a_choice_without_a_seed_is_refused(drawn_tiles):
    """NumPy draws another seed for each None, so that two calls chose different tiles."""
    with refused("seed", "None"):
        choose_tiles(GRID, drawn_tiles, seed=None)


def test_a_choice_may_have_any_whole_numbers(drawn_tiles):
    """Four times an index overflowed in 8 bits, and other tiles were drawn without a word."""
    many = replace(drawn_tiles, tiles=drawn_tiles.tiles * 10)
    chosen = choose_tiles(GRID, many, seed=1)
    assert 64 < chosen[..., 0].max() < 256
    expected, image = (
        render(GRID, many, tile_px=16, chosen=choice).image for choice in (chosen, chosen.astype(np.uint8))
    )
    np.testing.assert_array_equal(image, expected)


def test_a_picture_that_no_png_file_holds_is_refused(capfd):
    """The encoder complained to the terminal, and Python's error was about a tuple."""
    for shape in ((1, 1_000_001), (1_000_001, 1)):
        with refused("pixels", expected="at most 1,000,000"):
            png_of(np.zeros(shape, np.uint8))
    assert png_of(np.zeros((1, 1_000_000), np.uint8))
    assert capfd.readouterr() == ("", "")


def test_a_picture_is_written_with_its_masks(drawn_tiles, tmp_path):
    picture = render([[6, 3], [12, 9]], drawn_tiles, tile_px=32)
    folder = tmp_path / "new" / "folder"
    picture.save(folder)
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{name}.png" for name in PIXELS)
    for name in PIXELS[1:]:
        np.testing.assert_array_equal(read_picture(folder / f"{name}.png"), getattr(picture, name))
