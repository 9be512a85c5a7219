"""Random choices from raw bits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from refusals import refused

from elitelanes_jax.network import random_grids
from elitelanes_jax.network.bits import bernoulli, categorical, fold_in, randint, random_bits, random_bits16
from elitelanes_jax.network.xla import UNIT


def test_below_is_the_upper_half_of_the_product():
    words = np.random.default_rng(0).integers(0, 2**32, 1000, np.uint32)
    words[:2] = 0, 2**32 - 1
    for count in (0, 1, 2, 3, 11, 144, 65_535, 65_536, 65_537, 2**27 + 12_345, 2**31 - 1):
        expected = [int(word) * count >> 32 for word in words]
        np.testing.assert_array_equal(randint(jnp.asarray(words), count), expected)
    counts = np.arange(1000)
    np.testing.assert_array_equal(randint(jnp.asarray(words), counts), words.astype(object) * counts >> 32)


def test_chance():
    words = jnp.array([0, 2**31 - 1, 2**31, 2**32 - 1], jnp.uint32)
    np.testing.assert_array_equal(bernoulli(words, 0.5), [True, True, False, False])
    assert not bernoulli(words, 0.0).any()
    assert bernoulli(words, 1.0).all()
    assert float(bernoulli(random_bits(jax.random.key(1), (100_000,)), 0.7).mean()) == pytest.approx(0.7, abs=0.006)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("dtype", [np.int32, np.int64, np.uint8, np.uint64, bool])
@pytest.mark.parametrize("draw", [lambda bits: randint(bits, 9), lambda bits: bernoulli(bits, 0.5)])
def test_bits_of_another_dtype_are_refused(draw, dtype):
    with refused("bits", np.dtype(dtype)):
        draw(np.array([1, 0], dtype))


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("count", [-1, 2**31, True, 2.5, np.array([2.5]), np.array([3, -1]), [2**31], jnp.array(2.5)])
def test_counts_out_of_range_are_refused(count):
    with refused("count", expected="number"):
        randint(jnp.zeros(2, jnp.uint32), count)


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("key", [jax.random.split(jax.random.key(0)), np.zeros((2, 2), np.uint32), np.uint32(3)])
def test_grids_are_drawn_from_one_key(key):
    # Two keys broadcast against two cells.
    with refused("key", expected="jax.random.key"):
        random_grids(key, 1, (1, 2))


@pytest.mark.parametrize("kind", ["threefry2x32", "rbg", "not partitionable"])
def test_words_and_keys_are_those_of_jax_random_by_default(kind):
    key = jax.random.key(3, impl="rbg" if kind == "rbg" else "threefry2x32")
    partitionable = jax.threefry_partitionable(kind != "not partitionable")
    for shape in ((4, 5), (), (0, 3), (7,)):
        with partitionable:
            bits = random_bits(key, shape)
        np.testing.assert_array_equal(bits, jax.random.bits(key, shape, jnp.uint32))
    for number in (0, 1, 2**31 + 5, 2**32 - 1):
        with partitionable:
            folded = fold_in(key, np.uint32(number))
        expected = jax.random.fold_in(key, np.uint32(number))
        assert folded.dtype == expected.dtype
        np.testing.assert_array_equal(*(jax.random.key_data(one) for one in (folded, expected)))


def test_words_of_a_batch_of_keys():
    keys = jax.random.split(jax.random.key(4), (3, 2))
    drawn = jax.jit(jax.vmap(jax.vmap(lambda key: random_bits(fold_in(key, jnp.int32(9)), (6, 2)))))(keys)
    for index in np.ndindex(keys.shape):
        np.testing.assert_array_equal(drawn[index], jax.random.bits(jax.random.fold_in(keys[index], 9), (6, 2)))


def test_halves_are_all_bits_of_the_words():
    key = jax.random.key(4)
    words = np.asarray(random_bits(key, (13,)))
    halves = np.asarray(random_bits16(key, (5, 5)))
    assert halves.dtype == np.int32
    np.testing.assert_array_equal(halves.ravel(), np.concatenate([words & 0xFFFF, words >> 16])[:25])


@pytest.mark.parametrize(
    "logits",
    [[-4, -1, 0, 0.25, 2, 4], [0] * 11, [3], [16, -16, 15.5], [-7.5] * 15 + [-7]],
    ids=lambda logits: len(logits),
)
def test_categorical_draws_from_the_softmax(logits):
    """All 2**16 words that differ in their upper half, one after another: shares are exact but for the last bits."""
    units = np.rint(np.array(logits) * UNIT).astype(np.int32)
    words = np.arange(2**16, dtype=np.uint32) << 16 | 0x8000
    drawn = np.asarray(jax.jit(categorical)(words, np.broadcast_to(units[:, None], (len(units), 2**16))))
    shares = np.bincount(drawn, minlength=len(units)) / 2**16
    expected = np.exp(np.array(logits) - max(logits))
    np.testing.assert_allclose(shares, expected / expected.sum(), atol=1e-4)
    assert (np.diff(drawn) >= 0).all()


def test_categorical_is_the_rule_in_python_numbers():
    """The index of the first cumulative weight over the product's upper half, weights within 1 / 5,000."""
    rng = np.random.default_rng(7)
    logits = rng.integers(-4 * UNIT, 4 * UNIT, (11, 200)).astype(np.int32)
    words = rng.integers(0, 2**32, 200, np.uint32)
    weights = np.exp((logits - logits.max(axis=0)) / UNIT)
    cumulative = np.cumsum(weights, axis=0) / weights.sum(axis=0)
    lot = words / 2**32
    clear = (abs(cumulative - lot) > 2e-4).all(axis=0)
    assert clear.mean() > 0.98
    expected = (cumulative <= lot).sum(axis=0)
    drawn = np.asarray(categorical(jnp.asarray(words), jnp.asarray(logits)))
    np.testing.assert_array_equal(drawn[clear], expected[clear])
