"""The problem in other libraries' loops: the same niches and fitness, and their searches make progress."""

import re
import runpy
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Axis, random_grids, repair, road_problem
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.optimizers import MoveWeights
from elitelanes_jax.optimizers.interop import (
    evosax_task,
    qdax_centroids,
    qdax_moves,
    qdax_scoring_fn,
    ribs_archive_space,
    ribs_evaluate,
    ribs_grids,
)
from elitelanes_jax.problem import Problem
from elitelanes_jax.problem.descriptor import compute_descriptor, niche_index

# Other libraries' warnings are theirs.
pytestmark = [pytest.mark.filterwarnings("default"), pytest.mark.usefixtures("standard")]

DOCS = Path(__file__).parents[2] / "docs"
SHAPE, COUNT, PARK = (5, 6), 24, (2, 3)
AXES = (Axis("cyclomatic", 6, 2, start=1), Axis("straight_share", 7, 143), Axis("components", 2, 1, start=1))


@pytest.fixture(scope="module")
def problem():
    park = [[0 if (row, column) == PARK else None for column in range(6)] for row in range(5)]
    return road_problem(SHAPE, AXES, fix=park)


@pytest.fixture(scope="module")
def grids(problem):
    return jax.jit(partial(problem.random, count=COUNT))(jax.random.key(3))


@pytest.fixture(scope="module")
def evaluate(problem):
    return jax.jit(problem.evaluate)


def nearest(centroids, points):
    """The definition of QDax's niches."""
    return ((points[:, None] - centroids) ** 2).sum(axis=-1).argmin(axis=1)


def test_qdax_scores_are_ours(problem, grids, evaluate):
    score = qdax_scoring_fn(problem)
    fitness, descriptor, extras = jax.jit(score)(grids, jax.random.key(0))
    scored, features = evaluate(grids)
    assert fitness.dtype == descriptor.dtype == jnp.float32
    assert descriptor.shape == (COUNT, 3)
    np.testing.assert_array_equal(-fitness, scored)
    np.testing.assert_array_equal(extras["features"], features)
    expected = niche_index(compute_descriptor(features, METRIC_NAMES, AXES), AXES)
    assert len(set(np.asarray(expected).tolist())) > 5
    np.testing.assert_array_equal(nearest(qdax_centroids(AXES), descriptor), expected)
    with refused("genotypes", f"int8 [{COUNT}, 6, 5]"):
        score(grids.transpose(0, 2, 1), jax.random.key(0))
    with refused("genotypes", "float32 [24, 5, 6]"):
        score(grids.astype(jnp.float32), jax.random.key(0))
    with refused("genotypes", "int32 [1, 1]"):
        score([[1]], jax.random.key(0))


def test_qdax_moves_are_the_mix_one_grid_at_a_time(problem, grids):
    mutate, vary = map(jax.jit, qdax_moves(problem))
    key = jax.random.key(1)
    children = vary(grids, grids[::-1], key)
    assert children.dtype == jnp.int8
    np.testing.assert_array_equal(jax.vmap(repair)(children), children)
    assert not children[:, *PARK].any()
    np.testing.assert_array_equal(mutate(grids, key), vary(grids, grids, key))
    assert (children != grids).any(axis=(1, 2)).sum() > COUNT / 2
    assert (children != mutate(grids, key)).any(), "it takes parts of the mates"
    with refused("corner", "-1"):
        qdax_moves(problem, MoveWeights(corner=-1))
    for wrong in (grids[:, :4], grids.astype(jnp.int32)):
        with refused("genotypes", expected="[B, 5, 6]"):
            mutate(wrong, key)
        with refused("mates", expected="[B, 5, 6]"):
            vary(grids, wrong, key)


