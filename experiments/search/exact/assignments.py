"""Ways to fill a half that may be part of a network of some score.

Cell by cell as in `sweep`, with all that the other half needs to know: the label of each column at the cut, which
columns hang together, and which links inside still could be bridges. A way is dropped when it can no longer reach the
value that any partner needs.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.components import encode, lay, make_line, read
from experiments.search.exact.duals import HalfBounds
from experiments.search.exact.graph import carry_best, merge
from experiments.search.exact.halves import Half, within_reach

__all__ = ["Assignments", "find_assignments", "trace"]


class Assignments(NamedTuple):
    """Ways to fill a half, and where they come from.

    Attributes:
      states: uint64 ``[N, words]``, as in `components`: the places of the line, then the columns at the cut from the
        last one to the first. The last word has the node in the half, and the crossings from bit 32 on.
      values: int64 ``[N, 2]``, the straight score, where a straight at the cut counts as if it ended there; and the
        value in units, with dual values and price.
      origins: of each cell, int32 ``[N]``, 4 times the index of the state before, plus the choice.
      places: of the line and the cut.
    """

    states: NDArray[np.uint64]
    values: NDArray[np.int64]
    origins: list[NDArray[np.int32]]
    places: int


def find_assignments(bounds: HalfBounds, bridgeless: bool) -> Assignments:
    """Finds the ways to fill a half that reach its value, of equal states the one of the highest score.

    Args:
      bounds: of the half.
      bridgeless: whether no link may be a bridge.
    """
    half, gains, rest, least = bounds
    places = half.height + 1 + half.width
    states, values = np.zeros((1, (places + 3) // 4 + 1), np.uint64), np.zeros((1, 2), np.int64)
    origins = []
    for index, layer in enumerate(half.layers):
        column, row = divmod(index, half.height)
        nodes = (states[:, -1] & np.uint64(0xFFFFFFFF)).astype(np.int64)
        ways, edges = within_reach(layer, gains[index], rest[index + 1], nodes, values[:, 1], least)
        tiles = layer.choice[edges], layer.label[edges], (row, column), (half.height, half.width)
        rows, possible = _lay_all(states, ways, *tiles, bridgeless)
        crossings = (states[ways, -1] >> np.uint64(32)) + layer.crossings[edges].astype(np.uint64)
        rows[:, -1] = layer.target[edges].astype(np.uint64) | crossings << np.uint64(32)
        ways, edges = ways[possible], edges[possible]
        target, states = merge(rows[possible])
        scores, best = carry_best(len(states), ways, target, layer.gain[edges], None, values[:, :1])
        ways, edges = ways[best[:, 0]], edges[best[:, 0]]
        values = np.stack([scores[:, 0], values[ways, 1] + gains[index][edges]], axis=1)
        origins.append(ways << 2 | layer.choice[edges].astype(np.int32))
    return Assignments(states, values, origins, places)


@numba.njit(cache=True)
def _lay_all(
    states: NDArray[np.uint64],
    ways: NDArray[np.int32],
    choices: NDArray[np.int64],
    labels: NDArray[np.int64],
    cell: tuple[int, int],
    shape: tuple[int, int],
    bridgeless: bool,
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Lays the tile of each edge; returns the states after them, without the last word, and which are possible."""
    (row, column), (height, width) = cell, shape
    places, at_cut = height + 1 + width, row == height - 1
    on_line, own_place = (2 << height) - 1, height + width - column  # the place of the column at the cut
    rows, possible = np.empty((len(ways), states.shape[1]), np.uint64), np.zeros(len(ways), np.bool_)
    line = make_line(places)
    blocks, splits = line.blocks[1], line.splits[1]
    before, count = -1, 0
    for edge in range(len(ways)):
        if ways[edge] != before:
            before = ways[edge]
            count = read(states[before, :-1], line)
        new_count = lay(line, count, row, choices[edge] >> 1, choices[edge] & 1, bridgeless)
        if new_count < 0:
            continue
        line.kinds[1] = line.kinds[0]
        if at_cut:  # the line goes on to the next column; its last place is at the cut
            line.kinds[1, own_place], blocks[own_place] = labels[edge], blocks[height]
            for place in range(height, 0, -1):
                blocks[place] = blocks[place - 1]
            blocks[0] = 0
            for split in range(new_count):
                side = splits[split]
                moved = (side << 1 & on_line) | (side & ~on_line)
                splits[split] = moved | (side >> height & 1) << own_place
        encode(line, new_count, 0, rows[edge, :-1])
        possible[edge] = True
    return rows, possible


def trace(half: Half, assignments: Assignments, state: int) -> NDArray[np.int8]:
    """Makes the grid of a half by the origins of its states."""
    links = np.zeros((half.width, half.height, 2), int)  # towards the cut, and to the next column
    for index in reversed(range(len(half.layers))):
        origin = int(assignments.origins[index][state])
        links[divmod(index, half.height)] = origin >> 1 & 1, origin & 1
        state = origin >> 2
    down, right = np.moveaxis(links, -1, 0).swapaxes(1, 2)
    up, left = np.roll(down, 1, axis=0), np.roll(right, 1, axis=1)
    up[0] = 0
    return (8 * up + 4 * right + 2 * down + left).astype(np.int8)
