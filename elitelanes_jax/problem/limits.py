"""Limits: the values that metrics can have on maps of a size, from simple inequalities, before any search.

Each metric has an interval. An inequality between metrics narrows them until nothing changes: Euler's formula, the
sides that tiles have to meet at, the number of cells and of pairs of cells. What the intervals leave out no map has;
what they leave in need not exist.
"""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from math import isqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import KINDS, SIDES
from elitelanes_jax.network.counts import largest_counts
from elitelanes_jax.problem.constraints import Range
from elitelanes_jax.problem.features import FEATURES, SHARES
from elitelanes_jax.problem.template import Template

_MOST_ROUNDS = 200

# The kinds of tiles that are counted one by one, and the codes of each.
_COUNTED = {
    "straights": "straight",
    "turns": "turn",
    "three-way crossings": "crossing3",
    "four-way crossings": "crossing4",
}


class _ContradictionError(Exception):
    """No map has such metrics: one would be at least so much, and at most so much."""


class _Inequality(NamedTuple):
    """The sum of metrics by factor is at least a number."""

    factors: Mapping[str, int]
    least: int


class Limits(NamedTuple):
    """The values that metrics can have.

    Attributes:
      intervals: the smallest and the largest value of each metric, by name.
      inequalities: between them.
    """

    intervals: dict[str, tuple[int, int]]
    inequalities: tuple[_Inequality, ...]

    def of(self, feature: str) -> tuple[Fraction, Fraction]:
        """Returns the smallest and the largest value of a feature, of a share as a part of 1."""
        part, whole = SHARES.get(feature, (feature, ()))
        low, high = map(Fraction, self.intervals[part])
        if not whole:
            return low, high
        least, most = (sum(self.intervals[name][end] for name in whole) for end in (0, 1))
        return low / max(most, 1), min(Fraction(1), high / max(least, 1))


def find_limits(
    shape: tuple[int, int],
    *,
    certain: Mapping[str, int],
    repaired: bool = True,
    fix: Template | None = None,
    alphabet: Iterable[int] | None = None,
) -> Limits:
    """Finds the limits of all metrics of grids.

    Args:
      shape: (height, width), each at least 2.
      certain: metrics that have one value on all of them.
      repaired: whether all connections within a grid are returned, and none leaves it.
      fix: cells that are given.
      alphabet: the codes that their tiles have, dead ends and empty cells aside; by default any.

    Raises:
      InputError: if there is no such grid.
    """
    limits = Limits(_first_intervals(shape), tuple(_inequalities(shape, repaired)))
    for name, value in certain.items():
        limits = _with(limits, _equal({name: 1}, value))
    if fix is not None:
        limits = _with(limits, _given(fix))
    if alphabet is not None:
        for name, kind in _COUNTED.items():
            if not set(alphabet) & set(KINDS[kind]):
                limits = _with(limits, _equal({name: 1}, 0))
    try:
        return _narrowed(limits)
    except _ContradictionError as error:
        given = " with the given cells" if fix is not None else ""
        raise InputError(f"no map of {shape[0]} x {shape[1]} tiles{given} is one to keep: {error}") from None


def check_ranges(where: Iterable[Range], limits: Limits, maps: str) -> None:
    """Checks that maps can be in all ranges, as far as limits tell.

    Args:
      where: the ranges.
      limits: of the maps.
      maps: words for them, for the message.

    Raises:
      InputError: for the first range that refutes itself or those before it; the message says the limit.
    """
    before = ""
    for item in where:
        if item.name not in FEATURES:
            continue  # nothing is known of extra features
        low, high = limits.of(item.name)
        if (item.low or 0) > high or (item.high is not None and item.high < low):
            expected = _format(low) if low == high else f"some of {_format(low)}..{_format(high)}"
            raise InputError(f"where {str(item)!r}: expected a range with {expected}, which {maps}{before} have")
        try:
            limits = _narrowed(_with(limits, _within(item)))
        except _ContradictionError as error:
            words = f"expected a range that {maps}{before} can be in, got one where {error}"
            raise InputError(f"where {str(item)!r}: {words}") from None
        before += (" and " if before else " with ") + str(item)


