"""What only tells XLA how to compute changes no value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.network.xla import lookup, materialize


@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.uint32])
def test_the_array_stays_as_it_is(dtype):
    limits = np.iinfo(dtype)
    array = np.array([[limits.max, 0, 5], [limits.min, 1, limits.max]], dtype)
    given = jnp.asarray(array)
    for function in (materialize, jax.jit(materialize), jax.vmap(jax.vmap(materialize))):
        result = function(given)
        assert result.dtype == dtype
        np.testing.assert_array_equal(result, array)


def test_values_are_looked_up_in_each_vector_of_a_batch():
    rng = np.random.default_rng(0)
    values = jnp.asarray(rng.integers(-9, 9, (2, 3, 7)), jnp.int8)
    places = jnp.asarray(rng.integers(0, 7, (2, 3, 4, 5)))
    expected = np.take_along_axis(np.asarray(values)[..., None, :], np.asarray(places), axis=-1)
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(lookup)))(values, places), expected)
    shared = jax.vmap(lookup, (None, 0))(values[0, 0], places[0])
    np.testing.assert_array_equal(shared, values[0, 0][places[0]])
