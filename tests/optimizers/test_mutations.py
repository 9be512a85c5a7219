"""The paper's mutations: which tiles they change, and how often."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from conftest import grids
from hypothesis import given
from hypothesis import strategies as st

from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.codes import CROSSINGS, ROAD_ALPHABET
from elitelanes_jax.optimizers._mutations import change_tile, insert_crossing, paper_mutation

ALPHABETS = (ROAD_ALPHABET, (3, 15), (7,))


def many(move, grid, count, seed=0):
    bits = random_bits(jax.random.key(seed), (count, move.bits))
    return jax.jit(jax.vmap(move.apply, (0, None)))(bits, jnp.asarray(grid, jnp.int8))


@given(grids(), st.sampled_from(ALPHABETS), st.integers(0, 2**32 - 1))
def test_what_is_not_dirty_is_as_it_was(grid, alphabet, seed):
    for move in (change_tile(alphabet), insert_crossing(alphabet), paper_mutation(alphabet)):
        bits = np.random.default_rng(seed).integers(0, 2**32, move.bits, np.uint32)
        varied = move.apply(jnp.asarray(bits), jnp.asarray(grid))
        assert varied.grid.dtype == jnp.int8
        assert varied.dirty.dtype == bool
        np.testing.assert_array_equal(np.where(varied.dirty, grid, varied.grid), grid)
        assert set(np.asarray(varied.grid)[np.asarray(varied.dirty)].tolist()) <= set(alphabet)


@pytest.mark.parametrize(
    ("move", "codes"), [(change_tile(ROAD_ALPHABET), ROAD_ALPHABET), (insert_crossing(ROAD_ALPHABET), CROSSINGS)]
)
def test_a_mutation_takes_every_tile_and_every_code_equally_often(move, codes):
    """A tile changes to another code; a crossing may be inserted where it is."""
    grid = np.arange(15).reshape(3, 5)
    varied = many(move, grid, 33_000)
    assert (varied.dirty.sum(axis=(1, 2)) == 1).all()
    seen = np.zeros((15, 16), int)
    np.add.at(seen, (np.argmax(varied.dirty.reshape(-1, 15), 1), np.asarray(varied.grid)[np.asarray(varied.dirty)]), 1)
    for code in range(15):
        others = [other for other in codes if codes == CROSSINGS or other != code]
        assert set(np.flatnonzero(seen[code])) == set(others)
        expected = 33_000 / 15 / len(others)
        assert (abs(seen[code, others] - expected) < 5 * np.sqrt(expected)).all()


def test_an_alphabet_of_one_code_stays_as_it_is():
    varied = many(change_tile((7,)), np.full((3, 3), 7), 100)
    assert (varied.grid == 7).all()


def test_the_papers_rates():
    varied = many(paper_mutation(ROAD_ALPHABET), np.zeros((12, 12)), 20_000)
    dirty = np.asarray(varied.dirty.sum(axis=(1, 2)))
    assert (dirty == 0).mean() == pytest.approx(0.3 * 0.5, abs=0.01)
    assert (dirty == 2).mean() == pytest.approx(0.7 * 0.5 * 143 / 144, abs=0.01)
    never, always = (many(paper_mutation((7, 15), rate, 0.0), np.zeros((3, 3)), 100).dirty for rate in (0.0, 1.0))
    assert not never.any() and (always.sum(axis=(1, 2)) == 1).all()
    assert many(paper_mutation((3, 5)), np.zeros((3, 3)), 100).dirty.sum(axis=(1, 2)).max() == 1, "no crossings"
