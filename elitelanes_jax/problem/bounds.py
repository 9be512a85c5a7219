"""Bounds that hold for the metrics of every map of a size, found from inequalities before any search.

Each metric has an interval. Inequalities between metrics narrow the intervals until nothing
changes: Euler's formula, the sides at which tiles meet, the number of cells and of pairs of cells.
No map has a value outside its interval; a value inside need not occur.
"""

import re
from collections.abc import Iterable, Mapping
from fractions import Fraction
from math import ceil, isqrt, prod
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import KINDS, SIDES
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.records import (
    features_without_gaps,
    largest_metrics,
    largest_town_feature,
)
from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES, feature_unit
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import Range
from elitelanes_jax.problem.rules import RULES, map_constraints

_MOST_ROUNDS = 200

_Cell = tuple[int, int]  # row and column

# The town features that are a metric / tiles.
_PER_TILE = {"loops_per_tile": "cyclomatic", "adjacent_turns_per_tile": "adjacent_turns"}

# Without any of these, straight roads lead away from each crossing, and have no roads beside them.
_BESIDE_CROSSINGS = ("crowded_crossings", "unlinked_neighbours")

# What holds for the metrics of all repaired grids. AREA is the number of cells, and INNER that of
# cells away from the border. PAIRS is the number of pairs of neighbours. LONGEST is the longer
# side, and SHORTENED is it without its ends.
_FACTS = (
    "tiles + empty_cells = AREA",
    # Euler's formula.
    "cyclomatic - edges + tiles - components = 0",
    "crossings - crossings3 - crossings4 = 0",
    # Each component has a tile, and there is a component if there is a tile.
    "tiles >= components",
    "AREA components >= tiles",
    "tiles >= straights + turns + crossings",
    "tiles >= dead_ends",
    "tiles >= off_alphabet",
    "tiles >= boundary_violations",
    # An edge joins two connections.
    "tiles + straights + turns + 2 crossings3 + 3 crossings4 >= 2 edges",
    # With Euler's formula: each further cycle needs two three-way crossings or a four-way one.
    "crossings3 + 2 crossings4 + 2 components >= 2 cyclomatic",
    # Bridges form a forest. Every other edge borders two faces, and a face has at least four of
    # them.
    "tiles >= components + bridges",
    "edges >= bridges + 2 cyclomatic",
    # An empty cell is in two to four pairs of neighbours; it may share each pair with another empty
    # cell.
    "edges + unlinked_neighbours + empty_cells <= PAIRS",
    "edges + unlinked_neighbours + 4 empty_cells >= PAIRS",
    "edges + mismatches <= PAIRS",
    # Linked pairs of crossings are counted twice and score 6 to 8 each time. All are crowded.
    "3 crossings3 + 4 crossings4 >= adjacent_crossings",
    "2 edges >= adjacent_crossings",
    "adjacent_crossing_score >= 3 adjacent_crossings",
    "adjacent_crossing_score <= 4 adjacent_crossings",
    "2 crowded_crossings >= adjacent_crossings",
    "crowded_crossings <= 4 crossings",
    "adjacent_turns <= 2 turns",
    "adjacent_turns + crowded_crossings <= PAIRS",
    # A run of L straights scores L².
    "straight_score >= straights",
    "straight_score <= LONGEST straights",
    # All connections within a grid are returned, and none leaves it.
    "mismatches = 0",
    "boundary_violations = 0",
    "tiles - dead_ends - straights - turns - crossings = 0",
    "2 edges - dead_ends - 2 straights - 2 turns - 3 crossings3 - 4 crossings4 = 0",
    "crossings3 + 2 crossings4 + 2 components - dead_ends - 2 cyclomatic = 0",
    # Roads do not leave the grid: no straight or crossing in a corner, no four-way crossing along
    # the border.
    "straights + crossings + 4 <= AREA",
    "crossings4 <= INNER",
    "straight_score <= SHORTENED straights",
    # A component has a cycle or two dead ends; cycles also border the outer face.
    "2 cyclomatic + dead_ends >= 2 components",
    "edges + dead_ends >= bridges + 2 cyclomatic + 2 components",
    # A component is a loop of at least four tiles or has two dead ends, and each tile has a
    # neighbour.
    "tiles + dead_ends >= 4 components",
    "tiles >= 2 components",
    # A component has a turn or a dead end at each end of its first and of its last row.
    "turns + 2 dead_ends >= 4 components",
    # A tile linked to a crossing is a straight, a dead end, or forms a crowded pair with it.
    "2 straights + dead_ends + 2 crowded_crossings >= 3 crossings3 + 4 crossings4",
)


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
        smallest = sum(self.intervals[name][0] for name in whole)
        largest = sum(self.intervals[name][1] for name in whole)
        return low / max(largest, 1), min(Fraction(1), high / max(smallest, 1))

    def _of_town(self, feature: str) -> tuple[Fraction, Fraction]:
        least, most = 0, largest_town_feature(feature, self.shape)
        unit = feature_unit(feature)
        fixed = features_without_gaps(self.shape)
        if feature in fixed and self.has_no_gaps:
            least = most = fixed[feature]
        elif feature in _PER_TILE:
            low, high = self.intervals[_PER_TILE[feature]]
            smallest, largest = self.intervals["tiles"]
            least = unit * low // max(largest, 1)
            most = unit * high // max(smallest, 1)
        elif feature == "signable" and all(self.intervals[name] == (0, 0) for name in _BESIDE_CROSSINGS):
            least = unit
        return Fraction(least, unit), Fraction(most, unit)

    @property
    def has_no_gaps(self) -> bool:
        """Whether no map has an empty cell."""
        return self.intervals["empty_cells"] == (0, 0)


