"""An exact dynamic programme over the flawless networks of a grid.

A broken line sweeps over the cells row by row. A state is what the cells before the line have in common with those
after it: the roads that cross the line, the tile that each comes from, the length of its straight, and which roads hang
together. Two beginnings with the same state have the same continuations. So of all beginnings with the same number of
cycles only the best counts; or of all with the same numbers of cycles and of tiles of a kind.

A network is flawless if it has one component and no dead end, boundary violation, mismatch, adjacent crossings or
adjacent turns. Then its fitness depends on its cycles, its straights and its bridges. Straights and cycles add up as
the line goes on. Bridges do not: to avoid them, a state also has the links that still could become one.

Before the cell of column c, place c of the line is the side between it and the cell to its left. Earlier places are
lower sides of its row, later ones lower sides of the row above.
"""

import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.components import CLOSED, encode, lay, make_line, read
from experiments.search.exact.graph import NEVER, carry_best, carry_counts, merge
from experiments.search.exact.tiles import CLEAR, COUNTED, NO_TILE, STRAIGHT, tile_of, type_of

__all__ = ["Sweep", "sweep"]

_KINDS = np.uint64(0x000F000F000F000F)
_FINISHED = np.uint64(2**64 - 1)
"""All words of the state of a finished network. Empty cells follow."""

_IMPOSSIBLE = 1 << 20


class Sweep(NamedTuple):
    """The result of a sweep, by cyclomatic number, and by the number of tiles of a kind if these were counted.

    Attributes:
      values: float ``[C]`` or ``[C, D]``, the number of networks, or the highest straight score; NaN if there is no
        network.
      witnesses: by index of `values`, an int8 grid ``[H, W]`` with that score; empty if networks were counted. The
        index is a number for values ``[C]``, a pair for values ``[C, D]``.
      states: the number of states, summed over all cells.
      peak: the most states after one cell.
    """

    values: NDArray[np.float64]
    witnesses: dict[Any, NDArray[np.int8]]
    states: int
    peak: int


class _Cell(NamedTuple):
    """A cell, and what is asked of networks: see `sweep`; `lengths` as in `tile_of`.

    `tile` is the counted kind of tile, `NO_TILE` if none is. A cycle adds `stride` to the number of a bin.
    """

    height: int
    width: int
    row: int
    column: int
    fill: bool
    lengths: bool
    bridgeless: bool
    tile: int
    stride: int


