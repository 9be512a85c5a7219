"""The archive against a dictionary filled one grid at a time, its ties, its niches, and its measures."""

from functools import partial
from math import prod

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusals import refused

from elitelanes_jax import Axis, Problem
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem import Population, coverage, insert, qd_score
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.descriptor import niche_bins, niche_index, paper_axes, resolve_axes

AXES = (Axis("cyclomatic", 3, width=2), Axis("dead_ends", 2, width=1))


insert_jit = jax.jit(insert, static_argnames="accept_equal")
PROBLEM = Problem((2, 2), lambda grids: None, METRIC_NAMES, AXES)


def one_by_one(batches, accept_equal=False):
    """Niche -> (grid, fitness, features): the first of the best; if equal ones are accepted, of the last batch."""
    best, since = {}, {}
    for number, (grids, fitness, all_features) in enumerate(batches):
        for grid, value, features in zip(grids, fitness, all_features, strict=True):
            cyclomatic, dead_ends = (features[METRIC_NAMES.index(axis.metric)] for axis in AXES)
            niche = min(cyclomatic // 2, 2) * 2 + min(dead_ends, 1)
            drift = accept_equal and niche in best and value == best[niche][1] and since[niche] < number
            if niche not in best or value < best[niche][1] or drift:
                best[niche], since[niche] = (grid, value, features), number
    return best


@st.composite
def some_batches(draw):
    count = draw(st.sampled_from([1, 4, 12]))  # each is compiled once
    batches = []
    for number in range(draw(st.integers(1, 3))):
        fitness = draw(hnp.arrays(np.int32, count, elements=st.integers(-2, 2)))  # ties abound
        features = draw(hnp.arrays(np.int32, (count, len(METRIC_NAMES)), elements=st.integers(0, 7)))
        grids = np.zeros((count, 2, 2), np.int8)
        grids[:, 0, 0], grids[:, 0, 1] = number, np.arange(count)  # each bears its own number
        batches.append((grids, fitness, features))
    return batches


@pytest.mark.parametrize("accept_equal", [False, True])
@given(batches=some_batches())
def test_insertion_is_that_of_one_after_another(batches, accept_equal):
    archive = PROBLEM.empty_archive()
    for batch in map(partial(map, jnp.asarray), batches):
        found = Population(*batch)
        archive = insert_jit(archive, PROBLEM.niche(found.features), found, accept_equal=accept_equal)
    expected = one_by_one(batches, accept_equal)
    assert set(np.flatnonzero(archive.valid)) == set(expected)
    for niche, (grid, value, features) in expected.items():
        np.testing.assert_array_equal(archive.grids[niche], grid)
        assert archive.fitness[niche] == value
        np.testing.assert_array_equal(archive.features[niche], features)


def test_ties():
    """The elite that is there stays; of newcomers the first in the batch comes in."""
    grids = jnp.arange(3, dtype=jnp.int8)[:, None, None] * jnp.ones((3, 2, 2), jnp.int8)
    same = jnp.zeros((3, len(METRIC_NAMES)), jnp.int32)
    niche = jnp.zeros(3, jnp.int32)
    archive = insert(PROBLEM.empty_archive(), niche, Population(grids, jnp.array([5, 4, 4]), same))
    assert (archive.grids[0] == 1).all()
    archive = insert(archive, niche, Population(grids + 10, jnp.array([4, 9, 4]), same))
    assert (archive.grids[0] == 1).all()
    archive = insert(archive, niche, Population(grids + 10, jnp.array([9, 3, 3]), same))
    assert (archive.grids[0] == 11).all()
    assert archive.valid.sum() == 1


def test_archives_and_niches_of_numpy(any_types):
    archive = PROBLEM.empty_archive()
    grids, features = np.full((2, 2, 2), 3, np.int8), np.zeros((2, len(METRIC_NAMES)), np.int32)
    found = Population(grids, np.array([4, 5], np.int32), features)
    expected = insert(archive, jnp.array([1, 3]), jax.tree.map(jnp.asarray, found))
    for niche in ([1, 3], np.array([1, 3])):
        inserted = insert(jax.tree.map(np.asarray, archive), niche, found)
        jax.tree.map(np.testing.assert_array_equal, inserted, expected)
    large = jax.tree.map(lambda part: jnp.resize(part, (300, *part.shape[1:])), archive)
    inserted = insert(large, [1, 3], found)
    for kind in (np.int8, np.uint8):
        for niche in (np.array([1, 3], kind), jnp.array([1, 3], kind)):
            jax.tree.map(np.testing.assert_array_equal, insert(large, niche, found), inserted)
    none = jax.tree.map(lambda array: array[:0], found)
    for niche in (np.zeros(0, int), np.zeros((2, 0), int)):
        jax.tree.map(np.testing.assert_array_equal, insert(archive, niche, none), archive)


@given(some_batches(), st.data())
def test_several_niches_are_a_batch_joined_to_itself(batches, data):
    niches = st.lists(st.integers(0, 11), min_size=2, max_size=2)
    one = two = PROBLEM.empty_archive(copies=2)
    for grids, *others in batches:
        slots = np.array(data.draw(st.lists(niches, min_size=len(grids), max_size=len(grids))), np.int32).T
        one = insert_jit(one, slots, Population(grids, *others))
        twice = (np.concatenate([part, part]) for part in (grids, *others))
        two = insert_jit(two, slots.reshape(-1), Population(*twice))
    jax.tree.map(np.testing.assert_array_equal, one, two)


@pytest.mark.parametrize("start", [-(2**30), -5, 2**30])
@pytest.mark.parametrize("kind", ["int64", "int32", "jax", "uint32"])
def test_the_niches_of_all_whole_numbers(start, kind):
    """The difference of a value and the start of an axis may not fit 32 bits."""
    values = [-(2**31), -(2**30), -1, 0, 2**30, 2**31 - 1] if kind != "uint32" else [0, 2**31 - 1, 2**32 - 1]
    descriptor = jnp.array(values, jnp.int32) if kind == "jax" else np.array(values, kind)
    for bins, width in ((3, 5), (4, 2**30), (1, 1)):
        expected = [min(max((min(value, 2**31 - 1) - start) // width, 0), bins - 1) for value in values]
        found = niche_bins(descriptor[:, None], (Axis("turns", bins, width, start),))
        assert found.dtype == np.int32 and found[:, 0].tolist() == expected


def test_the_papers_niches():
    axes = paper_axes((12, 12))
    names = ["cyclomatic", "components", "dead_ends", "adjacent_crossings", "adjacent_turns"]
    assert [axis.metric for axis in axes] == names
    assert prod(axis.bins for axis in axes) == 400
    for side, width in ((12, 2), (2, 1), (24, 8), (8, 1), (14, 3)):
        assert paper_axes((side, side))[0].width == width
    cases = {
        (0, 0, 0, 0, 0): (0, 0, 0, 0, 0),
        (1, 1, 0, 0, 0): (0, 0, 0, 0, 0),
        (2, 2, 1, 2, 1): (1, 1, 1, 1, 1),
        (47, 1, 9, 0, 0): (23, 0, 1, 0, 0),
        (48, 5, 0, 30, 0): (24, 1, 0, 1, 0),
        (121, 1, 0, 0, 8): (24, 0, 0, 0, 1),
    }
    descriptors, bins = np.array(list(cases)), np.array(list(cases.values()))
    niches = [np.ravel_multi_index(tuple(bin_), (25, 2, 2, 2, 2)) for bin_ in bins]
    for array in (np.asarray, jnp.asarray):
        np.testing.assert_array_equal(niche_bins(array(descriptors), axes), bins)
        np.testing.assert_array_equal(niche_index(array(descriptors), axes), niches)


@pytest.mark.usefixtures("any_types")
def test_axes_are_read_and_checked():
    for axes, expected in (
        ([Axis("bridges", 3)], Axis("bridges", 3, 24)),
        ({"bridges": np.int64(3)}, Axis("bridges", 3, 24)),
        ([Axis("bridges", np.int8(3), np.uint8(2), np.int64(1), np.int32(0))], Axis("bridges", 3, 2, 1, 0)),
        ("cyclomatic:25", Axis("cyclomatic", 25, 1)),
        (["straight_share:10"], Axis("straight_share", 10, 100)),
        ("crossings:8:3", Axis("crossings", 8, 3)),
        ([{"metric": "crossings", "bins": 8, "width": 3}], Axis("crossings", 8, 3)),
        ({"crossings": (8, 3)}, Axis("crossings", 8, 3)),
    ):
        assert resolve_axes(axes, (12, 12)) == (expected,)
    assert resolve_axes("cyclomatic:25 turns:3:1", (24, 24)) == (Axis("cyclomatic", 25, 4), Axis("turns", 3, 1))
    for axes, subject, got, expected in (
        (5, "axes", "5", ""),
        ([], "axes", "none", ""),
        (["bridges"], "axes 'bridges'", None, "BINS"),
        ([{"metric": "bridges", "size": 3}], "axes", "{'metric': 'bridges', 'size': 3}", ""),
        ([Axis("speed", 3)], "axes 'speed'", "'speed'", ""),
        ([Axis("bridges", 0)], "axes 'bridges'", "bins 0, width 0, start 0", ""),
        ([Axis("bridges", 3, width=2**31)], "axes 'bridges'", "2,147,483,648", ""),
        ([Axis("bridges", 3, target=3)], "axes 'bridges'", "3", "target"),
        ([Axis("bridges", 3, width=0.5)], "axes 'bridges'", "bins 3, width 0.5, start 0", ""),
    ):
        with refused(subject, got, expected):
            resolve_axes(axes, (12, 12))


def test_measures_of_archives_by_hand():
    fitness = np.array([[5, -3, 2**31 - 1, 20], [2**31 - 1, 1, 2, 3]])
    filled = np.array([[True, True, False, True], [False, True, True, True]])
    assert qd_score(fitness, filled, 10).tolist() == [5 + 13 + 0, 9 + 8 + 7]
    assert coverage(filled).tolist() == [0.75, 0.75]
    assert coverage(filled, [True, True, False, False]).tolist() == [1, 0.5]
    with refused("fitness", "a masked array"):
        qd_score(np.ma.masked_array(fitness, ~filled), filled, 10)
    with refused("valid", "a masked array"):
        coverage(np.ma.masked_array(filled, ~filled))


@pytest.mark.parametrize("x64", [False, True])
def test_measures_of_archives_are_the_same_in_compiled_code(x64):
    """A scan with `qd_score` raised TracerArrayConversionError."""
    rng = np.random.default_rng(0)
    fitness = rng.integers(-2000, 200, (3, 4, 20)).astype(np.int32)
    filled, feasible = rng.random((3, 4, 20)) < 0.7, rng.random(20) < 0.6
    fitness[~filled] = vacant_fitness(np.int32)
    # JAX before 0.8 has it elsewhere.
    enable_x64 = jax.enable_x64 if hasattr(jax, "enable_x64") else jax.experimental.enable_x64
    settings = enable_x64(x64), jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict")
    with settings[0], settings[1], settings[2]:
        scores = jax.jit(qd_score)(fitness, filled, 100.0)
        batched = jax.vmap(jax.vmap(lambda one, valid: qd_score(one, valid, worst=0)))(fitness, filled)
        shares = jax.jit(coverage)(filled, feasible), jax.jit(coverage)(filled), jax.vmap(coverage)(filled)
    assert {part.dtype for part in (scores, batched, *shares)} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(scores, qd_score(fitness, filled, 100))
    np.testing.assert_array_equal(batched, qd_score(fitness, filled, 0))
    expected = coverage(filled, feasible), coverage(filled), coverage(filled)
    for share, known in zip(shares, expected, strict=True):
        np.testing.assert_allclose(share, known, rtol=1e-6)
    with refused("valid", expected="bool"):
        jax.jit(qd_score)(fitness, fitness, 0)


@pytest.mark.parametrize("worse", [np.nan, np.inf, -np.inf])
def test_a_fitness_that_is_not_finite_takes_no_niche(worse):
    archive = PROBLEM.empty_archive()._replace(fitness=jnp.full(6, jnp.inf, jnp.float32))
    features = jnp.zeros((2, len(METRIC_NAMES)), jnp.int32)
    niche, grids = jnp.zeros(2, jnp.int32), jnp.stack([jnp.full((2, 2), code, jnp.int8) for code in (1, 2)])
    for fitness, code in (([worse, 1.0], 2), ([worse, worse], 2), ([0.5, worse], 1)):
        archive = insert(archive, niche, Population(grids, jnp.array(fitness, jnp.float32), features))
        assert archive.valid.tolist() == [True] + [False] * 5 and archive.grids[0, 0, 0] == code
    with refused("found", "float32"):
        insert(PROBLEM.empty_archive(), niche, Population(grids, jnp.zeros(2, jnp.float32), features))
