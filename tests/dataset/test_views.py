"""Views of maps: every layer goes the same way, and the matrix says which."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax.dataset._transforms import STANDARD, VARIED, Transforms, parse_transforms
from elitelanes_jax.dataset._views import _middle_scale, draw_view, photograph, warp

SIZES = st.tuples(st.integers(16, 90), st.integers(16, 90))
STRONG = Transforms(quarter_turns=True, rotation=180, scale=(0.5, 2), perspective=0.1)


def map_points(points, matrix):
    return cv2.perspectiveTransform(np.array([points], float), matrix)[0]


def view_of(seed, transforms, size):
    return draw_view(np.random.default_rng(seed), transforms, size)


def nearest(mask, view, outside):
    """Slow and obvious: where each pixel's centre comes from."""
    height, width = view.size
    places = np.array([(x + 0.5, y + 0.5) for y in range(height) for x in range(width)])
    x, y = map_points(places, np.linalg.inv(view.matrix)).T
    inside = (x >= 0) & (y >= 0) & (x < mask.shape[1]) & (y < mask.shape[0])
    found = np.full(len(places), outside, np.uint8)
    found[inside] = mask[np.floor(y[inside]).astype(int), np.floor(x[inside]).astype(int)]
    on_an_edge = np.minimum(np.abs(x - np.rint(x)), np.abs(y - np.rint(y))) < 1e-3
    return found.reshape(height, width), on_an_edge.reshape(height, width)


@given(st.integers(0, 10**6), SIZES)
def test_masks_are_the_nearest_pixels_and_keep_their_values(seed, size):
    rng = np.random.default_rng(seed)
    mask = rng.integers(0, 4, size, np.uint8)
    view = draw_view(rng, STRONG, size)
    warped, (expected, on_an_edge) = warp(mask, view, 9), nearest(mask, view, 9)
    assert warped.dtype == np.uint8
    assert warped.shape == view.size
    np.testing.assert_array_equal(warped[~on_an_edge], expected[~on_an_edge])
    assert set(np.unique(warped)) <= {0, 1, 2, 3, 9}


@given(st.integers(0, 10**6), SIZES)
def test_quarter_turns_are_exact_for_pictures_masks_and_points(seed, size):
    rng = np.random.default_rng(seed)
    image, mask = rng.integers(0, 256, (*size, 3), np.uint8), rng.integers(0, 4, size, np.uint8)
    view = draw_view(rng, Transforms(quarter_turns=True), size)
    turns = [turns for turns in range(4) if np.array_equal(warp(mask, view), np.rot90(mask, turns))]
    assert turns
    np.testing.assert_array_equal(warp(image, view), np.rot90(image, turns[0]))
    row, column = (int(rng.integers(side)) for side in size)
    (x, y), *_ = map_points([[column + 0.5, row + 0.5]], view.matrix)
    np.testing.assert_array_equal(warp(image, view)[int(y), int(x)], image[row, column])


@given(st.integers(0, 10**6))
def test_a_crop_is_a_part_of_the_whole_view(seed):
    mask = np.random.default_rng(seed).integers(0, 256, (60, 80), np.uint8)
    whole, part = (view_of(seed, STANDARD.replace(crop=crop), mask.shape) for crop in (0, 32))
    x, y = _corner(whole, part)
    assert part.size == (32, 32)
    # Where a pixel's centre comes from between two others, rounding may choose the other one.
    assert (warp(mask, part) != warp(mask, whole)[y : y + 32, x : x + 32]).sum() <= 1


def _corner(whole, part):
    """Where the part lies within the whole."""
    moved = whole.matrix @ np.linalg.inv(part.matrix)
    x, y = moved[:2, 2] / moved[2, 2]
    assert (x, y) == pytest.approx((round(x), round(y)), abs=1e-6)
    return round(x), round(y)


def test_a_crop_may_lie_anywhere_within_the_map():
    """A crop of 16 pixels has three places along a side of 18, and one along a side of 16."""
    whole = view_of(0, Transforms(), (16, 18))
    crops = [view_of(seed, Transforms(crop=16), (16, 18)) for seed in range(60)]
    assert {_corner(whole, crop) for crop in crops} == {(0, 0), (1, 0), (2, 0)}


