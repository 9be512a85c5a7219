"""Grids one tile wide: every one of up to three tiles, and long ones, against the oracle."""

import jax
import numpy as np
import pytest
from oracle import fitness as oracle_fitness
from oracle import measure as oracle
from oracle import repair as oracle_repair

from elitelanes_jax import InputError, fitness, measure, random_grids, repair, rotate
from elitelanes_jax.network import plain_measure

measure_many = jax.jit(jax.vmap(measure))
rotate_many = jax.vmap(rotate)
repair_many = jax.jit(jax.vmap(repair))


def every_row(length):
    codes = np.unravel_index(np.arange(16**length), (16,) * length)
    return np.stack(codes, axis=-1).reshape(-1, 1, length).astype(np.int8)


def compare(grids):
    """Compares rows with the oracle, and the same roads as a column with the rows."""
    rows, columns = (jax.device_get(measure_many(np.asarray(side))) for side in (grids, rotate_many(grids)))
    worth = jax.device_get(jax.jit(fitness)(rows))
    for number, grid in enumerate(grids):
        expected = oracle(grid)
        assert {name: values[number] for name, values in rows._asdict().items()} == expected, grid
        assert plain_measure(grid) == expected, grid
        assert worth[number] == oracle_fitness(expected)
    for name, values in rows._asdict().items():
        np.testing.assert_array_equal(getattr(columns, name), values, err_msg=name)


@pytest.mark.parametrize("length", [1, 3, *(pytest.param(length, marks=pytest.mark.slow) for length in (2, 4))])
def test_metrics_of_every_row_and_column(length):
    compare(every_row(length))


@pytest.mark.slow
@pytest.mark.parametrize("length", [9, 65, 1024])
def test_metrics_of_long_ones(length):
    """With runs of straight tiles too, as long as the row."""
    grids = np.random.default_rng(length).integers(0, 16, (12, 1, length)).astype(np.int8)
    grids[6:] = np.where(np.random.default_rng(0).random((6, 1, length)) < 0.9, 5, grids[6:])
    grids[0] = 5
    compare(grids)


@pytest.mark.parametrize("length", [3, *(pytest.param(length, marks=pytest.mark.slow) for length in (1, 2))])
def test_repair_of_every_row_and_column_with_every_mask(length):
    grids = every_row(length)
    for bits in range(2**length):
        dirty = (bits >> np.arange(length) & 1).astype(bool)[None]
        masks = np.broadcast_to(dirty, grids.shape)
        repaired = np.array(repair_many(grids, masks))
        column = np.array(repair_many(grids.transpose(0, 2, 1), masks.transpose(0, 2, 1)))
        for number in range(bits, len(grids), 11):
            np.testing.assert_array_equal(repaired[number], oracle_repair(grids[number], dirty))
            np.testing.assert_array_equal(column[number], oracle_repair(grids[number].T, dirty.T))
        found = measure_many(repaired)
        assert not found.mismatches.any()
        assert not found.boundary_violations.any()


def test_what_cannot_be_is_said():
    with pytest.raises(InputError, match="fill: expected a grid of at least 2 x 2, got 1 x 3"):
        repair([[5, 5, 5]], fill=True)
    assert random_grids(jax.random.key(0), 3, (1, 4)).shape == (3, 1, 4)
