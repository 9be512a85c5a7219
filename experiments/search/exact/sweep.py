"""An exact dynamic programme over the flawless networks of a grid.

A broken line sweeps the cells row by row. All that the cells before it have in common with those after it is a state:
the roads that cross the line, what tile each comes from, how long its straight is, and which of them hang together. Two
beginnings in the same state have the same continuations. So of all with as many cycles only the best counts.

A network is flawless if it has one component and no dead end, boundary violation, mismatch, adjacent crossings or
adjacent turns. Of the fitness its cycles, its straights and its bridges remain. Straights and cycles add up as the line
goes on. Bridges do not: where they are to be avoided, the state also has the links that still could become one.

A state has 16 bits for each place of the line, four places a word: from the lowest, four bits for the kind of the tile
before the line, four for the number of the component, four for the splits that begin here, four for those that end
here. A split is a set of the component's roads that some link alone holds to the others. Splits are nested intervals of
the component's roads, as the roads are in the plane. Before the cell of column c, place c is the side between it and
the cell to its left, places before are lower sides of its row, and places after of the row above.
"""

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = [
    *("BESIDE_TURN", "CROSSING", "STRAIGHT", "TURN", "Cell", "Sweep", "decode", "encode", "find", "insert"),
    *("join_splits", "sweep", "tile_of"),
]

# Kinds. Without a road: what is before the line is a turn, or anything else. With one: a turn, a crossing, or
# STRAIGHT + L for a straight of L tiles so far.
_CLEAR, BESIDE_TURN, TURN, CROSSING, STRAIGHT = 0, 1, 2, 3, 3

_WITHOUT_KINDS = np.uint64(0xFFF0FFF0FFF0FFF0)
_NEVER = 1 << 20


class Cell(NamedTuple):
    """The next cell, and what is asked of networks.

    Attributes:
      height: of the grid, 15 at most.
      width: of the grid, 15 at most.
      row: of the cell.
      column: of the cell.
      fill: whether no cell may be empty.
      lengths: whether straights are told apart by their length.
      bridgeless: whether no link may be a bridge.
      counting: whether values are numbers of networks, to be summed, or scores, of which the highest counts.
    """

    height: int
    width: int
    row: int
    column: int
    fill: bool
    lengths: bool
    bridgeless: bool
    counting: bool


class Sweep(NamedTuple):
    """The result of a sweep, by cyclomatic number.

    Attributes:
      values: float ``[C]``, the number of networks, or the highest straight score; not a number where there is none.
      witnesses: by cyclomatic number an int8 grid ``[H, W]`` with that score; none if networks were counted.
      states: the sum over all lines.
      peak: the most on one line.
    """

    values: NDArray[np.float64]
    witnesses: dict[int, NDArray[np.int8]]
    states: int
    peak: int