def test_pictures_follow_their_masks():
    """A picture that is its own mask, smooth enough for both ways of interpolation."""
    y, x = np.mgrid[:120, :120]
    mask = (np.hypot(x - 40, y - 70) < 25).astype(np.uint8)
    image = np.repeat(mask[..., None] * np.uint8(255), 3, axis=2)
    for seed in range(10):
        view = view_of(seed, STRONG, mask.shape)
        differ = (warp(image, view)[..., 0] > 127) != (warp(mask, view) > 0)
        assert differ.mean() < 0.01


def test_a_picture_that_shrinks_is_the_mean_of_its_pixels():
    """Stripes of one pixel: interpolation between neighbours would show some of them, or none."""
    image = np.zeros((128, 128, 3), np.uint8)
    image[:, ::2] = 200
    shown = warp(image, view_of(0, Transforms(scale=(0.25, 0.25)), (128, 128)))
    np.testing.assert_allclose(shown[52:76, 52:76], 100, atol=3)
    assert (shown[:40] == 0).all()


@pytest.mark.parametrize("crop", [0, 40])
@given(st.integers(0, 10**6))
def test_the_scale_of_a_view_is_that_in_its_middle(crop, seed):
    """The side of a square of one pixel there, also in perspective."""
    view = view_of(seed, STRONG.replace(perspective=0.2, crop=crop), (90, 150))
    middle = np.array([view.size[1] / 2, view.size[0] / 2])
    corner, right, down = map_points(np.add([[0, 0], [0.01, 0], [0, 0.01]], middle), np.linalg.inv(view.matrix))
    area = abs(np.linalg.det([right - corner, down - corner])) / 0.01**2
    assert _middle_scale(view.matrix, view.size) == pytest.approx(area**-0.5, rel=1e-3)


@given(st.integers(0, 10**6), st.floats(0.6, 2))
def test_a_crop_lies_within_the_map(seed, scale):
    mask = np.ones((80, 64), np.uint8)
    assert warp(mask, view_of(seed, Transforms(quarter_turns=True, scale=(scale, scale), crop=32), mask.shape)).all()


def test_nothing_asked_changes_nothing():
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3), np.uint8)
    view = view_of(0, Transforms(), (20, 30))
    assert warp(image, view) is image
    assert photograph(image, view) is image


def test_light_is_for_the_picture_and_the_same_every_time():
    image = np.full((64, 64, 3), 100, np.uint8)
    light = Transforms(light=0.5, contrast=0.3, colour=0.2, blur=2, noise=5)
    view = view_of(3, light, (64, 64))
    shown = photograph(image, view)
    np.testing.assert_array_equal(shown, photograph(image, view))
    assert shown.std(axis=(0, 1)) == pytest.approx(np.full(3, view.noise), rel=0.1)
    expected = (100 - 128) * np.array(view.gains) + 128 + view.offset
    assert shown.mean(axis=(0, 1)) == pytest.approx(expected, abs=0.7)
    assert len(set(view.gains)) == 3
    np.testing.assert_array_equal(view.matrix, np.eye(3))


@given(st.integers(0, 10**6))
def test_views_keep_to_their_ranges(seed):
    view = view_of(seed, STANDARD, (100, 100))
    centre, right = map_points([[50, 50], [51, 50]], view.matrix)
    assert np.hypot(*(centre - 50)) < 100 * STANDARD.perspective * 2
    assert 0.8 < np.hypot(*(right - centre)) < 1.25
    assert abs(view.offset) <= 128 * STANDARD.light
    assert 0 <= view.blur <= STANDARD.blur
    assert 0 <= view.noise <= STANDARD.noise


def test_reading():
    assert parse_transforms(["none"]) == parse_transforms([]) == Transforms()
    assert parse_transforms(["standard", "noise=0"]) == STANDARD.replace(noise=0.0)
    assert parse_transforms(["quarter-turns", "scale=0.5..2", "crop=64", "rotation=10"]) == Transforms(
        quarter_turns=True, scale=(0.5, 2.0), crop=64, rotation=10.0
    )
    assert parse_transforms(["scale=1.5"]).scale == (1.5, 1.5)
    assert parse_transforms(["varied", "shadow=0"]) == VARIED.replace(shadow=0.0)
    with refused("transforms", "it after noise=0"):
        parse_transforms(["noise=0", "standard"])


def test_a_crop_larger_than_the_map_is_refused():
    with refused("transforms", "32", expected="40 x 30"):
        view_of(0, Transforms(crop=32), (30, 40))
    # The message once named the size at which the crop would fit.
    with refused("transforms", "16", expected="20 x 15"):
        view_of(0, Transforms(crop=16, scale=(0.5, 1)), (30, 40))
