"""The baselines of experiments/search/speed.py are right where they differ most: borders, ends, bridges."""

import numpy as np
import pytest

from elitelanes_jax.network.codes import ROAD_ALPHABET
from experiments.search.baselines import cpp_fitness, networkx_fitness


def test_compiled_tarjan_is_exact():
    fitness = cpp_fitness()
    if fitness is None:
        pytest.skip("there is no C++ compiler here")
    rng = np.random.default_rng(1)
    for shape in [(2, 2), (2, 5), (5, 3), (7, 7)]:
        for codes in (np.arange(16), np.array(ROAD_ALPHABET)):
            grids = rng.choice(codes.astype(np.int8), (100, *shape))
            np.testing.assert_array_equal(fitness(grids), networkx_fitness(grids))
