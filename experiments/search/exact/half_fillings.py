"""Ways to fill a half, of which each may be a part of a network of some score.

Cell by cell, as `frontier` does, with all that the other half needs to know: the label of each column at the cut, which
columns hang together, and which links inside still could be bridges. A way goes when it can no more become high enough
for any partner, by the sweep of `half_sweep`.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.half_sweep import Half, value_of
from experiments.search.exact.half_worths import Worths
from experiments.search.exact.sweep import decode, encode, insert, join_splits

__all__ = ["Fillings", "fill", "trace"]


class Fillings(NamedTuple):
    """Ways to fill a half, and where they come from.

    Attributes:
      states: uint64 ``[N, words]``, as `frontier` has them: the places of the line, then the columns at the cut from
        the last one to the first. The last word has the state of the line in `half_sweep`, and the crossings.
      values: int64 ``[N, 2]``, the straight score, where a straight at the cut counts as if it ended there; and the
        value in units, with worths and price.
      origins: by cell, int32 ``[N]``, 4 times the number of the state before plus the choice.
      places: of the line and of the cut.
    """

    states: NDArray[np.uint64]
    values: NDArray[np.int64]
    origins: list[NDArray[np.int32]]
    places: int


def fill(
    halves: tuple[Half, ...], worths: Worths, crossings: int, target: int, most: int, bridgeless: bool
) -> list[Fillings] | None:
    """Finds the ways to fill each half that may be of a network of a score; None if they are too many."""
    filled = []
    for half, worth, rest, least in worths.needs(halves, crossings, target):
        found = _fill_half(half, worth, worths.price, rest, least, most, bridgeless)
        if found is None:
            return None
        filled.append(found)
    return filled


def _fill_half(
    half: Half,
    worth: NDArray[np.int64],
    price: int,
    rests: list[NDArray[np.int64]],
    least: int,
    most: int,
    bridgeless: bool,
) -> Fillings | None:
    """Finds all ways to fill a half of at least a value, of those alike the highest; None if they are too many."""
    places = half.height + 1 + half.width
    states, values = np.zeros((1, (places + 3) // 4 + 1), np.uint64), np.zeros((1, 2), np.int64)
    origins = []
    for number, layer in enumerate(half.layers):
        at = (number // half.height, number % half.height, half.height, half.width)
        states, values, origin, used = _advance(
            layer, at, states, values, rests[number + 1], worth[at[0]], price, least, most, bridgeless
        )
        if len(states) == 0:
            return None
        states, values = states[used], values[used]
        origins.append(origin[used, 0])
    return Fillings(states, values, origins, places)


class _Line(NamedTuple):
    """What a state says, and what the next will; arrays to be written to.

    Attributes:
      places: int64 ``[4, P]``, the kinds of this state and the next, the components of this state and the next.
      splits: int64 ``[4, 4 P]``, the splits of this state and the next, their components of this state and the next.
      members: int64 ``[P + 2]``, the places of each component of this state, as bits.
    """

    places: NDArray[np.int64]
    splits: NDArray[np.int64]
    members: NDArray[np.int64]


@numba.njit(cache=True)
def _read(states: Any, number: Any, line: Any) -> Any:
    """Reads one of the states; returns the number of its splits."""
    blocks = line.places[2]
    count = decode(states, number, line.places[0], blocks, line.splits[0], line.splits[2])
    line.members[:] = 0
    for place in range(len(blocks)):
        line.members[blocks[place]] |= 1 << place
    return count


@numba.njit(cache=True)
def _lay(line: Any, count: Any, row: Any, right: Any, down: Any, bridgeless: Any) -> Any:
    """Lays a tile: writes the components and splits of the next state; returns how many splits, -1 if it may not be."""
    blocks, new_blocks = line.places[2], line.places[3]
    left, up = blocks[row], blocks[row + 1]
    line.splits[1, :count], line.splits[3, :count] = line.splits[0, :count], line.splits[2, :count]
    if not (left or up or right or down):
        new_blocks[:] = blocks
        return count
    own = up if up else left if left else blocks.max() + 1
    mine = 0
    for place in range(len(blocks)):
        new_blocks[place] = up if up and left and blocks[place] == left else blocks[place]
    new_blocks[row], new_blocks[row + 1] = own * down, own * right
    for place in range(len(blocks)):
        if new_blocks[place] == own:
            mine |= 1 << place
    if not bridgeless:
        return 0 if mine else -1
    taken = (1 << row + 1 if up else 0) | (1 << row if left else 0)
    return join_splits(line.members, up, left, taken, own, mine, count, line.splits[1], line.splits[3])


@numba.njit(cache=True)
def _advance(
    layer: Any,
    at: Any,
    old: Any,
    old_values: Any,
    rest: Any,
    worth: Any,
    price: Any,
    least: Any,
    most: Any,
    bridgeless: Any,
) -> Any:
    """Goes past one cell with all that can still reach a value; returns a table, without states if too many."""
    column, row, height, width = at
    line, places = height + 1, height + 1 + width
    last = row == height - 1
    own_place = line + width - 1 - column  # of the column at the cut
    capacity, words = 1 << 10, old.shape[1]
    states, values = np.zeros((capacity, words), np.uint64), np.zeros((capacity, 2), np.int64)
    origins, used = np.zeros((capacity, 1), np.int32), np.zeros(capacity, np.bool_)
    size = 0
    memory = _Line(np.zeros((4, places), np.int64), np.zeros((4, 4 * places), np.int64), np.zeros(places + 2, np.int64))
    kinds, new_kinds, _, new_blocks = memory.places
    new_splits = memory.splits[1]
    state = np.zeros(words, np.uint64)
    on_line = (1 << line) - 1
    for source in range(len(old)):
        number = np.int64(old[source, words - 1] & np.uint64(0xFFFFFFFF))
        crossings = old[source, words - 1] >> np.uint64(32)
        count = -1
        for edge in range(layer.starts[number], layer.starts[number + 1]):
            value = old_values[source, 1] + value_of(layer, edge, worth, price)
            if value + rest[layer.after[edge]] < least:
                continue
            if count < 0:
                count = _read(old, source, memory)
            new_count = _lay(memory, count, row, layer.choice[edge] >> 1, layer.choice[edge] & 1, bridgeless)
            if new_count < 0:
                continue
            new_kinds[:] = kinds
            if last:  # the line begins anew; its last place goes to the cut
                new_kinds[own_place], new_blocks[own_place] = layer.label[edge], new_blocks[height]
                for place in range(height, 0, -1):
                    new_blocks[place] = new_blocks[place - 1]
                new_blocks[0] = 0
                for split in range(new_count):
                    side = new_splits[split]
                    moved = (side << 1 & on_line) | (side & ~on_line)
                    new_splits[split] = moved | (side >> height & 1) << own_place
            encode(state, new_kinds, new_blocks, new_splits, new_count, 0)
            used_so_far = crossings + np.uint64(layer.crossings[edge])
            state[words - 1] = np.uint64(layer.after[edge]) | used_so_far << np.uint64(32)
            before = size
            place, size, states, values, origins, used = insert(size, states, values, origins, used, state)
            score = old_values[source, 0] + layer.gain[edge]
            if size > before or score > values[place, 0]:
                values[place] = score, value
                origins[place, 0] = source << 2 | layer.choice[edge]
            if size > most:
                return states[:0], values, origins, used
    return states, values, origins, used


def trace(half: Half, fillings: Fillings, number: int) -> NDArray[np.int8]:
    """Makes the grid of a half by the origins of its states."""
    links = np.zeros((half.width, half.height, 2), int)  # towards the cut, and to the next column
    for place in reversed(range(len(half.layers))):
        origin = int(fillings.origins[place][number])
        links[divmod(place, half.height)] = origin >> 1 & 1, origin & 1
        number = origin >> 2
    down, right = np.moveaxis(links, -1, 0).swapaxes(1, 2)
    up, left = np.roll(down, 1, axis=0), np.roll(right, 1, axis=1)
    up[0] = 0
    return (8 * up + 4 * right + 2 * down + left).astype(np.int8)
