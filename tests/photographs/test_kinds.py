"""The kinds that are read in the cells of a floor."""

from dataclasses import replace

import cv2
import numpy as np
import photographed
import pytest

from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.photographs import Photograph, _cells, _kinds, cut_tiles, propose_tiles, write_cuts
from elitelanes_jax.photographs._views import view_of
from elitelanes_jax.tiles import TileSet, load_tiles, render

TURNS = np.array([[6, 3, 6, 3], [10, 12, 9, 10], [12, 5, 5, 9]], np.int8)


def test_turns_of_a_lab_are_read_by_each_other():
    """Turns without white tape look like ends to the drawn turns, but like the lab's other turns."""
    worn = photographed.worn_tiles(0.55, 0.3, bare=("turn_2", "turn_3", "turn_4"))
    flat = render(TURNS, worn, tile_px=_cells._TILE_PX, seed=0).image
    read = _kinds.read_kinds(_cells.apart(flat), load_tiles())
    np.testing.assert_array_equal(read.codes, TURNS)
    assert read.margins.min() > 0.3


def test_a_cell_of_the_floor_counts_less_than_a_picture_of_the_set():
    """Crossings of three and of four ways are more like each other than any other kinds are."""
    cell = render(np.array([[10]], np.int8), tile_px=_cells._TILE_PX, seed=0).image
    scores = np.zeros((1, 2, 16))
    scores[0, 0, 10] = 0.9
    compared = _kinds._compare_cells(_cells.apart(np.hstack([cell, cell])), scores)[0]
    assert compared[0, 10] == 0.9 and 0.8 < compared[1, 10] <= 0.85


def test_a_straight_that_is_laid_across_the_road_is_read():
    codes = np.array([[6, 7, 10, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
    flat = render(codes, tile_px=_cells._TILE_PX, seed=0).image
    read = _kinds.read_kinds(_cells.apart(flat), load_tiles())
    assert read.codes[0, 2] == 10 and read.margins[0, 2] > 0.2


def test_a_road_to_a_bare_cell_is_read_with_a_set_without_ends():
    codes = np.array([[6, 5, 3], [14, 5, 10], [12, 5, 9]], np.int8)
    set_without_ends = TileSet("no-ends", "", tuple(tile for tile in load_tiles().tiles if tile.code in ROAD_ALPHABET))
    flat = np.array(render(codes, set_without_ends, tile_px=_cells._TILE_PX, seed=0).image, float)
    middle = flat[_cells._TILE_PX : 2 * _cells._TILE_PX, _cells._TILE_PX : 2 * _cells._TILE_PX]
    middle[:] = middle.mean((0, 1)) + 0.04 * (middle - middle.mean((0, 1)))  # a straight that is hardly there
    read = _kinds.read_kinds(_cells.apart(flat.round().astype(np.uint8)), set_without_ends)
    np.testing.assert_array_equal(read.codes, [[6, 5, 3], [14, 0, 10], [12, 5, 9]])


# The holes are between roads, whose white tape is beside them.
HOLES = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [10, 0, 10, 10], [12, 5, 13, 9], [0, 6, 3, 0], [0, 12, 9, 0]], np.int8)
FLOORS = {
    "linoleum": photographed.LINO,
    "wood": (190, 140, 96),
    "grey": (128, 128, 128),
    "dark grey": (60, 60, 62),
    "white": (240, 240, 238),
    "grass": (86, 118, 72),
    "black": (30, 30, 32),
}


def read_holes(tiles, read_with, ground, seed):
    """The kinds of a floor with holes, whose view is off by 0.6 % of a tile."""
    rng = np.random.default_rng(seed)
    corners = photographed.corners_of(6, 4, tilt=float(rng.uniform(0, 40)), turn=float(rng.uniform(-30, 30)), away=1.9)
    picture = photographed.photograph(HOLES, corners, ground, seed, tiles=tiles)
    blurred = cv2.GaussianBlur(picture, (0, 0), float(rng.uniform(0.5, 1.5)))
    away = rng.uniform(-0.006, 0.006, (4, 2)) * np.linalg.norm(corners[1] - corners[0]) / 4
    view = view_of(corners + away, 6, 4, photographed.WIDTH, photographed.HEIGHT)
    return _kinds.read_kinds(_cells.fitted_cells(blurred, view), read_with)


def cut_from_a_floor(tiles, folder):
    """The set that a lab cuts from a photograph of its own floor."""
    town = np.array([[6, 7, 5, 3], [14, 15, 5, 11], [12, 13, 5, 9]], np.int8)
    shot = Photograph("floor", photographed.photograph(town, tiles=tiles))
    write_cuts(folder, cut_tiles(shot, propose_tiles(shot, shape=(3, 4))))
    return load_tiles(folder)


@pytest.mark.parametrize("ground", FLOORS)
def test_holes_between_roads_are_no_tiles(ground, drawn_tiles):
    """A neighbour's tape at the edge of a hole looked like the white line of a straight."""
    read = read_holes(drawn_tiles, drawn_tiles, FLOORS[ground], seed=0)
    np.testing.assert_array_equal(read.codes, HOLES)
    assert read.margins.min() > 0.1


@pytest.mark.slow
@pytest.mark.parametrize("ground", FLOORS)
@pytest.mark.parametrize("lab", ["drawn_tiles", "real_tiles"])
def test_holes_are_no_tiles_with_sets_cut_from_the_same_lab(lab, ground, tmp_path, request):
    tiles = replace(request.getfixturevalue(lab), blend=False)
    for read_with in (tiles, cut_from_a_floor(tiles, tmp_path / "set")):
        for seed in range(4):
            read = read_holes(tiles, read_with, FLOORS[ground], seed)
            is_sure = read.margins > 0.06
            np.testing.assert_array_equal(read.codes[is_sure], HOLES[is_sure])
            assert is_sure.mean() > 0.9
