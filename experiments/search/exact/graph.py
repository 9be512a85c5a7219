"""The step that all programmes share: equal states become one node, and values are carried along edges."""

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["NEVER", "Integer", "carry_best", "carry_counts", "merge"]

Integer = int | np.int64
"""A number in compiled code."""

NEVER = -(1 << 50)
"""A value that means that a node cannot be reached."""


@numba.njit(cache=True)
def merge(rows: NDArray[np.uint64]) -> tuple[NDArray[np.int32], NDArray[np.uint64]]:
    """Finds equal rows with a hash table.

    Args:
      rows: ``[E, words]``, the state that each edge leads to.

    Returns:
      The node of each row, int32 ``[E]``, and the states of all nodes ``[N, words]``, numbered by first appearance.
    """
    capacity = 1 << 8
    while 2 * capacity < 3 * len(rows):
        capacity *= 2
    slots, nodes = np.full(capacity, -1, np.int32), np.empty(len(rows), np.int32)
    first = np.empty(len(rows), np.int32)
    count = 0
    for edge in range(len(rows)):
        mixed = np.uint64(0)
        for word in range(rows.shape[1]):
            mixed = (mixed ^ rows[edge, word]) * np.uint64(0x9E3779B97F4A7C15)
            mixed ^= mixed >> np.uint64(29)
        mixed *= np.uint64(0xBF58476D1CE4E5B9)
        slot = np.int64((mixed ^ mixed >> np.uint64(32)) & np.uint64(capacity - 1))
        while slots[slot] >= 0:
            same = True
            for word in range(rows.shape[1]):
                same &= rows[first[slots[slot]], word] == rows[edge, word]
            if same:
                break
            slot = slot + 1 & capacity - 1
        if slots[slot] < 0:
            slots[slot], first[count] = count, edge
            count += 1
        nodes[edge] = slots[slot]
    return nodes, rows[first[:count]]


@numba.njit(cache=True)
def carry_best(
    count: Integer,
    source: NDArray[np.int32],
    target: NDArray[np.int32],
    gain: NDArray[np.int64],
    shift: NDArray[np.int16] | None,
    values: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Carries values along the edges of a cell. Of those that meet, the highest is kept.

    Args:
      count: N, nodes after the cell.
      source: ``[E]``, the node before the cell.
      target: ``[E]``, the node after it.
      gain: ``[E]``, added to a value.
      shift: ``[E]``, added to the bin of a value; None for 0.
      values: ``[M, B]``, of each node and bin before the cell, `NEVER` if there is none.

    Returns:
      The values ``[N, B]``, and the edge that each came by. The first edge wins ties.
    """
    best, way = np.full((count, values.shape[1]), NEVER), np.zeros((count, values.shape[1]), np.int32)
    for edge in range(len(source)):
        after, moved = target[edge], 0 if shift is None else shift[edge]
        for number in range(values.shape[1] - moved):
            value = values[source[edge], number]
            if value != NEVER and value + gain[edge] > best[after, number + moved]:
                best[after, number + moved], way[after, number + moved] = value + gain[edge], edge
    return best, way


@numba.njit(cache=True)
def carry_counts(
    count: Integer,
    source: NDArray[np.int32],
    target: NDArray[np.int32],
    shift: NDArray[np.int16],
    values: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Carries numbers along the edges of a cell, as `carry_best` does. Those that meet are added."""
    total = np.zeros((count, values.shape[1]), np.int64)
    for edge in range(len(source)):
        for number in range(values.shape[1] - shift[edge]):
            total[target[edge], number + shift[edge]] += values[source[edge], number]
    return total
