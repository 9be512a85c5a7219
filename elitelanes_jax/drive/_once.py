"""Values that XLA computes once, instead of again for each use."""

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp

from elitelanes_jax._util.types import Pytree

_T = TypeVar("_T", bound=Pytree)


def once(compute: Callable[[], _T]) -> _T:
    """Returns the result of `compute`, a pytree of arrays, for use in compiled code.

    XLA for processors fuses arithmetic into each of its uses, so that many uses of a long formula repeat it. It never
    fuses into a loop. Therefore this is a loop of one round, which the barrier keeps XLA from unrolling. GPUs have no
    barrier, so that XLA unrolls the loop, because a GPU waits for the processor whenever a loop checks its condition.
    """
    empty = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(compute))
    one = partial(jnp.int32, 1)
    turns = jax.lax.platform_dependent(cpu=lambda: jax.lax.optimization_barrier(one()), default=one)
    _, computed = jax.lax.while_loop(
        lambda carry: carry[0] < turns, lambda carry: (carry[0] + 1, compute()), (jnp.int32(0), empty)
    )
    return computed
