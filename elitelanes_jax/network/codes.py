"""Tile codes: one number per tile, with a bit for each side that the tile connects to.

All constants are of NumPy. A code is ``8·N + 4·E + 2·S + 1·W`` (paper, section "Tile-Based Road
Network Representation").
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from elitelanes_jax._util.checks import items_of
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue, WholeT

NORTH = 8
"""The bit of a code that connects to the north."""

EAST = 4
"""The bit of a code that connects to the east."""

SOUTH = 2
"""The bit of a code that connects to the south."""

WEST = 1
"""The bit of a code that connects to the west."""


class Side(NamedTuple):
    """A side of a tile.

    Attributes:
      bit: the bit of a code that connects there.
      letter: N, E, S or W.
      name: north, east, south or west.
      down: the number of rows from the tile down to its neighbour there, -1 to 1.
      right: the number of columns from the tile right to its neighbour there, -1 to 1.
      opposite: the bit of the neighbour's side that faces the tile.
    """

    bit: int
    letter: str
    name: str
    down: int
    right: int
    opposite: int


SIDES = (
    Side(NORTH, "N", "north", -1, 0, SOUTH),
    Side(EAST, "E", "east", 0, 1, WEST),
    Side(SOUTH, "S", "south", 1, 0, NORTH),
    Side(WEST, "W", "west", 0, -1, EAST),
)
"""The four sides, clockwise."""

CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
"""The four diagonal neighbours of a cell, by (rows down, columns right)."""

SIDE_TOWARDS = {(side.down, side.right): side for side in SIDES}
"""The side towards a neighbour, by (rows down, columns right) to it."""

CONNECTIONS = np.array([code.bit_count() for code in range(16)], np.int8)
"""int8 ``[16]``: the number of connections of each code."""

KINDS: dict[str, tuple[int, ...]] = {
    "empty": (0,),
    "end": (1, 2, 4, 8),
    "straight": (5, 10),
    "turn": (3, 6, 9, 12),
    "crossing3": (7, 11, 13, 14),
    "crossing4": (15,),
}
"""The codes of each kind of tile, by its name."""

KIND_OF = {code: kind for kind, codes in KINDS.items() for code in codes}
"""The kind of each code."""

CROSSINGS = KINDS["crossing3"] + KINDS["crossing4"]
"""The codes with three or four connections."""

ROAD_ALPHABET = tuple(code for code in range(16) if CONNECTIONS[code] >= 2)
"""The 11 codes with two or more connections, which have pictures.

By default, new tiles are drawn from them.
"""


def rotate_codes(codes: WholeT, quarter_turns: int = 1) -> WholeT:
    """Rotates codes of any shape counter-clockwise by quarter turns: N becomes W, W becomes S."""
    for _ in range(quarter_turns % 4):
        # From the highest bit on, the bits follow the sides clockwise. So a quarter turn rotates
        # them by one bit.
        codes = (codes << 1) & 15 | codes >> 3
    return codes


def list_turned(codes: Mapping[str, int]) -> dict[int, tuple[str, int]]:
    """Returns for each code the kind of tile, and its fewest quarter turns counter-clockwise.

    `codes` has the code of each kind without a turn.
    """
    turned: dict[int, tuple[str, int]] = {}
    for kind, code in codes.items():
        for turns in range(4):
            # A straight looks the same after half a turn. `setdefault` keeps the fewest turns.
            turned.setdefault(rotate_codes(code, turns), (kind, turns))
    return turned


def exchange_sides(codes: WholeT, one: int, other: int) -> WholeT:
    """Exchanges two sides of codes of any shape, such as east and west for a mirror image.

    `one` is the higher bit of the two.
    """
    # Each of the two bits moves to the position of the other one.
    shift = one.bit_length() - other.bit_length()
    return codes & (15 ^ one ^ other) | (codes & one) >> shift | (codes & other) << shift


def transpose_codes(codes: WholeT) -> WholeT:
    """Exchanges north with west and east with south in codes of any shape."""
    return exchange_sides(exchange_sides(codes, NORTH, WEST), EAST, SOUTH)


def check_alphabet(codes: UserValue) -> tuple[int, ...]:
    """Checks a set of tile codes; returns it as a sorted tuple without repeats.

    Raises `InputError` if it is empty.
    """
    expected = "tile codes, whole numbers 0 to 15"
    try:
        listed = (
            np.asarray(codes if hasattr(codes, "shape") else list(items_of(codes))).ravel().tolist()
        )
    except (TypeError, ValueError):
        # The value cannot be iterated over, or its rows have several lengths.
        raise InputError("alphabet", expected, quote(codes)) from None
    wrong = [code for code in listed if type(code) is not int or not 0 <= code <= 15]
    if wrong or not listed:
        raise InputError("alphabet", expected, quote(wrong[0]) if wrong else "none")
    return tuple(sorted(set(listed)))