def test_evosax_decodes_the_largest_logit_and_minimises_ours(problem, evaluate):
    task = evosax_task(problem)
    assert task.num_dims == 5 * 6 * 11
    state = task.init(jax.random.key(0))
    solutions = jax.vmap(task.sample)(jax.random.split(jax.random.key(2), COUNT))
    assert solutions.shape == (COUNT, 330)
    fitness, state, metrics = task.eval(jax.random.key(0), solutions, state)
    assert fitness.dtype == jnp.float32 and state.counter == 1
    largest = np.vectorize(lambda *logits: problem.alphabet[max(range(11), key=logits.__getitem__)])
    codes = largest(*np.moveaxis(np.asarray(solutions).reshape(COUNT, *SHAPE, 11), -1, 0)).astype(np.int8)
    grids = np.stack([task.decode(solution) for solution in solutions])
    np.testing.assert_array_equal(grids, jax.jit(jax.vmap(problem.repair_raster))(codes))
    scored, features = evaluate(grids)
    np.testing.assert_array_equal(fitness, scored)
    np.testing.assert_array_equal(metrics["features"], features)
    assert [row[0] for row in features.tolist()] == [oracle(grid)["components"] for grid in grids]
    np.testing.assert_array_equal(
        task.decode(np.zeros(330, np.float32)), problem.repair_raster(jnp.full(SHAPE, 3, jnp.int8))
    )
    with refused("solution", "shape (329,)", expected="330"):
        task.eval(jax.random.key(0), solutions[:, 1:], state)


@pytest.mark.parametrize("refused", [pytest.param(2**30, marks=pytest.mark.slow), jnp.nan])
def test_refused_grids_have_the_worst_score(refused):
    problem = road_problem(SHAPE, AXES, fitness=lambda usual, metrics: jnp.where(metrics.turns > 9, refused, usual))
    grids = jax.jit(partial(problem.random, count=8))(jax.random.key(0))
    bad = np.array([oracle(grid)["turns"] > 9 for grid in grids])
    assert bad.any() and not bad.all()
    fitness = np.asarray(jax.jit(qdax_scoring_fn(problem))(grids, jax.random.key(0))[0])
    np.testing.assert_array_equal(np.isneginf(fitness), bad)
    objective, _ = ribs_evaluate(problem)(np.asarray(grids).reshape(8, -1))
    np.testing.assert_array_equal(objective < -2e9, bad)
    task = evosax_task(problem)
    solutions = jax.vmap(task.sample)(jax.random.split(jax.random.key(1), 8))
    bad = np.array([oracle(task.decode(solution))["turns"] > 9 for solution in solutions])
    assert bad.any() and not bad.all()
    fitness = np.asarray(task.eval(jax.random.key(0), solutions, task.init(jax.random.key(0)))[0])
    np.testing.assert_array_equal(fitness > 2e9, bad)
    assert np.isfinite(fitness).all()


@pytest.mark.parametrize("dtype", [jnp.int16, jnp.float32])
def test_scores_of_any_dtype(dtype):
    scale = 1e12 if dtype == jnp.float32 else 1

    def evaluate(grids):
        ones = (grids == 3).sum((1, 2))
        return (ones * scale).astype(dtype), ones[:, None]

    problem = Problem(SHAPE, evaluate, ("ones",), (Axis("ones", 5, 4),), repair=partial(repair, fill=True))
    grids = problem.random(jax.random.key(0), 6)
    expected = -np.asarray((grids == 3).sum((1, 2)) * scale, np.float32)
    np.testing.assert_array_equal(qdax_scoring_fn(problem)(grids, jax.random.key(0))[0], expected)
    np.testing.assert_array_equal(ribs_evaluate(problem)(np.asarray(grids).reshape(6, -1))[0], expected)


def test_ribs_solutions_stand_for_grids(problem, grids, evaluate):
    ranges = [(1, 13), (0, 1001), (1, 3)]
    assert ribs_archive_space(problem) == {"solution_dim": 30, "dims": [6, 7, 2], "ranges": ranges}
    decode, score = ribs_grids(problem), ribs_evaluate(problem)
    whole = np.asarray(grids)
    flat = whole.reshape(COUNT, -1)
    np.testing.assert_array_equal(decode(flat.astype(np.int32)), whole)  # repaired grids are themselves
    alphabet = list(problem.alphabet)
    drawn = np.asarray(random_grids(jax.random.key(5), COUNT, SHAPE)).reshape(COUNT, -1)  # not repaired
    places = np.vectorize(alphabet.index)(drawn)
    for aside in (0.0, 0.5, 0.99):
        np.testing.assert_array_equal(decode(places + aside), decode(drawn))
    np.testing.assert_array_equal(decode(np.full((COUNT, 30), -7.5)), decode(np.full((COUNT, 30), alphabet[0])))
    np.testing.assert_array_equal(decode(np.full((COUNT, 30), 99.0)), decode(np.full((COUNT, 30), 15)))
    objective, measures = score(flat)
    scored, features = evaluate(grids)
    assert objective.dtype == measures.dtype == np.float64
    np.testing.assert_array_equal(-objective, scored)
    np.testing.assert_array_equal(measures, compute_descriptor(features, METRIC_NAMES, AXES))
    for solutions, got, expected in (
        (flat[:, 1:], f"int8 ({COUNT}, 29)", "[B, 30]"),
        (flat[0], "int8 (30,)", "[B, 30]"),
        ([[1] * 30, [2] * 29], "... inhomogeneous ...", "[B, 30]"),
        (np.full((1, 30), np.nan), None, "finite"),
        (np.full((1, 30), 16), "16 to 16", "codes"),
    ):
        with refused("solutions", got, expected):
            score(solutions)