def free_links(
    shape: tuple[int, int], fix: Template | None, *, filled: bool
) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Finds the pairs of neighbouring cells that are linked on all maps, and those that some maps may link.

    Args:
      shape: (height, width) of the maps.
      fix: cells that are given.
      filled: whether every cell has a road.

    Returns:
      The certain links and the free ones, ints ``[N, 3]``: row and column of the one cell, and the place in `SIDES` of
      its side, east or south.
    """
    codes = np.full(shape, -1) if fix is None else np.where(fix.fixed, fix.grid, -1)
    corner = np.zeros(shape, bool)
    corner[:: shape[0] - 1, :: shape[1] - 1] = filled
    certain: list[NDArray[np.int_]] = []
    free: list[NDArray[np.int_]] = []
    for place, (one, other) in ((1, (np.s_[:, :-1], np.s_[:, 1:])), (2, (np.s_[:-1], np.s_[1:]))):
        ends = ((codes[one], SIDES[place].bit), (codes[other], SIDES[place].opposite))
        given = np.any([(code >= 0) & (code & bit > 0) for code, bit in ends], axis=0)
        unknown = (codes[one] < 0) & (codes[other] < 0)
        sure = given | unknown & (corner[one] | corner[other])
        for links, found in ((sure, certain), (unknown & ~sure, free)):
            found.append(np.insert(np.argwhere(links), 2, place, axis=1))
    return np.concatenate(certain), np.concatenate(free)


def _first_intervals(shape: tuple[int, int]) -> dict[str, tuple[int, int]]:
    height, width = shape
    area, pairs = height * width, 2 * height * width - height - width
    border = area - (height - 2) * (width - 2)
    most = largest_counts(shape) | dict.fromkeys(_COUNTED, area)
    most |= dict.fromkeys(("edges", "adjacent_turns", "crowded_crossings", "unlinked_neighbours"), pairs)
    most |= {"mismatches": 2 * pairs, "adjacent_crossings": 2 * pairs, "adjacent_crossing_score": 8 * pairs}
    most |= {"boundary_violations": border, "bridges": area - 1, "cyclomatic": (height - 1) * (width - 1)}
    return {name: (0, number) for name, number in most.items()}


def _inequalities(shape: tuple[int, int], repaired: bool) -> list[_Inequality]:
    height, width = shape
    area, pairs, longest = height * width, 2 * height * width - height - width, max(shape)
    found = [
        *_equal({"tiles": 1, "empty_cells": 1}, area),
        *_equal({"cyclomatic": 1, "edges": -1, "tiles": 1, "components": -1}, 0),  # Euler's formula
        *_equal({"crossings": 1, "three-way crossings": -1, "four-way crossings": -1}, 0),
        # A tile or more a component, and a component or more where there is a tile.
        _Inequality({"tiles": 1, "components": -1}, 0),
        _Inequality({"components": area, "tiles": -1}, 0),
        _Inequality({"tiles": 1, "straights": -1, "turns": -1, "crossings": -1}, 0),
        _Inequality({"tiles": 1, "dead_ends": -1}, 0),
        _Inequality({"tiles": 1, "off_alphabet": -1}, 0),
        _Inequality({"tiles": 1, "boundary_violations": -1}, 0),
        # Two ends of connections an edge.
        _Inequality(
            {"tiles": 1, "straights": 1, "turns": 1, "three-way crossings": 2, "four-way crossings": 3, "edges": -2}, 0
        ),
        # With Euler's formula: another cycle takes two three-way crossings, or a four-way one.
        _Inequality({"three-way crossings": 1, "four-way crossings": 2, "components": 2, "cyclomatic": -2}, 0),
        # Bridges are a forest; of other edges a face has four or more, and each is one of two faces.
        _Inequality({"tiles": 1, "components": -1, "bridges": -1}, 0),
        _Inequality({"edges": 1, "bridges": -1, "cyclomatic": -2}, 0),
        # An empty cell is one of two to four pairs of neighbours, of which it may share all with other empty cells.
        _Inequality({"edges": -1, "unlinked_neighbours": -1, "empty_cells": -1}, -pairs),
        _Inequality({"edges": 1, "unlinked_neighbours": 1, "empty_cells": 4}, pairs),
        _Inequality({"edges": -1, "mismatches": -1}, -pairs),
        # Pairs of crossings, counted from both sides; their scores, 6 to 8 a pair; pairs that a crossing or turn is in.
        _Inequality({"three-way crossings": 3, "four-way crossings": 4, "adjacent_crossings": -1}, 0),
        _Inequality({"edges": 2, "adjacent_crossings": -1}, 0),
        _Inequality({"adjacent_crossing_score": 1, "adjacent_crossings": -3}, 0),
        _Inequality({"adjacent_crossing_score": -1, "adjacent_crossings": 4}, 0),
        _Inequality({"crowded_crossings": 2, "adjacent_crossings": -1}, 0),
        _Inequality({"crowded_crossings": -1, "crossings": 4}, 0),
        _Inequality({"adjacent_turns": -1, "turns": 2}, 0),
        _Inequality({"adjacent_turns": -1, "crowded_crossings": -1}, -pairs),
        # A run of L straights adds L².
        _Inequality({"straight_score": 1, "straights": -1}, 0),
        _Inequality({"straight_score": -1, "straights": longest}, 0),
    ]
    if not repaired:
        return found
    return [
        *found,
        *_equal({"mismatches": 1}, 0),
        *_equal({"boundary_violations": 1}, 0),
        *_equal({"tiles": 1, "dead_ends": -1, "straights": -1, "turns": -1, "crossings": -1}, 0),
        *_equal(
            {
                "edges": 2,
                "dead_ends": -1,
                "straights": -2,
                "turns": -2,
                "three-way crossings": -3,
                "four-way crossings": -4,
            },
            0,
        ),
        *_equal(
            {"three-way crossings": 1, "four-way crossings": 2, "components": 2, "dead_ends": -1, "cyclomatic": -2}, 0
        ),
        # Roads stay within the grid: no straight or crossing in a corner, no four-way crossing along the border.
        _Inequality({"straights": -1, "crossings": -1}, 4 - area),
        _Inequality({"four-way crossings": -1}, -(height - 2) * (width - 2)),
        _Inequality({"straight_score": -1, "straights": longest - 2}, 0),
        # A component has a cycle or two dead ends; cycles also have a face outside.
        _Inequality({"cyclomatic": 2, "dead_ends": 1, "components": -2}, 0),
        _Inequality({"edges": 1, "bridges": -1, "cyclomatic": -2, "components": -2, "dead_ends": 1}, 0),
        # A component is a loop of four tiles or more, or has two dead ends; and a tile has a neighbour.
        _Inequality({"tiles": 1, "dead_ends": 1, "components": -4}, 0),
        _Inequality({"tiles": 1, "components": -2}, 0),
        # A component has a turn at each end of its first and of its last row, or a dead end there.
        _Inequality({"turns": 1, "dead_ends": 2, "components": -4}, 0),
        # What a crossing is linked to is a straight, a dead end, or in a crowded pair.
        _Inequality(
            {
                "straights": 2,
                "dead_ends": 1,
                "crowded_crossings": 2,
                "three-way crossings": -3,
                "four-way crossings": -4,
            },
            0,
        ),
    ]


def _given(fix: Template) -> tuple[_Inequality, ...]:
    """Returns what given cells say: how many there are of each kind at least, and of each link."""
    free = fix.codes.count(None)
    found = []
    for name, kind in {**_COUNTED, "empty_cells": "empty"}.items():
        number = sum(code in KINDS[kind] for code in fix.codes if code is not None)
        found += [_Inequality({name: 1}, number), _Inequality({name: -1}, -number - free)]
    certain, possible = free_links(fix.shape, fix, filled=False)
    found += [_Inequality({"edges": 1}, len(certain)), _Inequality({"edges": -1}, -len(certain) - len(possible))]
    return tuple(found)


def _within(item: Range) -> tuple[_Inequality, ...]:
    part, whole = SHARES.get(item.name, (item.name, ()))
    found = []
    for limit, sign in ((item.low, 1), (item.high, -1)):
        if limit is not None:
            factors = {part: sign * limit.denominator}
            for name in whole:
                factors[name] = factors.get(name, 0) - sign * limit.numerator
            found.append(_Inequality(factors, 0 if whole else sign * limit.numerator))
    return tuple(found)


def _equal(factors: Mapping[str, int], value: int) -> tuple[_Inequality, _Inequality]:
    return _Inequality(factors, value), _Inequality({name: -factor for name, factor in factors.items()}, -value)


def _with(limits: Limits, more: tuple[_Inequality, ...]) -> Limits:
    return limits._replace(inequalities=(*limits.inequalities, *more))


def _narrowed(limits: Limits) -> Limits:
    """Narrows the intervals until nothing changes, or for so many rounds; raises `_ContradictionError`."""
    intervals = dict(limits.intervals)
    for _ in range(_MOST_ROUNDS):
        before = dict(intervals)
        for factors, least in limits.inequalities:
            ends = {name: max(factor * end for end in intervals[name]) for name, factor in factors.items()}
            spare = sum(ends.values()) - least
            for name, factor in factors.items():
                limit = ends[name] - spare  # of the term, when all others are at their most
                low, high = intervals[name]
                if factor > 0:
                    _set(intervals, name, max(low, -(-limit // factor)), high)
                elif factor < 0:
                    _set(intervals, name, low, min(high, limit // factor))
        # Of so many cells at most so many pairs are neighbours, in a square (Harary and Harborth, 1976).
        tiles = intervals["tiles"][1]
        low, high = intervals["edges"]
        _set(intervals, "edges", low, min(high, 2 * tiles - (isqrt(4 * tiles - 1) + 1 if tiles else 0)))
        if intervals == before:
            break
    return limits._replace(intervals=intervals)


def _set(intervals: dict[str, tuple[int, int]], name: str, low: int, high: int) -> None:
    intervals[name] = (low, high)
    if low > high:
        words = name.replace("_", " ")
        raise _ContradictionError(f"{words} would be {low} or more and {high} or less")


def _format(limit: Fraction) -> str:
    return f"{limit}" if limit.denominator == 1 else f"{float(limit):.3g}"
