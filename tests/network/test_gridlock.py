"""The gridlock number and the shortest loop against NetworkX."""

import jax
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from gridlock_oracle import gridlock_loop as slow_loop
from gridlock_oracle import gridlock_number as slow_number
from hypothesis import given
from refusals import refused
from sparse_towns import sparse_towns

from elitelanes_jax.network import gridlock_loop, gridlock_number


def ring(height, width):
    """One loop along the border."""
    grid = np.zeros((height, width), np.int8)
    grid[[0, -1], 1:-1], grid[1:-1, [0, -1]] = 5, 10
    grid[[0, 0, -1, -1], [0, -1, 0, -1]] = 6, 3, 12, 9
    return grid


def serpentine(height, width):
    """One road through all tiles."""
    grid = np.full((height, width), 5, np.int8)
    grid[0::2, -1], grid[1::2, -1], grid[1::2, 0], grid[2::2, 0] = 3, 9, 6, 12
    return grid


@given(grids([(2, 2), (2, 5), (6, 6), (5, 1)]))
def test_numbers_and_loops_of_any_grid_are_the_oracles(grid):
    assert int(gridlock_number(grid)) == slow_number(grid)
    assert gridlock_loop(grid) == slow_loop(grid)
    assert int(gridlock_number(grid, slots=3)) == slow_number(grid, slots=3)


@pytest.mark.slow
@given(grids(ALL_SHAPES))
def test_numbers_and_loops_of_grids_of_more_shapes_are_the_oracles(grid):
    assert int(gridlock_number(grid)) == slow_number(grid)
    assert gridlock_loop(grid) == slow_loop(grid)


@pytest.mark.parametrize("shape", [(2, 2), (3, 7), (9, 9), (12, 5), (33, 40)])
def test_a_ring_is_its_own_shortest_loop(shape):
    assert int(gridlock_number(ring(*shape))) == 2 * sum(shape) - 5


def test_a_road_without_a_loop_has_the_number_0():
    assert int(gridlock_number(serpentine(7, 6))) == 0
    assert int(gridlock_number(np.zeros((3, 3), np.int8))) == 0
    assert int(gridlock_number([[15]])) == 0


def test_of_several_shortest_loops_the_least_list_of_tiles_comes_first():
    """Four loops of eight tiles around empty cells, and two of these have the same first tile."""
    streets = np.array([[6, 5, 7, 5, 3], [10, 0, 10, 0, 10], [14, 5, 15, 5, 11], [10, 0, 10, 0, 10], [12, 5, 13, 5, 9]])
    clockwise = [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (1, 0)]
    assert gridlock_loop(streets) == slow_loop(streets) == clockwise
    assert gridlock_loop(np.pad(streets, 2)) == [(row + 2, column + 2) for row, column in clockwise]


def test_loops_of_sparse_towns_are_the_oracles():
    for town in sparse_towns(60, 9):
        assert gridlock_loop(town) == slow_loop(town)


def test_a_batch_has_the_numbers_of_its_grids():
    towns = np.array(jax.random.randint(jax.random.key(0), (40, 9, 8), 0, 16), np.int8)
    np.testing.assert_array_equal(jax.vmap(gridlock_number)(towns), [slow_number(town) for town in towns])


def test_bad_maps_and_slots_are_refused():
    with refused("codes", "(2, 129)", expected="128"):
        gridlock_number(np.zeros((2, 129), np.int8))
    with refused("slots", "0"):
        gridlock_number(ring(2, 2), slots=0)
    for function in (gridlock_number, gridlock_loop):
        with refused("codes", "16 at A1 ([0, 0])"):
            function(np.full((2, 2), 16))
        with refused("codes", "a masked array", hint="codes.filled"):
            function(np.ma.masked_equal([[6, 3], [12, 9]], 3))