def find_bounds(shape: tuple[int, int], certain: Mapping[str, int]) -> FeatureBounds:
    """Finds bounds of the metrics of a set of repaired grids; `certain` has the metrics with one value on all grids."""
    largest = largest_metrics(shape) | dict.fromkeys(COUNTED.values(), prod(shape))
    intervals = {name: (0, most) for name, most in largest.items()}
    bounds = FeatureBounds(shape, intervals, tuple(_inequalities(shape)))
    for name, value in certain.items():
        bounds = _with(bounds, [_Inequality({name: 1}, value), _negated({name: 1}, value)])
    return _narrowed(bounds)


def check_ranges(where: Iterable[Range], bounds: FeatureBounds, maps: str) -> None:
    """Checks that the bounds do not rule out a map in all ranges; `maps` is how the message calls the maps.

    The `InputError` names the first range that contradicts the bounds or the ranges before it, and
    states the bound.
    """
    where = tuple(where)
    bounds = _with(bounds, _least_tiles(where, bounds.shape))
    before = ""  # the ranges that the bounds contain, for messages
    for item in where:
        if item.name not in (*FEATURES, *TOWN_FEATURES):
            continue  # a user's feature has no bounds
        _check_range(item, bounds, f"{maps}{before}")
        inequalities = []
        if item.name in FEATURES or item.name in COUNTED.values():
            inequalities = _within(item)
        try:
            bounds = _narrowed(_with(bounds, inequalities))
        except _ContradictionError as error:
            words = f"expected a range that {maps}{before} can be in, got one where {error}"
            raise InputError(f"where {str(item)!r}: {words}") from None
        before += f" and {item}" if before else f" with {item}"


def _least_tiles(where: Iterable[Range], shape: tuple[int, int]) -> list[_Inequality]:
    """Returns a least number of tiles: the least box around a town, times the least part of it that has tiles."""
    box = [item.low or 0 for item in where if item.name in ("box_share", "box_fill")]
    if len(box) < 2:
        return []
    return [_Inequality({"tiles": 1}, ceil(prod(box) * prod(shape)))]


