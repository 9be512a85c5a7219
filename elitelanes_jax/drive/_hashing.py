"""Random numbers by integer hashing.

Each number takes two multiplications, where threefry needs about 70 operations. The numbers are for
pictures. They pass no battery of tests of randomness; searches and drawn maps use `jax.random`.
"""

from math import prod

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt32

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.network.bits import mix

# 2**32 divided by the golden ratio: neighbours' products are far apart.
_GOLDEN = np.uint32(0x9E3779B9)
# The mean and the standard deviation of the sum of four uniform bytes.
_MEAN = 2 * 255
_DEVIATION = float(np.sqrt(4 * (256**2 - 1) / 12))


def fork(seed: UInt32[Array, ""], number: Numeric) -> UInt32[Array, ""]:
    """Returns another seed for each whole number."""
    return mix(seed + jnp.asarray(number, jnp.uint32) * _GOLDEN)


def hash_bits(seed: UInt32[Array, ""], shape: tuple[int, ...]) -> UInt32[Array, "..."]:
    """Returns 32 random bits for each element of a shape."""
    index = jnp.arange(prod(shape), dtype=jnp.uint32).reshape(shape)
    return mix(index * _GOLDEN ^ seed)


def uniform(bits: UInt32[Array, "..."]) -> Float[Array, "..."]:
    """Returns numbers from 0 to less than 1, from 24 of 32 random bits."""
    # A float32 holds 24 bits exactly. With all 32, the largest numbers would be rounded to 1.
    return (bits >> 8).astype(jnp.float32) * np.float32(2**-24)


def hash_normal(seed: UInt32[Array, ""], shape: tuple[int, ...]) -> Float[Array, "..."]:
    """Returns nearly normal numbers, mean 0 and deviation 1.

    Each number is the sum of the four bytes of a hash. No number is farther than 3.46 from 0.
    """
    bits = hash_bits(seed, shape)
    # Two sums of two bytes in one word, and then the sum of both. Ten bits hold 4 * 255.
    pairs = (bits & 0xFF00FF) + (bits >> 8 & 0xFF00FF)
    total = (pairs + (pairs >> 16) & 0x3FF).astype(jnp.int32) - _MEAN
    return total.astype(jnp.float32) / _DEVIATION
