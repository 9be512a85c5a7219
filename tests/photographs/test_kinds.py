"""The kinds that are read in the cells of a floor."""

import cv2
import numpy as np
import photographed

from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.photographs import (
    _kinds,
)
from elitelanes_jax.tiles import TileSet, load_tiles, render

TURNS = np.array([[6, 3, 6, 3], [10, 12, 9, 10], [12, 5, 5, 9]], np.int8)


def test_turns_of_a_lab_are_read_by_each_other():
    """Turns without white tape look like ends to the drawn turns, but like the lab's other turns."""
    worn = photographed.worn_tiles(0.55, 0.3, bare=("turn_2", "turn_3", "turn_4"))
    flat = render(TURNS, worn, tile_px=_kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.asarray(flat), *(_kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = _kinds.read_kinds(flat, 3, 4, load_tiles())
    np.testing.assert_array_equal(read.codes, TURNS)
    assert read.margins.min() > 0.3


def test_a_cell_of_the_floor_counts_less_than_a_picture_of_the_set():
    """Crossings of three and of four ways are more like each other than any other kinds are."""
    cell = render(np.array([[10]], np.int8), tile_px=_kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.hstack([cell, cell]), *(_kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    scores = np.zeros((1, 2, 16))
    scores[0, 0, 10] = 0.9
    compared = _kinds._compare_cells(flat, scores)[0]
    assert compared[0, 10] == 0.9 and 0.8 < compared[1, 10] <= 0.85


def test_a_straight_that_is_laid_across_the_road_is_read():
    codes = np.array([[6, 7, 10, 3], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
    flat = render(codes, tile_px=_kinds.READ_PX, seed=0).image
    flat = cv2.copyMakeBorder(np.asarray(flat), *(_kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = _kinds.read_kinds(flat, 3, 4, load_tiles())
    assert read.codes[0, 2] == 10 and read.margins[0, 2] > 0.2


def test_a_road_to_a_bare_cell_is_read_with_a_set_without_ends():
    codes = np.array([[6, 5, 3], [14, 5, 10], [12, 5, 9]], np.int8)
    set_without_ends = TileSet("no-ends", "", tuple(tile for tile in load_tiles().tiles if tile.code in ROAD_ALPHABET))
    flat = np.array(render(codes, set_without_ends, tile_px=_kinds.READ_PX, seed=0).image, float)
    middle = flat[_kinds.READ_PX : 2 * _kinds.READ_PX, _kinds.READ_PX : 2 * _kinds.READ_PX]
    middle[:] = middle.mean((0, 1)) + 0.04 * (middle - middle.mean((0, 1)))  # a straight that is hardly there
    flat = cv2.copyMakeBorder(flat.round().astype(np.uint8), *(_kinds.MARGIN_PX,) * 4, cv2.BORDER_REFLECT)
    read = _kinds.read_kinds(flat, 3, 3, set_without_ends)
    np.testing.assert_array_equal(read.codes, [[6, 5, 3], [14, 0, 10], [12, 5, 9]])
