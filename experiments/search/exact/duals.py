"""A bound of the straight score of networks made of two halves, by linear programming.

A column's label is its kind at the cut (see `tiles`). Each label gets a dual value in either half, in such a way that
two labels that fit are together worth at least what a straight across the cut adds to their scores. Then the score of a
network is at most that of its halves, each with its dual values. Crossings get a price, because their number is given.
Any such values give a bound. The lowest bound is the solution of a linear programme.
"""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from experiments.search.exact.halves import Half, cost_to_go, find_highest
from experiments.search.exact.tiles import STRAIGHT, TURN, score_across

__all__ = ["UNIT", "Duals", "HalfBounds", "choose_duals", "first_duals"]

UNIT = 256
"""Units of dual values, prices and values in a point of the straight score."""

_IMPOSSIBLE = -(1 << 44)
"""The dual value of a label that a column may not have."""

_ROUNDS, _RADIUS, _LEAST_RADIUS, _GAP = 100, 30.0, 0.5, 0.5


class HalfBounds(NamedTuple):
    """What decides whether a partial way to fill a half can still be part of a network of some score.

    Attributes:
      half: the half.
      gains: of each layer, int64 ``[E]``, what its edges add to the value, in units.
      rest: see `cost_to_go`.
      least: the value that a way has to reach.
    """

    half: Half
    gains: list[NDArray[np.int64]]
    rest: list[NDArray[np.int64]]
    least: int


class Duals(NamedTuple):
    """Dual values of the labels at the cut.

    Attributes:
      bound: no network has a higher straight score.
      price: of a crossing, in units.
      labels: of each half, int64 ``[W, L]``, in units.
      exact: price and labels as solved, not rounded.
    """

    bound: int
    price: int
    labels: list[NDArray[np.int64]]
    exact: NDArray[np.float64]

    def needed(self, crossings: int, target: int) -> int:
        """Returns the value that two halves need together for a straight score."""
        return UNIT * target + self.price * crossings

    def half_bounds(self, halves: tuple[Half, ...], crossings: int, target: int) -> Iterator[HalfBounds]:
        """Returns the bounds of each half of a network with so many crossings and a straight score of `target`."""
        gains = [edge_gains(half, label, self.price) for half, label in zip(halves, self.labels, strict=True)]
        rests = [cost_to_go(half, gain) for half, gain in zip(halves, gains, strict=True)]
        others = [int(rest[0][0]) for rest in rests][::-1]
        for half, gain, rest, other in zip(halves, gains, rests, others, strict=True):
            yield HalfBounds(half, gain, rest, self.needed(crossings, target) - other)


def edge_gains(half: Half, labels: NDArray[np.int64], price: int) -> list[NDArray[np.int64]]:
    """Returns what the edges of each layer add to the value of a half, in units: its score, labels and crossings.

    Args:
      half: the half.
      labels: dual values, int64 ``[W, L]``.
      price: of a crossing; a four-way crossing is two.
    """
    gains = []
    for index, layer in enumerate(half.layers):
        gain = UNIT * layer.gain + price * layer.crossings
        if layer.label[0] >= 0:
            gain += labels[index // half.height, layer.label]
        gains.append(gain)
    return gains


def first_duals(halves: tuple[Half, ...]) -> Duals:
    """Returns dual values to start from: a straight of a tiles gets a², as 2 a b is at most a² + b²."""
    lengths = np.maximum(np.arange(_count_labels(halves)) - STRAIGHT, 0.0)
    return Duals(0, 0, [], np.append(10.0, np.tile(lengths**2, len(halves) * halves[0].width)))


def _count_labels(halves: tuple[Half, ...]) -> int:
    return STRAIGHT + 1 + max(half.height for half in halves)


def choose_duals(halves: tuple[Half, ...], crossings: int, start: Duals, pattern: int | None, target: int) -> Duals:
    """Chooses dual values that make the bound low, by Kelley's cutting planes.

    Each half that is found to be the highest bounds the next choice from below. The choice stays near the best one so
    far.

    Args:
      halves: one if both are alike.
      crossings: of the network; a four-way crossing is two.
      start: dual values to start from.
      pattern: the columns that are linked, as bits; None for a bound of all patterns.
      target: a score. Once the bound is below it, the search ends.
    """
    width, labels = halves[0].width, _count_labels(halves)
    span = width * labels
    size = 1 + len(halves) * span  # the price and all labels; the highest value of each half follows
    allowed = np.ones((width, labels), np.bool_)
    if pattern is not None:
        linked = pattern >> np.arange(width) & 1 > 0
        allowed = (np.arange(labels) >= TURN) == linked[:, None]
    rows, limits = [], []
    for column, one, other in product(range(width), range(labels), range(labels)):
        if score_across(one, other) >= 0 and allowed[column, one] and (one <= other or len(halves) == 2):
            row = np.zeros(size + len(halves))
            row[1 + column * labels + one] -= 1
            row[size - span + column * labels + other] -= 1
            rows.append(row)
            limits.append(-score_across(one, other))
    cost = np.zeros(size + len(halves))
    cost[0], cost[size:] = -crossings, 2 // len(halves)
    best, centre, radius, tried = start, start.exact, _RADIUS, start.exact
    lowest = np.inf
    for _ in range(_ROUNDS):
        # Rounded up, so that labels that fit still have enough.
        units = np.ceil(UNIT * tried + 0.01).astype(np.int64)
        price, total = int(units[0]), -crossings * int(units[0])
        duals = [np.where(allowed, part, _IMPOSSIBLE) for part in units[1:].reshape(len(halves), width, labels)]
        for index, (half, dual) in enumerate(zip(halves, duals, strict=True)):
            gains = edge_gains(half, dual, price)
            row, score = np.zeros(size + len(halves)), 0
            row[size + index] = -1
            for cell, edge in enumerate(find_highest(half, gains)):
                layer = half.layers[cell]
                total += int(gains[cell][edge]) * (2 // len(halves))
                score += int(layer.gain[edge])
                row[0] += layer.crossings[edge]
                if layer.label[edge] >= 0:
                    row[1 + index * span + cell // half.height * labels + layer.label[edge]] = 1
            rows.append(row)
            limits.append(-score)
        if total / UNIT < lowest:
            lowest, centre = total / UNIT, tried
            best = Duals(max(-1, int(lowest)), price, duals, tried)
        else:
            radius = max(0.8 * radius, _LEAST_RADIUS)
        if lowest < target:
            break
        near = [(value - radius, value + radius) for value in centre] + [(None, None)] * len(halves)
        plan = linprog(cost, A_ub=np.array(rows), b_ub=limits, bounds=near, method="highs")
        if plan.status or lowest - plan.fun < _GAP:
            break
        tried = plan.x[:size]
    return best
