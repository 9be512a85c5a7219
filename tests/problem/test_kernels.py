"""Features of one's own: measured where they are asked for, in ranges, axes and weights, and kept with the result."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve
from refusals import refused

from elitelanes_jax import Result, SearchSpec, random_grids, road_problem
from elitelanes_jax.network import measure_town
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.kernels import digest
from elitelanes_jax.problem.road import _sum_exceeds
from elitelanes_jax.search.resolve import resolve

SHAPE, PAPER = (5, 5), {"preset": "paper"}


def row_sum(grid):
    """The codes of the first row, summed: a feature that no metric is."""
    return grid[0].astype(jnp.int32).sum()


def middle(grid):
    return grid[2, 2].astype(jnp.int32)


FEATURES = {"row_sum": row_sum, "middle": middle}
RUN = {"axes": "cyclomatic:4:2 middle:16:1", "where": {"row_sum": (30, 40)}, "features": FEATURES} | PAPER


@pytest.fixture(scope="module")
def result():
    return evolve(jax.random.split(jax.random.key(0), 2), SHAPE, **RUN, generations=20)


def test_values_are_those_of_the_kernels(result):
    valid = np.asarray(result.elites.valid)
    grids = np.asarray(result.elites.grids)[valid]
    assert set(result.elites.features) == {"middle", "row_sum"}
    np.testing.assert_array_equal(np.asarray(result.elites.features["row_sum"])[valid], grids[:, 0].sum(axis=1))
    np.testing.assert_array_equal(np.asarray(result.elites.features["middle"])[valid], grids[:, 2, 2])
    np.testing.assert_array_equal(np.asarray(result.elites.descriptor)[valid][:, 1], grids[:, 2, 2])


def test_chosen_maps_are_in_the_ranges_and_have_the_values(result):
    for road_map in result.choose(50).maps:
        assert 30 <= road_map.codes[0].sum() <= 40
        assert road_map.metrics["row_sum"] == road_map.codes[0].sum()
        assert road_map.descriptor["middle"] == road_map.codes[2, 2]
    sums = np.asarray(result.elites.grids)[..., 0, :].sum(axis=-1)
    valid = np.asarray(result.elites.valid)
    np.testing.assert_array_equal(result.satisfies(), valid & (sums >= 30) & (sums <= 40))
    assert 0 < result.satisfies().sum() < valid.sum()


def test_a_result_is_saved_and_read_with_them(result, tmp_path):
    result.save(tmp_path / "result.npz")
    read = Result.load(tmp_path / "result.npz")
    assert read.search == result.search
    jax.tree.map(np.testing.assert_array_equal, read.elites, result.elites)
    np.testing.assert_array_equal(read.satisfies(), result.satisfies())


def test_a_weight_is_what_a_unit_adds():
    usual, weighed = (
        evolve(jax.random.key(1), SHAPE, evaluations=0, method="ea", **options, **PAPER)
        for options in ({}, {"features": FEATURES, "weights": {"row_sum": -7, "bridges": 100}})
    )
    grids = {grid.tobytes(): int(fitness) for grid, fitness in zip(*np_elites(usual), strict=True)}
    for grid, fitness in zip(*np_elites(weighed), strict=True):
        assert int(fitness) == grids[grid.tobytes()] - 7 * grid[0].sum()


@pytest.mark.parametrize(
    "measured",
    [
        ["row_sum", "turns", "signable"],
        [],
        *(pytest.param(slow, marks=pytest.mark.slow) for slow in (["signable", "row_sum"], ["row_sum"])),
    ],
)
def test_weights_are_those_of_the_measured_in_their_order(measured):
    grids, axes = random_grids(jax.random.key(0), 8, SHAPE), "signable:5"
    usual, weighed = (
        road_problem(SHAPE, axes, measured=measured, features=FEATURES, feature_weights=weights).evaluate(grids)
        for weights in (None, 1 + np.arange(len(measured)))
    )
    towns = jax.vmap(measure_town)(grids)
    values = {"signable": towns.signable, "row_sum": jax.vmap(row_sum)(grids)}
    values["turns"] = usual.features[:, METRIC_NAMES.index("turns")]
    added = sum(((1 + place) * values[name] for place, name in enumerate(measured)), np.zeros(8, int))
    np.testing.assert_array_equal(weighed.fitness - usual.fitness, added)


def test_the_limit_of_weighted_features_is_exact():
    values = jnp.array([[2**28, 0], [2**28 + 1, 0], [-1, 1], [0, -(2**30)], [2**28 - 1, 2]], jnp.int32)
    assert _sum_exceeds(2**29, values, jnp.array([2, 1])).tolist() == [False, True, False, True, False]
    assert _sum_exceeds(2**29, values, jnp.array([-(2**31), 0])).tolist() == [True, True, True, False, True]


def np_elites(result):
    return np.asarray(result.elites.grids), np.asarray(result.elites.fitness)


def test_values_may_be_negative():
    features, options = {"low": lambda grid: -grid[0, 0].astype(jnp.int32) - 5}, {"method": "ea", "evaluations": 0}
    result = evolve(jax.random.key(0), (3, 3), features=features, where="low=-11..-9", **options, **PAPER)
    np.testing.assert_array_equal(result.elites.features["low"], -result.elites.grids[:, 0, 0].astype(int) - 5)
    inside = np.isin(result.elites.grids[:, 0, 0], (4, 6))
    np.testing.assert_array_equal(result.satisfies(), inside)
    assert inside.any()


@pytest.mark.parametrize(
    ("features", "options", "subject", "got", "expected"),
    [
        ({"turns": middle}, {}, "features", "'turns'", "built-in"),
        ({"a b": middle}, {}, "features", "'a b'", "letters"),
        ({"mine": 3}, {}, "features", "3", "mine"),
        ({"mine": lambda grid: grid.mean()}, {}, "features", "float32 of shape ()", "mine"),
        ({"mine": lambda grid: grid[0]}, {}, "features", "int8 of shape (5,)", "mine"),
        ({"mine": lambda grid: None}, {}, "features", "None", "mine"),
        ([middle], {}, "features", "[<function middle ...", "by name"),
        ({"mine": middle}, {"where": "yours=3"}, "where 'yours=3'", "'yours'", "a feature"),
        ({"mine": lambda grid: int(grid[0, 0])}, {}, "features", None, "trace"),
        (None, {"spec": SearchSpec(features=["mine"])}, "features", "none", "the kernel of mine"),
    ],
)
def test_wrong_features_are_named(features, options, subject, got, expected, any_types):
    with refused(subject, got, expected):
        evolve(jax.random.key(0), SHAPE, features=features, **options)


def test_the_name_of_a_users_feature_is_suggested(any_types):
    with refused("axes 'min:3'", "'min'", hint="is it mine?"):
        evolve(jax.random.key(0), SHAPE, features={"mine": middle}, axes="min:3")


def counting(codes):
    """Makes a feature that counts cells of some codes: other codes give other constants in the same jaxpr."""
    table = np.zeros(16, np.int32)
    table[codes] = 1
    return lambda grid: jnp.asarray(table)[grid.astype(int)].sum()


def test_a_digest_is_of_the_jaxpr_and_its_constants():
    grid = jax.ShapeDtypeStruct((3, 4), jnp.int8)
    assert digest(counting([5, 10]), grid) == digest(counting([5, 10]), grid)
    nested = [jax.jit(counting(codes)) for codes in ([3], [6])]
    looped = [lambda grid, f=f: jax.lax.fori_loop(0, 2, lambda _, total: total + f(grid), 0) for f in nested]
    functions = [counting([5, 10]), counting([3]), counting([6]), *nested, *looped, lambda grid: grid.sum()]
    assert len({digest(function, grid) for function in functions}) == len(functions)


def test_a_digest_knows_floats_that_the_result_depends_on():
    grid = jax.ShapeDtypeStruct((3, 4), jnp.int8)
    floats = [lambda grid: 0.5 * grid.sum(), lambda grid: (grid.mean() * 3).astype(int), jax.jit(jnp.mean)]
    whole = [lambda grid: (grid.sum(), 0.5 * grid)[0], lambda _: 7, counting([3])]
    with jax.numpy_dtype_promotion("standard"):
        assert [digest(function, grid)[1] for function in (*floats, *whole)] == [True] * 3 + [False] * 3


def test_own_features_come_after_the_metrics():
    spec = SearchSpec(features=["a", "b", "c"], axes=["turns:3", "c:4:1"], weights={"b": 1})
    search = resolve(spec, (4, 4))
    assert search.measured == ("c", "b", "a") and search.feature_weights == (0, 1, 0)
    assert not set(search.measured) & set(METRIC_NAMES)


@pytest.mark.slow
def test_features_of_a_town_are_measured_where_they_are_named():
    options = {"axes": ["symmetry:4", "turns:4"], "where": "box_fill=0.5.. repetition=..0.9", "rules": "duckietown"}
    found = evolve(jax.random.split(jax.random.key(0), 2), (5, 6), generations=30, **options, **PAPER)
    assert set(found.elites.features) == {"symmetry", "box_fill", "repetition"}
    valid = np.asarray(found.elites.valid)
    towns = jax.vmap(measure_town)(found.elites.grids[valid])
    for name, values in found.elites.features.items():
        np.testing.assert_array_equal(np.asarray(values)[valid], getattr(towns, name))
    np.testing.assert_array_equal(np.asarray(found.elites.descriptor)[valid][:, 0], towns.symmetry)
    inside = (np.asarray(towns.box_fill) >= 500) & (np.asarray(towns.repetition) <= 900)
    np.testing.assert_array_equal(found.satisfies()[valid], inside)
    # The few grids of this search without flaws break the rules.
    spec = found.search.to_spec().replace(rules=None, fill=False, where="box_fill=0..")
    free = replace(found, search=resolve(spec, found.search.shape, room_for="anything"))
    with pytest.warns(UserWarning, match="^found [1-9] of 99 maps"):
        maps = free.maps(99, where="mean_street=1..")  # measured for the choice
    for road_map in maps:
        assert int(measure_town(road_map.codes).mean_street) == 1000 * road_map.metrics["mean_street"] >= 1000
    with refused("shape", "33 x 4", expected="at most 32"):
        evolve(0, (33, 4), where="mean_detour=1..2")
