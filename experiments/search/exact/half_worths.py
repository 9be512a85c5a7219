"""A bound of the straight score of networks made of two halves, by linear programming.

What a column has at the cut is its label: no link, of a turn or another tile; or a link, of a turn, a crossing, or a
straight of some length. A straight across the cut, of a tiles above and b below, scores (a + b)^2 = a^2 + 2 a b + b^2.
Each label gets a worth in either half, so that two labels that fit are worth together at least 2 a b. Then the score of
a network is at most that of its halves, each with its worths. Crossings get a price, as their number is given. Any such
worths give a bound; those that make it the lowest are the solution of a linear programme.
"""

from itertools import product
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from experiments.search.exact.half_sweep import NEVER, UNIT, Half, find_highest, find_rests
from experiments.search.exact.sweep import BESIDE_TURN, CROSSING, STRAIGHT, TURN

__all__ = ["Worths", "across", "choose_worths", "first_worths"]

_ROUNDS, _REACH, _LEAST_REACH, _ENOUGH = 100, 30.0, 0.5, 0.5


class Worths(NamedTuple):
    """What labels at the cut are worth.

    Attributes:
      bound: no network has a higher straight score.
      price: of a crossing, in units.
      labels: by half, int64 ``[W, L]``, in units.
      exact: price and worths as numbers.
    """

    bound: int
    price: int
    labels: list[NDArray[np.int64]]
    exact: NDArray[np.float64]

    def least(self, crossings: int, target: int) -> int:
        """Returns what two halves have to be worth together for a straight score."""
        return UNIT * target + self.price * crossings

    def needs(
        self, halves: tuple[Half, ...], crossings: int, target: int
    ) -> list[tuple[Half, NDArray[np.int64], list[NDArray[np.int64]], int]]:
        """Returns each half, its worths, its rests (see `find_rests`), and what it has to be worth for a score."""
        rests = [find_rests(half, worth, self.price) for half, worth in zip(halves, self.labels, strict=True)]
        others = [int(rest[0][0]) for rest in rests][::-1]
        least = [self.least(crossings, target) - other for other in others]
        return list(zip(halves, self.labels, rests, least, strict=True))


@numba.njit(cache=True)
def across(one: Any, other: Any) -> Any:
    """Returns what a straight across the cut adds to the scores of its two ends; -1 if the labels do not fit."""
    if (one >= TURN) != (other >= TURN) or (one == other and one in (BESIDE_TURN, TURN, CROSSING)):
        return -1
    return 2 * max(0, one - STRAIGHT) * max(0, other - STRAIGHT)


def first_worths(halves: tuple[Half, ...]) -> Worths:
    """Returns worths to begin with: a straight of a tiles is worth a^2, as 2 a b is at most a^2 + b^2."""
    lengths = np.maximum(np.arange(_count_labels(halves)) - STRAIGHT, 0.0)
    return Worths(0, 0, [], np.append(10.0, np.tile(lengths**2, len(halves) * halves[0].width)))


def _count_labels(halves: tuple[Half, ...]) -> int:
    return STRAIGHT + 1 + max(half.height for half in halves)


def choose_worths(halves: tuple[Half, ...], crossings: int, start: Worths, pattern: int | None, target: int) -> Worths:
    """Chooses what labels at the cut are worth, and the price of a crossing, so that the bound is low.

    Kelley's cutting planes: each half that the sweep finds to be the highest bounds the next choice from below, which
    stays near the best one so far.

    Args:
      halves: one if both are alike.
      crossings: of the network; a four-way crossing is two.
      start: worths to begin with.
      pattern: the columns that are linked, as bits; None of all patterns.
      target: a score; with a bound below it the search ends.
    """
    width, labels = halves[0].width, _count_labels(halves)
    span = width * labels
    size = 1 + len(halves) * span  # the price and all worths; then the highest of each half
    allowed = np.ones((width, labels), np.bool_)
    if pattern is not None:
        linked = pattern >> np.arange(width) & 1 > 0
        allowed = (np.arange(labels) >= TURN) == linked[:, None]
    rows, limits = [], []
    for column, one, other in product(range(width), range(labels), range(labels)):
        if across(one, other) >= 0 and allowed[column, one] and (one <= other or len(halves) == 2):
            row = np.zeros(size + len(halves))
            row[1 + column * labels + one] -= 1
            row[size - span + column * labels + other] -= 1
            rows.append(row)
            limits.append(-across(one, other))
    cost = np.zeros(size + len(halves))
    cost[0], cost[size:] = -crossings, 2 // len(halves)
    best, centre, reach, tried = start, start.exact, _REACH, start.exact
    lowest = np.inf
    for _ in range(_ROUNDS):
        # Rounded up, so that labels that fit are still worth enough.
        units = np.ceil(UNIT * tried + 0.01).astype(np.int64)
        price, total = int(units[0]), -crossings * int(units[0])
        worths = [np.where(allowed, worth, NEVER >> 6) for worth in units[1:].reshape(len(halves), width, labels)]
        for number, (half, worth) in enumerate(zip(halves, worths, strict=True)):
            value, score, used, at_cut = find_highest(half, worth, price)
            total += value * (2 // len(halves))
            row = np.zeros(size + len(halves))
            row[1 + number * span + np.arange(width) * labels + at_cut] = 1
            row[0], row[size + number] = used, -1
            rows.append(row)
            limits.append(-score)
        if total / UNIT < lowest:
            lowest, centre = total / UNIT, tried
            best = Worths(max(-1, int(lowest)), price, worths, tried)
        else:
            reach = max(0.8 * reach, _LEAST_REACH)
        if lowest < target:
            break
        near = [(value - reach, value + reach) for value in centre] + [(None, None)] * len(halves)
        plan = linprog(cost, A_ub=np.array(rows), b_ub=limits, bounds=near, method="highs")
        if plan.status or lowest - plan.fun < _ENOUGH:
            break
        tried = plan.x[:size]
    return best
