"""Real numbers as whole numbers of units: sums and products are the same bit for bit on every machine."""

import jax.numpy as jnp
from chex import Array, Numeric, PRNGKey

from elitelanes_jax.draws import UNIT, random_halves

__all__ = ["either_way", "part", "units"]


def units(value: Numeric) -> Array:
    """A real number in units of 1 / `UNIT`, int32; the product with a power of two is exact."""
    return jnp.rint(jnp.asarray(value, jnp.float32) * UNIT).astype(jnp.int32)


def part(value: Array, share: Array) -> Array:
    """The product of two numbers in units, rounded down."""
    return value * share >> 12


def either_way(key: PRNGKey, shape: tuple[int, ...]) -> Array:
    """Numbers in units, uniform from -1 to 1, int32 of the given shape; the key is consumed."""
    return random_halves(key, shape) // 8 - UNIT
