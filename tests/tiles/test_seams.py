"""Seams: the figures against a slow count, and the picture shows the worst of them."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from elitelanes_jax.tiles import TileSet, describe_seams, find_seams, seam_picture
from elitelanes_jax.tiles.files import Tile


def tile(name, code, road):
    nothing = np.zeros_like(road)
    return Tile(name, code, np.full((*road.shape, 3), 70, np.uint8), road, nothing, nothing)


def along(tiles, sides, number):
    """The road along a side, left to right from outside, by the tile's own rows and columns."""
    place, side = sides[number]
    road = tiles.tiles[place].road
    return {"N": road[0, ::-1], "E": road[::-1, -1], "S": road[-1], "W": road[:, 0]}[side.letter]


def displaced(one, other):
    """The largest distance from a pixel of either to the nearest of the other, where the two face each other."""
    one, other = np.flatnonzero(one), np.flatnonzero(other[::-1])
    return max(
        max(min(abs(pixel - far) for far in those) for pixel in these) for these, those in ((one, other), (other, one))
    )


@settings(max_examples=40)
@given(hnp.arrays(bool, (2, 9, 9), elements=st.sampled_from([False, False, True])))
def test_offsets_are_the_largest_distances_from_road_to_road(roads):
    roads[:, 4] = roads[:, :, 4] = True  # some road on every side
    tiles = TileSet("random", "", (tile("turn_1", 3, roads[0]), tile("crossing4_1", 15, roads[1])))
    seams = find_seams(tiles)
    assert [f"{place}{side.letter}" for place, side in seams.sides] == ["0S", "0W", "1N", "1E", "1S", "1W"]
    for one, other in np.ndindex(6, 6):
        expected = displaced(along(tiles, seams.sides, one), along(tiles, seams.sides, other))
        assert seams.offsets[one, other] == expected
    # A tile of another size is looked at in the pixels of the largest.
    large = tile("turn_1", 3, roads[0].repeat(3, 0).repeat(3, 1))
    seams = find_seams(TileSet("two sizes", "", (large, tiles.tiles[1])))
    assert seams.pixels == 27
    assert seams.offsets[0, 2] == displaced(*(along(tiles, seams.sides, side).repeat(3) for side in (0, 2)))


def spoilt(drawn_tiles, pixels):
    """The drawn tiles, one straight moved to the east, and as much brighter."""
    tiles = list(drawn_tiles.tiles)
    moved = {name: np.roll(getattr(tiles[5], name), pixels, axis=1) for name in ("road", "red", "yellow")}
    brighter = np.minimum(np.roll(tiles[5].image, pixels, axis=1), 255 - pixels) + np.uint8(pixels)
    tiles[5] = tiles[5]._replace(image=brighter, **moved)
    return TileSet("spoilt", "", tuple(tiles))


def test_a_displaced_road_is_found_and_named(drawn_tiles):
    seams = find_seams(drawn_tiles)
    assert not seams.offsets.any()
    assert seams.colours.max() < 3
    assert describe_seams(drawn_tiles, seams).startswith(
        "seams: 496 pairs of sides may meet; the road is displaced by 0 pixels of 384 at most, by 0.0 on average\n  the"
    )
    tiles = spoilt(drawn_tiles, 11)
    seams = find_seams(tiles)
    named = [(place, side.letter) for place, side in seams.sides]
    north, south = named.index((5, "N")), named.index((5, "S"))
    # Against all others by 11; against its like, turned, by 22; its two ends still meet each other.
    expected = np.zeros((31, 31))
    expected[[north, south]] = expected[:, [north, south]] = 11
    expected[[north, south], [north, south]] = 22
    expected[north, south] = expected[south, north] = 0
    np.testing.assert_array_equal(seams.offsets, expected)
    assert seams.worst == (north, north)
    assert 9 < seams.colours[north, 0] < 13
    text = describe_seams(tiles, seams)
    assert "displaced by 22 pixels of 384 at most" in text
    assert "worst: straight_2 north with straight_2 north" in text


def test_the_picture_shows_the_two_tiles_and_the_jump(drawn_tiles):
    tiles = spoilt(drawn_tiles, 11)
    picture = seam_picture(tiles, find_seams(tiles))
    exact = seam_picture(drawn_tiles, find_seams(drawn_tiles))
    assert picture.dtype == exact.dtype == np.uint8
    assert picture.shape == exact.shape
    # In the enlarged part the road's outline is at another height on the left than on the right, unless all is exact.
    for sheet, jump in ((picture, 22), (exact, 0)):
        blue = (np.abs(sheet.astype(int) - (0, 190, 230)) < 12).all(axis=2)
        left, right = (blue[100:450, column : column + 60] for column in (700, 860))
        heights = [np.median(np.argwhere(side)[:, 0]) for side in (left, right)]
        assert abs(abs(heights[0] - heights[1]) - jump * 360 / 66) < 8
