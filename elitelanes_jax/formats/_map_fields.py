"""The fields of a map besides its codes: what their values may be."""

import json
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeGuard

import numpy as np

from elitelanes_jax._util.checks import is_real, is_whole
from elitelanes_jax._util.types import Plain, UserValue


class Drawn(NamedTuple):
    """The tile pictures that a map is drawn with.

    Attributes:
      tile_set: the name of the set.
      tiles: names ``[H][W]``.
      quarter_turns: ints ``[H][W]``, counter-clockwise.
      digests: a digest of each tile's picture, by the name of the tile; None if they are not known.
    """

    tile_set: str
    tiles: list[list[str]]
    quarter_turns: list[list[int]]
    digests: dict[str, str] | None = None


def plain_value(value: UserValue) -> Plain:
    """Returns a field's value as JSON has it.

    Python's numbers replace those of NumPy, and lists replace tuples.
    """
    if isinstance(value, Drawn):
        value = value._asdict()
    if isinstance(value, Mapping):
        return {name: plain_value(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_value(item) for item in value]
    # `item` returns NumPy's longest float unchanged, and JSON cannot hold it.
    if isinstance(value, np.floating):
        return float(value)
    return value.item() if isinstance(value, np.generic) else value


def show_value(value: Plain) -> str:
    """Returns a field's value for a message, as JSON has it.

    If a key is no text, returns the value as Python has it.
    """
    # JSON cannot have such a key, and would hide it.
    if isinstance(value, dict) and not all(map(_is_text, value)):
        return repr(value)
    return json.dumps(value, default=repr, skipkeys=True)


def has_shape(table: Sequence[Sequence[Plain]], shape: tuple[int, ...]) -> bool:
    height, width = shape
    return len(table) == height and all(len(row) == width for row in table)


def _is_list(values: Plain, fits: Callable[[Plain], bool]) -> bool:
    """Returns whether a value is a list whose items all pass a test."""
    return isinstance(values, list) and all(map(fits, values))


def is_table(rows: Plain, fits: Callable[[Plain], bool]) -> bool:
    """Returns whether a value is a list of lists whose items all pass a test."""
    return _is_list(rows, lambda row: _is_list(row, fits))


def _is_drawn(value: Plain) -> bool:
    if not isinstance(value, dict) or set(value) | {"digests"} != set(Drawn._fields):
        return False
    digests = {} if value.get("digests") is None else value["digests"]
    if not isinstance(value["tile_set"], str) or not isinstance(digests, dict):
        return False
    if not all(map(_is_text, (*digests, *digests.values()))):
        return False
    return is_table(value["tiles"], _is_text) and is_table(value["quarter_turns"], _is_quarter_turn)


def _is_text(value: Plain) -> bool:
    return isinstance(value, str)


def _is_quarter_turn(value: Plain) -> bool:
    return is_whole(value) and 0 <= value < 4


def _are_cells(value: Plain) -> bool:
    return _is_list(value, _is_cell)


def _is_cell(value: Plain) -> bool:
    return _are_whole(value) and len(value) == 2 and min(value) >= 0


def is_number(value: Plain) -> bool:
    # `isfinite` raises an error for whole numbers above the largest float, so the size is compared.
    return is_real(value) and abs(value) <= sys.float_info.max


def _are_numbers_by_name(value: Plain) -> bool:
    if not isinstance(value, dict):
        return False
    return all(map(_is_text, value)) and all(map(is_number, value.values()))


def _are_whole(value: Plain) -> TypeGuard[list[int]]:
    return _is_list(value, is_whole)


def _are_two_whole(value: Plain) -> bool:
    return _are_whole(value) and len(value) == 2


# The fields of a map besides its codes: a test of the value, and what is expected, for messages.
FIELDS: dict[str, tuple[Callable[[Plain], bool], str]] = {
    "metrics": (_are_numbers_by_name, "numbers by name"),
    "fitness": (is_number, "a number"),
    "descriptor": (_are_numbers_by_name, "numbers by name"),
    "niche": (_are_whole, "whole numbers"),
    "seed": (_are_two_whole, "two whole numbers"),
    "unsure": (_are_cells, "a list of cells, each a row and a column"),
    "drawn": (_is_drawn, "a record of tile_set, tiles, quarter_turns, turns 0 to 3"),
}
