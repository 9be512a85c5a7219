"""Tile codes: four connection bits a tile, and what they make of it (NumPy constants).

A code is ``8·N + 4·E + 2·S + 1·W`` (paper, section "Tile-Based Road Network Representation"): each bit says whether
the tile connects in that direction.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np

from elitelanes_jax.errors import InputError

__all__ = [
    "CONNECTIONS",
    "CROSSINGS",
    "EAST",
    "KINDS",
    "NORTH",
    "ROAD_ALPHABET",
    "SIDES",
    "SOUTH",
    "WEST",
    "Side",
    "alphabet_of",
    "turned",
]

NORTH, EAST, SOUTH, WEST = 8, 4, 2, 1
"""The bits of a code."""


class Side(NamedTuple):
    """A side of a tile.

    Attributes:
      bit: of a code that connects there.
      name: in words.
      down: rows from the tile to its neighbour there.
      right: columns likewise.
      answer: the bit of the neighbour's side that faces it.
    """

    bit: int
    name: str
    down: int
    right: int
    answer: int


SIDES = (
    Side(NORTH, "north", -1, 0, SOUTH),
    Side(EAST, "east", 0, 1, WEST),
    Side(SOUTH, "south", 1, 0, NORTH),
    Side(WEST, "west", 0, -1, EAST),
)
"""The four sides, clockwise."""

CONNECTIONS = np.array([code.bit_count() for code in range(16)], np.int8)
"""int8 ``[16]``: the number of connections of each code."""

KINDS: dict[str, tuple[int, ...]] = {
    "empty": (0,),
    "stub": (1, 2, 4, 8),
    "straight": (5, 10),
    "turn": (3, 6, 9, 12),
    "crossing3": (7, 11, 13, 14),
    "crossing4": (15,),
}
"""The codes of each kind of tile."""

CROSSINGS = KINDS["crossing3"] + KINDS["crossing4"]
"""The codes with three or four connections."""

ROAD_ALPHABET = tuple(code for code in range(16) if CONNECTIONS[code] >= 2)
"""The 11 codes with two or more connections: every tile that has a picture. New tiles are drawn from it by default."""


def turned(code: Any, quarter_turns: int = 1) -> Any:
    """The code of a tile, or those of an array, turned by quarter turns counter-clockwise: N becomes W, W becomes S."""
    for _ in range(quarter_turns % 4):
        code = (code << 1) & 15 | code >> 3
    return code


def alphabet_of(codes: Iterable[Any]) -> tuple[int, ...]:
    """A set of tile codes as a sorted tuple without repeats.

    Raises:
      InputError: if it is empty or holds anything but whole numbers 0..15.
    """
    try:
        listed = np.asarray(codes if hasattr(codes, "shape") else list(codes)).ravel().tolist()
    except TypeError:
        raise InputError(f"alphabet: expected tile codes, whole numbers 0 to 15, got {codes!r}") from None
    wrong = [code for code in listed if type(code) is not int or not 0 <= code <= 15]
    if wrong or not listed:
        raise InputError(
            f"alphabet: expected tile codes, whole numbers 0 to 15, got {repr(wrong[0]) if wrong else 'none'}"
        )
    return tuple(sorted(set(listed)))
