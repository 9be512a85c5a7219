"""Pairs of halves that make a network."""

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.assignments import Assignments
from experiments.search.exact.components import make_line, read
from experiments.search.exact.tiles import score_across

__all__ = ["find_best_pair"]


def find_best_pair(
    width: int, upper: Assignments, lower: Assignments, crossings: int, target: int, needed: int, bridgeless: bool
) -> tuple[int, int, int] | None:
    """Finds two halves that make the best network of a score of `target` or more.

    Args:
      width: columns.
      upper: ways to fill the upper half.
      lower: ways to fill the lower half; the same object if both are alike.
      crossings: of the network; a four-way crossing is two.
      target: the lowest straight score.
      needed: the value that two halves need together, see `Duals.needed`.
      bridgeless: whether no link may be a bridge.

    Returns:
      The score and the index of each half; None without such a network.
    """
    spans, orders = [], []
    for part in (upper, lower):
        links = np.zeros(len(part.states), np.int64)
        for place in range(part.places - width, part.places):
            linked = part.states[:, place >> 2] >> np.uint64(16 * (place & 3) + 4) & np.uint64(15) > 0
            links = links << 1 | linked
        used = (part.states[:, -1] >> np.uint64(32)).astype(np.int64)
        order = np.lexsort((-part.values[:, 1], used, links))
        keys, starts = np.unique((links << 8 | used)[order], return_index=True)
        ends = np.append(starts, len(order))[1:]
        spans.append({key: span for key, *span in zip(keys.tolist(), starts.tolist(), ends.tolist(), strict=True)})
        orders.append(order)
    pairs = []
    for key, span in spans[0].items():
        partner = (key >> 8 << 8) + crossings - (key & 255)
        # If both halves are alike, each pair is examined once.
        if partner in spans[1] and (upper is not lower or partner >= key):
            pairs.append((*span, *spans[1][partner]))
    if not pairs:
        return None
    one, other = (
        (part.states[order][:, :-1], part.values[order], part.places)
        for part, order in zip((upper, lower), orders, strict=True)
    )
    score, first, second = _best_pair(np.array(pairs), one, other, width, target, needed, bridgeless)
    return (score, int(orders[0][first]), int(orders[1][second])) if score >= target else None


@numba.njit(cache=True)
def _best_pair(
    pairs: NDArray[np.int64],
    upper: tuple[NDArray[np.uint64], NDArray[np.int64], int],
    lower: tuple[NDArray[np.uint64], NDArray[np.int64], int],
    width: int,
    target: int,
    needed: int,
    bridgeless: bool,
) -> tuple[int, int, int]:
    """Finds the best network among pairs of groups of halves; returns a score below the target if there is none."""
    (states, values, places), (other_states, other_values, other_places) = upper, lower
    best, best_first, best_second = target - 1, -1, -1
    line, other_line = make_line(places), make_line(other_places)
    for start, end, other_start, other_end in pairs:
        for first in range(start, end):
            if values[first, 1] + other_values[other_start, 1] < needed:
                break
            count = read(states[first], line)
            for second in range(other_start, other_end):
                if values[first, 1] + other_values[second, 1] < needed:
                    break
                score = values[first, 0] + other_values[second, 0]
                for place in range(-width, 0):
                    code = other_states[second, other_places + place >> 2] >> np.uint64(16 * (other_places + place & 3))
                    added = score_across(line.kinds[0, place], np.int64(code) & 15)
                    if added < 0:
                        score = -1
                        break
                    score += added
                if score <= best:
                    continue
                other_count = read(other_states[second], other_line)
                if _fits(
                    line.blocks[0, -width:],
                    line.splits[0, :count] >> places - width,
                    other_line.blocks[0, -width:],
                    other_line.splits[0, :other_count] >> other_places - width,
                    bridgeless,
                ):
                    best, best_first, best_second = score, first, second
    return best, best_first, best_second


@numba.njit(cache=True)
def _fits(
    blocks: NDArray[np.int64],
    splits: NDArray[np.int64],
    other_blocks: NDArray[np.int64],
    other_splits: NDArray[np.int64],
    bridgeless: bool,
) -> bool:
    """Tells whether two halves make one component, and, if asked for, whether no link of it is a bridge.

    Args:
      blocks: the component of each column at the cut, 0 without a road.
      splits: the columns of each split, as bits.
      other_blocks: of the other half.
      other_splits: of the other half.
      bridgeless: whether no link may be a bridge.
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
    for side in other_splits:
        if not _is_connected(other_blocks, blocks, -1, side):
            return False
    return True


@numba.njit(cache=True)
def _is_connected(blocks: NDArray[np.int64], other_blocks: NDArray[np.int64], without: int, side: int) -> bool:
    """Tells whether two halves make one component without the link of a column, the first half split along a side."""
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
