"""Values that are computed once, where XLA would compute them again for all that reads them."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

from elitelanes_jax._util.types import Pytree

_T = TypeVar("_T", bound=Pytree)


def once(compute: Callable[[], _T]) -> _T:
    """Returns what `compute` returns, a pytree of arrays, for use in compiled code.

    XLA for processors fuses arithmetic into each of its readers, so that many readers of long formulas repeat them. It
    never fuses into a loop. So this is a loop, of one turn, which the barrier keeps it from unrolling.
    """
    empty = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), jax.eval_shape(compute))
    turns = jax.lax.optimization_barrier(jnp.int32(1))
    _, computed = jax.lax.while_loop(
        lambda carry: carry[0] < turns, lambda carry: (carry[0] + 1, compute()), (jnp.int32(0), empty)
    )
    return computed
