"""Tile codes, shapes, checked grids and random ones."""

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import random_grids
from elitelanes_jax.network.checks import check_grid, check_shape
from elitelanes_jax.network.codes import (
    CONNECTIONS,
    CROSSINGS,
    EAST,
    KINDS,
    NORTH,
    ROAD_ALPHABET,
    SOUTH,
    WEST,
    check_alphabet,
    rotate_codes,
)


def test_every_code_has_one_kind_and_its_connections():
    expected = {"empty": 0, "end": 1, "straight": 2, "turn": 2, "crossing3": 3, "crossing4": 4}
    assert sorted(code for codes in KINDS.values() for code in codes) == list(range(16))
    for kind, codes in KINDS.items():
        for code in codes:
            sides = [side for side in (NORTH, EAST, SOUTH, WEST) if code & side]
            assert CONNECTIONS[code] == len(sides) == expected[kind]
    assert KINDS["straight"] == (EAST | WEST, NORTH | SOUTH)
    assert CROSSINGS == (7, 11, 13, 14, 15)
    assert ROAD_ALPHABET == (3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15)


def test_a_quarter_turn_is_counter_clockwise():
    assert [rotate_codes(side) for side in (NORTH, WEST, SOUTH, EAST)] == [WEST, SOUTH, EAST, NORTH]
    for code in range(16):
        assert rotate_codes(code, 4) == rotate_codes(code, 0) == code
        assert rotate_codes(rotate_codes(code, 3)) == code
        assert rotate_codes(code, -1) == rotate_codes(code, 3)
        assert CONNECTIONS[rotate_codes(code)] == CONNECTIONS[code]


def test_alphabets():
    assert check_alphabet([15, 3, 3, np.int8(5)]) == (3, 5, 15)
    for wrong, got in (
        ([], "none"),
        ([16], "16"),
        ([-1], "-1"),
        ([1.5], "1.5"),
        (["road"], "'road'"),
        ([[3], [5, 6]], "[[3], [5, 6]]"),
    ):
        with refused("alphabet", got):
            check_alphabet(wrong)


def test_random_grids_are_uniform_over_the_alphabet():
    grids = np.asarray(random_grids(jax.random.key(0), 1000, (12, 12)))
    assert grids.shape == (1000, 12, 12)
    assert grids.dtype == np.int8
    counts = np.bincount(grids.ravel(), minlength=16)
    assert tuple(np.flatnonzero(counts)) == ROAD_ALPHABET
    expected = grids.size / len(ROAD_ALPHABET)
    # Chi square with 10 degrees of freedom: over 29.6 once in a thousand keys.
    assert ((counts[list(ROAD_ALPHABET)] - expected) ** 2 / expected).sum() < 29.6


def test_a_random_grid_does_not_depend_on_how_many_there_are():
    key = jax.random.key(7)
    many = random_grids(key, 50, (3, 5), alphabet=[3, 9])
    np.testing.assert_array_equal(random_grids(key, 4, (3, 5), alphabet=[3, 9]), many[:4])
    assert set(np.unique(many)) == {3, 9}
    assert random_grids(key, 0).shape == (0, 12, 12)
    assert random_grids(key, 3, (1, 4)).shape == (3, 1, 4)
    with refused("count", "-1"):
        random_grids(key, -1)


@pytest.mark.parametrize(
    "shape",
    [
        *[(5, 0), (2,), (2, 2, 2), (2.5, 3), (2, 2.5, 2), (2.5, 2, 2), "ab", None, 7, (2, 2000)],
        *[{5: 1, 6: 2}, {5, 6}, b"68", bytearray(b"68"), np.ma.masked_array([6, 8], [False, True])],
    ],
)
def test_bad_shapes_are_refused(shape):
    with refused("shape"):
        check_shape(shape)


def test_new_maps_are_at_least_two_by_two():
    assert check_shape((1, 5)) == (1, 5)
    with refused("shape", "1 x 5", expected="new maps"):
        check_shape((1, 5), new=True)


def test_checked_grids_are_int8_and_the_same():
    for kind in (np.int8, np.uint8, np.int64, np.uint32):
        grid = check_grid(np.arange(16, dtype=kind).reshape(4, 4))
        assert grid.dtype == np.int8
        np.testing.assert_array_equal(grid.ravel(), np.arange(16))
    assert check_grid([[1, 2], [3, 4]]).tolist() == [[1, 2], [3, 4]]
    assert isinstance(check_grid(jax.numpy.zeros((2, 2), int)), jax.Array)
    assert isinstance(check_grid([[1, 2], [3, 4]]), np.ndarray)
