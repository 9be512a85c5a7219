"""Runs an optimiser: many seeds and many generations in one compiled call."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Int, Key

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Numeric, Pytree
from elitelanes_jax.network.xla import run_if
from elitelanes_jax.optimizers.base import Info, Optimizer


def seed_keys(seed: int, indices: int | Sequence[int]) -> Key[Array, " K"]:
    """Returns keys ``[K]`` made from a whole number, 0 to 2**32 - 1. Each depends on the number and its index alone.

    `indices` are those of the keys; or their number K, for the first K.
    """
    return _fold_in(np.uint32(seed), np.arange(indices) if isinstance(indices, int) else np.array(indices, int))


@jax.jit
def _fold_in(seed: Array, indices: Array) -> Key[Array, " K"]:
    return jax.vmap(partial(jax.random.fold_in, jax.random.key(seed)))(indices)


def run(optimizer: Optimizer, keys: Key[Array, " S"], generations: int) -> tuple[Pytree, Info]:
    """Runs an optimiser from the start; for `jax.jit`.

    Args:
      optimizer: on one problem.
      keys: ``[S]``, one for each seed. With JAX's default kind of key a seed's result does not depend on other seeds.
      generations: the number of generations, static.

    Returns:
      The states of all seeds, arrays ``[S, ...]``, and an `Info` of arrays ``[generations, S]``.
    """
    if not isinstance(optimizer, Optimizer):
        raise InputError(f"optimizer: expected an Optimizer, got {type(optimizer).__name__}")
    return advance(optimizer, keys, start(optimizer, keys), 1, generations, most=generations)


def start(optimizer: Optimizer, keys: Key[Array, " S"]) -> Pytree:
    """Returns the states of generation 0 for keys ``[S]``, arrays ``[S, ...]``."""
    return jax.vmap(lambda key: optimizer.init(jax.random.fold_in(key, 0)))(keys)


def advance(
    optimizer: Optimizer,
    keys: Key[Array, " S"],
    states: Pytree,
    first: Int[ArrayLike, ""],
    last: Int[ArrayLike, ""],
    *,
    most: int,
) -> tuple[Pytree, Info]:
    """Runs the generations `first` to `last`, both included; the first generation of a run is 1.

    Generation i of a seed depends on ``fold_in(key, i)`` and the state before it alone. Therefore generations 1 to 200
    equal 1 to 100 and then 101 to 200, bit for bit, and a seed's result does not depend on other seeds. `first` and
    `last` may be traced: one compiled call serves every part of every run.

    Returns the states, and an `Info` of arrays ``[most, S]``. Only the first `last` - `first` + 1 rows have a meaning;
    if `last` is less than `first`, no generation is run. `most` is static.
    """

    @partial(jax.jit, inline=True)  # so that it is traced once, for the shapes and for the loop
    def step(states: Pytree, generation: Array) -> tuple[Pytree, Info]:
        def step_one(key: Array, state: Pytree) -> tuple[Pytree, Info]:
            return optimizer.step(jax.random.fold_in(key, generation), state)

        return jax.vmap(step_one)(keys, states)

    shapes = jax.eval_shape(step, states, jnp.int32(0))[1]
    nothing = jax.tree.map(lambda info: jnp.zeros(info.shape, info.dtype), shapes)

    def generation(states: Pytree, index: Numeric) -> tuple[Pytree, Info]:
        return run_if(index <= last, lambda _, carry: step(carry[0], index), (states, nothing))

    return lax.scan(generation, states, first + jnp.arange(most))
