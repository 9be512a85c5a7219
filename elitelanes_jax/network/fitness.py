"""Fitness: a weighted sum of metrics, to be minimised (paper, section "Fitness Function")."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric
from elitelanes_jax.network.records import Metrics, Weights


@name_wrong_arguments
@runs_jax
def fitness(metrics: Metrics, weights: Weights = Weights()) -> Int32[Array, "..."]:
    """Returns the weighted sum of a network's metrics; lower is better.

    Args:
      metrics: the metrics of one grid, or of many with the same leading axes.
      weights: integers, or integer arrays that broadcast against the metrics. The sum must fit
        int32.

    Returns:
      int32, of the metrics' shape.

    Raises:
      InputError: for anything but `Metrics` and `Weights`, or weights that are not integers.
    """
    if not isinstance(metrics, Metrics):
        raise InputError(f"metrics: expected Metrics, from measure, got {type(metrics).__name__}")
    if not isinstance(weights, Weights):
        raise InputError(f"weights: expected Weights, got {type(weights).__name__}")
    total = _integer("constant", weights.constant)
    for name in Weights._fields[:-1]:
        value = getattr(metrics, name)
        if name == "components":
            # One component is no fault. An empty grid has none.
            value = jnp.maximum(value - 1, 0)
        total = total + _integer(name, getattr(weights, name)) * value
    return total


def _integer(name: str, weight: Numeric) -> Int32[Array, "..."]:
    array = weight if isinstance(weight, jax.Array) else np.asarray(weight)
    if not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(f"weights: expected integers, got {name} of type {array.dtype}")
    if isinstance(array, np.ndarray) and (array != array.astype(np.int32)).any():
        raise InputError(f"weights: expected integers of 32 bits, got {name}={weight!r}")
    return jnp.asarray(array, jnp.int32)
