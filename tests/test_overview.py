"""The sheet of many maps."""

import numpy as np
import pytest

from elitelanes_jax.overview import overview


@pytest.mark.parametrize("count", [1, 2, 5, 16, 17])
def test_every_picture_is_on_it_whole_and_once(count):
    pictures = [np.full((60, 90, 3), 10 + number, np.uint8) for number in range(count)]
    sheet = overview("title", pictures, [("first", "second")] * count)
    assert sheet.dtype == np.uint8
    for number in range(count):
        rows, columns = np.nonzero((sheet == 10 + number).all(axis=2))
        inside = sheet[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        assert inside.shape >= (60, 90, 3)
        assert ((sheet == 10 + number).all(axis=2)).sum() >= 60 * 90


def test_captions_leave_their_mark():
    picture = [np.zeros((60, 90, 3), np.uint8)]
    plain = overview("", picture, [("", "")])
    assert (overview("title", picture, [("", "")]) != plain).any()
    assert (overview("", picture, [("", "fitness 3")]) != plain).any()
