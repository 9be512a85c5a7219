"""Bounds refuse nothing that there is: shown on all small grids, and on random larger ones."""

from fractions import Fraction
from functools import cache
from itertools import product

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused

from elitelanes_jax import SearchSpec
from elitelanes_jax.maps.furnishing.signs import crossings, has_free_corners
from elitelanes_jax.network import gridlock_number, measure_town, plain_measure, repair
from elitelanes_jax.network.codes import CONNECTIONS, SIDES
from elitelanes_jax.network.records import features_without_gaps
from elitelanes_jax.problem.bounds import check_feasible, check_ranges, check_ranges_of_grids, find_bounds
from elitelanes_jax.problem.features import FEATURES, SHARES, feature_unit
from elitelanes_jax.problem.fixed_cells import parse_fixed_cells
from elitelanes_jax.problem.ranges import Range, parse_ranges
from elitelanes_jax.problem.rules import map_constraints
from elitelanes_jax.search.resolve import resolve

SHAPES = [(2, 2), (2, 3), (3, 2), (3, 3)]


def grid_of(shape, links):
    """The grid whose cells are linked so, and have no other connections."""
    grid = np.zeros(shape, np.int8)
    for row, column, index in links:
        side = SIDES[index]
        grid[row, column] |= side.bit
        grid[row + side.down, column + side.right] |= side.opposite
    return grid


def all_links(shape):
    sides = [(row, column, index) for row, column in np.ndindex(*shape) for index in (1, 2)]
    return [
        link for link in sides if link[0] + SIDES[link[2]].down < shape[0] and link[1] + SIDES[link[2]].right < shape[1]
    ]


@cache
def repaired_grids(shape):
    """All grids of which every connection is returned, each with its metrics."""
    links = all_links(shape)
    found = [
        grid_of(shape, [link for link, on in zip(links, there, strict=True) if on])
        for there in product((0, 1), repeat=len(links))
    ]
    return [(grid, metrics_of(grid)) for grid in found]


def metrics_of(grid):
    return plain_measure(grid) | {f"crossings{n}": int((CONNECTIONS[grid] == n).sum()) for n in (3, 4)}


def is_map(metrics, rules, filled):
    return all(metrics[name] == right for name, right, _ in map_constraints(rules, filled=filled))


def check(bounds, metrics):
    for name, (low, high) in bounds.intervals.items():
        assert low <= metrics[name] <= high, name
    for factors, least in bounds.inequalities:
        assert sum(factor * metrics[name] for name, factor in factors.items()) >= least, factors


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("rules", "filled"), [(None, True), (None, False), ("duckietown", False), (None, None)])
def test_bounds_hold_on_all_maps(shape, rules, filled):
    """And on all repaired grids, if `filled` is None."""
    constraints = () if filled is None else map_constraints(rules, filled=filled)
    certain = {name: right for name, right, _ in constraints}
    bounds = find_bounds(shape, certain)
    kept = [metrics for _, metrics in repaired_grids(shape) if certain.items() <= metrics.items()]
    assert kept
    for metrics in kept:
        check(bounds, metrics)


@pytest.mark.parametrize("shape", [pytest.param((2, 3), marks=pytest.mark.slow), (3, 3)])
@pytest.mark.parametrize("filled", [True, False])
def test_bounds_of_town_features_hold_on_all_maps(shape, filled):
    bounds = find_bounds(shape, {name: right for name, right, _ in map_constraints(None, filled=filled)})
    kept = np.array([grid for grid, metrics in repaired_grids(shape) if is_map(metrics, None, filled)])
    for name, values in jax.vmap(measure_town)(kept)._asdict().items():
        low, high = (limit * feature_unit(name) for limit in bounds.of(name))
        assert low <= int(values.min()) <= int(values.max()) <= high, name
        if filled and name in features_without_gaps(shape):
            assert low == high


