"""Repair against its definition, edge by edge, and what must hold of every repaired grid."""

import jax
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from hypothesis import given
from hypothesis import strategies as st
from oracle import fill as oracle_fill
from oracle import measure as oracle
from oracle import raster_rank
from oracle import repair as oracle_repair
from refusals import refused

from elitelanes_jax import measure, repair
from elitelanes_jax.network.codes import ROAD_ALPHABET


@given(grids(ALL_SHAPES), st.integers(0, 2**32 - 1))
def test_repair_is_the_rule_applied_to_every_edge(grid, seed):
    rng = np.random.default_rng(seed)
    mask = rng.random(grid.shape) < rng.random()
    np.testing.assert_array_equal(repair(grid, mask), oracle_repair(grid, mask))
    np.testing.assert_array_equal(repair(grid, mask, raster=True), oracle_repair(grid, raster_rank(grid.shape)))
    np.testing.assert_array_equal(repair(grid), oracle_repair(grid, np.zeros(grid.shape)))


@pytest.mark.parametrize("shape", [(2, 2), (1, 3), (3, 1), pytest.param((1, 2), marks=pytest.mark.slow)], ids=str)
def test_every_small_grid_with_every_mask(shape):
    cells = shape[0] * shape[1]
    codes = (np.arange(16**cells)[:, None] // 16 ** np.arange(cells) % 16).reshape(-1, *shape).astype(np.int8)
    repair_many = jax.jit(jax.vmap(repair, (0, None)))
    for bits in range(2**cells):
        dirty = (bits >> np.arange(cells) & 1).astype(bool).reshape(shape)
        repaired = np.array(repair_many(codes, dirty))
        for index in range(bits, len(codes), 1 + len(codes) // 600):
            np.testing.assert_array_equal(repaired[index], oracle_repair(codes[index], dirty))
        metrics = jax.vmap(measure)(repaired)
        assert not (metrics.mismatches.any() or metrics.boundary_violations.any())


@given(grids(ALL_SHAPES))
def test_a_repaired_grid_fits_together_and_stays_as_it_is(grid):
    repaired = np.array(repair(grid))
    found = oracle(repaired)
    assert found["mismatches"] == found["boundary_violations"] == 0
    np.testing.assert_array_equal(repair(repaired), repaired)


@given(grids(), st.integers(0, 2**32 - 1), st.booleans())
def test_fixed_tiles_decide_and_filling_leaves_them(grid, seed, raster):
    rng = np.random.default_rng(seed)
    fixed, dirty = rng.random(grid.shape) < rng.random(), rng.random(grid.shape) < rng.random()
    rank = np.where(fixed, 2**30, raster_rank(grid.shape) if raster else dirty)
    expected = oracle_repair(grid, rank)
    np.testing.assert_array_equal(repair(grid, dirty, raster=raster, fixed=fixed), expected)
    filled = repair(grid, dirty, raster=raster, fixed=fixed, fill=True)
    np.testing.assert_array_equal(filled, oracle_fill(expected, fixed))


@given(grids(), st.booleans())
def test_a_filled_grid_has_a_picture_for_every_tile(grid, raster):
    plain, filled = np.array(repair(grid, raster=raster)), np.array(repair(grid, raster=raster, fill=True))
    np.testing.assert_array_equal(filled, oracle_fill(plain, np.zeros(grid.shape, bool)))
    found = oracle(filled, ROAD_ALPHABET)
    assert found["mismatches"] == found["boundary_violations"] == found["dead_ends"] == found["off_alphabet"] == 0
    assert found["coverage"] == 1
    assert (filled & plain == plain).all(), "filling removes nothing"
    np.testing.assert_array_equal(repair(filled, fill=True), filled)


@pytest.mark.parametrize("shape", [(2, 11), (33, 17), pytest.param((12, 12), marks=pytest.mark.slow)], ids=str)
def test_what_holds_after_repair_holds_at_every_size(shape):
    rng = np.random.default_rng(shape)
    codes = rng.integers(0, 16, (200, *shape)).astype(np.int8)
    codes[50:100] = np.where(rng.random((50, *shape)) < 0.2, codes[50:100], 0)
    codes[0], codes[1] = 0, 15
    dirty = rng.random(codes.shape) < 0.3
    for fill in (False, True):
        repaired = jax.vmap(lambda grid, dirty, fill=fill: repair(grid, dirty, fill=fill))(codes, dirty)
        metrics = jax.vmap(lambda grid: measure(grid, ROAD_ALPHABET))(repaired)
        assert not metrics.mismatches.any()
        assert not metrics.boundary_violations.any()
        if fill:
            assert (metrics.coverage == 1).all()
            assert not metrics.dead_ends.any()
            assert not metrics.off_alphabet.any()


def test_no_grids_are_repaired_to_none():
    none = np.zeros((2, 0, 3, 4), np.int8)
    for fill in (False, True):
        assert jax.vmap(jax.vmap(lambda grid, fill=fill: repair(grid, fill=fill)))(none).shape == none.shape
    assert jax.vmap(jax.vmap(measure))(none).turns.shape == none.shape[:2]


def test_bad_masks_and_thin_grids_to_fill_are_refused():
    with refused("fill", "1 x 3", expected="2 x 2"):
        repair([[5, 5, 5]], fill=True)
    for dirty in (np.zeros((2, 3), bool), np.zeros((2, 2), float), True, "x", [[1], [1, 2]], [[0, 1], [1, 0]]):
        with refused("dirty", expected="bool"):
            repair([[0, 0], [0, 0]], dirty)
