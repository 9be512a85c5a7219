"""Values that XLA computes once, instead of again for each use."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from elitelanes_jax._util.types import Pytree

_T = TypeVar("_T", bound=Pytree)


def once(compute: Callable[[], _T]) -> _T:
    """Returns the result of `compute`, a pytree of arrays, for use in compiled code.

    XLA for processors fuses arithmetic into each of its uses, so that many uses of a long formula repeat it. It never
    fuses into a branch. Therefore this is a branch that is always taken, which the barrier hides from XLA. GPUs have no
    barrier, so that XLA removes the branch, because a GPU waits for the processor whenever it checks a condition.

    A loop of one round does the same, but it fills and copies each array before: 6 us for 120 x 160 numbers.
    """
    shapes = jax.eval_shape(compute)
    taken = jax.lax.platform_dependent(
        cpu=lambda: jax.lax.optimization_barrier(jnp.bool_(True)), default=lambda: jnp.bool_(True)
    )
    return jax.lax.cond(taken, compute, lambda: jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), shapes))