@st.composite
def networks(draw):
    """Repaired grids of up to 12 x 12, most without dead ends."""
    shape = draw(st.tuples(st.integers(2, 12), st.integers(2, 12)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    share = draw(st.sampled_from([0.2, 0.5, 0.7, 0.9, 1.0]))
    links = [link for link in all_links(shape) if rng.random() < share]
    for _ in range(draw(st.sampled_from([0, 3, 99]))):  # dead ends are taken back
        ends = np.argwhere(CONNECTIONS[grid_of(shape, links)] == 1).tolist()
        far = {link: (link[0] + SIDES[link[2]].down, link[1] + SIDES[link[2]].right) for link in links}
        links = [link for link in links if [*link[:2]] not in ends and [*far[link]] not in ends]
    return grid_of(shape, links)


@given(networks(), st.lists(st.sampled_from(FEATURES), unique=True), st.integers(0, 2))
def test_what_a_network_is_can_be_asked_for(grid, names, spread):
    """Bounds hold on it, and a search for its own values is not refused."""
    metrics = metrics_of(grid)
    bounds = find_bounds(grid.shape, {})
    check(bounds, metrics)
    where = []
    for name in names:
        part, whole = SHARES.get(name, (name, ()))
        value = Fraction(metrics[part], max(sum(metrics[other] for other in whole), 1) if whole else 1)
        around = Fraction(spread, 10 if whole else 1)
        where.append(Range(name, max(value - around, Fraction(0)), value + around))
    check_ranges(where, bounds, "maps")


def test_messages_say_the_bound():
    for options, subject, got, expected in (
        ({"where": "cyclomatic=100.."}, "where cyclomatic", "cyclomatic=100..", "some of 1..9, which"),
        ({"where": "tiles=0..3"}, "where tiles", "tiles=0..3", "with 16, which"),
        ({"where": "tiles=0..3", "rules": "duckietown"}, "where tiles", "tiles=0..3", "some of 4..13, which"),
        ({"where": ["cyclomatic=2", "crossings=3.."]}, "where crossings", "crossings=3..,...", "with cyclomatic=2 can"),
        ({"where": "straight_share=0.8.."}, "where straight_share", "straight_share=0.8..", "some of 0..0.75, which"),
        (
            {"where": ["box_share=0.9..", "box_fill=0.9..", "tiles=..12"], "fill": False},
            "where tiles",
            "tiles=..12",
            "some of 13..16, which",
        ),
        (
            {"alphabet": [3, 5, 6, 9, 10, 12, 15], "where": "crossings3=1.."},
            "where crossings3",
            "crossings3=1..",
            "with 0, which maps of 4 x 4 tiles without crossing3",
        ),
        ({"alphabet": [3, 5, 6, 9, 10]}, "alphabet", "no 12", "(3, 6, 9, 12)"),
    ):
        with refused(subject, got, expected):
            resolve(SearchSpec(**options), (4, 4), room_for="maps")


FREE = None
POCKET = [[FREE, FREE, FREE], [FREE, 0, 0], [FREE, FREE, FREE]]
STUB = [[FREE, FREE, 0], [FREE, FREE, FREE], [0, 0, FREE]]
ENCLOSED = [[FREE, FREE, 0], [FREE, FREE, 0], [0, 0, FREE]]
HALVES = [[FREE, FREE, 0, FREE, FREE]] * 2
RINGS = [[6, 3, 0, 6, 3], [12, 9, 0, 12, 9]]
RING = [[6, 3, FREE, FREE], [12, 9, FREE, FREE]]


@pytest.mark.parametrize(
    ("cells", "got", "passes_unfilled"),
    [
        (POCKET, "one at C1 ([0, 2])", False),
        (STUB, "one at C3 ([2, 2])", True),
        ([[0, 0], [0, 0]], "none", False),
        (HALVES, "no way from A1 ([0, 0]) to D1 ([0, 3])", True),
        (RINGS, "no way from A1 ([0, 0]) to D1 ([0, 3])", False),
        (RING, "no way from A1 ([0, 0]) to C1 ([0, 2])", True),
    ],
)
def test_fixed_cells_leave_room_for_a_network(cells, got, passes_unfilled):
    shape, fix = (len(cells), len(cells[0])), parse_fixed_cells(cells)
    with refused("fix", got):
        check_feasible(shape, fix=fix)
    if passes_unfilled:
        check_feasible(shape, fix=fix, filled=False)
    else:
        with refused("fix", expected="cells"):
            check_feasible(shape, fix=fix, filled=False)


def test_fixed_cells_that_contradict_the_alphabet_or_a_range_are_refused():
    rows = [[None] * 4 for _ in range(4)]
    rows[1][1], rows[1][2] = 15, 7
    fix = parse_fixed_cells(rows)
    with refused("fix", "code 15 at B2 ([1, 1])", expected="alphabet"):
        check_feasible((4, 4), fix=fix, alphabet=[3, 5, 6, 7, 9, 10, 11, 12, 13, 14])
    for where, most, count in (("crossings=..1", "at most 1 crossings", 2), ("crossings4=0", "at most 0 cross", 1)):
        with refused("fix", str(count), expected=most):
            check_feasible((4, 4), parse_ranges([where]), fix=fix)
    check_feasible((4, 4), parse_ranges(["crossings=..2", "crossings4=..1"]), fix=fix, alphabet=range(16))


def test_an_enclosed_cell_stays_empty():
    check_feasible((3, 3), fix=parse_fixed_cells(ENCLOSED))
    grid = repair(np.zeros((3, 3), np.int8), fill=True, fixed=parse_fixed_cells(ENCLOSED).fixed)
    np.testing.assert_array_equal(grid, [[6, 3, 0], [12, 9, 0], [0, 0, 0]])


@pytest.mark.parametrize("filled", [True, False])
@pytest.mark.parametrize("shape", [(2, 3), (3, 3)])
def test_any_cells_of_a_map_can_be_fixed(shape, filled):
    random = np.random.default_rng(5)
    maps = [grid for grid, metrics in repaired_grids(shape) if is_map(metrics, None, False)]
    for grid in maps:
        # Cells without a road that are not fixed may only stay empty if nothing fills them.
        fixed = (random.random(shape) < random.random()) | (filled & (grid == 0))
        codes = np.where(fixed, grid, -1).tolist()
        rows = [[None if code < 0 else code for code in row] for row in codes]
        check_feasible(shape, fix=parse_fixed_cells(rows), filled=filled)
    assert maps


def test_bounds_of_large_grids_take_no_time():
    for shape in ((12, 12), (1024, 2), (1024, 1024)):
        check_feasible(shape, parse_ranges(["cyclomatic=1..", "straight_share=0.1.."]))


@pytest.mark.parametrize("name", ["crowded_crossings", "unlinked_neighbours"])
def test_one_of_the_rules_alone_leaves_no_room_for_signs(name):
    """A full grid has no unlinked neighbours."""
    assert find_bounds((3, 3), {name: 0}).of("signable") == (0, 1)
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]])
    assert measure_town(full).signable == plain_measure(full)["unlinked_neighbours"] == 0


