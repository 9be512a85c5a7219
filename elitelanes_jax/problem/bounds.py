"""Bounds that hold for the metrics of every map of a size.

The bounds are found from inequalities before any search. Each metric has an interval. Inequalities
between metrics narrow the intervals until nothing changes: Euler's formula, the sides at which
tiles meet, the number of cells and of pairs of cells. No map has a value outside its interval; a
value inside need not occur.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from fractions import Fraction
from functools import lru_cache
from math import ceil, isqrt, prod
from typing import NamedTuple

import numpy as np

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.network.records import (
    features_without_gaps,
    largest_metrics,
    largest_town_feature,
)
from elitelanes_jax.problem._connectable import check_connectable
from elitelanes_jax.problem.features import FEATURES, SHARES, TOWN_FEATURES, feature_unit
from elitelanes_jax.problem.fixed_cells import FixedCells
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import Range
from elitelanes_jax.problem.rules import RULES, map_constraints

# The largest number of rounds that narrow the intervals. They settle after a few rounds.
_MOST_ROUNDS = 200

# The town features that are a metric / tiles.
_PER_TILE = {"loops_per_tile": "cyclomatic", "adjacent_turns_per_tile": "adjacent_turns"}

# The least value other than 0 of features whose other values are larger by a multiple of 2: a loop
# has 4 tiles or more and an even number of them, and a linked pair of crossings counts twice.
_LEAST_OF_TWOS = {"gridlock_number": 3, "adjacent_crossings": 2}

# Without any of these, straight roads lead away from each crossing, and have no roads beside them.
_BESIDE_CROSSINGS = ("crowded_crossings", "unlinked_neighbours")

# The name of a term without a metric.
_NUMBER = ""

# These facts hold for the metrics of all repaired grids. AREA is the number of cells, INNER the
# number of cells that are not on the border, and PAIRS the number of pairs of neighbours. LONGEST
# is the longer side, and SHORTENED is LONGEST - 2.
_FACTS = (
    "tiles + empty_cells = AREA",
    # This is Euler's formula.
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
    # By Euler's formula, each further cycle needs two three-way crossings or a four-way one.
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
    # Roads do not leave the grid. So no straight or crossing is in a corner, and no four-way
    # crossing is along the border.
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
    """The sum of metrics times their factors is at least a number.

    Attributes:
      factors: the factor of each metric, by name.
      least: the number.
    """

    factors: Mapping[str, int]
    least: int


class FeatureBounds(NamedTuple):
    """Bounds of the metrics, shares and town features of a set of maps.

    Attributes:
      shape: (height, width) of the maps.
      intervals: a lower and an upper bound of each metric, by name.
      inequalities: the inequalities that the metrics satisfy.
    """

    shape: tuple[int, int]
    intervals: dict[str, tuple[int, int]]
    inequalities: tuple[_Inequality, ...]

    def of(self, feature: str) -> tuple[Fraction, Fraction]:
        """Returns a lower and an upper bound of a feature that is not the user's, in units of 1."""
        if feature in TOWN_FEATURES and feature not in COUNTED.values():
            return self._of_town(feature)
        part, whole = SHARES.get(feature, (feature, ()))
        low, high = self.intervals[part]
        if not whole:
            return Fraction(low), Fraction(high)
        # A share is least if the part is least and the whole is largest, and the other way round.
        smallest = sum(self.intervals[name][0] for name in whole)
        largest = sum(self.intervals[name][1] for name in whole)
        least_share = Fraction(low, max(largest, 1))
        most_share = Fraction(high, max(smallest, 1))
        return least_share, min(Fraction(1), most_share)

    def _of_town(self, feature: str) -> tuple[Fraction, Fraction]:
        least, most = 0, largest_town_feature(feature, self.shape)
        unit = feature_unit(feature)
        values_without_gaps = features_without_gaps(self.shape)
        if feature in values_without_gaps and self.has_no_gaps:
            least = most = values_without_gaps[feature]
        elif feature in _PER_TILE:
            low, high = self.intervals[_PER_TILE[feature]]
            fewest_tiles, most_tiles = self.intervals["tiles"]
            least = unit * low // max(most_tiles, 1)
            most = unit * high // max(fewest_tiles, 1)
        elif feature == "signable" and self._leaves_room_for_signs:
            least = unit
        elif feature == "gridlock_number":
            # The number is 0 without a loop. A loop has at least 4 tiles, and an even number.
            fewest_loops, most_loops = self.intervals["cyclomatic"]
            least = 3 * min(fewest_loops, 1)
            longest_loop = self.intervals["tiles"][1] // 2 * 2
            most = min(most_loops, 1) * max(longest_loop - 1, 0)
        return Fraction(least, unit), Fraction(most, unit)

    @property
    def _leaves_room_for_signs(self) -> bool:
        """Whether every crossing of every map has room for its signs."""
        return all(self.intervals[name] == (0, 0) for name in _BESIDE_CROSSINGS)

    @property
    def has_no_gaps(self) -> bool:
        """Whether no map has an empty cell."""
        return self.intervals["empty_cells"] == (0, 0)


