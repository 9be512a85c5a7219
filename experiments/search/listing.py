"""Lists all flawless networks of a small square whose cells all have a road."""

import numba
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network import CROSSINGS, EAST, KINDS, NORTH, SOUTH, WEST

__all__ = ["flawless_networks"]

_TILES = np.array([code for code in range(16) if code.bit_count() > 1])
# What a tile shows to a neighbour: no link (0; 1 from a turn), or a link (2 from a straight, 3 a turn, 4 a crossing).
_SHOWN = 5


def _shows(code: int, side: int) -> int:
    turn, crossing = code in KINDS["turn"], code in CROSSINGS
    return (3 if turn else 4 if crossing else 2) if code & side else int(turn)


def _accepts(code: int, side: int, shown: int) -> bool:
    alike = (code in KINDS["turn"] and shown in (1, 3)) or (code in CROSSINGS and shown == 4)
    return (code & side > 0) == (shown >= 2) and not alike


_EAST, _SOUTH = (np.array([_shows(code, side) for code in _TILES]) for side in (EAST, SOUTH))
_FROM_WEST, _FROM_NORTH = (
    np.array([[_accepts(code, side, shown) for shown in range(_SHOWN)] for code in _TILES]) for side in (WEST, NORTH)
)


def flawless_networks(side: int) -> NDArray[np.int8]:
    """Returns all flawless networks, int8 ``[N, side, side]``, in lexicographic order of their codes.

    A broken line visits the cells row by row. What the cells before it show to the cells after it is a state. States
    from which no grid can be completed are found first, from the last cell on, so that the listing meets no dead end.

    Args:
      side: at most 9: the states take 5^(side + 1) bits a cell, and 9 x 9 tiles have 1.3 million networks.
    """
    after = np.ones(_SHOWN ** (side + 1), bool)
    completable = [after]
    for cell in reversed(range(side * side)):
        after = _before(after, side, cell)
        completable.append(after)
    packed = np.array([np.packbits(states, bitorder="little") for states in reversed(completable)])
    count = _list(packed, side, np.zeros((0, side * side), np.int8))
    networks = np.zeros((count, side * side), np.int8)
    _list(packed, side, networks)
    return networks.reshape(-1, side, side)


@numba.njit
def _next(state: int, side: int, cell: int, tile: int) -> int:
    """Returns the state after a cell, or -1 if the tile does not fit."""
    row, column = cell // side, cell % side
    place, last = _SHOWN**column, _SHOWN**side
    north, west = state // place % _SHOWN, state // last
    code = _TILES[tile]
    outside = (column == side - 1 and code & EAST) or (row == side - 1 and code & SOUTH)
    if outside or not _FROM_NORTH[tile, north] or not _FROM_WEST[tile, west]:
        return -1
    east = 0 if column == side - 1 else _EAST[tile]
    return state + (_SOUTH[tile] - north) * place + (east - west) * last


@numba.njit
def _before(after: NDArray[np.bool_], side: int, cell: int) -> NDArray[np.bool_]:
    before = np.zeros_like(after)
    for state in range(len(before)):
        for tile in range(len(_TILES)):
            following = _next(state, side, cell, tile)
            if following >= 0 and after[following]:
                before[state] = True
                break
    return before


@numba.njit
def _list(completable: NDArray[np.uint8], side: int, networks: NDArray[np.int8]) -> int:
    """Counts the networks of one component, and writes as many of them as there is room for."""
    cells, count, cell = side * side, 0, 0
    tiles, states = np.full(cells + 1, -1), np.zeros(cells + 1, np.int64)
    while cell >= 0:
        if cell == cells:
            grid = _TILES[tiles[:cells]]
            if _is_connected(grid, side):
                if count < len(networks):
                    networks[count] = grid
                count += 1
            cell -= 1
            continue
        found = False
        for tile in range(tiles[cell] + 1, len(_TILES)):
            state = _next(states[cell], side, cell, tile)
            if state >= 0 and completable[cell + 1, state >> 3] >> (state & 7) & 1:
                tiles[cell], states[cell + 1], tiles[cell + 1] = tile, state, -1
                found = True
                break
        cell += 1 if found else -1
    return count


@numba.njit
def _is_connected(grid: NDArray[np.int_], side: int) -> bool:
    seen, stack = np.zeros(len(grid), np.bool_), [0]
    seen[0] = True
    while stack:
        cell = stack.pop()
        for link, step in ((NORTH, -side), (EAST, 1), (SOUTH, side), (WEST, -1)):
            if grid[cell] & link and not seen[cell + step]:
                seen[cell + step] = True
                stack.append(cell + step)
    return bool(seen.all())