def test_crossings_that_keep_the_rules_have_room_for_signs():
    """Outlines of three rectangles over one another; those that keep the rules."""
    rules = map_constraints("duckietown", filled=False)
    low, high = find_bounds((9, 9), {name: right for name, right, _ in rules}).of("signable")
    assert low == high == 1
    rng, kept = np.random.default_rng(0), 0
    for _ in range(300):
        links = set()
        for _ in range(3):
            (top, bottom), (left, right) = (sorted(rng.choice([0, 2, 5, 8], 2, replace=False)) for _ in range(2))
            links |= {(row, column, 1) for row in (top, bottom) for column in range(left, right)}
            links |= {(row, column, 2) for column in (left, right) for row in range(top, bottom)}
        grid = grid_of((9, 9), links)
        metrics = metrics_of(grid)
        if metrics["crossings"] and is_map(metrics, "duckietown", filled=False):
            kept += 1
            assert all(has_free_corners(grid, crossing) for crossing in crossings(grid))
    assert kept >= 20


@pytest.mark.parametrize("shape", SHAPES)
def test_crossings_of_maps_without_empty_cells_have_no_room_for_signs(shape):
    grids = np.array([grid for grid, metrics in repaired_grids(shape) if not metrics["empty_cells"]])
    towns = jax.vmap(measure_town)(grids)
    has_crossing = np.array([plain_measure(grid)["crossings"] > 0 for grid in grids])
    np.testing.assert_array_equal(np.asarray(towns.signable), np.where(has_crossing, 0, 1000))


