"""Optima of grids that are too large for one sweep, by their two halves.

The grid is cut between two rows. Of a half the other one only needs to know what it has at the cut: the label of each
column, which linked columns hang together inside, and which links inside still could be bridges. Of all ways to fill a
half that agree in this only the one of the highest score counts. A network is two halves that fit.

There are far more halves than can be kept, but few that matter. The bound of `half_worths` first leaves a list of
patterns, of columns that are linked across the cut. For each of these it is made anew, and so is much lower. A half is
kept as long as it can still become high enough for a partner, by the sweep of `half_sweep`. The score that is asked
for is lowered step by step, until two halves fit.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from frontier import TURN, decode, encode, insert, join_splits
from half_sweep import UNIT, Half, find_highest, find_rests, value_of
from half_worths import Worths, across, choose_worths, first_worths
from numpy.typing import NDArray

__all__ = ["Proof", "find_most_crossings", "find_optimum", "find_patterns"]

_STEP = 8  # of the score that is asked for


class Proof(NamedTuple):
    """What is proven of the flawless networks of a cyclomatic number.

    Attributes:
      score: no network that is asked for has a higher straight score; -1 if there is none.
      grid: int8 ``[H, W]``, a network with that score; None if none was found.
      with_bridges: no network has a higher straight score, with bridges or without; -1 if there is none.
      kept: ways to fill a half that were kept, over all lines and steps.
      peak: the most on one line.
    """

    score: int
    grid: NDArray[np.int8] | None
    with_bridges: int
    kept: int
    peak: int


def find_most_crossings(upper: Half, lower: Half) -> int:
    """Returns how many crossings no network has more of; a four-way crossing is two."""
    price = UNIT * 1000
    free = [np.zeros((half.width, 16), np.int64) for half in (upper, lower)]
    return sum(find_highest(half, worth, price)[2] for half, worth in zip((upper, lower), free, strict=True))


def find_optimum(
    upper: Half, lower: Half, cyclomatic: int, *, bridgeless: bool = True, most: int = 20_000_000
) -> Proof:
    """Finds the highest straight score of the flawless networks of a cyclomatic number that cross the cut.

    Args:
      upper: the rows above the cut.
      lower: those below it, upside down; the same object if both are alike, which takes half the time.
      cyclomatic: 1 + x / 2 + y of x three-way and y four-way crossings.
      bridgeless: whether no link may be a bridge.
      most: ways to fill a half to keep on a line; with more the search ends with what is proven so far.
    """
    crossings = 2 * (cyclomatic - 1)
    halves = (upper,) if upper is lower else (upper, lower)
    overall = choose_worths(halves, crossings, first_worths(halves), None, 0)
    known: dict[int, Worths] = {}
    proven = with_bridges = max(-1, overall.bound)
    kept = peak = 0
    tight = True  # so far all patterns had a bound below the target
    while proven >= 0:
        target = max(0, proven + 1 - _STEP)
        best: tuple[int, NDArray[np.int8]] | None = None
        patterns = find_patterns(halves, overall, crossings, target, most)
        if patterns is None:
            return Proof(proven, None, with_bridges, kept, peak)
        for pattern in patterns:
            worths = known.get(pattern, overall)
            if worths is overall or worths.bound >= target:
                known[pattern] = worths = choose_worths(halves, crossings, worths, pattern, target)
            if worths.bound < target:
                continue
            tight = False
            filled = _fill(halves, worths, crossings, target, most, bridgeless)
            if filled is None:
                return Proof(proven, None, with_bridges, kept, peak)
            sizes = [len(origin) for fillings in filled for origin in fillings.origins]
            kept, peak = kept + sum(sizes), max(peak, *sizes)
            least = worths.least(crossings, target)
            found = _fit(upper.width, filled[0], filled[-1], crossings, target, least, bridgeless)
            if found and (best is None or found[0] > best[0]):
                ends = _trace(upper, filled[0], found[1]), _MIRRORED[_trace(lower, filled[-1], found[2])[::-1]]
                best = found[0], np.concatenate(ends)
        proven = best[0] if best else target - 1
        with_bridges = target - 1 if tight else with_bridges
        if best:
            return Proof(proven, best[1], with_bridges, kept, peak)
    return Proof(-1, None, with_bridges, kept, peak)


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
    rests = [find_rests(half, worth, worths.price) for half, worth in zip(halves, worths.labels, strict=True)]
    tops, least = [int(rest[0][0]) for rest in rests], worths.least(crossings, target)
    highest = []
    for half, worth, rest, other in zip(halves, worths.labels, rests, tops[::-1], strict=True):
        keys, values = np.zeros((1, 1), np.uint64), np.zeros((1, 1), np.int64)
        for number, layer in enumerate(half.layers):
            column = number // half.height
            keys, values, used = _extend_pattern(
                layer, column, keys, values, rest[number + 1], worth[column], worths.price, least - other, most
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
        if partner is not None and value + partner >= least:
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


class _Fillings(NamedTuple):
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


def _fill(
    halves: tuple[Half, ...], worths: Worths, crossings: int, target: int, most: int, bridgeless: bool
) -> list[_Fillings] | None:
    """Finds the ways to fill each half that may be of a network of a score; None if they are too many."""
    rests = [find_rests(half, worth, worths.price) for half, worth in zip(halves, worths.labels, strict=True)]
    tops, least = [int(rest[0][0]) for rest in rests], worths.least(crossings, target)
    filled = []
    for half, worth, rest, other in zip(halves, worths.labels, rests, tops[::-1], strict=True):
        found = _fill_half(half, worth, worths.price, rest, least - other, most, bridgeless)
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
) -> _Fillings | None:
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
    return _Fillings(states, values, origins, places)


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


def _fit(
    width: int, upper: _Fillings, lower: _Fillings, crossings: int, target: int, least: int, bridgeless: bool
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


# The code of each tile with the grid upside down.
_MIRRORED = np.array([code & 5 | code << 2 & 8 | code >> 2 & 2 for code in range(16)], np.int8)


def _trace(half: Half, fillings: _Fillings, number: int) -> NDArray[np.int8]:
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
