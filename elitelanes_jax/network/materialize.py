"""Control over what XLA fuses."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Int, Shaped


@jax.custom_batching.custom_vmap
def materialize(array: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
    """Returns an integer array as it is, and lets XLA compute it once and store it.

    On a CPU, XLA computes a value anew for each of its uses, and where a use is one of its shifts for each tile: a
    program that is longer, slower, and takes longer to compile. What goes into a loop is stored; this one has no round,
    which XLA cannot know.
    """

    def body(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        return jnp.array(False), jnp.where(carry[0], carry[1], 0)

    never = array.reshape(-1)[0] == np.array(jnp.iinfo(array.dtype).max, array.dtype)
    return lax.while_loop(lambda carry: carry[0], body, (never, array))[1]


@materialize.def_vmap
def _(axis_size: int, batched: list[bool], array: Array) -> tuple[Array, bool]:
    return materialize(array), True


def batch_all(axis_size: int, batched: Sequence[bool], arrays: Sequence[Array]) -> list[Array]:
    """Gives all arguments of a batching rule the axis of the batch in front."""
    return [
        array if has_axis else jnp.broadcast_to(array, (axis_size, *array.shape))
        for array, has_axis in zip(arrays, batched, strict=True)
    ]


@jax.custom_batching.custom_vmap
def lookup(values: Shaped[Array, " N"], places: Int[Array, "..."]) -> Shaped[Array, "..."]:
    """Returns the values at places that are all in [0, N).

    Many vectors are looked up as one long vector: XLA puts together the indices of a batch for each value anew.
    """
    return values.at[places.astype(jnp.uint32)].get(mode="promise_in_bounds")


@lookup.def_vmap
def _(axis_size: int, batched: list[bool], values: Array, places: Array) -> tuple[Array, bool]:
    values, places = batch_all(axis_size, batched, (values, places))
    first = np.arange(axis_size, dtype=places.dtype).reshape(-1, *(1,) * (places.ndim - 1)) * values.shape[1]
    return lookup(values.reshape(-1), places + first), True