def axes_and_points():
    """Hypothesis: axes of different metrics, and descriptors inside and beyond them."""
    numbers = st.integers(1, 9), st.integers(1, 400), st.integers(-5, 50), st.none()
    axis = st.builds(Axis, st.sampled_from(["cyclomatic", "crossings", "turns", "bridges"]), *numbers)
    return st.lists(axis, min_size=1, max_size=4, unique_by=lambda axis: axis.metric).flatmap(
        lambda axes: st.tuples(
            st.just(tuple(axes)),
            st.lists(st.tuples(*[st.integers(-10, 4000) | st.integers(0, 2**26)] * len(axes)), min_size=1),
        )
    )


@given(axes_and_points())
def test_qdax_niches_are_ours_everywhere(drawn):
    axes, points = drawn[0], np.array(drawn[1], np.int32)
    bins = np.array(
        [[min(max((p - a.start) // a.width, 0), a.bins - 1) for a, p in zip(axes, q, strict=True)] for q in drawn[1]]
    )
    found = nearest(np.asarray(qdax_centroids(axes)), bins.astype(np.float32))
    np.testing.assert_array_equal(found, niche_index(points, axes))


@given(axes_and_points())
def test_ribs_niches_are_ours_everywhere(drawn):
    archives = pytest.importorskip("ribs.archives")
    axes, points = drawn[0], np.array(drawn[1], np.int32)
    archive = archives.GridArchive(**ribs_archive_space(road_problem((2, 2), axes)))
    np.testing.assert_array_equal(archive.index_of(points), niche_index(points, axes))


def test_evosax_task_has_all_that_evosax_asks_of_a_problem():
    problems = pytest.importorskip("evosax.problems.problem")
    names = {name for name in vars(problems.Problem) if not name.startswith("_")}
    assert names == {"num_dims", "init", "eval", "sample"}
    task = evosax_task(road_problem((2, 2), AXES))
    assert all(hasattr(task, name) for name in names)


def check_qdax(repertoire, history, problem, **_):
    """Its archive has our niches and fitness, and the search improved."""
    found = np.asarray(repertoire.fitnesses[:, 0])
    occupied = np.isfinite(found)
    check_archive(problem, repertoire.genotypes[occupied], found[occupied], np.flatnonzero(occupied))
    assert history["max_fitness"][-1] > history["max_fitness"][0] + 100
    assert Path("qdax-map.png").exists()


def check_evosax(task, best, state, **_):
    assert best[-1] < best[0] - 100
    assert road_problem((6, 6)).evaluate(task.decode(state.best_solution)[None]).fitness[0] == best[-1]


def check_ribs(problem, archive, **_):
    found = archive.data(return_type="dict")
    check_archive(problem, ribs_grids(problem)(found["solution"]), found["objective"], found["index"])


def check_archive(problem, grids, objective, niches):
    assert len(niches) > 5
    scored, features = problem.evaluate(jnp.asarray(grids))
    np.testing.assert_array_equal(-scored, objective)
    np.testing.assert_array_equal(problem.niche(features), niches)


@pytest.mark.parametrize(
    ("name", "library", "check"),
    [
        ("qdax_map_elites", "qdax", check_qdax),
        ("evosax_task", "evosax", check_evosax),
        ("ribs_archive", "ribs", check_ribs),
    ],
)
def test_examples_find_what_our_problem_says(name, library, check, tmp_path, monkeypatch, capsys):
    pytest.importorskip(library)
    monkeypatch.chdir(tmp_path)
    check(**runpy.run_path(str(DOCS / "examples" / f"{name}.py")))
    assert capsys.readouterr().out


PAGE = (DOCS / "interop.md").read_text()


def test_the_page_shows_the_examples_as_they_are():
    programs = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    examples = {file.read_text().split('"""\n', 1)[1].strip() for file in (DOCS / "examples").glob("*.py")}
    assert len(programs) == 4 and {program.strip() for program in programs} <= examples
