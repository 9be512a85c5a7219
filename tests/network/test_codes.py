"""Tile codes: their bits, their kinds, their turns."""

import numpy as np
import pytest

from elitelanes_jax.network import CROSSINGS, EAST, KINDS, NORTH, ROAD_ALPHABET, SOUTH, WEST
from elitelanes_jax.network.codes import CONNECTIONS, check_alphabet, rotate_codes


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
    for wrong, got in (([], "none"), ([16], "16"), ([-1], "-1"), ([1.5], "1.5"), (["road"], "'road'")):
        with pytest.raises(ValueError, match=f"alphabet: expected tile codes, whole numbers 0 to 15, got {got}"):
            check_alphabet(wrong)
