"""What hangs together along the line that sweeps over a grid, and which links still could be bridges.

A state has 16 bits for each place of the line, four places a word. From the lowest: four bits for the kind of the tile
before the line (see `tiles`), four for the number of the component, four for the splits that begin here, four for those
that end here. A split is a set of the component's roads that a single link holds to the others. As the roads are in the
plane, splits are nested intervals of the component's roads.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from experiments.search.exact.graph import Integer

__all__ = ["CLOSED", "Line", "encode", "lay", "make_line", "read"]

CLOSED = -2
"""What `lay` returns when the tile closes a component, so that no road of it crosses the line."""


class Line(NamedTuple):
    """A state that was read, and the next one, to be written.

    Attributes:
      kinds: int64 ``[2, P]``, the kinds of both states.
      blocks: int64 ``[2, P]``, the component of each place, 0 without a road.
      splits: int64 ``[2, 4 P]``, the places of each split's roads, as bits.
      owners: int64 ``[2, 4 P]``, the component of each split.
      members: int64 ``[P + 2]``, the places of each component of the state that was read, as bits.
    """

    kinds: NDArray[np.int64]
    blocks: NDArray[np.int64]
    splits: NDArray[np.int64]
    owners: NDArray[np.int64]
    members: NDArray[np.int64]


@numba.njit(cache=True)
def make_line(places: int) -> Line:
    """Makes room for two states of so many places."""
    kinds, blocks = np.zeros((2, places), np.int64), np.zeros((2, places), np.int64)
    splits, owners = np.zeros((2, 4 * places), np.int64), np.zeros((2, 4 * places), np.int64)
    return Line(kinds, blocks, splits, owners, np.zeros(places + 2, np.int64))


@numba.njit(cache=True)
def read(state: NDArray[np.uint64], line: Line) -> int:
    """Reads a state; returns the number of splits."""
    kinds, blocks, splits, owners = line.kinds[0], line.blocks[0], line.splits[0], line.owners[0]
    line.members[:] = 0
    count = 0
    for place in range(len(kinds)):
        code = np.int64(state[place >> 2] >> np.uint64(16 * (place & 3))) & 0xFFFF
        kinds[place], blocks[place] = code & 15, code >> 4 & 15
        line.members[blocks[place]] |= 1 << place
        for _ in range(code >> 8 & 15):
            splits[count], owners[count] = -1 << place, blocks[place]  # open: all places from here on
            count += 1
        for _ in range(code >> 12):  # the split of this component that was opened last ends
            last = count - 1
            while owners[last] != blocks[place] or splits[last] >= 0:
                last -= 1
            splits[last] &= (2 << place) - 1
    for split in range(count):
        splits[split] &= line.members[owners[split]]
    return count


@numba.njit(cache=True)
def encode(line: Line, count: Integer, shift: Integer, state: NDArray[np.uint64]) -> None:
    """Writes the next state, its components numbered as they come.

    Args:
      line: has the next state.
      count: of its splits.
      shift: places by which everything moves on; 1 at the end of a row, 0 elsewhere.
      state: written to.
    """
    kinds, blocks, splits = line.kinds[1], line.blocks[1], line.splits[1]
    places = len(kinds)
    numbers, opens, closes = np.zeros(places + 2, np.int64), np.zeros(places, np.int64), np.zeros(places, np.int64)
    for split in range(count):
        first = last = 0
        while not splits[split] >> first & 1:
            first += 1
        last = first
        while splits[split] >> last + 1:
            last += 1
        opens[first] += 1
        closes[last] += 1
    state[:] = 0
    highest = 0
    for place in range(places - shift):
        block = blocks[place]
        if block and numbers[block] == 0:
            highest += 1
            numbers[block] = highest
        code = kinds[place] | numbers[block] << 4 | opens[place] << 8 | closes[place] << 12
        state[place + shift >> 2] |= np.uint64(code) << np.uint64(16 * (place + shift & 3))


@numba.njit(cache=True)
def lay(line: Line, count: Integer, at: Integer, right: Integer, down: Integer, bridgeless: bool) -> Integer:
    """Lays a tile: writes the components and the splits of the next state.

    Args:
      line: has the state before.
      count: of its splits.
      at: the place to the left of the tile. The place above it is the next one.
      right: 1 if the tile has a link to the right.
      down: 1 if it has a link down.
      bridgeless: whether no link may be a bridge. If bridges do not matter, there are no splits.

    Returns:
      The number of splits; `CLOSED` if no road of the component is left; -1 if some link has become a bridge.
    """
    blocks, new = line.blocks[0], line.blocks[1]
    left, up = blocks[at], blocks[at + 1]
    line.splits[1, :count], line.owners[1, :count] = line.splits[0, :count], line.owners[0, :count]
    if not (left or up or right or down):
        new[:] = blocks
        return count
    own = up if up else left if left else blocks.max() + 1
    mine = 0
    for place in range(len(blocks)):
        new[place] = up if up and left and blocks[place] == left else blocks[place]
    new[at], new[at + 1] = own * down, own * right
    for place in range(len(blocks)):
        if new[place] == own:
            mine |= 1 << place
    if mine == 0:
        return CLOSED
    if not bridgeless:
        return 0
    taken = (1 << at + 1 if up else 0) | (1 << at if left else 0)
    return _join_splits(line.members, up, left, taken, own, mine, count, line.splits[1], line.owners[1])


@numba.njit(cache=True)
def _join_splits(
    members: NDArray[np.int64],
    up: Integer,
    left: Integer,
    taken: Integer,
    own: Integer,
    mine: Integer,
    count: Integer,
    splits: NDArray[np.int64],
    owners: NDArray[np.int64],
) -> int:
    """Changes splits as roads meet in a tile; returns their number, or -1 if some link has become a bridge.

    Args:
      members: the places of each component before the tile, as bits.
      up: the component of the road from above, or 0.
      left: the component of the road from the left, or 0.
      taken: the places of these two roads.
      own: the component of the tile.
      mine: the places of that component after the tile.
      count: of splits.
      splits: changed here.
      owners: changed here.
    """
    if mine & mine - 1 == 0:
        return -1
    kept = 0
    for split in range(count):
        owner, side = owners[split], splits[split]
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
    for split in range(count):
        side, owner = splits[split], owners[split]
        if owner == own:
            rest = mine & ~side
            if side == 0 or rest == 0:
                return -1
            if side & (mine & -mine):
                side, rest = rest, side
            # The link of a single road is the road's own link, which is checked when the road goes on.
            known = side & side - 1 == 0 or rest & rest - 1 == 0
            for earlier in range(kept):
                known |= splits[earlier] == side
            if known:
                continue
        splits[kept], owners[kept] = side, owner
        kept += 1
    return kept
