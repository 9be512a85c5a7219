"""The patterns of linked columns that a network made of two halves may have at the cut."""

from typing import Any

import numba
import numpy as np

from experiments.search.exact.half_sweep import Half, value_of
from experiments.search.exact.half_worths import Worths
from experiments.search.exact.sweep import TURN, insert

__all__ = ["find_patterns"]


def find_patterns(halves: tuple[Half, ...], worths: Worths, crossings: int, target: int, most: int) -> list[int] | None:
    """Finds the patterns of linked columns that a network of a score may have, components and bridges left out.

    Args:
      halves: one if both are alike.
      worths: of labels, for any pattern.
      crossings: of the network; a four-way crossing is two.
      target: the least score.
      most: states to keep on a line.

    Returns:
      The columns as bits, of two patterns that are mirrored the lower number; None if states are too many.
    """
    highest = []
    for half, worth, rest, least in worths.needs(halves, crossings, target):
        keys, values = np.zeros((1, 1), np.uint64), np.zeros((1, 1), np.int64)
        for number, layer in enumerate(half.layers):
            column = number // half.height
            keys, values, used = _extend_pattern(
                layer, column, keys, values, rest[number + 1], worth[column], worths.price, least, most
            )
            if len(keys) == 0:
                return None
            keys, values = keys[used], values[used]
        best: dict[int, int] = {}
        for key, value in zip((keys[:, 0] >> np.uint64(32)).tolist(), values[:, 0].tolist(), strict=True):
            best[key] = max(value, best.get(key, value))
        highest.append(best)
    found = set()
    for key, value in highest[0].items():
        pattern, used = key & 0xFFFF, key >> 16
        partner = highest[-1].get(pattern | (crossings - used) << 16)
        if partner is not None and value + partner >= worths.least(crossings, target):
            found.add(min(pattern, int(f"{pattern:0{halves[0].width}b}"[::-1], 2)))
    return sorted(found)


@numba.njit(cache=True)
def _extend_pattern(
    layer: Any, column: Any, old: Any, old_values: Any, rest: Any, worth: Any, price: Any, least: Any, most: Any
) -> Any:
    """Goes past one cell with all that can still reach a value; returns a table, without states if they are too many.

    A state is that of the line, in 32 bits, the pattern in 16, and the crossings.
    """
    capacity = 1 << 10
    states, values = np.zeros((capacity, 1), np.uint64), np.zeros((capacity, 1), np.int64)
    origins, used = np.zeros((capacity, 0), np.int32), np.zeros(capacity, np.bool_)
    size = 0
    state = np.zeros(1, np.uint64)
    for source in range(len(old)):
        number = np.int64(old[source, 0] & np.uint64(0xFFFFFFFF))
        for edge in range(layer.starts[number], layer.starts[number + 1]):
            value = old_values[source, 0] + value_of(layer, edge, worth, price)
            if value + rest[layer.after[edge]] < least:
                continue
            known = (old[source, 0] >> np.uint64(32)) + (np.uint64(layer.crossings[edge]) << np.uint64(16))
            known |= np.uint64(layer.label[edge] >= TURN) << np.uint64(column)
            state[0] = np.uint64(layer.after[edge]) | known << np.uint64(32)
            before = size
            place, size, states, values, origins, used = insert(size, states, values, origins, used, state)
            if size > before or value > values[place, 0]:
                values[place, 0] = value
            if size > most:
                return states[:0], values, used
    return states, values, used
