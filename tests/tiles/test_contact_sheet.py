"""The sheet of many maps."""

import numpy as np
import pytest

from elitelanes_jax.maps import furnish
from elitelanes_jax.maps.furnishing.space import make_object
from elitelanes_jax.tiles import load_objects, render
from elitelanes_jax.tiles.contact_sheet import _face, contact_sheet, pin_signs, write_text


@pytest.mark.parametrize("count", [1, 2, 5, 16, 17])
def test_every_picture_is_on_it_whole_and_once(count):
    pictures = [np.full((60, 90, 3), 10 + number, np.uint8) for number in range(count)]
    plain = contact_sheet("", pictures, [("", "")] * count)
    assert (contact_sheet("title", pictures, [("", "")] * count) != plain).any()
    assert (contact_sheet("", pictures, [("", "fitness 3")] * count) != plain).any()
    for number in range(count):
        rows, columns = np.nonzero((plain == 10 + number).all(axis=2))
        assert (np.ptp(rows) + 1, np.ptp(columns) + 1, len(rows)) == (60, 90, 60 * 90)


def test_no_text_is_cut_off_or_runs_into_its_neighbour():
    """With a text of any length the sheet is as wide as the text needs, and the ground shows between the columns."""
    pictures = [np.zeros((60, 90, 3), np.uint8)] * 16  # in several columns, whatever the font
    sheet = contact_sheet(
        "A title that is longer than all the pictures below it", pictures, [("a caption of some length",)] * 16
    )
    ground = sheet[0, 0]
    assert (sheet[:, -10:] == ground).all()
    below = sheet[3 * 28 + 60 : 3 * 28 + 60 + 19]
    inked = np.flatnonzero((below != ground).any(axis=(0, 2)))
    assert np.diff(inked).max() > 28 - 8


def test_zeros_have_no_slash():
    sheet = np.zeros((200, 200, 3), np.uint8)
    write_text(sheet, "0", (20, 180), 6, (255, 255, 255))
    rows, columns = np.nonzero(sheet.any(axis=2))
    top, left, height, width = rows.min(), columns.min(), np.ptp(rows), np.ptp(columns)
    assert height > 80
    assert not sheet[top + height // 4 : top + 3 * height // 4, left + 2 * width // 5 : left + 3 * width // 5].any()


@pytest.mark.parametrize("size", [72, 96])
def test_signs_are_read_on_the_sheet(size):
    """Each face is upright and whole: no other one hides a part of it, and those beside the map are on the border."""
    codes = [[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [14, 5, 15, 5, 11], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]]
    town = furnish(codes, "signs")
    plain = render(town.codes, tile_px=size).image
    pinned = pin_signs(plain, town.objects, size)
    border = (pinned.shape[0] - plain.shape[0]) // 2
    whole = 0
    for sign in town.objects:
        face = _face(load_objects().kinds[sign.kind][0], round(0.21 * size))
        height, width = face.shape[:2]
        x, y = (round((round(at) + 1.9 * (at - round(at))) * size) + border for at in (sign.x, sign.y))
        part = pinned[y - height // 2 :][:height, x - width // 2 :][:, :width]
        opaque = face[..., 3] == 255
        assert opaque.mean() > 0.5
        whole += (part[opaque] == face[opaque, :3]).all()
    assert whole == len(town.objects) == 32
    np.testing.assert_array_equal(pin_signs(plain, (), size)[border:-border, border:-border], plain)


@pytest.mark.parametrize(("x", "y"), [(-1, -1), (-0.9, 1), (1, -1), (4, 1), (1, 4), (4, 4)])
def test_a_sign_beyond_the_border_is_left_out(x, y):
    """Objects may be up to a tile outside of the map, and the sheet of such a map was an error."""
    plain = np.full((192, 192, 3), 90, np.uint8)
    pinned = pin_signs(plain, [make_object("sign_stop", x, y, 0)], 64)
    np.testing.assert_array_equal(pinned, pin_signs(plain, [], 64))
