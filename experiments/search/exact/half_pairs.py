"""Pairs of halves that make a network."""

from typing import Any

import numba
import numpy as np

from experiments.search.exact.half_fillings import Fillings
from experiments.search.exact.half_worths import across
from experiments.search.exact.sweep import decode

__all__ = ["find_best_pair"]


def find_best_pair(
    width: int, upper: Fillings, lower: Fillings, crossings: int, target: int, least: int, bridgeless: bool
) -> tuple[int, int, int] | None:
    """Finds two halves that make the best network of at least a score; returns it and their numbers."""
    groups, orders = [], []
    for fillings in (upper, lower):
        links = np.zeros(len(fillings.states), np.int64)
        for place in range(fillings.places - width, fillings.places):
            linked = fillings.states[:, place >> 2] >> np.uint64(16 * (place & 3) + 4) & np.uint64(15) > 0
            links = links << 1 | linked
        used = (fillings.states[:, -1] >> np.uint64(32)).astype(np.int64)
        order = np.lexsort((-fillings.values[:, 1], used, links))
        keys, starts = np.unique((links << 8 | used)[order], return_index=True)
        ends = [*starts[1:].tolist(), len(order)]
        groups.append({key: span for key, *span in zip(keys.tolist(), starts.tolist(), ends, strict=False)})
        orders.append(order)
    pairs = []
    for key, ends in groups[0].items():
        partner = (key >> 8 << 8) + crossings - (key & 255)
        # If both halves are alike, each pair is looked at once.
        if partner in groups[1] and (upper is not lower or partner >= key):
            pairs.append((*ends, *groups[1][partner]))
    if not pairs:
        return None
    score, first, second = _best_pair(
        np.array(pairs),
        upper.states[orders[0]],
        upper.values[orders[0]],
        lower.states[orders[1]],
        lower.values[orders[1]],
        width,
        upper.places,
        lower.places,
        target,
        least,
        bridgeless,
    )
    return (score, int(orders[0][first]), int(orders[1][second])) if score >= target else None


@numba.njit(cache=True)
def _best_pair(
    pairs: Any,
    states: Any,
    values: Any,
    other_states: Any,
    other_values: Any,
    width: Any,
    places: Any,
    other_places: Any,
    target: Any,
    least: Any,
    bridgeless: Any,
) -> Any:
    """Finds the best network among groups of halves; returns its score and the numbers, or a score below the target."""
    best, best_first, best_second = target - 1, -1, -1
    kinds, blocks = np.zeros((2, places), np.int64)
    other_kinds, other_blocks = np.zeros((2, other_places), np.int64)
    splits, owners = np.zeros((2, 4 * places), np.int64)
    other_splits, other_owners = np.zeros((2, 4 * other_places), np.int64)
    for group in range(len(pairs)):
        start, end, other_start, other_end = pairs[group]
        for first in range(start, end):
            if values[first, 1] + other_values[other_start, 1] < least:
                break
            count = decode(states, first, kinds, blocks, splits, owners)
            for second in range(other_start, other_end):
                if values[first, 1] + other_values[second, 1] < least:
                    break
                score = values[first, 0] + other_values[second, 0]
                for place in range(-width, 0):
                    code = other_states[second, other_places + place >> 2] >> np.uint64(16 * (other_places + place & 3))
                    added = across(kinds[places + place], np.int64(code) & 15)
                    if added < 0:
                        score = -1
                        break
                    score += added
                if score <= best:
                    continue
                other_count = decode(other_states, second, other_kinds, other_blocks, other_splits, other_owners)
                if _fits(
                    blocks[-width:],
                    splits[:count] >> places - width,
                    other_blocks[-width:],
                    other_splits[:other_count] >> other_places - width,
                    bridgeless,
                ):
                    best, best_first, best_second = score, first, second
    return best, best_first, best_second


@numba.njit(cache=True)
def _fits(blocks: Any, splits: Any, other_blocks: Any, other_splits: Any, bridgeless: Any) -> Any:
    """Tells whether two halves make one component, and if it matters that no link of it is a bridge.

    Args:
      blocks: the component of each column at the cut, or 0.
      splits: the columns of each split, as bits.
      other_blocks: the same of the other half.
      other_splits: likewise.
      bridgeless: whether bridges matter.
    """
    if not _is_connected(blocks, other_blocks, -1, 0):
        return False
    if not bridgeless:
        return True
    for column in range(len(blocks)):
        if blocks[column] and not _is_connected(blocks, other_blocks, column, 0):
            return False
    for side in splits:
        if not _is_connected(blocks, other_blocks, -1, side):
            return False
    for side in other_splits:  # noqa: SIM110 (compiled)
        if not _is_connected(other_blocks, blocks, -1, side):
            return False
    return True


@numba.njit(cache=True)
def _is_connected(blocks: Any, other_blocks: Any, without: Any, side: Any) -> Any:
    """Tells whether two halves make one component without a column's link, the first one split along a side."""
    parents = np.arange(64)
    present = np.zeros(64, np.bool_)
    components = 0
    for column in range(len(blocks)):
        if blocks[column] == 0:
            continue
        one, other = blocks[column] + 16 * (side >> column & 1), other_blocks[column] + 32
        for node in (one, other):
            components += not present[node]
            present[node] = True
        if column != without:
            while parents[one] != one:
                one = parents[one]
            while parents[other] != other:
                other = parents[other]
            components -= one != other
            parents[one] = other
    return components == 1
