"""JAX and NumPy give the metrics of the oracle's cases; the explorer's tests read the same file."""

import json
from collections import defaultdict

import jax
import numpy as np
from measure_cases import CASES, grid_of, measure_cases

from elitelanes_jax import measure
from elitelanes_jax.network import plain_measure

CONTENT = json.loads(CASES.read_text(encoding="utf-8"))
ALPHABET, NAMES = CONTENT["alphabet"], CONTENT["names"]


def test_jax_gives_the_metrics_of_the_oracle():
    shapes = defaultdict(list)
    for text, expected in CONTENT["cases"]:
        grid = grid_of(text)
        shapes[grid.shape].append((grid, expected))
    measure_many = jax.jit(jax.vmap(lambda grid: measure(grid, tuple(ALPHABET))))
    for cases in shapes.values():
        metrics = jax.device_get(measure_many(np.stack([grid for grid, _ in cases])))
        for index, name in enumerate(NAMES):
            expected = [values[index] for _, values in cases]
            np.testing.assert_array_equal(getattr(metrics, name), np.array(expected, getattr(metrics, name).dtype))


def test_numpy_gives_the_metrics_of_the_oracle():
    for text, expected in CONTENT["cases"]:
        assert plain_measure(grid_of(text), ALPHABET) == dict(zip(NAMES, expected, strict=True)), text


def test_the_cases_are_fresh():
    assert CASES.read_text(encoding="utf-8") == measure_cases(), "run: python tests/measure_cases.py"