def find_bounds(shape: tuple[int, int], certain: Mapping[str, int]) -> FeatureBounds:
    """Finds bounds of the metrics of a set of repaired grids.

    `certain` has the metrics with one value on all grids.
    """
    # An inventory counts crossings by their number of sides, which no metric does.
    largest = largest_metrics(shape) | dict.fromkeys(COUNTED.values(), prod(shape))
    intervals = {name: (0, most) for name, most in largest.items()}
    intervals |= {name: (value, value) for name, value in certain.items()}
    return _narrowed(FeatureBounds(shape, intervals, tuple(_inequalities(shape))))


def check_ranges(where: Iterable[Range], bounds: FeatureBounds, maps: str) -> None:
    """Checks that the bounds do not rule out a map in all ranges.

    `maps` is how the message calls the maps. The `InputError` names the first range that
    contradicts the bounds or the ranges before it, and states the bound.
    """
    # Each range is checked against the bounds and the ranges before it, and then narrows the
    # bounds.
    where = tuple(where)
    bounds = _with_inequalities(bounds, _least_tiles(where, bounds.shape))
    # Messages call the maps in the ranges before an item by these words.
    ranged_maps = maps
    # This flag says whether an earlier range wants crossings with empty cells at their corners.
    asks_for_gaps = False
    for item in where:
        if item.name not in FEATURES and item.name not in TOWN_FEATURES:
            # A feature of the user has no bounds.
            continue
        _check_range(item, bounds, ranged_maps, asks_for_gaps=asks_for_gaps)
        inequalities = []
        if item.name in FEATURES or item.name in COUNTED.values():
            inequalities = _inequalities_of_range(item)
        elif item.name == "signable":
            inequalities = _crossings_of_signable(item, bounds)
            asks_for_gaps = bool(item.low)
        elif item.name == "gridlock_number":
            # The shortest loop has one tile more.
            loop_tiles = ceil(_next_value(item.name, item.low or Fraction(0))) + 1
            inequalities = [_Inequality({"tiles": 1}, loop_tiles)]
        try:
            bounds = _narrowed(_with_inequalities(bounds, inequalities))
        except _ContradictionError as error:
            expected = f"a range that {ranged_maps} can be in"
            raise InputError(f"where {item.name}", expected, f"{item}, where {error}") from None
        conjunction = "with" if ranged_maps == maps else "and"
        ranged_maps += f" {conjunction} {item}"


def _crossings_of_signable(item: Range, bounds: FeatureBounds) -> list[_Inequality]:
    """Returns what a range of `signable` says of the crossings.

    Without crossings `signable` is 1. Without empty cells, each crossing has a road at a corner.
    """
    if item.high is not None and item.high < 1:
        return [_Inequality({"crossings": 1}, 1)]
    if item.low is not None and item.low > 0 and bounds.has_no_gaps:
        return [_at_most({"crossings": 1}, 0)]
    return []


def _least_tiles(where: Iterable[Range], shape: tuple[int, int]) -> list[_Inequality]:
    """Returns a least number of tiles.

    The least box around a town, times the least part of it that has tiles, gives this number.
    """
    least_shares = []
    for item in where:
        if item.name in ("box_share", "box_fill"):
            least_shares.append(item.low or 0)
    # The share of the box in the grid, times the share of the tiles in the box, is the share of the
    # tiles in the grid. One of them alone bounds nothing.
    if len(least_shares) < 2:
        return []
    least_tiles = ceil(prod(least_shares) * prod(shape))
    return [_Inequality({"tiles": 1}, least_tiles)]


def _check_range(item: Range, bounds: FeatureBounds, maps: str, *, asks_for_gaps: bool) -> None:
    """Checks that a range and the bounds of its feature have a value in common."""
    low, high = bounds.of(item.name)
    is_above = item.low is not None and item.low > high
    is_below = item.high is not None and item.high < low
    first = low if item.low is None else max(low, item.low)
    last = high if item.high is None else min(high, item.high)
    is_between_values = item.name in _LEAST_OF_TWOS and _next_value(item.name, first) > last
    # A range that ends before it begins comes of two options, which later checks name.
    if not is_above and not is_below and not is_between_values:
        return
    limits = f"{_format(low)}..{_format(high)}"
    if low == high:
        expected = _format(low)
    elif item.name not in _LEAST_OF_TWOS:
        expected = f"some of {limits}"
    elif _LEAST_OF_TWOS[item.name] % 2 == 0:
        expected = f"an even number in {limits}"
    elif low > 0:
        expected = f"an odd number in {limits}"
    else:
        expected = f"0 or an odd number in {limits}"
    unless = ""
    depends_on_gaps = asks_for_gaps or item.name in features_without_gaps(bounds.shape)
    if bounds.has_no_gaps and depends_on_gaps:
        unless = " unless rules, an inventory or fixed cells leave cells empty"
    raise InputError(
        f"where {item.name}", f"a range with {expected}, which {maps} have{unless}", str(item)
    )


