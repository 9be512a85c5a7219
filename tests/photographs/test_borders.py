"""Where the border of tiles is seen, and how a view of them bends."""

import cv2
import numpy as np
import photographed

from elitelanes_jax.photographs import (
    _borders,
)
from elitelanes_jax.photographs._views import FloorView, places_of, view_of

CORNERS = photographed.corners_of(3, 3)


def square_on_a_dark_floor(shadow):
    """A square of asphalt, 200 pixels wide, on a floor nearly as dark, which the square shades by a share."""
    y, x = np.mgrid[:400, :400]
    away = np.maximum(np.abs(x - 199.5), np.abs(y - 199.5)) - 100
    floor = np.array([76, 79, 86]) * (1 - shadow * np.exp(-np.maximum(away, 0) / 6))[..., None]
    picture = cv2.GaussianBlur(np.where((away < 0)[..., None], photographed.ASPHALT, floor), (0, 0), 0.8)
    noise = np.random.default_rng(0).normal(0, 6, picture.shape)
    return np.clip(picture + noise, 0, 255).astype(np.uint8)


def square_view(off=0.0):
    """The view of that square, with each side `off` tiles outside of where it is."""
    half = 100 + 200 * off
    corners = 199.5 + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    return view_of(corners, 1, 1, 400, 400)


def test_a_border_is_seen_by_colours_where_no_edge_is():
    picture = square_on_a_dark_floor(0.0)
    sides = _borders.outer_sides(np.ones((1, 1), np.int8))
    for off in (0.0, 0.015):
        offsets = _borders.colour_border(picture, square_view(off), sides, 0.04).offsets
        np.testing.assert_allclose(np.nanmean(offsets, axis=1), -off, atol=0.003)
    assert (_borders.contrasts(picture, square_view(), sides) > 5).all()
    assert (_borders.contrasts(picture, square_view(0.04), sides) < 3).all()


def test_a_shadow_under_tiles_moves_the_border_by_colours_but_not_the_sharpest_edge():
    picture = square_on_a_dark_floor(0.1)
    sides = _borders.outer_sides(np.ones((1, 1), np.int8))
    by_colours = _borders.colour_border(picture, square_view(), sides, 0.04).offsets
    assert np.nanmean(by_colours) > 0.007
    shadow = _borders.shadow_width(picture, square_view(), sides, 0.04)
    np.testing.assert_allclose(np.nanmean(by_colours) - shadow, 0, atol=0.002)
    # An edge beyond the reach is not seen: nothing says how wide the shadow is.
    assert np.isnan(_borders.shadow_width(picture, square_view(0.03), sides, 0.04))


def test_the_border_of_a_floor_with_many_open_sides_is_seen():
    """OpenCV reads fewer than 2**15 rows at once. A side has 96."""
    codes = np.where(np.indices((14, 14)).sum(axis=0) % 2, 15, 0).astype(np.int8)
    sides, corners = _borders.outer_sides(codes), photographed.corners_of(14, 14)
    picture, view = photographed.photograph(codes, corners), view_of(corners, 14, 14, 800, 640)
    offsets = _borders.colour_border(picture, view, sides, 0.04).offsets
    last = _borders.colour_border(picture, view, sides[-3:], 0.04).offsets
    np.testing.assert_array_equal(offsets[-3:], last)


def test_a_view_bends_and_scales():
    view = view_of(CORNERS, 3, 3, 800, 640)
    np.testing.assert_allclose(view.pixels_of(np.array([[0, 0], [3, 3]], float)), CORNERS[[0, 2]], atol=1e-3)
    bent = view._replace(radial=0.05)
    step = (bent.pixels_of(places_of(3, 3, 4, 0)) - view.pixels_of(places_of(3, 3, 4, 0))) / 0.05
    np.testing.assert_allclose(view.bend(places_of(3, 3, 4, 0)), step, atol=1e-6)
    double = FloorView(*bent).scaled(2)
    place = np.array([[1.0, 2.0]])
    np.testing.assert_allclose(double.pixels_of(place), bent.pixels_of(place) * 2 + 0.5, atol=1e-6)
