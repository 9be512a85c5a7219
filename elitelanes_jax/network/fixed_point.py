"""Real numbers as whole numbers of units: sums and products are the same bit for bit on every machine."""

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Int32, Real

UNIT = 4096
"""The whole number that stands for 1."""


def to_fixed(value: Real[ArrayLike, "..."]) -> Int32[Array, "..."]:
    """Rounds a real number to units of 1 / `UNIT`; the product with a power of two is exact."""
    return jnp.rint(jnp.asarray(value, jnp.float32) * UNIT).astype(jnp.int32)


def multiply(value: Int32[Array, "..."], factor: Int32[Array, "..."]) -> Int32[Array, "..."]:
    """Multiplies two numbers in units; the product is rounded down."""
    return value * factor >> 12
