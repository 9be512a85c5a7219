"""Gamma and the gridlock potential against the oracle, on sparse towns with rings, dead ends and several parts."""

import jax
import numpy as np
import pytest
from gridlock_oracle import gamma
from gridlock_oracle import gridlock_potential as slow_potential
from refusals import refused
from sparse_towns import sparse_towns

from elitelanes_jax.network import gridlock_gamma, gridlock_potential

many_gammas = jax.jit(jax.vmap(gridlock_gamma))
many_potentials = jax.jit(jax.vmap(gridlock_potential, in_axes=(0, 0)))
many_slopes = jax.jit(jax.vmap(jax.grad(gridlock_potential, argnums=1), in_axes=(0, None)))


@pytest.fixture(scope="module")
def towns():
    """Of two thirds of them one or two tiles lack connections."""
    towns, rng = sparse_towns(24, 7, least=2), np.random.default_rng(0)
    for number, town in enumerate(towns):
        for row, column in rng.integers(0, 7, (number % 3, 2)):
            town[row, column] &= rng.integers(0, 16)
    return towns


def test_gammas_are_the_oracles(towns):
    found = many_gammas(towns)
    np.testing.assert_array_equal(found, [gamma(town) for town in towns])
    assert 0 in found and len(np.unique(found)) > 5
    town = towns[int(np.argmax(found))]
    assert int(gridlock_gamma(town, tile_size=33.3)) == gamma(town, 33.3)


def test_potentials_are_the_oracles_to_five_digits(towns):
    """Also tiny ones: a determinant of float32 would be 1."""
    robots = np.tile(np.float32([1, 12.5, 250]), 8)
    found, expected = many_potentials(towns, robots), list(map(slow_potential, towns, robots))
    np.testing.assert_allclose(found, expected, rtol=3e-5, atol=np.finfo(np.float32).tiny)
    assert 0 < np.min(found, initial=1, where=found > 0) < 1e-10


def test_the_slope_is_the_derivative_by_the_robots(towns):
    robots, step = 25.0, 1e-3
    expected = [
        (slow_potential(town, robots + step) - slow_potential(town, robots - step)) / (2 * step) for town in towns[:8]
    ]
    np.testing.assert_allclose(many_slopes(towns, robots)[:8], expected, rtol=1e-4, atol=1e-30)
    assert np.isfinite(many_slopes(towns, 0.0)).all()


def test_a_town_alone_and_tiles_of_another_size(towns):
    town = towns[int(np.argmax(many_potentials(towns, np.full(24, 30, np.float32))))]
    for robots in (0, 30):
        expected = slow_potential(town, robots, 20)
        assert float(gridlock_potential(town, robots, tile_size=20)) == pytest.approx(expected, rel=3e-5)
    assert gridlock_potential(town, 1e6, tile_size=20) == np.inf
    assert gridlock_potential(town, np.inf, tile_size=20) == np.inf


def test_a_map_without_crossings_has_no_streets():
    ring, road = np.array([[6, 3], [12, 9]], np.int8), np.full((1, 4), 5, np.int8)
    empty = np.zeros((7, 7), np.int8)
    for codes in (ring, road, empty):
        padded = np.pad(codes, [(0, 7 - length) for length in codes.shape])
        batch = np.repeat(padded[None], 24, axis=0)
        assert not many_gammas(batch).any() and not many_potentials(batch, np.full(24, 9, np.float32)).any()
    assert int(gridlock_gamma([[0]])) == 0


def test_large_maps_and_wrong_tiles_are_refused():
    with refused("codes", "(33, 2)", expected="at most 32"):
        gridlock_gamma(np.zeros((33, 2), np.int8))
    with refused("tile_size", "14"):
        gridlock_potential(np.zeros((3, 2), np.int8), 3, tile_size=14)
    with refused("codes", "float64"):
        gridlock_gamma(np.zeros((3, 2)))
