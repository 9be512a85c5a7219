"""Random choices made from raw bits: whole numbers and chances, exact and the same everywhere."""

from math import prod

import jax
import jax.numpy as jnp
from chex import Array, Numeric, PRNGKey

__all__ = ["below", "chance", "random_words"]


def random_words(key: PRNGKey, shape: tuple[int, ...]) -> Array:
    """uint32 of the given shape, all bits random; the key is consumed."""
    # The same words as `jax.random.bits` gives for the shape; drawn in one row they compile four times faster.
    return jax.random.bits(key, (prod(shape),), jnp.uint32).reshape(shape)


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
