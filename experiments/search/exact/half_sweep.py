"""All ways to fill a half of a grid that is open along one side, components left out.

The grid is cut between two rows. The half above the cut, or the one below it upside down, is filled column by column.
The line lies across the columns, as that of `frontier`, and a state has the tiles along it and the lengths of their
straights. There are few such states, so that all transitions are kept, and the half of the highest value is found fast
for any worth of what lies at the cut.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.sweep import TURN, Cell, find, insert, tile_of

__all__ = ["NEVER", "UNIT", "Half", "Layer", "find_highest", "find_rests", "make_half", "value_of"]

NEVER = -(1 << 50)
"""A value that stands for none."""

UNIT = 256
"""Units of worths, prices and values in a point of the straight score."""


class Layer(NamedTuple):
    """What one cell adds: transitions between states of the line, sorted by the state before.

    Attributes:
      starts: int32 ``[S + 1]``, the first transition of each state.
      after: int32 ``[E]``, the state that follows.
      gain: int32 ``[E]``, what the tile adds to the straight score.
      label: int8 ``[E]``, what the column has at the cut, if the cell lies there, as a kind of `frontier`; else -1.
      crossings: int8 ``[E]``, 1 of a three-way crossing, 2 of a four-way crossing.
      choice: int8 ``[E]``, 2 if the tile has a link towards the cut, plus 1 if it has one to the next column.
      states: S' after the cell.
    """

    starts: NDArray[np.int32]
    after: NDArray[np.int32]
    gain: NDArray[np.int32]
    label: NDArray[np.int8]
    crossings: NDArray[np.int8]
    choice: NDArray[np.int8]
    states: int


class Half(NamedTuple):
    """A half.

    Attributes:
      height: rows, the last one at the cut.
      width: columns.
      fill: whether no cell may be empty.
      layers: of all cells, column by column, each towards the cut.
    """

    height: int
    width: int
    fill: bool
    layers: list[Layer]


def make_half(height: int, width: int, *, fill: bool) -> Half:
    """Makes a half of 1 to 7 rows and 2 to 12 columns, with or without empty cells."""
    states = np.zeros((1, (height + 1) // 4 + 1), np.uint64)
    layers = []
    for row, column in np.ndindex(width, height):
        # The line is one cell longer than the half is high, as its end is not the grid's.
        cell = Cell(width, height + 1, row, column, fill, lengths=True, bridgeless=True, counting=False)
        table, used, layer = _advance(cell, states)
        layers.append(layer._replace(after=(np.cumsum(used) - 1)[layer.after].astype(np.int32)))
        states = table[used]
    return Half(height, width, fill, _without_dead_ends(layers))


def _without_dead_ends(layers: list[Layer]) -> list[Layer]:
    """Leaves out the states from which no way leads to the end."""
    kept = []
    alive = np.ones(layers[-1].states, np.bool_)
    for layer in reversed(layers):
        stays = alive[layer.after]
        source = np.repeat(np.arange(len(layer.starts) - 1), np.diff(layer.starts))[stays]
        numbers, count = (np.cumsum(alive) - 1).astype(np.int32), int(alive.sum())
        alive = np.zeros(len(layer.starts) - 1, np.bool_)
        alive[source] = True
        starts = np.searchsorted((np.cumsum(alive) - 1)[source], np.arange(alive.sum() + 1)).astype(np.int32)
        columns = {name: getattr(layer, name)[stays] for name in ("gain", "label", "crossings", "choice")}
        kept.append(Layer(starts=starts, after=numbers[layer.after[stays]], states=count, **columns))
    return kept[::-1]


@numba.njit(cache=True)
def _advance(cell: Any, old: Any) -> Any:
    """Takes the line past one cell; returns the table of states, which are used, and the layer.

    In the layer stand the places of states in the table.
    """
    places, words = cell.width, old.shape[1]
    last = cell.column == places - 2
    capacity = 1 << 8
    states, values = np.zeros((capacity, words), np.uint64), np.zeros((capacity, 0), np.int64)
    origins, used = np.zeros((capacity, 0), np.int32), np.zeros(capacity, np.bool_)
    size = count = 0
    starts, following = np.zeros(len(old) + 1, np.int32), np.zeros((4 * len(old), words), np.uint64)
    after, gains = np.zeros((2, 4 * len(old)), np.int32)
    labels, crossings, choices = np.zeros((3, 4 * len(old)), np.int8)
    kinds = np.zeros(places, np.int64)
    for source in range(len(old)):
        for place in range(places):
            kinds[place] = np.int64(old[source, place >> 2] >> np.uint64(16 * (place & 3))) & 15
        left, up = kinds[cell.column], kinds[cell.column + 1]
        for choice in range(4):
            right, down = choice >> 1, choice & 1
            if down and cell.row == cell.height - 1:
                continue
            gain, right_kind, down_kind = tile_of(cell, left, up, right, down)
            if gain < 0:
                continue
            for place in range(places - last):
                kind = kinds[place]
                if place == cell.column:
                    kind = down_kind
                elif place == cell.column + 1:
                    kind = right_kind
                moved = place + last
                following[count, moved >> 2] |= np.uint64(kind) << np.uint64(16 * (moved & 3))
            _, size, states, values, origins, used = insert(size, states, values, origins, used, following[count])
            gains[count], choices[count] = gain, choice
            labels[count] = right_kind if last else -1
            crossings[count] = max(0, (left >= TURN) + (up >= TURN) + right + down - 2)
            count += 1
        starts[source + 1] = count
    for number in range(count):
        after[number] = find(states, used, following[number])
    columns = after[:count], gains[:count], labels[:count], crossings[:count], choices[:count]
    return states, used, Layer(starts, *columns, size)


def find_highest(half: Half, worth: NDArray[np.int64], price: int) -> tuple[int, int, int, list[int]]:
    """Finds the way to fill a half that has the highest value.

    Args:
      half: the half.
      worth: int64 ``[W, L]``, in units, of each label that a column may have at the cut.
      price: of a crossing, in units; a four-way crossing is two.

    Returns:
      The value: of its straight score, its labels and its crossings; the score; the crossings; and the labels.
    """
    values, ways = np.zeros(1, np.int64), []
    for number, layer in enumerate(half.layers):
        values, way = _forward(layer, values, worth[number // half.height], price)
        ways.append(way)
    state = int(values.argmax())
    value, score, crossings, labels = int(values[state]), 0, 0, []
    for layer, way in zip(half.layers[::-1], ways[::-1], strict=True):
        edge = way[state]
        score, crossings = score + int(layer.gain[edge]), crossings + int(layer.crossings[edge])
        if layer.label[edge] >= 0:
            labels.append(int(layer.label[edge]))
        state = int(np.searchsorted(layer.starts, edge, side="right")) - 1
    return value, score, crossings, labels[::-1]


@numba.njit(cache=True)
def value_of(layer: Any, edge: Any, worth: Any, price: Any) -> Any:
    """Returns the value that a transition adds, in units."""
    value = UNIT * layer.gain[edge] + price * layer.crossings[edge]
    return value + worth[layer.label[edge]] if layer.label[edge] >= 0 else value


@numba.njit(cache=True)
def _forward(layer: Any, values: Any, worth: Any, price: Any) -> Any:
    """Returns the highest value of each state after a cell, and the transition that it comes by."""
    highest, way = np.full(layer.states, NEVER), np.zeros(layer.states, np.int32)
    for state in range(len(values)):
        if values[state] < NEVER >> 8:
            continue
        for edge in range(layer.starts[state], layer.starts[state + 1]):
            value = values[state] + value_of(layer, edge, worth, price)
            if value > highest[layer.after[edge]]:
                highest[layer.after[edge]], way[layer.after[edge]] = value, edge
    return highest, way


def find_rests(half: Half, worth: NDArray[np.int64], price: int) -> list[NDArray[np.int64]]:
    """Returns the highest value that each state can still add, before each cell and after the last."""
    rests = [np.zeros(half.layers[-1].states, np.int64)]
    for number in reversed(range(len(half.layers))):
        rests.append(_backward(half.layers[number], rests[-1], worth[number // half.height], price))
    return rests[::-1]


@numba.njit(cache=True)
def _backward(layer: Any, rest: Any, worth: Any, price: Any) -> Any:
    highest = np.full(len(layer.starts) - 1, NEVER)
    for state in range(len(highest)):
        for edge in range(layer.starts[state], layer.starts[state + 1]):
            value = rest[layer.after[edge]] + value_of(layer, edge, worth, price)
            highest[state] = max(highest[state], value)
    return highest
