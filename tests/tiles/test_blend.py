"""Blending: gains and offsets are those of a plain least squares, seams are feathered, and masks stay."""

from dataclasses import replace

import numpy as np
import pytest

from elitelanes_jax import render
from elitelanes_jax.tiles import choose_tiles
from elitelanes_jax.tiles._blend import feather, lay_toned, solve_tones
from elitelanes_jax.tiles.rendering import scale_tiles

TOWN = np.array([[6, 5, 7, 3, 0], [10, 0, 10, 14, 3], [14, 5, 15, 13, 11], [12, 5, 9, 0, 8]], np.int8)
PX = 64


@pytest.fixture(scope="module")
def uneven(drawn_tiles):
    """The drawn tiles, each in a light of its own, as photographs are; edges are darker."""
    rng, tiles = np.random.default_rng(5), []
    for tile in drawn_tiles.tiles:
        side = tile.image.shape[0]
        slope = np.linspace(-6, 6, side)[:, None, None]
        light = tile.image * rng.uniform(0.85, 1.15, 3) + rng.uniform(-15, 15, 3) + slope
        tiles.append(tile._replace(image=np.clip(np.rint(light), 0, 255).astype(np.uint8)))
    return drawn_tiles.__class__("uneven", "", tuple(tiles), blend=True)


def seams(grid):
    """All seams: the two cells, and whether one is left of the other."""
    for row, column in np.ndindex(grid.shape):  # no road leaves the grid
        if grid[row, column] & 4:
            yield (row, column), (row, column + 1), True
        if grid[row, column] & 2:
            yield (row, column), (row + 1, column), False


def at_seam(layer, one, other, level, size):
    """The pixel layers on both sides of a seam, from the seam away: lists of lines."""
    first, second = (layer[row * size : (row + 1) * size, column * size :][:, :size] for row, column in (one, other))
    if level:
        first, second = first.swapaxes(0, 1), second.swapaxes(0, 1)
    return [list(first[::-1]), list(second)]


