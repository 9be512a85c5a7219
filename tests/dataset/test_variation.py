"""Variation of views: off by default, within its ranges, the same every time, and only where it belongs."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from elitelanes_jax.dataset._sampling import draw_sample
from elitelanes_jax.dataset._transforms import VARIATION, Transforms
from elitelanes_jax.dataset._variation import _apply_tone, compress, vary_background, vary_light, vary_motion
from elitelanes_jax.drive.camera_options import LaneCamera
from elitelanes_jax.formats.road_map import RoadMap

LOOP = np.pad(np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8), 1)
SMALL = LaneCamera(rows=48, columns=64)
PX = 64


def rng(seed=0):
    return np.random.default_rng(seed)


def image_of(seed=0, shape=(40, 60, 3)):
    return rng(seed).integers(0, 256, shape, np.uint8)


@pytest.mark.parametrize("name", VARIATION)
@pytest.mark.parametrize("camera", [None, SMALL])
def test_a_variation_changes_the_picture_alone_and_the_same_way_each_time(name, camera, drawn_tiles):
    most = {"motion": 10.0, "warmth": 0.5}.get(name, 1.0)

    def draw(transforms):
        return draw_sample(RoadMap(LOOP), drawn_tiles, 1, tile_px=PX, camera=camera, transforms=transforms)

    plain, varied, again = (draw(Transforms(**values)) for values in ({}, {name: most}, {name: most}))
    # The metadata of robots' views have the colour of their sky, which a pattern replaces.
    assert camera or varied.record == plain.record
    for layer, pixels in varied.layers.items():
        np.testing.assert_array_equal(pixels, again.layers[layer])
        if layer != "image":
            np.testing.assert_array_equal(pixels, plain.layers[layer])
    assert (varied.layers["image"] != plain.layers["image"]).any()


def test_each_sample_varies_in_its_own_way(drawn_tiles):
    def warmth(index):
        plain, warm = (
            draw_sample(RoadMap(LOOP), drawn_tiles, index, tile_px=16, transforms=Transforms(**values)).layers["image"]
            for values in ({}, {"warmth": 0.5})
        )
        return warm[..., 0].mean() / plain[..., 0].mean()

    assert len({round(warmth(index), 2) for index in range(4)}) == 4


@given(st.integers(0, 10**6))
@settings(max_examples=20)
def test_a_background_covers_nothing_else(seed):
    image = image_of()
    ground = np.zeros((40, 60), bool)
    ground[20:30] = True
    shown = vary_background(rng(seed), image, ground, 1)
    np.testing.assert_array_equal(shown[~ground], image[~ground])
    assert (shown[ground] != image[ground]).any()
    assert vary_background(rng(seed), image, ground, 0) is image
    assert vary_background(rng(seed), image, np.zeros_like(ground), 1) is image


def test_no_range_no_change():
    image, none = image_of(), Transforms()
    np.testing.assert_array_equal(vary_light(rng(), image, none), image)
    assert vary_motion(rng(), image, 0) is image
    assert compress(rng(), image, 0) is image


@given(
    st.integers(0, 10**6), st.floats(0.25, 4), st.floats(0, 2), st.floats(-0.5, 0.5), st.sampled_from([0, 1e-9, 0.5])
)
@settings(max_examples=60)
def test_tones_are_those_of_the_formula(seed, exponent, saturation, warmth, darkest):
    """All ranges of `Transforms`, and the light that no shadow, a deep one and a whole one leave."""
    image, light = image_of(seed), darkest + (1 - darkest) * rng(seed + 1).random((40, 60))
    channels = (1 + warmth, 1, 1 - warmth)
    colours = 255 * (image * light[..., None] / 255) ** exponent
    grey = colours.mean(axis=-1, keepdims=True)
    expected = np.clip(np.rint((grey + (colours - grey) * saturation) * channels), 0, 255)
    np.testing.assert_array_equal(_apply_tone(image, light, exponent, saturation, channels), expected)


@given(st.integers(0, 10**6))
@settings(max_examples=20)
def test_shadows_and_vignettes_take_at_most_their_share_of_the_light(seed):
    image = np.full((40, 60, 3), 200, np.uint8)
    shown = vary_light(rng(seed), image, Transforms(shadow=0.5, vignette=0.5))
    assert 200 * 0.25 - 1 <= shown.min() <= shown.max() <= 200
    np.testing.assert_array_equal(shown[..., 0], shown[..., 1])
    warm = vary_light(rng(seed), image, Transforms(warmth=0.2)).astype(int)
    assert (abs(warm[..., 0] + warm[..., 2] - 400) <= 1).all() and (abs(warm[..., 0] - 200) <= 40).all()


def test_motion_keeps_the_light_and_smears_at_most_its_length():
    image = np.zeros((41, 41, 3), np.uint8)
    image[20, 20] = 250
    for seed in range(10):
        rows, columns = np.nonzero(vary_motion(rng(seed), image, 10)[..., 0])
        assert np.hypot(rows - 20, columns - 20).max() <= 5 + np.sqrt(0.5)
    plain = np.full((20, 20, 3), 77, np.uint8)
    np.testing.assert_array_equal(vary_motion(rng(1), plain, 10), plain)


def test_compression_loses_more_when_it_is_stronger():
    image = cv2.GaussianBlur(image_of(), (0, 0), 2)
    lost = [np.abs(compress(rng(3), image, most).astype(int) - image).mean() for most in (0.1, 0.5, 1)]
    assert 0 < lost[0] < lost[1] < lost[2] < 30
    red = np.full((40, 60, 3), (200, 90, 40), np.uint8)
    assert np.abs(compress(rng(3), red, 1).astype(int) - red).max() < 20
