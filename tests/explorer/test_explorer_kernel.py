"""The page's kernel in TypeScript gives what Python gives: metrics, fitness, repair; Vitest compares files of maps."""

import json
import shutil
import subprocess
from pathlib import Path

import jax
import numpy as np
import pytest
from kernel_cases import ALPHABET, CASES, WEIGHTS, kernel_cases

from elitelanes_jax import fitness, measure, random_grids, repair
from elitelanes_jax.network import plain_measure
from elitelanes_jax.network.metrics import stack_metrics
from elitelanes_jax.network.records import METRIC_NAMES, TownFeatures
from elitelanes_jax.problem.kernels import measure_features

HERE = Path(__file__).parent
MODULE = HERE.parents[1] / "elitelanes_jax" / "explorer" / "static" / "explorer.js"

pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="the kernel runs in Node")


def run_kernel(grids, tmp_path, *, town=False):
    """What the kernel makes of grids, each with the masks of its repair or none; with the features of a town or not."""
    file = tmp_path / "grids.json"
    file.write_text(json.dumps({"grids": grids, "weights": WEIGHTS._asdict(), "alphabet": ALPHABET, "town": town}))
    ran = subprocess.run(["node", HERE / "kernel.mjs", MODULE, file], capture_output=True, text=True, check=True)
    return json.loads(ran.stdout)


@pytest.fixture(scope="module", params=[2000, pytest.param(10_000, marks=pytest.mark.slow)])
def sample(request):
    """Grids of 12 x 12: half of all codes, a quarter repaired, a quarter filled; masks for repair."""
    count = request.param // 4
    raw = np.asarray(random_grids(jax.random.key(0), 2 * count, (12, 12), alphabet=tuple(range(16))))
    flipped = np.asarray(jax.vmap(repair)(raw[:count]))
    filled = np.asarray(jax.vmap(lambda grid: repair(grid, fill=True))(raw[count:]))
    grids = np.concatenate([raw, flipped, filled])
    masks = np.random.default_rng(1).random((2, *grids.shape)) < np.array([0.3, 0.1])[:, None, None, None]
    return grids, *masks


@pytest.fixture(scope="module")
def made(sample, tmp_path_factory):
    listed = zip(
        *(array.tolist() for array in (sample[0], *(mask.reshape(-1, 144) for mask in sample[1:]))), strict=True
    )
    grids = [{"rows": rows, "dirty": dirty, "fixed": fixed} for rows, dirty, fixed in listed]
    return run_kernel(grids, tmp_path_factory.mktemp("kernel"))


def test_metrics_and_fitness_are_equal_on_many_grids(sample, made):
    metrics = jax.vmap(lambda grid: measure(grid, ALPHABET))(sample[0])
    np.testing.assert_array_equal([one["metrics"] for one in made], stack_metrics(metrics))
    np.testing.assert_array_equal([one["fitness"] for one in made], fitness(metrics, WEIGHTS))


@pytest.mark.parametrize("fill", [False, True])
def test_repair_is_equal_on_many_grids(sample, made, fill):
    expected = jax.vmap(lambda grid, dirty, fixed: repair(grid, dirty, fixed=fixed, fill=fill))(*sample)
    np.testing.assert_array_equal([one["repaired"][fill] for one in made], np.asarray(expected).reshape(-1, 144))


@pytest.mark.slow
@pytest.mark.parametrize("step", [20, 1])
def test_the_features_of_a_town_are_equal(sample, step, tmp_path):
    grids = sample[0][::step]
    made = run_kernel([{"rows": rows} for rows in grids.tolist()], tmp_path, town=True)
    town = measure_features(grids, TownFeatures._fields, {})
    np.testing.assert_array_equal([[one["town"][name] for name in TownFeatures._fields] for one in made], town)


@pytest.mark.slow
def test_the_features_of_towns_within_larger_grids_are_equal(tmp_path):
    """Sparse ones, of one tile and of none too, of several parts, and beyond the sides where detours are measured."""
    random = np.random.default_rng(0)
    codes = random.integers(1, 16, (60, 33, 5))
    grids = np.where(random.random((60, 33, 5)) < np.linspace(0, 1, 60)[:, None, None], codes, 0).astype(np.int8)
    grids[1] = 0
    grids[1, 20, 3] = 6
    for some, names in ((grids[:, :32], TownFeatures._fields), (grids, TownFeatures._fields[:-1])):
        made = run_kernel([{"rows": grid.tolist()} for grid in some], tmp_path, town=True)
        assert [list(one["town"]) for one in made] == [list(names)] * 60
        town = measure_features(some, names, {})
        np.testing.assert_array_equal([[one["town"][name] for name in names] for one in made], town)


def test_grids_of_all_sizes_are_measured_alike(tmp_path):
    """Thin ones too, which repair leaves alone; plain_measure equals measure, as other tests show."""
    random = np.random.default_rng(0)
    shapes = [(1, 1), (1, 9), (9, 1), (2, 2), (3, 7), (17, 5), (64, 64), (70, 3)]
    grids = [random.choice([0, *range(16)], shape) for shape in shapes for _ in range(8)]
    grids += [np.full((40, 40), code) for code in (5, 10, 15)]
    made = run_kernel([{"rows": grid.tolist()} for grid in grids], tmp_path)
    for grid, one in zip(grids, made, strict=True):
        expected = plain_measure(grid, ALPHABET)
        assert dict(zip(METRIC_NAMES, one["metrics"], strict=True)) == {name: expected[name] for name in METRIC_NAMES}


def test_the_cases_for_vitest_are_fresh():
    assert CASES.read_text(encoding="utf-8") == kernel_cases(), "run: python tests/explorer/kernel_cases.py"