def _next_value(feature: str, least: Fraction) -> Fraction:
    """Returns the least value of a feature that may occur and is at least a number.

    For most features this is the number itself.
    """
    if feature not in _LEAST_OF_TWOS or least <= 0:
        return least
    first = max(ceil(least), _LEAST_OF_TWOS[feature])
    return Fraction(first + (first - _LEAST_OF_TWOS[feature]) % 2)


def check_feasible(
    shape: tuple[int, int],
    where: Iterable[Range] = (),
    *,
    fix: FixedCells | None = None,
    rules: str | None = None,
    filled: bool = True,
    alphabet: Iterable[int] | None = None,
) -> None:
    """Checks that the bounds do not rule out all maps that satisfy some constraints.

    Some contradictions are missed. `filled` says whether every free cell has a road. The
    `InputError` states the bound.
    """
    where = tuple(where)
    codes = set(range(16) if alphabet is None else alphabet)
    # The first row with roads begins and ends with a turn, because its ends have no tiles beside
    # and above them. So does the last row: every map has all four turns.
    missing_turns = set(KINDS["turn"]) - codes
    if missing_turns:
        expected = f"the turns {KINDS['turn']}, which every map has"
        raise InputError("alphabet", expected, f"no {min(missing_turns)}")
    if fix is not None:
        _check_fixed(fix, rules, codes)
        _check_fixed_counts(fix, where)
        check_connectable(fix, filled)
    if where:
        fills_all_cells = filled and fix is None
        constraints = map_constraints(rules, filled=fills_all_cells)
        certain = {name: value for name, value, _ in constraints}
        maps = f"maps of {shape[0]} x {shape[1]} tiles"
        # A kind that the alphabet lacks has no tile on any map.
        lacking_kinds = [kind for kind in COUNTED if codes.isdisjoint(KINDS[kind])]
        certain |= {COUNTED[kind]: 0 for kind in lacking_kinds}
        if lacking_kinds:
            maps += f" without {' and '.join(lacking_kinds)}"
        if rules is not None and (min(shape) < 3 or max(shape) < 5):
            # By the rules, straights are next to a crossing on three sides, and each leads to a
            # further tile.
            certain["crossings"] = 0
        check_ranges(where, find_bounds(shape, certain), maps)


@lru_cache(maxsize=32)
def check_ranges_of_grids(
    where: tuple[Range, ...], shape: tuple[int, int], *, filled: bool
) -> None:
    """Checks ranges against the bounds of repaired grids; `filled` as for `check_feasible`.

    The result is cached, because a search that is repeated for other seeds is checked again.
    """
    known_metrics: dict[str, int] = {}
    # A repair that fills leaves no dead ends and no empty cells.
    if filled:
        known_metrics = {"dead_ends": 0, "empty_cells": 0}
    grids = f"repaired grids of {shape[0]} x {shape[1]}"
    check_ranges(where, find_bounds(shape, known_metrics), grids)


def _check_fixed(fix: FixedCells, rules: str | None, alphabet: Iterable[int]) -> None:
    for expected, wrong in (
        ("cells without dead ends", np.isin(fix.grid, KINDS["end"])),
        ("codes of the alphabet", ~np.isin(fix.grid, [*alphabet, *KINDS["empty"]])),
    ):
        for row, column in np.argwhere(wrong).tolist():
            got = f"code {fix.grid[row, column]} at {describe_cell(row, column)}"
            raise InputError("fix", expected, got)
    if rules is not None:
        metrics = plain_measure(fix.grid)
        for name in RULES[rules].forbidden:
            if metrics[name]:
                raise InputError(
                    "fix", f"cells that keep the rules of {rules}", f"{name} {metrics[name]}"
                )