def sweep(
    shape: tuple[int, int],
    bins: int,
    *,
    fill: bool,
    counting: bool = False,
    bridgeless: bool = False,
    thin: bool = True,
    tiles: str | None = None,
) -> Sweep:
    """Sweeps over all flawless networks of a grid.

    Args:
      shape: (height, width), each 2 to 14; a narrow grid takes less time.
      bins: C. Networks with cyclomatic numbers of C and more are left out.
      fill: whether no cell may be empty.
      counting: whether networks are counted, or the highest straight score is found.
      bridgeless: whether no link may be a bridge.
      thin: whether to drop states that cannot be better than another. It changes no score.
      tiles: a second descriptor, ``turns``, ``crossings`` or ``straights``: values are also by the number of these.

    Raises:
      OverflowError: if a count may not be exact.
    """
    height, width = shape
    states = np.zeros((1, width // 4 + 1), np.uint64)
    # A network has at most one turn in each pair of neighbours, and fewer crossings than other tiles.
    levels = 1 if tiles is None else 1 + (height * width if tiles == "straights" else (height * width + 1) // 2)
    tile = NO_TILE if tiles is None else COUNTED[tiles]
    values = np.full((1, bins * levels), 0 if counting else NEVER)
    values[0, 0] = int(counting)
    total = peak = 0
    with tempfile.TemporaryDirectory(prefix="sweep-") as folder:
        for index, (row, column) in enumerate(np.ndindex(shape)):
            cell = _Cell(height, width, row, column, fill, not counting, bridgeless, tile, levels)
            rows, source, gain, shift, choice = _expand(cell, states)
            target, states = merge(rows)
            if counting:
                values = carry_counts(len(states), source, target, shift, values)
                # A value is the sum of fewer than 2^12: it has not wrapped around unnoticed.
                if values.max(initial=0) >= 2**51:
                    raise OverflowError("more networks than can be counted")
            else:
                values, way = carry_best(len(states), source, target, gain, shift, values)
                if thin:
                    following = cell._replace(row=row + (column + 1) // width, column=(column + 1) % width)
                    kept = _undominated(following, states, values)
                    states, values, way = states[kept], values[kept], way[kept]
                # 27 bits for the state, and four for the cycle, the counted tile and the links.
                cycle, counted = np.divmod(shift, levels) if levels > 1 else (shift, 0 * shift)
                origins = source << 4 | cycle << 3 | counted << 2 | choice
                np.save(Path(folder) / f"{index}.npy", origins[way])
            unfinished = int((states[:, 0] != _FINISHED).sum())
            total, peak = total + unfinished, max(peak, unfinished)
        finished = (states == _FINISHED).all(axis=1)
        best = values[finished].reshape(-1, bins * levels).max(axis=0, initial=0 if counting else NEVER)
        found = best > 0 if counting else best > NEVER
        witnesses: dict[Any, NDArray[np.int8]] = {}
        if not counting:
            for number in np.flatnonzero(found).tolist():
                niche = number if tiles is None else divmod(number, levels)
                final = int(np.flatnonzero(finished)[0])
                witnesses[niche] = _trace(Path(folder), shape, number, levels, final)
    by_niche = np.where(found, best.astype(float), np.nan)
    return Sweep(by_niche if tiles is None else by_niche.reshape(bins, levels), witnesses, total, peak)


def _trace(folder: Path, shape: tuple[int, int], number: int, stride: int, state: int) -> NDArray[np.int8]:
    """Makes the grid of the network of a bin that ends in a state, by the origins of the states."""
    links = np.zeros((shape[0] * shape[1], 2), int)  # to the right and down
    for index in reversed(range(len(links))):
        origin = int(np.load(folder / f"{index}.npy", mmap_mode="r")[state, number])
        number -= stride * (origin >> 3 & 1) + (origin >> 2 & 1)
        state, links[index] = origin >> 4, (origin >> 1 & 1, origin & 1)
    right, down = np.moveaxis(links.reshape(*shape, 2), -1, 0)
    left, up = np.roll(right, 1, axis=1), np.roll(down, 1, axis=0)
    return (8 * up + 4 * right + 2 * down + left).astype(np.int8)


@numba.njit(cache=True)
def _expand(
    cell: _Cell, states: NDArray[np.uint64]
) -> tuple[NDArray[np.uint64], NDArray[np.int32], NDArray[np.int64], NDArray[np.int16], NDArray[np.int8]]:
    """Lists the edges of a cell.

    Returns:
      The state after each, the index of the state before, what the tile adds to the straight score, what it adds to the
      number of the bin, and its links: 2 for one to the right, plus 1 for one down.
    """
    height, width, row, column = cell.height, cell.width, cell.row, cell.column
    last = row == height - 1 and column == width - 1
    most, count = 4 * len(states), 0
    rows, source = np.empty((most, states.shape[1]), np.uint64), np.empty(most, np.int32)
    gains, shifts, choices = np.empty(most, np.int64), np.empty(most, np.int16), np.empty(most, np.int8)
    line = make_line(width + 1)
    for state in range(len(states)):
        if states[state, 0] == _FINISHED:
            rows[count] = _FINISHED
            source[count], gains[count], shifts[count], choices[count] = state, 0, 0, 0
            count += 1
            continue
        splits = read(states[state], line)
        left, up = line.blocks[0, column], line.blocks[0, column + 1]
        for choice in range(4):
            right, down = choice >> 1, choice & 1
            if (right and column == width - 1) or (down and row == height - 1):
                continue
            before = line.kinds[0, column], line.kinds[0, column + 1]
            gain, right_kind, down_kind = tile_of(*before, right, down, cell.fill, cell.lengths)
            if gain < 0:
                continue
            new_splits = lay(line, splits, column, right, down, cell.bridgeless)
            if new_splits == CLOSED:  # then the component has to be the whole network
                if line.blocks[1].any() or (cell.fill and not last):
                    continue
                rows[count] = _FINISHED
            elif new_splits < 0:
                continue
            else:
                line.kinds[1] = line.kinds[0]
                line.kinds[1, column] = down_kind
                line.kinds[1, column + 1] = CLEAR if column == width - 1 else right_kind
                encode(line, new_splits, np.int64(column == width - 1), rows[count])
            source[count], gains[count], choices[count] = state, gain, choice
            shifts[count] = cell.stride if up == left and up > 0 else 0
            if cell.tile != NO_TILE and type_of(*before, right, down) == cell.tile:
                shifts[count] += 1
            count += 1
    return rows[:count], source[:count], gains[:count], shifts[:count], choices[:count]


def _undominated(cell: _Cell, states: NDArray[np.uint64], values: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Removes values that cannot become better than another state's value; returns which states keep any.

    A state is compared with others of the same roads, components and splits, the highest values first. A straight may
    go on as anything, a turn not as a turn, a crossing not as a crossing. A straight that is longer by L gains at most
    2 L for each tile that it may still grow by.
    """
    places = np.arange(cell.width + 1)
    kinds = (states[:, places >> 2] >> (16 * (places & 3)).astype(np.uint64) & np.uint64(15)).astype(np.int8)
    groups, freedom = states & ~_KINDS, np.where(kinds == CLEAR, 15, kinds).sum(axis=1)
    order = np.lexsort((-freedom, -values.max(axis=1), *groups.T))
    changes = (groups[order[1:]] != groups[order[:-1]]).any(axis=1)
    starts = np.flatnonzero(np.concatenate([[True], changes, [True]]))
    rows = cell.height - 1 - cell.row - (places < cell.column)
    growth = 2 * np.where(places == cell.column, cell.width - 1 - cell.column, rows).clip(0)
    return _remove_dominated(values, order, starts, kinds, growth)


@numba.njit(cache=True)
def _remove_dominated(
    values: NDArray[np.int64],
    order: NDArray[np.int64],
    starts: NDArray[np.int64],
    kinds: NDArray[np.int8],
    growth: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Removes values from groups of states.

    Args:
      values: ``[S, B]``, changed here.
      order: ``[S]``, the states group by group, changed here.
      starts: ``[G + 1]``, where each group starts.
      kinds: ``[S, P]``, of each place.
      growth: ``[P]``, the most that a straight gains at each place by being one tile longer now.

    Returns:
      Which states keep a value.
    """
    alive = np.zeros(len(values), np.bool_)
    for group in range(len(starts) - 1):
        first, kept = starts[group], starts[group]  # states that stay move to the front of their group
        for member in range(first, starts[group + 1]):
            state = order[member]
            remain = (values[state] != NEVER).sum()
            for rival in order[first:kept]:
                slack = 0
                for place in range(len(growth)):
                    theirs, mine = kinds[rival, place], kinds[state, place]
                    if theirs != mine and theirs != CLEAR:
                        if theirs <= STRAIGHT:
                            slack = _IMPOSSIBLE
                            break
                        slack += growth[place] * max(0, mine - theirs)
                if slack == _IMPOSSIBLE:
                    continue
                for number in range(values.shape[1]):
                    if values[state, number] != NEVER and values[rival, number] >= values[state, number] + slack:
                        values[state, number] = NEVER
                        remain -= 1
                if remain == 0:
                    break
            alive[state] = remain > 0
            if remain:
                order[kept] = state
                kept += 1
    return alive
