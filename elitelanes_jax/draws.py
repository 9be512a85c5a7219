"""Random choices made from raw bits: whole numbers and chances, exact and the same everywhere."""

from math import log, prod

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, Numeric, PRNGKey
from numpy.polynomial import Chebyshev, Polynomial

__all__ = ["UNIT", "below", "categorical", "chance", "exponential", "random_halves", "random_words"]

UNIT = 4096
"""What 1 is in fixed-point numbers: sums and products of whole numbers are the same bit for bit on every machine."""


def random_words(key: PRNGKey, shape: tuple[int, ...]) -> Array:
    """uint32 of the given shape, all bits random; the key is consumed."""
    # The same words as `jax.random.bits` gives for the shape; drawn in one row they compile four times faster.
    return jax.random.bits(key, (prod(shape),), jnp.uint32).reshape(shape)


def random_halves(key: PRNGKey, shape: tuple[int, ...]) -> Array:
    """int32 in [0, 2**16) of the given shape, all 16 bits random; the key is consumed."""
    size = prod(shape)
    words = random_words(key, (-(-size // 2),))
    return jnp.concatenate([words & 0xFFFF, words >> 16])[:size].reshape(shape).astype(jnp.int32)


def below(word: Array, count: Numeric) -> Array:
    """A whole number in [0, count) from 32 random bits, each with probability 1 / count within 2**-32.

    It is the upper half of the 64-bit product of the two, in 32-bit arithmetic.

    Args:
      word: uint32, any shape.
      count: 1 to 2**31 - 1, a number or an array that broadcasts against `word`.

    Returns:
      int32, of the broadcast shape.
    """
    count = jnp.asarray(count, jnp.uint32)
    high, low = word >> 16, word & 0xFFFF
    count_high, count_low = count >> 16, count & 0xFFFF
    middle = high * count_low + (low * count_low >> 16)
    carry = (middle & 0xFFFF) + low * count_high
    return (high * count_high + (middle >> 16) + (carry >> 16)).astype(jnp.int32)


def chance(word: Array, probability: Numeric) -> Array:
    """True with the given probability, from 32 random bits of which it takes the upper 24.

    A probability of 0 is never, of 1 always.
    """
    return (word >> 8).astype(jnp.float32) < jnp.float32(2**24) * probability


def exponential(word: Array) -> Array:
    """An exponentially distributed number of mean 1 from 32 random bits, int32 in units of 1 / `UNIT`, at most 8.4.

    It is one of 2048 quantiles, each equally likely.
    """
    return jnp.asarray(_QUANTILES)[word >> 21]


def categorical(word: Array, logits: Array) -> Array:
    """A whole number in [0, K) from 32 random bits, with the probabilities of a softmax, each within 1 / 10,000 of it.

    Args:
      word: uint32 ``[...]``.
      logits: int32 ``[K, ...]``, K at most 31, in units of 1 / `UNIT`.

    Returns:
      int32 ``[...]``.
    """
    weights = _exponential(logits - logits.max(axis=0))
    drawn = below(word, weights.sum(axis=0, dtype=jnp.int32))
    place, reached = jnp.zeros(word.shape, jnp.int32), jnp.zeros(word.shape, jnp.int32)
    for weight in weights:
        reached = reached + weight
        place = place + (drawn >= reached)
    return place


def _exponential(value: Array) -> Array:
    """The exponential of a number up to 0 in units, in units of 2**-26, int32."""
    # In powers of two, n + f with f in [0, 1), in units of 2**-26; over 20 the result is 0 anyway.
    halvings = jnp.minimum(-value, 20 * UNIT) * round(2**14 / log(2))
    f = (halvings & 2**26 - 1) >> 11
    # 2**-f by the polynomial that is exact at the Chebyshev points, in units of 2**-15.
    share = jnp.zeros_like(f)
    for coefficient in _EXPONENTIAL:
        share = (share * f >> 15) + coefficient
    return share << 11 >> (halvings >> 26)


_QUANTILES = np.rint(-UNIT * np.log((np.arange(2048) + 0.5) / 2048)).astype(np.int32)

_EXPONENTIAL = [
    round(2**15 * c) for c in Chebyshev.interpolate(lambda f: 2.0**-f, 4, [0, 1]).convert(kind=Polynomial).coef[::-1]
]
