"""Strips of the tape of neighbours along the sides of a tile: found, removed, and not taken for the tile's own tape."""

import numpy as np
import pytest

from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.tiles._lines import misplaced_lines
from elitelanes_jax.tiles.masking import propose_masks
from elitelanes_jax.tiles.strips import MIXED, TAPE, find_strips, without_strips

COLOURS = {"red": (231, 59, 71), "yellow": (235, 220, 80), "white": (226, 223, 214)}
NAMES = ("turn_1", "straight_1", "crossing3_1", "crossing4_1", "end_1")


def own(tiles, name):
    (tile,) = (tile for tile in tiles.tiles if tile.name == name)
    return tile


def stained(tile, side, colour, place, depth=0.012, mixed=1.0):
    """The tile with a strip at a side; `place` says where it begins and ends, seen from inside."""
    image = tile.image.copy()
    turned, size = np.rot90(image, SIDES.index(side)), len(image)
    part = turned[: max(1, round(depth * size)), round(place[0] * size) : round(place[1] * size)]
    part[:] = (1 - mixed) * part + mixed * np.array(COLOURS[colour])
    return tile._replace(image=image)


def strips_a_tile_cannot_have(tile):
    """Yields sides, colours and places. White lines at a closed side are the tile's own."""
    for side in SIDES:
        is_open, crosses = bool(tile.code & side.bit), CONNECTIONS[tile.code] > 2
        if is_open:
            yield side, "red", (0.55, 0.85)
            yield side, "white", (0.55, 0.8)
        if not (is_open and crosses):
            yield side, "red", (0.15, 0.45)
        yield side, "yellow", (0.25, 0.35)


@pytest.mark.parametrize("name", NAMES)
def test_tape_of_a_neighbour_is_found_and_removed(name, drawn_tiles):
    tile = own(drawn_tiles, name)
    assert list(find_strips(tile.image, tile.code, MIXED)) == []
    np.testing.assert_array_equal(without_strips(tile.image, tile.code), tile.image)
    plain = propose_masks(tile.image)
    for side, colour, place in strips_a_tile_cannot_have(tile):
        wrong = stained(tile, side, colour, place)
        found = list(find_strips(wrong.image, wrong.code, TAPE))
        assert (side, colour) in [(strip.side, strip.colour) for strip in found]
        ((_, mask, words), *_) = misplaced_lines([wrong, own(drawn_tiles, "straight_2")])
        assert mask == "image"
        assert words.startswith(
            f"expected no {found[0].colour} tape of a neighbour at the side {side.letter}, got a strip"
        )
        for mixed in (1.0, 0.5):
            clean = without_strips(stained(tile, side, colour, place, mixed=mixed).image, tile.code)
            assert all((strip.depths > 0).mean() < 0.01 for strip in find_strips(clean, tile.code, MIXED))
            for line, mask in propose_masks(clean).items():
                assert (mask != plain[line]).mean() < 0.002, line


@pytest.mark.parametrize("size", [48, 128, 384])
def test_strips_are_found_in_pictures_of_all_sizes(size, drawn_tiles):
    tile = own(drawn_tiles, "straight_1")
    places = (np.arange(size) + 0.5) * len(tile.image) / size
    small = tile._replace(image=tile.image[np.ix_(places.astype(int), places.astype(int))])
    wrong = stained(small, SIDES[0], "red", (0.55, 0.85))
    assert [strip.colour for strip in find_strips(wrong.image, wrong.code, TAPE)][:1] == ["red"]


def test_a_stop_line_of_the_tile_itself_stays(drawn_tiles, real_tiles):
    for tile in (*drawn_tiles.tiles, *real_tiles.tiles):
        clean = without_strips(tile.image, tile.code)
        for line, mask in propose_masks(clean).items():
            assert (mask & getattr(tile, line)).sum() >= 0.97 * getattr(tile, line).sum(), (tile.name, line)


def test_a_sliver_of_a_wooden_floor_is_no_fault(drawn_tiles):
    """It is on no road, and pictures that were cut by hand may show it."""
    tile = own(drawn_tiles, "straight_1")
    image = tile.image.copy()
    image[:, :4] = (190, 140, 96)
    assert misplaced_lines([tile._replace(image=image), own(drawn_tiles, "straight_2")]) == []
