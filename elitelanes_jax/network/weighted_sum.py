"""Fitness: a weighted sum of metrics, to be minimised (paper, section "Fitness Function")."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.records import Metrics, Weights


@name_wrong_arguments
@runs_jax
def fitness(metrics: Metrics, weights: Weights = Weights()) -> Int32[Array, "..."]:
    """Returns the weighted sum of a network's metrics; lower is better.

    Args:
      metrics: the metrics of one grid, or of many with the same leading axes.
      weights: integers, or integer arrays that broadcast against the metrics. The sum must fit
        int32. Under `jax.jit` and `jax.vmap` metrics are unknown, so this is not checked there;
        `road_problem` checks it for all grids of its shape.

    Returns:
      int32, of the metrics' shape.

    Raises:
      InputError: for anything but `Metrics` and `Weights`, weights that are not integers, or a sum
        that does not fit int32.
    """
    if not isinstance(metrics, Metrics):
        raise InputError("metrics", "Metrics, from measure", type(metrics).__name__)
    if not isinstance(weights, Weights):
        raise InputError("weights", "Weights", type(weights).__name__)
    total = _integer("constant", weights.constant)
    factors = []
    for name in Weights._fields[:-1]:
        value = getattr(metrics, name)
        if name == "components":
            # One component is no fault. An empty grid has none.
            value = jnp.maximum(value - 1, 0)
        weight = _integer(name, getattr(weights, name))
        factors.append((weight, value))
        total = total + weight * value
    _check_sum(weights.constant, factors)
    return total


def _check_sum(constant: ArrayLike, factors: list[tuple[Array, Array]]) -> None:
    """Checks that a constant and the products of factors add up to a number that fits int32."""
    if any(isinstance(number, jax.core.Tracer) for number in jax.tree.leaves((constant, factors))):
        return
    # No product of two numbers of 32 bits exceeds 64 bits. Of the metrics only the straight score
    # has over 24 bits, so the sum does not either.
    total = np.asarray(constant, np.int64)
    for weight, value in factors:
        total = total + np.asarray(weight, np.int64) * np.asarray(value, np.int64)
    wrong = total[np.abs(total) >= 2**31]
    if wrong.size:
        raise InputError("weights", "a fitness within int32", f"{wrong.flat[0]:,}")


def _integer(name: str, weight: UserValue) -> Int32[Array, "..."]:
    array = weight if isinstance(weight, jax.Array) else np.asarray(weight)
    if not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError("weights", "integers", f"{name} of type {array.dtype}")
    if isinstance(array, np.ndarray) and (array != array.astype(np.int32)).any():
        raise InputError("weights", "integers of 32 bits", f"{name}={weight!r}")
    return jnp.asarray(array, jnp.int32)
