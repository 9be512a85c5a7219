"""Bounds that hold for the metrics of every map of a size, found from inequalities before any search.

Each metric has an interval. Inequalities between metrics narrow the intervals until nothing changes: Euler's formula,
the sides at which tiles meet, the number of cells and of pairs of cells. No map has a value outside its interval; a
value inside need not occur.
"""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from math import ceil, isqrt, prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import KINDS, SIDES
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.records import features_without_gaps, largest_metrics, largest_town_feature
from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES, feature_unit
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import Range
from elitelanes_jax.problem.rules import RULES, map_constraints

_MOST_ROUNDS = 200

# The town features that are a metric / tiles.
_PER_TILE = {"loops_per_tile": "cyclomatic", "adjacent_turns_per_tile": "adjacent_turns"}

# Without any of these, straight roads lead away from each crossing, and have no roads beside them.
_BESIDE_CROSSINGS = ("crowded_crossings", "unlinked_neighbours")


class _ContradictionError(Exception):
    """A lower bound of a metric is greater than its upper bound: no map exists."""


class _Inequality(NamedTuple):
    """The sum of metrics times their factors is at least a number."""

    factors: Mapping[str, int]
    least: int


class FeatureBounds(NamedTuple):
    """Bounds of the metrics, shares and town features of a set of maps."""

    shape: tuple[int, int]  # (height, width) of the maps
    intervals: dict[str, tuple[int, int]]  # a lower and an upper bound of each metric, by name
    inequalities: tuple[_Inequality, ...]  # that the metrics satisfy

    def of(self, feature: str) -> tuple[Fraction, Fraction]:
        """Returns a lower and an upper bound of a feature that is not the user's, in units of 1."""
        if feature in TOWN_FEATURES and feature not in COUNTED.values():
            return self._of_town(feature)
        part, whole = SHARES.get(feature, (feature, ()))
        low, high = map(Fraction, self.intervals[part])
        if not whole:
            return low, high
        smallest, largest = (sum(self.intervals[name][end] for name in whole) for end in (0, 1))
        return low / max(largest, 1), min(Fraction(1), high / max(smallest, 1))

    def _of_town(self, feature: str) -> tuple[Fraction, Fraction]:
        least, most, unit = 0, largest_town_feature(feature, self.shape), feature_unit(feature)
        if self.intervals["empty_cells"] == (0, 0) and feature in (fixed := features_without_gaps(self.shape)):
            least = most = fixed[feature]
        elif feature in _PER_TILE:
            (low, high), (smallest, largest) = self.intervals[_PER_TILE[feature]], self.intervals["tiles"]
            least, most = (unit * end // max(tiles, 1) for end, tiles in ((low, largest), (high, smallest)))
        elif feature == "signable" and all(self.intervals[name] == (0, 0) for name in _BESIDE_CROSSINGS):
            least = unit
        return Fraction(least, unit), Fraction(most, unit)


def find_bounds(shape: tuple[int, int], certain: Mapping[str, int]) -> FeatureBounds:
    """Finds bounds of the metrics of a set of repaired grids; `certain` has the metrics with one value on all grids."""
    largest = largest_metrics(shape) | dict.fromkeys(COUNTED.values(), prod(shape))
    intervals = {name: (0, most) for name, most in largest.items()}
    bounds = FeatureBounds(shape, intervals, tuple(_inequalities(shape)))
    for name, value in certain.items():
        bounds = _with(bounds, _equal({name: 1}, value))
    return _narrowed(bounds)


def check_ranges(where: Iterable[Range], bounds: FeatureBounds, maps: str) -> None:
    """Checks that the bounds do not rule out a map in all ranges; `maps` is how the message calls the maps.

    The `InputError` names the first range that contradicts the bounds or the ranges before it, and states the bound.
    """
    before, where = "", tuple(where)
    # The least box around a town, and the least part of the box that has tiles, are also a least number of tiles.
    box = [item.low or 0 for item in where if item.name in ("box_share", "box_fill")]
    if len(box) == 2:
        bounds = _with(bounds, (_Inequality({"tiles": 1}, ceil(prod(box) * prod(bounds.shape))),))
    for item in where:
        if item.name not in (*FEATURES, *TOWN_FEATURES):
            continue  # a user's feature has no bounds
        low, high = bounds.of(item.name)
        if (item.low or 0) > high or (item.high is not None and item.high < low):
            expected = _format(low) if low == high else f"some of {_format(low)}..{_format(high)}"
            gaps = item.name in features_without_gaps(bounds.shape) and bounds.intervals["empty_cells"] == (0, 0)
            unless = " unless rules or fixed cells leave cells empty" if gaps else ""
            raise InputError(
                f"where {str(item)!r}: expected a range with {expected}, which {maps}{before} have{unless}"
            )
        try:
            bounds = _narrowed(_with(bounds, _within(item) if item.name in (*FEATURES, *COUNTED.values()) else ()))
        except _ContradictionError as error:
            words = f"expected a range that {maps}{before} can be in, got one where {error}"
            raise InputError(f"where {str(item)!r}: {words}") from None
        before += (" and " if before else " with ") + str(item)


def check_feasible(
    shape: tuple[int, int],
    where: Iterable[Range] = (),
    *,
    fix: FixedCells | None = None,
    rules: str | None = None,
    filled: bool = True,
    alphabet: Iterable[int] | None = None,
) -> None:
    """Checks that the bounds do not rule out all maps that satisfy some constraints. Some contradictions are missed.

    `filled` says whether every free cell has a road. The `InputError` states the bound.
    """
    missing = set() if alphabet is None else set(KINDS["turn"]) - set(alphabet)
    if missing:
        raise InputError(f"alphabet: expected the turns {KINDS['turn']}, which every map has, got no {min(missing)}")
    if fix is not None:
        _check_fixed(fix, rules)
        _check_room(fix, filled)
    if where:
        lacking = [kind for kind in COUNTED if alphabet is not None and not {*KINDS[kind]} & {*alphabet}]
        limits = {name: value for name, value, _ in map_constraints(rules, filled=filled and fix is None)}
        bounds = find_bounds(shape, limits | dict.fromkeys((COUNTED[kind] for kind in lacking), 0))
        without = f" without {' and '.join(lacking)}" if lacking else ""
        check_ranges(where, bounds, f"maps of {shape[0]} x {shape[1]} tiles{without}")


def _check_fixed(fix: FixedCells, rules: str | None) -> None:
    ends = np.argwhere(np.isin(fix.grid, KINDS["end"])).tolist()
    if ends:
        row, column = ends[0]
        code = int(fix.grid[row, column])
        raise InputError(f"fix: expected cells without dead ends, got code {code} at row {row}, column {column}")
    if rules is not None:
        metrics = plain_measure(fix.grid)
        for name in RULES[rules].forbidden:
            if metrics[name]:
                raise InputError(f"fix: expected cells that keep the rules of {rules}, got {name} {metrics[name]}")


def _check_room(fix: FixedCells, filled: bool) -> None:
    """Checks that roads can pass through the cells that need one, and connect them.

    `filled` says whether each free cell needs one; a free cell without any neighbour to link stays empty.
    """
    fixed = fix.fixed
    codes = np.where(fixed, fix.grid, 15)
    ways = {(row, column): _ways(codes, row, column) for row, column in np.argwhere(codes).tolist()}
    ways = {cell: beside for cell, beside in ways.items() if beside or fixed[cell]}
    needed = [cell for cell in ways if filled or fixed[cell]]
    dead = [cell for cell, beside in ways.items() if len(beside) < 2]
    if filled and dead:
        row, column = dead[0]
        raise InputError(
            f"fix: expected two neighbours for a road in every free cell, got one at row {row}, column {column}; "
            "with rules, an inventory or a style such as town it may stay empty"
        )
    while dead:
        cell = dead.pop()
        for other in ways.pop(cell):
            ways[other].discard(cell)
            if len(ways[other]) == 1:
                dead.append(other)
    reached, ahead = set(), needed[:1] or [*ways][:1]
    while ahead:
        cell = ahead.pop()
        if cell not in reached and cell in ways:
            reached.add(cell)
            ahead += ways[cell]
    if not reached:
        raise InputError("fix: expected cells that leave room for a loop of roads, got none")
    if apart := [cell for cell in needed if cell not in reached]:
        way = " to ".join(f"row {row}, column {column}" for row, column in (needed[0], apart[0]))
        raise InputError(f"fix: expected cells whose roads can be connected, got no way from {way}")


def _ways(codes: NDArray[np.int8], row: int, column: int) -> set[tuple[int, int]]:
    """Returns the neighbours to which a cell can have a road, if free cells have all sides."""
    height, width = codes.shape
    beside = {(row + side.down, column + side.right): side for side in SIDES if codes[row, column] & side.bit}
    return {
        (down, right)
        for (down, right), side in beside.items()
        if 0 <= down < height and 0 <= right < width and codes[down, right] & side.opposite
    }


def _inequalities(shape: tuple[int, int]) -> list[_Inequality]:
    height, width = shape
    area, pairs, longest = height * width, 2 * height * width - height - width, max(shape)
    return [
        *_equal({"tiles": 1, "empty_cells": 1}, area),
        *_equal({"cyclomatic": 1, "edges": -1, "tiles": 1, "components": -1}, 0),  # Euler's formula
        *_equal({"crossings": 1, "crossings3": -1, "crossings4": -1}, 0),
        # Each component has a tile, and there is a component if there is a tile.
        _Inequality({"tiles": 1, "components": -1}, 0),
        _Inequality({"components": area, "tiles": -1}, 0),
        _Inequality({"tiles": 1, "straights": -1, "turns": -1, "crossings": -1}, 0),
        _Inequality({"tiles": 1, "dead_ends": -1}, 0),
        _Inequality({"tiles": 1, "off_alphabet": -1}, 0),
        _Inequality({"tiles": 1, "boundary_violations": -1}, 0),
        # An edge joins two connections.
        _Inequality({"tiles": 1, "straights": 1, "turns": 1, "crossings3": 2, "crossings4": 3, "edges": -2}, 0),
        # With Euler's formula: each further cycle needs two three-way crossings or a four-way one.
        _Inequality({"crossings3": 1, "crossings4": 2, "components": 2, "cyclomatic": -2}, 0),
        # Bridges form a forest. Every other edge borders two faces, and a face has at least four of them.
        _Inequality({"tiles": 1, "components": -1, "bridges": -1}, 0),
        _Inequality({"edges": 1, "bridges": -1, "cyclomatic": -2}, 0),
        # An empty cell is in two to four pairs of neighbours; it may share each pair with another empty cell.
        _Inequality({"edges": -1, "unlinked_neighbours": -1, "empty_cells": -1}, -pairs),
        _Inequality({"edges": 1, "unlinked_neighbours": 1, "empty_cells": 4}, pairs),
        _Inequality({"edges": -1, "mismatches": -1}, -pairs),
        # Linked pairs of crossings are counted twice and score 6 to 8 each time. All are crowded.
        _Inequality({"crossings3": 3, "crossings4": 4, "adjacent_crossings": -1}, 0),
        _Inequality({"edges": 2, "adjacent_crossings": -1}, 0),
        _Inequality({"adjacent_crossing_score": 1, "adjacent_crossings": -3}, 0),
        _Inequality({"adjacent_crossing_score": -1, "adjacent_crossings": 4}, 0),
        _Inequality({"crowded_crossings": 2, "adjacent_crossings": -1}, 0),
        _Inequality({"crowded_crossings": -1, "crossings": 4}, 0),
        _Inequality({"adjacent_turns": -1, "turns": 2}, 0),
        _Inequality({"adjacent_turns": -1, "crowded_crossings": -1}, -pairs),
        # A run of L straights scores L².
        _Inequality({"straight_score": 1, "straights": -1}, 0),
        _Inequality({"straight_score": -1, "straights": longest}, 0),
        # All connections within a grid are returned, and none leaves it.
        *_equal({"mismatches": 1}, 0),
        *_equal({"boundary_violations": 1}, 0),
        *_equal({"tiles": 1, "dead_ends": -1, "straights": -1, "turns": -1, "crossings": -1}, 0),
        *_equal({"edges": 2, "dead_ends": -1, "straights": -2, "turns": -2, "crossings3": -3, "crossings4": -4}, 0),
        *_equal({"crossings3": 1, "crossings4": 2, "components": 2, "dead_ends": -1, "cyclomatic": -2}, 0),
        # Roads do not leave the grid: no straight or crossing in a corner, no four-way crossing along the border.
        _Inequality({"straights": -1, "crossings": -1}, 4 - area),
        _Inequality({"crossings4": -1}, -(height - 2) * (width - 2)),
        _Inequality({"straight_score": -1, "straights": longest - 2}, 0),
        # A component has a cycle or two dead ends; cycles also border the outer face.
        _Inequality({"cyclomatic": 2, "dead_ends": 1, "components": -2}, 0),
        _Inequality({"edges": 1, "bridges": -1, "cyclomatic": -2, "components": -2, "dead_ends": 1}, 0),
        # A component is a loop of at least four tiles or has two dead ends, and each tile has a neighbour.
        _Inequality({"tiles": 1, "dead_ends": 1, "components": -4}, 0),
        _Inequality({"tiles": 1, "components": -2}, 0),
        # A component has a turn or a dead end at each end of its first and of its last row.
        _Inequality({"turns": 1, "dead_ends": 2, "components": -4}, 0),
        # A tile linked to a crossing is a straight, a dead end, or forms a crowded pair with it.
        _Inequality({"straights": 2, "dead_ends": 1, "crowded_crossings": 2, "crossings3": -3, "crossings4": -4}, 0),
    ]


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


def _with(bounds: FeatureBounds, more: tuple[_Inequality, ...]) -> FeatureBounds:
    return bounds._replace(inequalities=(*bounds.inequalities, *more))


def _narrowed(bounds: FeatureBounds) -> FeatureBounds:
    """Narrows the intervals until nothing changes, in at most `_MOST_ROUNDS`; raises `_ContradictionError`."""
    intervals = dict(bounds.intervals)
    for _ in range(_MOST_ROUNDS):
        before = dict(intervals)
        for factors, least in bounds.inequalities:
            ends = {name: max(factor * end for end in intervals[name]) for name, factor in factors.items()}
            spare = sum(ends.values()) - least
            for name, factor in factors.items():
                limit = ends[name] - spare  # of this term, when all other terms are largest
                low, high = intervals[name]
                if factor > 0:
                    _set(intervals, name, max(low, -(-limit // factor)), high)
                elif factor < 0:
                    _set(intervals, name, low, min(high, limit // factor))
        # For a number of tiles, a square has the most pairs of neighbours (Harary and Harborth, 1976).
        tiles = intervals["tiles"][1]
        low, high = intervals["edges"]
        _set(intervals, "edges", low, min(high, 2 * tiles - (isqrt(4 * tiles - 1) + 1 if tiles else 0)))
        if intervals == before:
            break
    return bounds._replace(intervals=intervals)


def _set(intervals: dict[str, tuple[int, int]], name: str, low: int, high: int) -> None:
    intervals[name] = (low, high)
    if low > high:
        words = name.replace("_", " ")
        raise _ContradictionError(f"{words} would be {low} or more and {high} or less")


def _format(limit: Fraction) -> str:
    return f"{limit}" if limit.denominator == 1 else f"{float(limit):.3g}"
