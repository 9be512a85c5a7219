"""Random choices from raw bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.draws import below, chance, random_words


def test_below_is_the_upper_half_of_the_product():
    words = np.random.default_rng(0).integers(0, 2**32, 1000, np.uint32)
    words[:2] = 0, 2**32 - 1
    for count in (1, 2, 3, 11, 144, 65_535, 65_536):
        expected = [int(word) * count >> 32 for word in words]
        np.testing.assert_array_equal(below(jnp.asarray(words), count), expected)
    counts = np.arange(1, 1001)
    np.testing.assert_array_equal(below(jnp.asarray(words), counts), words.astype(object) * counts >> 32)


def test_chance():
    words = jnp.array([0, 2**31 - 1, 2**31, 2**32 - 1], jnp.uint32)
    np.testing.assert_array_equal(chance(words, 0.5), [True, True, False, False])
    assert not chance(words, 0.0).any()
    assert chance(words, 1.0).all()
    assert float(chance(random_words(jax.random.key(1), (100_000,)), 0.7).mean()) == pytest.approx(0.7, abs=0.006)


def test_words_are_jax_randoms_own():
    key = jax.random.key(3)
    np.testing.assert_array_equal(random_words(key, (4, 5)), jax.random.bits(key, (4, 5), jnp.uint32))