@pytest.mark.parametrize(
    ("where", "filled", "subject", "got", "expected"),
    [
        (["signable=0.1..", "crossings=1.."], True, "where crossings", "crossings=1..", "with 0, which"),
        (["crossings=1..", "signable=1"], True, "where signable", "signable=1, where crossings would be...", ""),
        (["crossings=0", "signable=..0.9"], False, "where signable", "signable=..0.9, where crossings would be...", ""),
        (["signable=1"], True, None, None, None),
        (["signable=..0", "crossings=1.."], True, None, None, None),
        (["signable=1", "crossings=4.."], False, None, None, None),
    ],
)
def test_a_range_of_room_for_signs_says_whether_there_are_crossings(where, filled, subject, got, expected):
    if subject is None:
        check_feasible((6, 6), parse_ranges(where), filled=filled)
        return
    with refused(subject, got, expected):
        check_feasible((6, 6), parse_ranges(where), filled=filled)


@pytest.mark.parametrize(
    ("where", "subject", "got", "expected"),
    [
        (["gridlock_number=1..2"], "where gridlock_number", "gridlock_number=1..2", "in 3..35"),
        (["gridlock_number=36.."], "where gridlock_number", "gridlock_number=36..", "in 3..35"),
        (["tiles=..15", "gridlock_number=15.."], "where gridlock_number", "gridlock_number=15..", "in 3..13"),
        (["gridlock_number=15..", "tiles=..15"], "where tiles", "tiles=..15", "of 16..36"),
        (["gridlock_number=14..", "tiles=..15"], "where tiles", "tiles=..15", "of 16..36"),
    ],
)
def test_the_shortest_loop_needs_tiles(where, subject, got, expected):
    with refused(subject, got, expected):
        check_feasible((6, 6), parse_ranges(where), filled=False)
    check_feasible((6, 6), parse_ranges(["gridlock_number=15..", "tiles=..16"]), filled=False)


@pytest.mark.parametrize(
    ("name", "expected"), [("gridlock_number", "0 or an odd number in 0..7"), ("adjacent_crossings", "an even number")]
)
def test_a_number_between_the_values_of_a_feature_is_refused(name, expected):
    grids = repaired_grids((3, 3))
    values = {metrics.get(name) for _, metrics in grids}
    if name == "gridlock_number":
        values = set(np.asarray(jax.vmap(gridlock_number)(np.array([grid for grid, _ in grids]))).tolist())
    assert len(values) >= 4
    for value in range(max(values) + 1):
        ranges = tuple(parse_ranges([f"{name}={value}"]))
        if value in values:
            check_ranges_of_grids(ranges, (3, 3), filled=False)
        else:
            with refused(f"where {name}", f"{name}={value}", expected):
                check_ranges_of_grids(ranges, (3, 3), filled=False)


def test_the_gridlock_number_is_within_its_bounds():
    grids = repaired_grids((3, 3))
    numbers = np.asarray(jax.vmap(gridlock_number)(np.array([grid for grid, _ in grids])))
    loops = np.array([metrics["cyclomatic"] for _, metrics in grids])
    for count in range(5):
        low, high = find_bounds((3, 3), {"cyclomatic": count}).of("gridlock_number")
        assert low <= numbers[loops == count].min() and numbers[loops == count].max() <= high
