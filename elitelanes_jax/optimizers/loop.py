"""Running an optimiser: many seeds and generations in one compiled call."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, ArrayLike, Int, Key

from elitelanes_jax._util.types import Numeric, Pytree
from elitelanes_jax.optimizers.base import Info, Optimizer


def seed_keys(seed: int, count: int) -> Key[Array, " count"]:
    """Makes keys ``[count]`` from a whole number, each the same however many there are."""
    key = jax.random.key(seed)
    return jax.vmap(lambda number: jax.random.fold_in(key, number))(np.arange(count))


def run(optimizer: Optimizer, keys: Key[Array, " S"], generations: int) -> tuple[Pytree, Info]:
    """Runs an optimiser from the start; `jax.jit` it, and see `advance` for runs in parts.

    Args:
      optimizer: on one problem.
      keys: ``[S]``, one a seed. With JAX's default kind of key a seed's result is the same alone and among others.
      generations: how many, static.

    Returns:
      The states with the seeds in front, and an `Info` of arrays ``[generations, S]``.
    """
    return advance(optimizer, keys, start(optimizer, keys), 1, generations, most=generations)


def start(optimizer: Optimizer, keys: Key[Array, " S"]) -> Pytree:
    """Makes the states of generation 0, one for each of the keys ``[S]``: seeds in front."""
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
    """Runs the generations `first` to `last`, counted from 1, both included.

    Generation i of a seed depends on ``fold_in(key, i)`` and the state before it, and on nothing else. So going from 1
    to 200 is going from 1 to 100 and then from 101 to 200, bit for bit, and a seed's result is the same alone or among
    a thousand. `first` and `last` may be traced: one compiled call serves every part of every run.

    Args:
      optimizer: on one problem.
      keys: ``[S]``, the same at every part of a run.
      states: of generation `first` - 1, with the seeds in front.
      first: the first generation to run.
      last: the last one; under `first` nothing is run.
      most: the most generations that the call can run, static.

    Returns:
      The states, and an `Info` of arrays ``[most, S]`` of which the first `last` - `first` + 1 rows count.
    """

    @partial(jax.jit, inline=True)  # traced once, for the shapes as for the loop
    def step(states: Pytree, generation: Array) -> tuple[Pytree, Info]:
        def step_one(key: Array, state: Pytree) -> tuple[Pytree, Info]:
            return optimizer.step(jax.random.fold_in(key, generation), state)

        return jax.vmap(step_one)(keys, states)

    shapes = jax.eval_shape(step, states, jnp.int32(0))[1]
    nothing = jax.tree.map(lambda info: jnp.zeros(info.shape, info.dtype), shapes)

    def generation(states: Pytree, number: Numeric) -> tuple[Pytree, Info]:
        def once(carry: tuple[Pytree, Info, Array]) -> tuple[Pytree, Info, Array]:
            return *step(carry[0], number), jnp.array(False)

        # A loop of one round or none: `lax.cond` would copy the states of a generation that is not run.
        states, info, _ = lax.while_loop(lambda carry: carry[2], once, (states, nothing, number <= last))
        return states, info

    return lax.scan(generation, states, first + jnp.arange(most))
