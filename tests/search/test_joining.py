"""Results of one search that ran with different keys are joined as if they had run together, or refused."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import Optimizer, Result, ea, evolve
from elitelanes_jax.optimizers import EvolutionConfig
from elitelanes_jax.search import join_results
from elitelanes_jax.search.joining import without_state

KEYS = jax.random.split(jax.random.key(5), 3)
OF_SEEDS = ("best_fitness", "elite_count", "refused")


def search(keys, *, turn=50, generations=3, **options):
    """A search with a feature and a fitness of its own."""

    def corner(grid):
        return grid[0, 0] % 2

    def fitness(usual, metrics):
        return usual + turn * metrics.turns

    options = {"where": ["corner=0"], "shape": (4, 5), "method": "ea", "preset": "paper"} | options
    return evolve(keys, features={"corner": corner}, fitness=fitness, generations=generations, **options)


@pytest.fixture(scope="module")
def parts():
    return [search(KEYS[:2]), search(KEYS[2])]


def test_a_joined_result_is_that_of_all_keys_together(parts, tmp_path):
    joined, together = join_results(parts), search(KEYS)
    for found, expected in zip(jax.tree.leaves(joined.elites), jax.tree.leaves(together.elites), strict=True):
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == expected.dtype
    for name in (*OF_SEEDS, "generation", "evaluations"):
        np.testing.assert_array_equal(getattr(joined.history, name), getattr(together.history, name))
    assert joined.history.seconds == pytest.approx(sum(part.history.seconds for part in parts))
    assert (joined.search, joined.functions) == (together.search, together.functions)
    joined.save(tmp_path / "joined.npz", state=False)
    together.save(tmp_path / "together.npz", state=False)
    assert (tmp_path / "joined.npz").read_bytes() == (tmp_path / "together.npz").read_bytes()
    with refused("state", "that of a result that was joined or saved without its state"):
        search(KEYS, state=joined.state)


def test_results_from_files_are_joined_too(parts, tmp_path):
    files = [tmp_path / f"{index}.npz" for index in range(2)]
    for part, file in zip(parts, files, strict=True):
        part.save(file)
    loaded = [Result.load(file) for file in files]
    assert [result.functions for result in loaded] == [part.functions for part in parts]
    assert {name for name, _ in loaded[0].functions} == {"corner", "fitness"}
    np.testing.assert_array_equal(join_results(loaded).elites.grids, join_results(parts).elites.grids)


def counting(problem):
    inner = ea(problem, EvolutionConfig(population=4, offspring=4))
    return Optimizer(inner.init, inner.step, inner.elites, inner.evaluations_per_step)


def test_results_of_ones_own_optimiser_are_joined():
    one, other = (evolve(keys, (3, 4), optimizer=counting, generations=1) for keys in (KEYS[:1], KEYS[1:]))
    assert [name for name, _ in one.functions] == ["optimizer"]
    assert join_results([one, other]).elites.grids.shape[0] == 3


@pytest.mark.slow
def test_another_function_is_seen_by_its_digest(parts):
    with refused("results", "...", expected="function 'fitness'"):
        join_results([parts[0], search(KEYS[2], turn=51)])


def other_search(result, **changes):
    return replace(result.search, **changes)


@pytest.mark.parametrize(
    ("change", "got", "expected"),
    [
        (lambda one: {"functions": ()}, "None at index 1", "function 'corner'"),
        (
            lambda one: {"search": other_search(one, settings=replace(one.search.settings, weights=(("turns", 1),)))},
            "(('turns', 1),) at index 1",
            "weights ()",
        ),
        (
            lambda one: {"search": other_search(one, axes=one.search.axes[:1])},
            "(Axis(metric='cyclomatic', ... at index 1",
            "axes",
        ),
        (lambda one: {"config": None}, "None at index 1", "config"),
        (
            lambda one: {"history": one.history._replace(generation=np.arange(3))},
            "[[0, 1, 2], [40, 80, 120]] at index 1",
            "generations",
        ),
        (lambda one: {"search": other_search(one, shape=one.search.shape[::-1])}, "(5, 4) at index 1", "size"),
    ],
)
def test_results_of_other_searches_are_refused(parts, change, got, expected):
    with refused("results", got, expected):
        join_results([parts[0], replace(parts[1], **change(parts[1]))])


def test_a_result_that_comes_twice_is_refused(parts):
    with refused("results", "the keys of index 1 again at index 2"):
        join_results([*parts, parts[1]])


def test_a_seed_that_comes_twice_is_warned_of(parts):
    """Results without a state do not tell their keys, and a key may be one of several in two results."""
    with pytest.warns(UserWarning, match="^results: seed 0 at index 1 has the elites .* of seed 0 at index 0"):
        assert join_results([parts[0], without_state(parts[0])]).elites.grids.shape[0] == 4
    with pytest.warns(UserWarning, match="^results: seed 0 at index 1 has the elites .* of seed 1 at index 0"):
        assert join_results([parts[0], search(KEYS[1])]).elites.grids.shape[0] == 3


@pytest.mark.parametrize(("results", "expected"), [([], "at least one"), ("abc", "Result"), ([3], "Result")])
def test_only_results_are_joined(results, expected):
    with refused("results", expected=expected):
        join_results(results)