def _check_range(item: Range, bounds: FeatureBounds, maps: str) -> None:
    """Checks that a range and the bounds of its feature have a value in common."""
    low, high = bounds.of(item.name)
    is_above = item.low is not None and item.low > high
    is_below = item.high is not None and item.high < low
    if not is_above and not is_below:
        return
    expected = _format(low) if low == high else f"some of {_format(low)}..{_format(high)}"
    unless = ""
    if bounds.has_no_gaps and item.name in features_without_gaps(bounds.shape):
        unless = " unless rules or fixed cells leave cells empty"
    raise InputError(f"where {str(item)!r}: expected a range with {expected}, which {maps} have{unless}")


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
    lacking_kinds: list[str] = []
    if alphabet is not None:
        codes = set(alphabet)
        missing_turns = set(KINDS["turn"]) - codes
        if missing_turns:
            expected = f"alphabet: expected the turns {KINDS['turn']}, which every map has"
            raise InputError(f"{expected}, got no {min(missing_turns)}")
        lacking_kinds = [kind for kind in COUNTED if codes.isdisjoint(KINDS[kind])]
    if fix is not None:
        _check_fixed(fix, rules)
        _check_room(fix, filled)
    if where:
        certain = {name: value for name, value, _ in map_constraints(rules, filled=filled and fix is None)}
        for kind in lacking_kinds:
            certain[COUNTED[kind]] = 0
        without = f" without {' and '.join(lacking_kinds)}" if lacking_kinds else ""
        maps = f"maps of {shape[0]} x {shape[1]} tiles{without}"
        check_ranges(where, find_bounds(shape, certain), maps)


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

    `filled` says whether each free cell needs one; a free cell without any neighbour to link stays
    empty.
    """
    is_fixed = fix.fixed
    ways = _ways(np.where(is_fixed, fix.grid, 15))
    ways = {cell: beside for cell, beside in ways.items() if beside or is_fixed[cell]}
    needed = [cell for cell in ways if filled or is_fixed[cell]]
    dead_ends = [cell for cell, beside in ways.items() if len(beside) < 2]
    if filled and dead_ends:
        row, column = dead_ends[0]
        raise InputError(
            f"fix: expected two neighbours for a road in every free cell, got one at row {row}, column {column}; "
            "with rules, an inventory or a style such as town it may stay empty"
        )
    while dead_ends:
        cell = dead_ends.pop()
        for neighbour in ways.pop(cell):
            ways[neighbour].discard(cell)
            if len(ways[neighbour]) == 1:
                dead_ends.append(neighbour)
    starts = needed or list(ways)
    reached = _reachable(ways, starts[0]) if starts else set()
    if not reached:
        raise InputError("fix: expected cells that leave room for a loop of roads, got none")
    for cell in needed:
        if cell not in reached:
            first = "row {}, column {}".format(*needed[0])
            last = "row {}, column {}".format(*cell)
            expected = "fix: expected cells whose roads can be connected"
            raise InputError(f"{expected}, got no way from {first} to {last}")


def _reachable(ways: Mapping[_Cell, set[_Cell]], start: _Cell) -> set[_Cell]:
    """Returns the cells that a road from a cell can reach; empty if the cell itself can have no road."""
    reached: set[_Cell] = set()
    ahead = [start]
    while ahead:
        cell = ahead.pop()
        if cell in ways and cell not in reached:
            reached.add(cell)
            ahead += ways[cell]
    return reached


def _ways(codes: Int[np.ndarray, "H W"]) -> dict[_Cell, set[_Cell]]:
    """Returns the neighbours to which each cell can have a road, if free cells have all sides."""
    height, width = codes.shape
    ways: dict[_Cell, set[_Cell]] = {}
    for row, column in np.argwhere(codes).tolist():
        ways[row, column] = set()
        for side in SIDES:
            down, right = row + side.down, column + side.right
            is_inside = 0 <= down < height and 0 <= right < width
            if is_inside and codes[row, column] & side.bit and codes[down, right] & side.opposite:
                ways[row, column].add((down, right))
    return ways


def _inequalities(shape: tuple[int, int]) -> list[_Inequality]:
    """Returns the inequalities of `_FACTS` on grids of a shape."""
    height, width = shape
    constants = {
        "AREA": height * width,
        "INNER": (height - 2) * (width - 2),
        "PAIRS": 2 * height * width - height - width,
        "LONGEST": max(shape),
        "SHORTENED": max(shape) - 2,
    }
    inequalities = []
    for fact in _FACTS:
        left, relation, right = re.split(" (=|>=|<=) ", fact)
        factors: dict[str, int] = {}
        least = 0
        # Metrics move to the left of >=, and numbers to the right.
        for side, sign in ((left, 1), (right, -1)):
            side_factors, number = _read_sum(side, constants)
            for name, factor in side_factors.items():
                factors[name] = factors.get(name, 0) + sign * factor
            least -= sign * number
        if relation == ">=":
            inequalities.append(_Inequality(factors, least))
        elif relation == "<=":
            inequalities.append(_negated(factors, least))
        else:
            inequalities += [_Inequality(factors, least), _negated(factors, least)]
    return inequalities


def _read_sum(text: str, constants: Mapping[str, int]) -> tuple[dict[str, int], int]:
    """Reads a sum of metrics times their factors, and of numbers."""
    factors: dict[str, int] = {}
    number = 0
    for operator, term in re.findall(r"([+-]?) ?([\w ]*\w)", text):
        factor = -1 if operator == "-" else 1
        metric = None
        for word in term.split():
            if word in constants:
                factor *= constants[word]
            elif word.isdigit():
                factor *= int(word)
            else:
                metric = word
        if metric is None:
            number += factor
        else:
            factors[metric] = factor
    return factors, number


def _negated(factors: Mapping[str, int], most: int) -> _Inequality:
    """Returns the inequality that a sum is at most a number."""
    return _Inequality({name: -factor for name, factor in factors.items()}, -most)


def _within(item: Range) -> list[_Inequality]:
    """Returns the inequalities of a range. The range of a share limits a part by a multiple of its whole."""
    part, whole = SHARES.get(item.name, (item.name, ()))
    inequalities = []
    for limit, sign in ((item.low, 1), (item.high, -1)):
        if limit is None:
            continue
        factors = {part: sign * limit.denominator}
        for name in whole:
            factors[name] = factors.get(name, 0) - sign * limit.numerator
        least = 0 if whole else sign * limit.numerator
        inequalities.append(_Inequality(factors, least))
    return inequalities


def _with(bounds: FeatureBounds, more: Iterable[_Inequality]) -> FeatureBounds:
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
        # For a number of tiles, a square has the most pairs of neighbours (Harary and Harborth,
        # 1976).
        tiles = intervals["tiles"][1]
        most_edges = 2 * tiles - isqrt(4 * tiles - 1) - 1 if tiles else 0
        low, high = intervals["edges"]
        _set(intervals, "edges", low, min(high, most_edges))
        if intervals == before:
            break
    return bounds._replace(intervals=intervals)


def _set(intervals: dict[str, tuple[int, int]], name: str, low: int, high: int) -> None:
    intervals[name] = (low, high)
    if low > high:
        words = name.replace("_", " ")
        raise _ContradictionError(f"{words} would be {low} or more and {high} or less")


def _format(limit: Fraction) -> str:
    if limit.denominator == 1:
        return str(limit)
    return f"{float(limit):.3g}"
