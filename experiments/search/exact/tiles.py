"""The local rules of flawless networks: which tile may follow which, and what straights score.

What lies beyond the line that sweeps over the grid is known by its kind. Without a link across the line, the tile
before it is a turn, or not. With one, it is a turn, a crossing, or a straight of some length.
"""

import numba

from experiments.search.exact.graph import Integer

__all__ = [
    *("BESIDE_TURN", "CLEAR", "COUNTED", "CROSSING", "NO_TILE", "STRAIGHT", "TURN"),
    *("score_across", "tile_of", "type_of"),
]

CLEAR, BESIDE_TURN, TURN, CROSSING, STRAIGHT = 0, 1, 2, 3, 3
"""The kinds. A straight of L tiles so far is ``STRAIGHT + L``. Kinds from `TURN` on have a link."""

COUNTED = {"turns": 1, "crossings": 2, "straights": 3}
"""The types of tiles that a sweep may count, as `type_of` returns them."""

NO_TILE = 0
"""The type of an empty cell."""


@numba.njit(cache=True)
def tile_of(
    left: Integer, up: Integer, right: Integer, down: Integer, fill: bool, lengths: bool
) -> tuple[Integer, Integer, Integer]:
    """Lays a tile.

    Args:
      left: the kind to its left.
      up: the kind above it.
      right: 1 if it has a link to the right.
      down: 1 if it has a link down.
      fill: whether no cell may be empty.
      lengths: whether straights of different lengths are different kinds.

    Returns:
      What it adds to the straight score, -1 if it may not be there; and the kinds that it has to its right and below.
    """
    has_left, has_up = left >= TURN, up >= TURN
    connections = has_left + has_up + right + down
    if connections == 0:
        return -1 if fill else 0, CLEAR, CLEAR
    if connections == 1:
        return -1, CLEAR, CLEAR
    if connections > 2:
        if left == CROSSING or up == CROSSING:
            return -1, CLEAR, CLEAR
        return 0, CROSSING * right, CROSSING * down
    if has_up != down:
        if left in (TURN, BESIDE_TURN) or up in (TURN, BESIDE_TURN):
            return -1, CLEAR, CLEAR
        return 0, TURN if right else BESIDE_TURN, TURN if down else BESIDE_TURN
    before = up if has_up else left
    length = before - STRAIGHT + 1 if before > STRAIGHT else 1
    kind = STRAIGHT + (length if lengths else 1)
    return 2 * length - 1, kind * right, kind * down


@numba.njit(cache=True)
def type_of(left: Integer, up: Integer, right: Integer, down: Integer) -> int:
    """Returns the type of a tile: one of `COUNTED`, or `NO_TILE`. See `tile_of` for the arguments."""
    has_left, has_up = left >= TURN, up >= TURN
    connections = has_left + has_up + right + down
    if connections == 0:
        return 0
    if connections > 2:
        return 2
    return 1 if has_up != down else 3


@numba.njit(cache=True)
def score_across(one: Integer, other: Integer) -> Integer:
    """Returns what a straight across a cut adds to the scores of its two ends; -1 if the kinds do not fit.

    A straight of a tiles on one side and b on the other scores (a + b)² = a² + 2 a b + b².
    """
    if (one >= TURN) != (other >= TURN) or (one == other and one in (BESIDE_TURN, TURN, CROSSING)):
        return -1
    return 2 * max(0, one - STRAIGHT) * max(0, other - STRAIGHT)
