"""Features, ranges and fixed cells."""

from fractions import Fraction
from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import grids
from hypothesis import given
from hypothesis import strategies as st
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Weights, measure, road_problem
from elitelanes_jax.network.metrics import stack_metrics
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.features import FEATURES, SHARES, default_width, with_shares
from elitelanes_jax.problem.fixed_cells import parse_fixed_cells
from elitelanes_jax.problem.ranges import Range, parse_ranges, range_limits, range_penalty, satisfies


@partial(jax.jit, static_argnums=2)
def penalty_of(features, limits, shape):
    return range_penalty(features, METRIC_NAMES, limits, shape)


def penalty(features, where, shape):
    return penalty_of(features, range_limits(where, METRIC_NAMES), shape)


@given(grids())
def test_shares_are_parts_in_thousandths_rounded_down(grid):
    found = oracle(grid)
    values, names = with_shares(stack_metrics(measure(grid)), METRIC_NAMES)
    features = dict(zip(names, values.tolist(), strict=True))
    for name, (part, whole) in SHARES.items():
        total = sum(found[metric] for metric in whole)
        assert features[name] == (1000 * found[part] // total if total else 0)
    assert {name: features[name] for name in METRIC_NAMES} == {name: found[name] for name in METRIC_NAMES}


@given(grids(), st.sampled_from(FEATURES), st.integers(0, 20), st.integers(0, 20))
def test_a_range_is_met_exactly_where_nothing_is_short(grid, name, one, other):
    low, high = sorted((one, other))
    unit = 20 if name in SHARES else 1
    item = Range(name, Fraction(low, unit), Fraction(high, unit))
    metrics = oracle(grid)
    part, whole = SHARES.get(name, (name, ()))
    total = max(sum(metrics[metric] for metric in whole), 1)  # a share of nothing is 0
    inside = low * total <= unit * metrics[part] <= high * total
    assert satisfies(metrics, [item]) == inside
    short = int(penalty(stack_metrics(measure(grid)), [item], grid.shape))
    assert short >= 0
    assert not (inside and short), "what meets it costs nothing"
    if name not in SHARES:
        assert (short == 0) == inside


def test_the_farther_from_a_range_the_more_it_costs():
    features = jnp.zeros((40, len(METRIC_NAMES)), jnp.int32).at[:, METRIC_NAMES.index("crossings")].set(jnp.arange(40))
    cost = np.asarray(penalty(features, parse_ranges(["crossings=10..20"]), (12, 12)))
    assert (np.diff(cost[:11]) < 0).all()
    assert (cost[10:21] == 0).all()
    assert (np.diff(cost[20:]) > 0).all()


def test_scores_cost_as_much_as_tiles_of_a_street():
    """Along 12 tiles: the 12th straight of a street adds 23 to its score, and two crossings side by side score 8."""
    scores = (("straight_score", 24), ("adjacent_crossing_score", 8), ("crossings", 1))
    for (name, unit), shape in product(scores, ((12, 5), (5, 12))):
        values = jnp.zeros((3, len(METRIC_NAMES)), jnp.int32)
        values = values.at[:, METRIC_NAMES.index(name)].set(jnp.array([100, 100 - unit, 100 - 3 * unit]))
        assert penalty(values, parse_ranges([f"{name}=100.."]), shape).tolist() == [0, 480, 3 * 480]


@pytest.mark.parametrize(("bins", "widths"), [(6, [3, 27, 167, 1]), (4, [5, 41, 250, 1])])
def test_default_bins_reach_half_of_what_there_may_be(bins, widths):
    names = ("turns", "straight_score", "turn_share", "cyclomatic")
    assert [default_width(name, bins, (4, 9)) for name in names] == widths


@pytest.mark.usefixtures("any_types")
def test_ranges_are_read():
    assert parse_ranges(["crossings=6..10", "bridges=0", "straight_share=0.3..", "tiles=..9"]) == (
        Range("crossings", Fraction(6), Fraction(10)),
        Range("bridges", Fraction(0), Fraction(0)),
        Range("straight_share", Fraction(3, 10), None),
        Range("tiles", None, Fraction(9)),
    )
    assert parse_ranges({"crossings": (6, None), "bridges": 0}) == parse_ranges(["crossings=6..", "bridges=0"])
    assert parse_ranges("bridges=0") == parse_ranges(["bridges=0"]) == parse_ranges({"bridges": "0"})
    assert parse_ranges({"crossings": "6..10", "bridges": "..2"}) == parse_ranges("crossings=6..10 bridges=..2")
    assert [str(item) for item in parse_ranges(["crossings=6..10", "bridges=0"])] == ["crossings=6..10", "bridges=0"]
    third = (Range("straight_share", Fraction(1, 3), None),)
    assert parse_ranges(["straight_share=1/3.."]) == parse_ranges({"straight_share": (1 / 3, None)}) == third
    assert parse_ranges(["straight_share=0.33333333.."]) == parse_ranges(third) == third
    assert parse_ranges({"straight_share": (0.1 + 0.2, 1)})[0].low == Fraction(3, 10)
    assert parse_ranges(["straight_share=1e-99999999..", "tiles=1e1"])[0].low == 0
    for wrong, subject, got in (
        (6, "where", "6"),
        (["crossings=6..x"], "where 'crossings=6..x'", "'x'"),
        ({"crossings": ()}, "where: crossings", "()"),
        ({"crossings": (1, 2, 3)}, "where: crossings", "(1, 2, 3)"),
        (["crossings=1e99999999"], "where 'crossings=1e99999999'", "'1e99999999'"),
        (["crossings=1234567..3"], "where 'crossings=1234567..3'", "1234567 before 3"),
        ([Range("crossings", 5, 3)], "where 'crossings=5..3'", "5 before 3"),
        ([Range("crossings", 2**40, None)], "where 'crossings=1099511627776..'", "1099511627776"),
    ):
        with refused(subject, got):
            parse_ranges(wrong)
    for wrong, subject in (("crossing=6", "where 'crossing=6'"), (Range("crossing", 1, 2), "where 'crossing=1..2'")):
        with refused(subject, "'crossing'", hint="is it crossings?"):
            parse_ranges([wrong])


def test_fixed_cells_are_read(tmp_path):
    file = tmp_path / "city.json"
    file.write_text("[[6, 5, null], [null, 0, null]]")
    fixed = parse_fixed_cells(file)
    assert fixed.shape == (2, 3)
    assert fixed.rows == [[6, 5, None], [None, 0, None]]
    assert fixed.codes == (6, 5, None, None, 0, None)
    assert parse_fixed_cells([[6, 5, None], [None, 0, None]]) == fixed == parse_fixed_cells(fixed)
    np.testing.assert_array_equal(fixed.fixed, [[1, 1, 0], [0, 1, 0]])
    assert hash(fixed) == hash(parse_fixed_cells(fixed.rows))
    codes = np.array([[6, 5, 15], [15, 0, 15]])
    assert parse_fixed_cells(np.ma.masked_equal(codes, 15)) == fixed, "a masked cell is free"
    for text, place, got, expected in (
        ("[[", "", "...", "JSON"),
        (f"[[{'1' * 5000}]]", "", "...", "JSON"),
        ("{}", "", "{}", "rows of tile codes"),
        ("7", "", "7", "rows of tile codes"),
        ("[[1, 2], [3]]", "", "2 rows of 1 or 2", "one length"),
        ("[[5, 5]]", ": shape", "1 x 2", "new maps"),
        ("[[99, null, null], [null, null, null]]", "", "99 at A1 ([0, 0])", "0 to 15"),
        ("[[8, null, null], [null, null, null]]", "", "one that leaves it to the north at A1 ([0, 0])", ""),
        ("[[4, 0, null], [null, null, null]]", "", "a road to the east at A1 ([0, 0]) that B1 ([0, 1]) ...", ""),
        ("[[0, 1, null], [null, null, null]]", "", "a road to the west at B1 ([0, 1]) that A1 ([0, 0]) ...", ""),
    ):
        file.write_text(text)
        with refused(f"{file}{place}", got, expected):
            parse_fixed_cells(file)
    with refused(tmp_path / "none.json", "no such file or directory"):
        parse_fixed_cells(tmp_path / "none.json")


def test_fixed_cells_are_lists_or_arrays():
    whole = [[6, 5, 3], [12, 5, 9]]
    array = np.array(whole, np.int8)
    for cells in (array, jnp.asarray(array), array.astype(object), [[np.int8(code) for code in row] for row in whole]):
        assert parse_fixed_cells(cells) == parse_fixed_cells(whole)
    for cells in ([[6, 5, 0], [None] * 3], np.array([[6, 5, 0], [8, 0, 0]]), [list(np.int8([6, 5, 0])), [None] * 3]):
        with refused("fix", "a road to the east at B1 ([0, 1]) that C1..."):
            parse_fixed_cells(cells)
    with refused("fix", "'x' at B1 ([0, 1])"):
        parse_fixed_cells([[6, "x", None], [None] * 3])


def test_violations_do_not_leave_32_bits():
    features = jnp.full((1, len(METRIC_NAMES)), 2**20 * 1024, jnp.int32)
    nothing = [Range(name, Fraction(0), Fraction(0)) for name in FEATURES]
    assert 0 < int(penalty(features, nothing, (1024, 1024))[0]) <= 2**30
    # Limits of ratios are in thousandths.
    assert range_limits(parse_ranges({"mean_block": (None, 2**30)}), ["mean_block"])[1, 0] == 2**30


def test_a_range_of_a_share_between_thousandths_costs_nothing_within():
    """Two of six tiles are straight, a share of a third; in thousandths, 333."""
    grid = np.array([[6, 5, 3], [12, 5, 9]], np.int8)
    where = [Range("straight_share", Fraction(3333, 10_000), None)]
    assert satisfies(oracle(grid), where)
    assert penalty(stack_metrics(measure(grid)), where, grid.shape) == 0


def test_limits_count_in_the_largest_fitness_and_are_checked():
    columns = len(METRIC_NAMES) + len(SHARES)
    limits = range_limits(parse_ranges({"bridges": (2**20, None)}), METRIC_NAMES)
    weights = Weights(constant=2**31 - 10**6)
    for options in ({"where": {"bridges": (2**20, None)}}, {"limits": limits}, {"limits": jnp.asarray(limits)}):
        with refused("weights", "weights with which it might reach ..."):
            road_problem((4, 4), weights=weights, **options)
    unlimited = range_limits((), METRIC_NAMES)
    assert road_problem((4, 4), weights=weights, limits=unlimited).evaluate(jnp.zeros((1, 4, 4), jnp.int8))
    assert jax.jit(lambda limits: road_problem((4, 4), limits=limits).evaluate(jnp.zeros((1, 4, 4), jnp.int8)))(limits)
    with refused("limits", "[2, 3]", expected=f"[2, {columns}]"):
        road_problem((4, 4), limits=jnp.zeros((2, 3), jnp.int32))
    far = limits.copy()
    far[0, 0] = -(2**31)
    with refused("limits", "-2,147,483,648 to 1,073,741,824"):
        road_problem((4, 4), limits=far)
