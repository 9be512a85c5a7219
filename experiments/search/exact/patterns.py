"""The patterns of linked columns that a network made of two halves may have at the cut."""

import numpy as np

from experiments.search.exact.duals import Duals
from experiments.search.exact.graph import carry_best, merge
from experiments.search.exact.halves import Half, within_reach
from experiments.search.exact.tiles import TURN

__all__ = ["find_patterns"]

# A state has the node in the half in its lowest 32 bits, then the pattern in 16 bits, then the crossings.
_PATTERN, _CROSSINGS = 32, 48


def find_patterns(halves: tuple[Half, ...], duals: Duals, crossings: int, target: int) -> list[int]:
    """Finds the patterns of linked columns that a network of a score may have, whatever hangs together.

    Args:
      halves: one if both are alike.
      duals: for any pattern.
      crossings: of the network; a four-way crossing is two.
      target: the lowest score.

    Returns:
      The columns as bits, of two mirrored patterns the lower number.
    """
    highest = []
    for half, gains, rest, least in duals.half_bounds(halves, crossings, target):
        states, values = np.zeros(1, np.int64), np.zeros((1, 1), np.int64)
        for index, layer in enumerate(half.layers):
            nodes = states & (1 << _PATTERN) - 1
            ways, edges = within_reach(layer, gains[index], rest[index + 1], nodes, values[:, 0], least)
            known = (states - nodes)[ways] + (layer.crossings[edges] << _CROSSINGS)
            known |= (layer.label[edges] >= TURN).astype(np.int64) << _PATTERN + index // half.height
            targets, merged = merge((known | layer.target[edges]).astype(np.uint64)[:, None])
            states = merged[:, 0].astype(np.int64)
            values, _ = carry_best(len(states), ways, targets, gains[index][edges], None, values)
        best: dict[int, int] = {}
        for key, value in zip((states >> _PATTERN).tolist(), values[:, 0].tolist(), strict=True):
            best[key] = max(value, best.get(key, value))
        highest.append(best)
    found = set()
    for key, value in highest[0].items():
        pattern, used = key & 0xFFFF, key >> 16
        partner = highest[-1].get(pattern | (crossings - used) << 16)
        if partner is not None and value + partner >= duals.needed(crossings, target):
            found.add(min(pattern, int(f"{pattern:0{halves[0].width}b}"[::-1], 2)))
    return sorted(found)
