"""The evolutionary loop's parts."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import (
    Axis,
    Problem,
    annealed_map_elites,
    gwo,
    map_elites,
    pso,
    road_problem,
    run,
)
from elitelanes_jax.optimizers import EvolutionConfig, Move, seed_keys
from elitelanes_jax.optimizers._mutations import Variation
from elitelanes_jax.optimizers._population import breed, evaluate, random_population, survivors, tournament
from elitelanes_jax.problem import Population

PROBLEM = road_problem((4, 5))


def population(fitness, start=0):
    """Each with its own number as its feature."""
    count = len(fitness)
    numbers = jnp.arange(start, start + count)
    return Population(jnp.zeros((count, 4, 5), jnp.int8), jnp.array(fitness, jnp.int32), numbers[:, None])


def numbers(population):
    return population.features[:, 0].tolist()


def test_survivors_are_sorted_and_ties_go_to_what_came_first():
    config = EvolutionConfig(population=5)
    parents, offspring = population([1, 3, 3, 7, 9]), population([3, 2, 3, 1], start=10)
    kept = survivors(config, parents, offspring)
    assert numbers(kept) == [0, 13, 11, 1, 2]
    assert kept.fitness.tolist() == [1, 1, 2, 3, 3]
    comma = survivors(replace(config, population=3, survivors="comma"), parents, offspring)
    assert numbers(comma) == [13, 11, 10]


def test_a_tournament_is_won_by_the_best_that_was_drawn():
    grids = jnp.arange(20, dtype=jnp.int8)[:, None, None] * jnp.ones((20, 2, 2), jnp.int8)
    sorted_population = Population(grids, jnp.arange(20), jnp.zeros((20, 5), jnp.int32))
    bits = jnp.array([[2**32 - 1, 2**31, 2**31 + 5], [2**32 - 1] * 3, [0, 2**31, 9]], jnp.uint32)
    winners = tournament(bits, sorted_population)
    assert winners[:, 0, 0].tolist() == [10, 19, 0]


def test_offspring_are_repaired_and_in_their_parents_order():
    dirty = jnp.zeros((4, 5), bool).at[0, 0].set(True)
    mark = Move(1, lambda bits, grid: Variation(jnp.where(dirty, bits[0].astype(jnp.int8), grid), dirty))
    parents = random_population(PROBLEM, jax.random.key(2), 6).grids
    offspring = breed(PROBLEM, mark, jnp.array([[15], [0], [4], [2], [9], [6]], jnp.uint32), parents)
    assert offspring.grids[:, 0, 0].tolist() == [6, 0, 4, 2, 0, 6]
    expected = PROBLEM.evaluate(offspring.grids)
    np.testing.assert_array_equal(offspring.fitness, expected.fitness)
    np.testing.assert_array_equal(offspring.features, expected.features)


def test_the_first_population_is_sorted_and_repaired():
    first = random_population(PROBLEM, jax.random.key(5), 30)
    assert (jnp.diff(first.fitness) >= 0).all()
    np.testing.assert_array_equal(first.grids, jax.vmap(PROBLEM.repair)(first.grids, jnp.zeros_like(first.grids, bool)))


def test_no_grids_are_evaluated_to_none():
    problem = road_problem((4, 5), "symmetry:3", fill=True)
    none = evaluate(problem, problem.random(jax.random.key(0), 0))
    assert none.grids.shape == (0, 4, 5) and none.fitness.shape == (0,) and len(none.features) == 0


def test_numbers_that_do_not_fit_32_bits_are_refused():
    """An unsigned number beyond int32 would become a negative one: the best fitness, or the first niche."""
    grids, large = jnp.zeros((3, 2, 3), jnp.int8), jnp.array([7, 2**31, 2**32 - 1], jnp.uint32)
    few = jnp.array([1, 2, 3], jnp.int32)
    for fitness, features in ((large, few), (few, large), (few.astype(jnp.float32), large)):
        problem = Problem((2, 3), lambda _, pair=(fitness, features[:, None]): pair, ("number",))
        found = evaluate(problem, grids)
        assert found.valid.tolist() == [True, False, False]
        assert found.fitness.tolist()[0] == fitness.tolist()[0] and found.features.tolist()[0] == [features.tolist()[0]]


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize(
    ("repaired", "got"),
    [
        (lambda grid: grid.T, "int8 [..., 3, 2]"),
        (lambda grid: grid.astype(jnp.float32), "float32 [..., 2, 3]"),
    ],
)
@pytest.mark.parametrize("make", [map_elites, annealed_map_elites, pso, gwo])
def test_a_repair_that_returns_no_grids_is_one_line(repaired, got, make):
    def count(grids):
        sums = grids.sum((1, 2)).astype(jnp.int32)
        return sums, sums[:, None]

    problem = Problem(
        (2, 3), count, ("sum",), (Axis("sum", 4, 4),), repair=lambda grid, dirty=None, raster=False: repaired(grid)
    )
    with refused("grids", got, expected="[P, 2, 3]"):
        jax.eval_shape(lambda keys: run(make(problem), keys, 2), seed_keys(0, 2))


def test_the_defaults_are_the_papers():
    assert EvolutionConfig() == EvolutionConfig(20, 40, 3, "plus", 0.7, 0.5)