def least_squares(picture, grid):
    """Gains and offsets by a dense design with a row for each pair of pixels."""
    height, width = grid.shape
    unknowns = 2 * grid.size
    tones = np.zeros((height, width, 3, 2))
    for channel in range(3):
        rows, wanted = [], []
        for number, cost in ((place, (1.0, 0.1)[place % 2]) for place in range(unknowns)):
            row = np.zeros(unknowns)
            row[number] = cost * (255 if number % 2 == 0 else 1)
            rows.append(row)
            wanted.append(cost * 255 if number % 2 == 0 else 0)
        for one, other, level in seams(grid):
            colours = at_seam(picture.image[..., channel].astype(float), one, other, level, PX)
            labels = at_seam(picture.labels, one, other, level, PX)
            first, second = (np.concatenate(side[: PX // 2]) for side in colours)
            marks = [np.concatenate(side[: PX // 2]) for side in labels]
            alike = (marks[0] == marks[1]) & (marks[0] > 0)
            block = np.zeros((alike.sum(), unknowns))
            here, there = (2 * (place[0] * width + place[1]) for place in (one, other))
            block[:, here], block[:, here + 1] = first[alike], 1
            block[:, there], block[:, there + 1] = -second[alike], -1
            rows.extend(block / np.sqrt(alike.sum()))
            wanted.extend(np.zeros(alike.sum()))
        solved = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0]
        tones[:, :, channel] = solved.reshape(height, width, 2)
    return tones


def pictures_of(tiles, grid, seed=0):
    chosen = choose_tiles(grid, tiles, seed)
    return chosen[..., 0] * 4 + chosen[..., 1]


def solved(tiles, grid, seed=0):
    small = scale_tiles(tiles, PX)
    return solve_tones(grid, pictures_of(tiles, grid, seed), small["image"], small["labels"])


def test_gains_and_offsets_are_those_of_least_squares_over_all_pairs(uneven):
    tones = solved(uneven, TOWN)
    expected = least_squares(render(TOWN, replace(uneven, blend=False), tile_px=PX), TOWN)
    np.testing.assert_allclose(tones, expected, atol=1e-8)
    assert np.abs(tones[..., 1]).max() > 5


def test_each_pixel_is_toned_as_the_formula_says(uneven):
    picture, tones = render(TOWN, replace(uneven, blend=False), tile_px=16), solved(uneven, TOWN)
    toned = lay_toned(scale_tiles(uneven, 16)["image"], pictures_of(uneven, TOWN), tones)
    rng = np.random.default_rng(0)
    for y, x in zip(rng.integers(0, 64, 200), rng.integers(0, 80, 200), strict=True):
        gain, offset = np.moveaxis(tones[y // 16, x // 16], -1, 0)
        expected = np.clip(np.rint(picture.image[y, x] * gain + offset), 0, 255)
        np.testing.assert_array_equal(toned[y, x], expected)


@pytest.mark.parametrize("size", [16, 64, 150])
def test_feathered_pixels_are_mixed_with_their_mirror_images(uneven, size):
    plain = render(TOWN, replace(uneven, blend=False), tile_px=size)
    reach = max(0.02 * size, 2)
    expected = plain.image.astype(np.float32)
    for one, other, level in seams(TOWN):
        near, far = at_seam(plain.image.astype(np.float32), one, other, level, size)
        marks = at_seam(plain.labels, one, other, level, size)
        changed = at_seam(expected, one, other, level, size)  # views
        for deep in range(size):
            away = deep + 0.5
            if away < reach:
                share = 0.25 * (1 + np.cos(np.pi * away / reach))
                alike = (marks[0][deep] == marks[1][deep])[:, None]
                changed[0][deep] += share * alike * (far[deep] - near[deep])
                changed[1][deep] += share * alike * (near[deep] - far[deep])
    got = feather(plain.image, plain.labels, TOWN)
    assert np.abs(got - expected).max() <= 0.5001
    assert (got != plain.image).any()


@pytest.mark.parametrize("codes", [[[5, 5, 5]], [[10], [10]], [[15]]])
def test_a_map_of_one_row_or_column_is_blended_as_in_a_larger_map(codes, uneven):
    """It has no seams in one direction, and a picture of it was an error of NumPy."""
    image = render(codes, uneven, tile_px=40).image
    height, width = image.shape[:2]
    assert (height, width) == (40 * len(codes), 40 * len(codes[0]))
    larger = np.pad(codes, ((0, 1), (0, 1)))
    plain = render(larger, replace(uneven, blend=False), tile_px=40)
    expected = feather(plain.image, plain.labels, larger)[:height, :width]
    np.testing.assert_array_equal(feather(plain.image[:height, :width], plain.labels[:height, :width], codes), expected)


def test_maps_are_toned_and_feathered_and_their_masks_and_labels_stay(uneven):
    plain, blended = (render(TOWN, replace(uneven, blend=blend), tile_px=40) for blend in (False, True))
    for name in ("road", "red", "yellow", "labels"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(blended, name))
    toned = lay_toned(scale_tiles(uneven, 40)["image"], pictures_of(uneven, TOWN), solved(uneven, TOWN))
    np.testing.assert_array_equal(blended.image, feather(toned, plain.labels, TOWN))


def test_a_turned_map_has_the_turned_light(uneven):
    chosen = choose_tiles(TOWN, uneven)
    turned = np.rot90(chosen, axes=(0, 1)).copy()
    turned[..., 1] = (turned[..., 1] + 1) % 4
    quarter = np.rot90(TOWN)
    quarter = ((quarter << 1 | quarter >> 3) & 15).astype(np.int8)
    one = render(TOWN, uneven, tile_px=48, chosen=chosen).image
    other = render(quarter, uneven, tile_px=48, chosen=turned).image
    difference = np.abs(np.rot90(one).astype(int) - other)
    assert difference.max() <= 1  # rounding
    assert (difference == 0).mean() > 0.999


def test_photographs_are_blended_and_drawings_are_not(drawn_tiles, real_tiles):
    assert real_tiles.blend and not drawn_tiles.blend