def _check_fixed_counts(fix: FixedCells, where: Iterable[Range]) -> None:
    """Checks that no more tiles of a kind are fixed than ranges allow."""
    counts = {COUNTED[kind]: int(np.isin(fix.grid, KINDS[kind]).sum()) for kind in COUNTED}
    counts["crossings"] = counts["crossings3"] + counts["crossings4"]
    counts["tiles"] = int((fix.grid > 0).sum())
    for item in where:
        count = counts.get(item.name, 0)
        if item.high is not None and count > item.high:
            raise InputError("fix", f"at most {item.high} {item.name}", count)


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
        factors = _read_sum(left, constants)
        factors.subtract(_read_sum(right, constants))
        # Metrics are on the left of >=, and numbers move to the right.
        least = -factors.pop(_NUMBER, 0)
        if relation == ">=":
            inequalities.append(_Inequality(factors, least))
        elif relation == "<=":
            inequalities.append(_at_most(factors, least))
        else:
            inequalities += [_Inequality(factors, least), _at_most(factors, least)]
    return inequalities


def _read_sum(text: str, constants: Mapping[str, int]) -> Counter[str]:
    """Reads a sum of metrics times their factors, and of numbers.

    Returns the factor of each metric by name, and the sum of the numbers by `_NUMBER`.
    """
    factors: Counter[str] = Counter()
    # A term such as "2 edges" or "AREA components" is a product of words, with a metric at the end.
    for operator, term in re.findall(r"([+-]?) ?([\w ]*\w)", text):
        factor = -1 if operator == "-" else 1
        metric = _NUMBER
        for word in term.split():
            if word in constants:
                factor *= constants[word]
            elif word.isdigit():
                factor *= int(word)
            else:
                metric = word
        factors[metric] += factor
    return factors


def _at_most(factors: Mapping[str, int], most: int) -> _Inequality:
    """Returns the inequality that a sum is at most a number."""
    return _Inequality({name: -factor for name, factor in factors.items()}, -most)


def _inequalities_of_range(item: Range) -> list[_Inequality]:
    """Returns the inequalities of a range.

    The range of a share limits a part by a multiple of its whole.
    """
    part, whole = SHARES.get(item.name, (item.name, ()))
    inequalities = []
    for limit, sign in ((item.low, 1), (item.high, -1)):
        if limit is None:
            continue
        # A limit of N / D for part / whole is D part >= N whole, which has whole numbers alone.
        factors = {part: sign * limit.denominator}
        for name in whole:
            factors[name] = factors.get(name, 0) - sign * limit.numerator
        least = 0 if whole else sign * limit.numerator
        inequalities.append(_Inequality(factors, least))
    return inequalities


def _with_inequalities(bounds: FeatureBounds, more: Iterable[_Inequality]) -> FeatureBounds:
    return bounds._replace(inequalities=(*bounds.inequalities, *more))


def _narrowed(bounds: FeatureBounds) -> FeatureBounds:
    """Narrows the intervals until nothing changes, in at most `_MOST_ROUNDS`.

    Raises `_ContradictionError`.
    """
    intervals = dict(bounds.intervals)
    for _ in range(_MOST_ROUNDS):
        before = dict(intervals)
        # What one inequality narrows, others narrow further in this round or in the next.
        for inequality in bounds.inequalities:
            _narrow_by(inequality, intervals)
        _limit_edges(intervals)
        if intervals == before:
            break
    return bounds._replace(intervals=intervals)


def _narrow_by(inequality: _Inequality, intervals: dict[str, tuple[int, int]]) -> None:
    """Narrows the interval of each metric in an inequality.

    An interval keeps what the inequality allows if all other terms are largest.
    """
    factors, least = inequality
    largest_terms = {}
    for name, factor in factors.items():
        low, high = intervals[name]
        largest_terms[name] = max(factor * low, factor * high)
    # By this much the largest sum exceeds the limit. So no term may be smaller than its largest
    # value by more.
    spare = sum(largest_terms.values()) - least
    for name, factor in factors.items():
        least_term = largest_terms[name] - spare
        low, high = intervals[name]
        if factor > 0:
            # The quotient is rounded up.
            least_value = -(-least_term // factor)
            _set(intervals, name, max(low, least_value), high)
        elif factor < 0:
            most_value = least_term // factor
            _set(intervals, name, low, min(high, most_value))


def _limit_edges(intervals: dict[str, tuple[int, int]]) -> None:
    """Limits the edges by the tiles.

    A square has the most pairs of neighbours (Harary and Harborth, 1976).
    """
    _, tiles = intervals["tiles"]
    most_edges = 0
    if tiles:
        most_edges = 2 * tiles - isqrt(4 * tiles - 1) - 1
    low, high = intervals["edges"]
    _set(intervals, "edges", low, min(high, most_edges))


def _set(intervals: dict[str, tuple[int, int]], name: str, low: int, high: int) -> None:
    intervals[name] = (low, high)
    if low > high:
        words = name.replace("_", " ")
        raise _ContradictionError(f"{words} would be {low} or more and {high} or less")


def _format(limit: Fraction) -> str:
    if limit.denominator == 1:
        return str(limit)
    return f"{float(limit):.3g}"
