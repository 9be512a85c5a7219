"""Valid windows, against all windows there are."""

from itertools import product

import numpy as np
import pytest

from elitelanes_jax.optimizers._windows import valid_windows


def is_valid(tiles, empty):
    """Whether links match, no tile has one, no turns share a side and no crossings are linked, tile by tile."""
    links = {(row, column): bin(code).count("1") for (row, column), code in np.ndenumerate(tiles)}
    if any(count == 1 or (count == 0 and not empty) for count in links.values()):
        return False
    for (row, column), code in np.ndenumerate(tiles):
        for other, forth, back in (((row, column + 1), 4, 1), ((row + 1, column), 2, 8)):
            if other in links:
                linked = bool(code & forth)
                both_turns = all(tiles[place] in (3, 6, 9, 12) for place in ((row, column), other))
                both_crossings = links[row, column] > 2 and links[other] > 2
                if linked != bool(tiles[other] & back) or both_turns or (both_crossings and linked):
                    return False
    return True


@pytest.mark.parametrize(
    ("shape", "empty"), [((1, 3), True), ((2, 2), False), pytest.param((2, 2), True, marks=pytest.mark.slow)]
)
def test_all_valid_windows_are_listed_by_their_border(shape, empty):
    height, width = shape
    expected = [[] for _ in range(2 ** (2 * (height + width)))]
    for codes in product(range(16), repeat=height * width):
        tiles = np.array(codes).reshape(shape)
        if is_valid(tiles, empty):
            sides = [*tiles[0] & 8, *tiles[-1] & 2, *tiles[:, 0] & 1, *tiles[:, -1] & 4]
            border = sum(2**place for place, side in enumerate(sides) if side)
            expected[border].append([sum(int(code) << 4 * place for place, code in enumerate(row)) for row in tiles])
    found = valid_windows(height, width, empty=empty)
    assert found.first[-1] == len(found.rows)
    for border, windows in enumerate(expected):
        assert sorted(found.rows[found.first[border] : found.first[border + 1]].tolist()) == sorted(windows)


@pytest.mark.parametrize(("empty", "count"), [(False, 9_139), (True, 38_043)])
def test_windows_of_nine_tiles_are_valid(empty, count):
    rows = valid_windows(3, 3, empty=empty).rows
    assert len(np.unique(rows, axis=0)) == len(rows) == count
    for window in rows[:: count // 100]:
        assert is_valid(window[:, None] >> 4 * np.arange(3) & 15, empty)
