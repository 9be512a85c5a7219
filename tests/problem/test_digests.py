"""Functions of the user are known by what they compute: an edited function keeps its name."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax import InputError, ea, evolve
from elitelanes_jax.optimizers import EvolutionConfig
from elitelanes_jax.problem.kernels import digest

KEYS = jax.random.split(jax.random.key(5), 2)
GRID = jax.ShapeDtypeStruct((3, 4), jnp.int8)

run = partial(evolve, KEYS, (3, 4), method="ea", preset="paper")


def counting(codes):
    """Makes a feature with one name and other constants for other codes: how many cells have one of the codes."""
    table = np.zeros(16, np.int32)
    table[codes] = 1

    def counted(grid):
        return jnp.asarray(table)[grid.astype(int)].sum()

    return counted


def test_a_digest_is_of_the_jaxpr_and_its_constants():
    assert digest(counting([5, 10]), GRID) == digest(counting([5, 10]), GRID)
    nested = [jax.jit(counting(codes)) for codes in ([3], [6])]
    looped = [lambda grid, f=f: jax.lax.fori_loop(0, 2, lambda _, total: total + f(grid), 0) for f in nested]
    functions = [counting([5, 10]), counting([3]), counting([6]), *nested, *looped, lambda grid: grid.sum()]
    assert len({digest(function, GRID) for function in functions}) == len(functions)


def test_a_feature_is_known_by_what_it_computes(tmp_path):
    kept = partial(run, checkpoint=tmp_path)
    first = kept(features={"v": counting([5, 10])}, generations=5)
    resumed = kept(features={"v": counting([5, 10])}, generations=10)
    whole = run(features={"v": counting([5, 10])}, generations=10)
    np.testing.assert_array_equal(resumed.elites.grids, whole.elites.grids)
    np.testing.assert_array_equal(resumed.elites.features["v"], whole.elites.features["v"])
    for other in (counting([3]), lambda grid: (grid == 5).sum() + (grid == 10).sum()):
        with pytest.raises(InputError, match="expected results with v '[0-9a-f]{16}', got results with '[0-9a-f]{16}'"):
            kept(features={"v": other}, generations=20)
        with pytest.raises(InputError, match="got one of a run with another key, other options or functions"):
            run(features={"v": other}, generations=5, state=first.state)


def test_a_fitness_is_known_by_what_it_computes(tmp_path):
    def scaled(factor):
        def fitness(metrics):
            return factor * metrics.crossings

        return fitness

    kept = partial(run, checkpoint=tmp_path)
    kept(fitness=scaled(2), generations=5)
    kept(fitness=scaled(2), generations=10)
    with pytest.raises(InputError, match="expected results with fitness '"):
        kept(fitness=scaled(3), generations=20)


def test_an_optimizer_is_known_by_what_it_computes(tmp_path):
    def making(rate):
        def own(problem):
            return ea(problem, EvolutionConfig(population=4, offspring=4, tile_rate=rate))

        return own

    kept = partial(evolve, KEYS, (3, 4), checkpoint=tmp_path)
    first = kept(optimizer=making(0.5), generations=5)
    kept(optimizer=making(0.5), generations=10)
    with pytest.raises(InputError, match="expected results with optimizer '"):
        kept(optimizer=making(0.25), generations=20)
    renamed = evolve(KEYS, (3, 4), optimizer=lambda problem: making(0.5)(problem), generations=5, state=first.state)
    assert renamed.state.generation == 10
    with pytest.raises(InputError, match="got one of a run with another key, other options or functions"):
        evolve(KEYS, (3, 4), optimizer=making(0.25), generations=5, state=first.state)
