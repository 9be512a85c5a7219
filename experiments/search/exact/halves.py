"""All ways to fill a half of a grid that is open along one side, whatever hangs together.

A grid is cut between two rows. The half above the cut, or the one below it upside down, is filled column by column. The
line lies across the columns. A node has the kinds along it (see `tiles`). There are few nodes, so all edges are kept,
and for any value of what lies at the cut the half of the highest value is found fast.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.graph import carry_best, merge
from experiments.search.exact.tiles import TURN, tile_of

__all__ = ["Half", "Layer", "cost_to_go", "find_highest", "make_half", "within_reach"]


class Layer(NamedTuple):
    """What one cell adds: E edges, sorted by the node before.

    Attributes:
      starts: int32 ``[M + 1]``, the first edge of each node before the cell.
      source: int32 ``[E]``, the node before the cell.
      target: int32 ``[E]``, the node after it.
      gain: int64 ``[E]``, what the tile adds to the straight score.
      label: int64 ``[E]``, the kind that the column has at the cut if the cell lies there, else -1.
      crossings: int64 ``[E]``, 1 for a three-way crossing, 2 for a four-way crossing.
      choice: int64 ``[E]``, 2 if the tile has a link towards the cut, plus 1 if it has one to the next column.
      nodes: N, after the cell.
    """

    starts: NDArray[np.int32]
    source: NDArray[np.int32]
    target: NDArray[np.int32]
    gain: NDArray[np.int64]
    label: NDArray[np.int64]
    crossings: NDArray[np.int64]
    choice: NDArray[np.int64]
    nodes: int


class Half(NamedTuple):
    """A half.

    Attributes:
      height: rows, the last one at the cut.
      width: columns.
      fill: whether no cell may be empty.
      layers: of all cells, column by column, each column towards the cut.
    """

    height: int
    width: int
    fill: bool
    layers: list[Layer]


def make_half(height: int, width: int, *, fill: bool) -> Half:
    """Makes a half of 1 to 7 rows and 2 to 12 columns, with or without empty cells."""
    states, layers = np.zeros(1, np.uint64), []
    for column, row in np.ndindex(width, height):
        following, source, about = _expand(states, row, row == height - 1, column == width - 1, fill)
        target, merged = merge(following[:, None])
        gain, label, crossings, choice = about
        layers.append(Layer(np.zeros(0, np.int32), source, target, gain, label, crossings, choice, len(merged)))
        states = merged[:, 0]
    return Half(height, width, fill, _without_dead_ends(layers))


@numba.njit(cache=True)
def _expand(
    states: NDArray[np.uint64], row: int, at_cut: bool, last_column: bool, fill: bool
) -> tuple[NDArray[np.uint64], NDArray[np.int32], NDArray[np.int64]]:
    """Lists the edges of a cell.

    Returns:
      The states after them, four bits a kind; the nodes before; the columns `gain`, `label`, `crossings` and `choice`
      of a `Layer`.
    """
    most, count = 4 * len(states), 0
    following, source, about = np.empty(most, np.uint64), np.empty(most, np.int32), np.empty((4, most), np.int64)
    for node in range(len(states)):
        state = np.int64(states[node])
        left, up = state >> 4 * row & 15, state >> 4 * row + 4 & 15
        for choice in range(4):
            right, down = choice >> 1, choice & 1
            if down and last_column:
                continue
            gain, right_kind, down_kind = tile_of(left, up, right, down, fill, True)
            if gain < 0:
                continue
            after = state & ~(255 << 4 * row) | down_kind << 4 * row | right_kind << 4 * row + 4
            if at_cut:  # the line goes on to the next column; its last place is at the cut
                after = after << 4 & (16 << 4 * row + 4) - 1
            links = (left >= TURN) + (up >= TURN) + right + down
            following[count], source[count] = np.uint64(after), node
            about[0, count], about[1, count] = gain, right_kind if at_cut else -1
            about[2, count], about[3, count] = links - 2 if links > 2 else 0, choice
            count += 1
    return following[:count], source[:count], about[:, :count]


def _without_dead_ends(layers: Sequence[Layer]) -> list[Layer]:
    """Removes nodes from which no path leads to the end, and sets `starts`."""
    kept = []
    alive = np.ones(layers[-1].nodes, np.bool_)
    for layer, before in zip(reversed(layers), [*(layer.nodes for layer in layers[-2::-1]), 1], strict=True):
        stays, index, nodes = alive[layer.target], np.cumsum(alive) - 1, int(alive.sum())
        target = index[layer.target[stays]].astype(np.int32)
        alive = np.zeros(before, np.bool_)
        alive[layer.source[stays]] = True
        source = (np.cumsum(alive) - 1)[layer.source[stays]].astype(np.int32)
        starts = np.searchsorted(source, np.arange(alive.sum() + 1)).astype(np.int32)
        columns = {name: getattr(layer, name)[stays] for name in ("gain", "label", "crossings", "choice")}
        kept.append(Layer(starts, source, target, **columns, nodes=nodes))
    return kept[::-1]


def find_highest(half: Half, gains: Sequence[NDArray[np.int64]]) -> list[int]:
    """Returns the edges of the way to fill a half that has the highest value, one a layer.

    Args:
      half: the half.
      gains: of each layer, int64 ``[E]``, what its edges add to the value.
    """
    values, ways = np.zeros((1, 1), np.int64), []
    for layer, gain in zip(half.layers, gains, strict=True):
        values, way = carry_best(layer.nodes, layer.source, layer.target, gain, None, values)
        ways.append(way)
    node, edges = int(values.argmax()), []
    for layer, way in zip(half.layers[::-1], ways[::-1], strict=True):
        edges.append(int(way[node, 0]))
        node = int(layer.source[edges[-1]])
    return edges[::-1]


def cost_to_go(half: Half, gains: Sequence[NDArray[np.int64]]) -> list[NDArray[np.int64]]:
    """Returns the highest value that each node can still add, before each cell and after the last.

    Args:
      half: the half.
      gains: as in `find_highest`.
    """
    values = [np.zeros((half.layers[-1].nodes, 1), np.int64)]
    for layer, gain in zip(half.layers[::-1], gains[::-1], strict=True):
        back = len(layer.starts) - 1, layer.target, layer.source, gain, None
        values.append(carry_best(*back, values[-1])[0])
    return [value[:, 0] for value in values[::-1]]


def within_reach(
    layer: Layer,
    gain: NDArray[np.int64],
    rest: NDArray[np.int64],
    nodes: NDArray[np.int64],
    values: NDArray[np.int64],
    least: int,
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Lists the edges by which partial ways can still reach a value.

    Args:
      layer: of the next cell.
      gain: ``[E]``, what its edges add to a value.
      rest: ``[N]``, the highest value that can still be added after it, see `cost_to_go`.
      nodes: ``[S]``, where each partial way is.
      values: ``[S]``, of each partial way.
      least: the value to reach.

    Returns:
      For each continuation the partial way and the edge.
    """
    counts = layer.starts[nodes + 1] - layer.starts[nodes]
    ways = np.repeat(np.arange(len(nodes), dtype=np.int32), counts)
    edges = np.arange(len(ways)) + np.repeat(layer.starts[nodes] - np.cumsum(counts) + counts, counts)
    stays = values[ways] + gain[edges] + rest[layer.target[edges]] >= least
    return ways[stays], edges[stays]