def sweep(
    shape: tuple[int, int],
    bins: int,
    *,
    fill: bool,
    counting: bool = False,
    bridgeless: bool = False,
    thin: bool = True,
) -> Sweep:
    """Goes over all flawless networks of a grid.

    Args:
      shape: (height, width), each 2 to 14; a narrow grid takes less time.
      bins: C, cyclomatic numbers from 0 on; networks with more are left out.
      fill: whether no cell may be empty.
      counting: whether networks are counted, or the highest straight score is found.
      bridgeless: whether no link may be a bridge.
      thin: whether states that cannot be better than another are dropped; it changes no score.

    Raises:
      OverflowError: if a count may not be exact.
    """
    height, width = shape
    states = np.zeros((1, width // 4 + 1), np.uint64)
    # Values begin at 1, as 0 stands for none: 1 beginning, or a score plus 1.
    values, final = np.zeros((2, 1, bins), np.int64)
    values[0, 0] = 1
    final_origins = np.zeros((1, bins), np.int32)
    last = np.zeros(bins, int)
    total = peak = 0
    with tempfile.TemporaryDirectory(prefix="frontier-") as folder:
        for number, (row, column) in enumerate(np.ndindex(shape)):
            cell = Cell(height, width, row, column, fill, not counting, bridgeless, counting)
            before = final.copy()
            *table, used = _advance(cell, states, values, final, final_origins)
            states, values, origins = (column[used] for column in table)
            last[(final != before)[0]] = number
            # A value is the sum of fewer than 2^12: it has not wrapped around unnoticed.
            if counting and max(values.max(initial=0), final.max()) >= 2**51:
                raise OverflowError("more networks than can be counted")
            if not counting:
                if thin and len(states):
                    following = cell._replace(row=row + (column + 1) // width, column=(column + 1) % width)
                    kept = _undominated(following, states, values)
                    states, values, origins = states[kept], values[kept], origins[kept]
                np.save(Path(folder) / f"{number}.npy", origins)
            total, peak = total + len(states), max(peak, len(states))
        witnesses = {}
        if not counting:
            for found in np.flatnonzero(final).tolist():
                witnesses[found] = _trace(Path(folder), shape, found, int(last[found]), int(final_origins[0, found]))
    scores = final[0].astype(float) - (not counting)
    return Sweep(np.where(final[0] > 0, scores, np.nan), witnesses, total, peak)


def _trace(folder: Path, shape: tuple[int, int], cycles: int, number: int, origin: int) -> NDArray[np.int8]:
    """Makes the network whose last road tile is the cell of that number, by the origins of its states."""
    links = np.zeros((shape[0] * shape[1], 2), int)  # to the right and down
    while True:
        place, cycle, *links[number] = origin >> 3, origin >> 2 & 1, origin >> 1 & 1, origin & 1
        cycles, number = cycles - cycle, number - 1
        if number < 0:
            break
        origin = int(np.load(folder / f"{number}.npy", mmap_mode="r")[place, cycles])
    right, down = np.moveaxis(links.reshape(*shape, 2), -1, 0)
    left, up = np.roll(right, 1, axis=1), np.roll(down, 1, axis=0)
    return (8 * up + 4 * right + 2 * down + left).astype(np.int8)


@numba.njit(cache=True)
def _advance(cell: Any, old: Any, old_values: Any, final: Any, final_origins: Any) -> Any:
    """Takes the line past one cell; returns states, values and origins.

    The origin of a value is eight times the number of its state before the cell, and in the three lowest bits whether a
    cycle was closed, whether the cell has a link to the right, and whether it has one down.
    """
    height, width, row, column = cell.height, cell.width, cell.row, cell.column
    places, bins = width + 1, old_values.shape[1]
    capacity = 1 << 12
    while capacity < len(old):
        capacity *= 2
    states = np.zeros((capacity, old.shape[1]), np.uint64)
    values = np.zeros((capacity, bins), np.int64)
    origins = np.zeros((capacity, 0 if cell.counting else bins), np.int32)
    used = np.zeros(capacity, np.bool_)
    size = 0
    kinds, blocks, new_kinds, new_blocks = np.zeros((4, places), np.int64)
    splits, owners, new_splits, new_owners = np.zeros((4, 4 * places), np.int64)
    members = np.zeros(places + 2, np.int64)
    state = np.zeros(old.shape[1], np.uint64)
    left_bit, up_bit = 1 << column, 1 << column + 1
    for source in range(len(old)):
        count = decode(old, source, kinds, blocks, splits, owners)
        components = 0
        for place in range(places + 2):
            members[place] = 0
        for place in range(places):
            members[blocks[place]] |= 1 << place
            components = max(components, blocks[place])
        left, up = blocks[column], blocks[column + 1]
        for choice in range(4):
            right, down = choice >> 1, choice & 1
            if (right and column == width - 1) or (down and row == height - 1):
                continue
            gain, right_kind, down_kind = tile_of(cell, kinds[column], kinds[column + 1], right, down)
            if gain < 0:
                continue
            for place in range(places):
                new_kinds[place], new_blocks[place] = kinds[place], blocks[place]
            own = up if up else left if left else components + 1
            if up and left:
                for place in range(places):
                    if new_blocks[place] == left:
                        new_blocks[place] = up
            new_kinds[column], new_kinds[column + 1] = down_kind, right_kind
            new_blocks[column], new_blocks[column + 1] = own * down, own * right
            cycle = np.int64(up == left and up > 0)
            road = up or left or right or down
            new_count = 0
            ended = False
            if road:
                mine = others = 0
                for place in range(places):
                    if new_blocks[place] == own:
                        mine |= 1 << place
                    elif new_blocks[place]:
                        others |= 1 << place
                if mine == 0:  # the component is complete: it has to be the whole network
                    if others or (cell.fill and (row < height - 1 or column < width - 1)):
                        continue
                    ended = True
                elif cell.bridgeless:
                    taken = (up_bit if up else 0) | (left_bit if left else 0)
                    for number in range(count):
                        new_splits[number], new_owners[number] = splits[number], owners[number]
                    new_count = join_splits(members, up, left, taken, own, mine, count, new_splits, new_owners)
                    if new_count < 0:
                        continue
            elif cell.bridgeless:
                new_count = count
                for number in range(count):
                    new_splits[number], new_owners[number] = splits[number], owners[number]
            origin = source << 3 | cycle << 2 | choice
            if ended:
                _offer(cell, old_values, source, gain, cycle, origin, final, final_origins, 0)
                continue
            encode(state, new_kinds, new_blocks, new_splits, new_count, np.int64(column == width - 1))
            place, size, states, values, origins, used = insert(size, states, values, origins, used, state)
            _offer(cell, old_values, source, gain, cycle, origin, values, origins, place)
    return states, values, origins, used


@numba.njit(cache=True)
def tile_of(cell: Any, left: Any, up: Any, right: Any, down: Any) -> Any:
    """Returns what a tile adds to the straight score, and the kinds to its right and below it; -1 if it may not be."""
    has_left, has_up = left >= TURN, up >= TURN
    connections = has_left + has_up + right + down
    if connections == 0:
        return -1 if cell.fill else 0, _CLEAR, _CLEAR
    if connections == 1:
        return -1, _CLEAR, _CLEAR
    if connections > 2:
        if left == CROSSING or up == CROSSING:
            return -1, _CLEAR, _CLEAR
        return 0, CROSSING * right, CROSSING * down
    if has_up != down:
        if left in (TURN, BESIDE_TURN) or up in (TURN, BESIDE_TURN):
            return -1, _CLEAR, _CLEAR
        right_kind = _CLEAR if cell.column == cell.width - 1 else TURN if right else BESIDE_TURN
        return 0, right_kind, TURN if down else BESIDE_TURN
    before = up if has_up else left
    length = before - STRAIGHT + 1 if before > STRAIGHT else 1
    kind = STRAIGHT + (length if cell.lengths else 1)
    return 2 * length - 1, kind * right, kind * down


@numba.njit(cache=True)
def join_splits(
    members: Any, up: Any, left: Any, taken: Any, own: Any, mine: Any, count: Any, splits: Any, owners: Any
) -> Any:
    """Changes splits as roads meet in a tile; returns their number, or -1 if some link has become a bridge.

    Args:
      members: the places of each component before the tile, as bits.
      up: the component of the road from above, or 0.
      left: that of the road from the left, or 0.
      taken: the places of these roads.
      own: the component of the tile.
      mine: the places of that component after the tile.
      count: of splits.
      splits: the places of each split's roads, changed here.
      owners: the component of each split, changed here.
    """
    if mine & mine - 1 == 0:
        return -1
    kept = 0
    for number in range(count):
        owner, side = owners[number], splits[number]
        if owner in (up, left):
            inside = side & taken
            if inside and inside != taken & members[owner]:
                continue  # a cycle through the tile has the link
            splits[kept], owners[kept] = members[owner] & ~side if inside else side, own
        else:
            splits[kept], owners[kept] = side, owner
        kept += 1
    if up != left:
        for component in (up, left):
            if component:
                splits[kept], owners[kept] = members[component] & ~taken, own
                kept += 1
    count, kept = kept, 0
    for number in range(count):
        side, owner = splits[number], owners[number]
        if owner == own:
            rest = mine & ~side
            if side == 0 or rest == 0:
                return -1
            if side & (mine & -mine):
                side, rest = rest, side
            # The link of a single road is the road's own, which is looked after when the road goes on.
            known = side & side - 1 == 0 or rest & rest - 1 == 0
            for earlier in range(kept):
                known |= splits[earlier] == side
            if known:
                continue
        splits[kept], owners[kept] = side, owner
        kept += 1
    return kept


@numba.njit(cache=True)
def _offer(
    cell: Any, values: Any, source: Any, gain: Any, cycle: Any, origin: Any, into: Any, origins: Any, place: Any
) -> None:
    """Offers the values of a state to one that follows it."""
    for cycles in range(values.shape[1] - cycle):
        value = values[source, cycles]
        if value > 0:
            if cell.counting:
                into[place, cycles + cycle] += value
            elif value + gain > into[place, cycles + cycle]:
                into[place, cycles + cycle] = value + gain
                origins[place, cycles + cycle] = origin


@numba.njit(cache=True)
def decode(states: Any, number: Any, kinds: Any, blocks: Any, splits: Any, owners: Any) -> Any:
    """Reads one of the states; returns the number of splits."""
    count = 0
    for place in range(len(kinds)):
        code = np.int64(states[number, place >> 2] >> np.uint64(16 * (place & 3))) & 0xFFFF
        kinds[place], blocks[place] = code & 15, code >> 4 & 15
        if code >> 8 & 15:
            for _ in range(code >> 8 & 15):
                splits[count], owners[count] = -1 << place, blocks[place]  # open: all places from here on
                count += 1
        for _ in range(code >> 12):  # the one of this component that was opened last ends
            last = count - 1
            while owners[last] != blocks[place] or splits[last] >= 0:
                last -= 1
            splits[last] &= (2 << place) - 1
    for number in range(count):
        members = 0
        for place in range(len(kinds)):
            if blocks[place] == owners[number]:
                members |= 1 << place
        splits[number] &= members
    return count


@numba.njit(cache=True)
def encode(state: Any, kinds: Any, blocks: Any, splits: Any, count: Any, shift: Any) -> None:
    """Writes a state, its components numbered as they come; past the end of a row all moves on by one place."""
    places = len(kinds)
    numbers, opens, closes = np.zeros(places + 2, np.int64), np.zeros(places, np.int64), np.zeros(places, np.int64)
    for number in range(count):
        first = last = 0
        while not splits[number] >> first & 1:
            first += 1
        last = first
        while splits[number] >> last + 1:
            last += 1
        opens[first] += 1
        closes[last] += 1
    for word in range(len(state)):
        state[word] = 0
    highest = 0
    for place in range(places - shift):
        block = blocks[place]
        if block and numbers[block] == 0:
            highest += 1
            numbers[block] = highest
        code = kinds[place] | numbers[block] << 4 | opens[place] << 8 | closes[place] << 12
        state[place + shift >> 2] |= np.uint64(code) << np.uint64(16 * (place + shift & 3))


@numba.njit(cache=True)
def find(states: Any, used: Any, state: Any) -> Any:
    """Returns where a state is in a hash table, or should be."""
    mixed = np.uint64(0)
    for word in range(len(state)):
        mixed = (mixed ^ state[word]) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    mixed *= np.uint64(0xBF58476D1CE4E5B9)
    place = np.int64((mixed ^ mixed >> np.uint64(32)) & np.uint64(len(used) - 1))
    while used[place]:
        same = True
        for word in range(len(state)):
            same &= states[place, word] == state[word]
        if same:
            break
        place = place + 1 & len(used) - 1
    return place


@numba.njit(inline="always")  # counting takes a quarter longer with a call
def insert(size: Any, states: Any, values: Any, origins: Any, used: Any, state: Any) -> Any:
    """Finds a state in a hash table of so many states, or adds it; returns its place, the number, and the table."""
    place = find(states, used, state)
    if not used[place]:
        if 3 * size > 2 * len(used):
            states, values, origins, used = _rehash(2 * len(used), states, values, origins, used)
            place = find(states, used, state)
        used[place] = True
        for word in range(len(state)):
            states[place, word] = state[word]
        size += 1
    return place, size, states, values, origins, used


@numba.njit(cache=True)
def _rehash(capacity: Any, states: Any, values: Any, origins: Any, used: Any) -> Any:
    """Moves a hash table to a larger one."""
    new_states = np.zeros((capacity, states.shape[1]), np.uint64)
    new_values = np.zeros((capacity, values.shape[1]), np.int64)
    new_origins = np.zeros((capacity, origins.shape[1]), np.int32)
    new_used = np.zeros(capacity, np.bool_)
    state = np.zeros(states.shape[1], np.uint64)
    for old in range(len(used)):
        if used[old]:
            for word in range(len(state)):
                state[word] = states[old, word]
            place = find(new_states, new_used, state)
            new_used[place] = True
            for word in range(len(state)):
                new_states[place, word] = state[word]
            for cycles in range(values.shape[1]):
                new_values[place, cycles] = values[old, cycles]
            for cycles in range(origins.shape[1]):
                new_origins[place, cycles] = origins[old, cycles]
    return new_states, new_values, new_origins, new_used


def _undominated(cell: Cell, states: NDArray[np.uint64], values: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Removes values that another state's value is as good as, whatever follows; returns which states keep any.

    A state is compared with others of the same roads, components and splits, the highest values first. A straight may
    go on as anything, a turn not as a turn, a crossing not as a crossing. A straight that is longer by L gains at most
    2 L for each tile that it may still grow by.
    """
    groups = states & _WITHOUT_KINDS
    order = np.lexsort((-values.max(axis=1), *groups.T))
    changes = (groups[order[1:]] != groups[order[:-1]]).any(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], changes, [True]]))
    kinds = np.empty((len(states), cell.width + 1), np.int8)
    return _remove_dominated(cell, states, values, order, starts, kinds)


@numba.njit(cache=True)
def _remove_dominated(cell: Any, states: Any, values: Any, order: Any, starts: Any, kinds: Any) -> Any:
    """Removes values from groups of states, given in order and where each group starts; returns which keep any."""
    places, bins = cell.width + 1, values.shape[1]
    growth = np.zeros(places, np.int64)
    for place in range(places):
        rows = cell.height - 1 - cell.row - np.int64(place < cell.column)
        growth[place] = 2 * max(0, cell.width - 1 - cell.column if place == cell.column else rows)
    alive = np.zeros(len(states), np.bool_)
    for group in range(len(starts) - 1):
        first, kept = starts[group], starts[group]  # those kept take the places of those before them
        for member in range(first, starts[group + 1]):
            number = order[member]
            for column in range(places):
                kinds[kept, column] = np.int64(states[number, column >> 2] >> np.uint64(16 * (column & 3))) & 15
            remain = 0
            for cycles in range(bins):
                remain += values[number, cycles] > 0
            for rival in range(first, kept):
                slack = 0
                for column in range(places):
                    theirs, mine = kinds[rival, column], kinds[kept, column]
                    if theirs != mine and theirs != _CLEAR:
                        if theirs <= STRAIGHT:
                            slack = _NEVER
                            break
                        slack += growth[column] * max(0, mine - theirs)
                if slack == _NEVER:
                    continue
                for cycles in range(bins):
                    if values[number, cycles] and values[order[rival], cycles] >= values[number, cycles] + slack:
                        values[number, cycles] = 0
                        remain -= 1
                if remain == 0:
                    break
            alive[number] = remain > 0
            if remain:
                order[kept] = number
                kept += 1
    return alive
