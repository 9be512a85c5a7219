"""Running an optimiser: many seeds and generations in one compiled call."""

import jax
import jax.numpy as jnp
from chex import Array, ArrayTree, PRNGKey
from jax import lax

from elitelanes_jax.optimizers.base import Info, Optimizer

__all__ = ["advance", "start"]


def start(optimizer: Optimizer, keys: PRNGKey) -> ArrayTree:
    """The states of generation 0, one for each of the keys ``[S]``: seeds in front."""
    return jax.vmap(lambda key: optimizer.init(jax.random.fold_in(key, 0)))(keys)


def advance(
    optimizer: Optimizer, keys: PRNGKey, states: ArrayTree, first: Array | int, last: Array | int, *, most: int
) -> tuple[ArrayTree, Info]:
    """The states after the generations `first` to `last`, counted from 1, both included.

    Generation i of a seed depends on ``fold_in(key, i)`` and the state before it, and on nothing else. So
    going from 1 to 200 is going from 1 to 100 and then from 101 to 200, bit for bit, and a seed's result is
    the same alone or among a thousand. `first` and `last` may be traced: one compiled call serves every part
    of every run.

    Args:
      optimizer: on one problem.
      keys: ``[S]``, the same at every part of a run.
      states: of generation `first` - 1, with the seeds in front.
      first: the first generation to run.
      last: the last one; under `first` there is nothing to do.
      most: how many generations the call can run at most, static.

    Returns:
      The states, and an `Info` of arrays ``[most, S]`` of which the first `last` - `first` + 1 rows count.
    """

    def step(states: ArrayTree, generation: Array) -> tuple[ArrayTree, Info]:
        def one(key: PRNGKey, state: ArrayTree) -> tuple[ArrayTree, Info]:
            return optimizer.step(jax.random.fold_in(key, generation), state)

        return jax.vmap(one)(keys, states)

    nothing = jax.tree.map(lambda info: jnp.zeros(info.shape, info.dtype), jax.eval_shape(step, states, 0)[1])

    def generation(states: ArrayTree, number: Array) -> tuple[ArrayTree, Info]:
        def once(carry: tuple[ArrayTree, Info, Array]) -> tuple[ArrayTree, Info, Array]:
            return *step(carry[0], number), jnp.array(False)

        # A loop of one round or none: `lax.cond` would copy the states of a generation that is not run.
        states, info, _ = lax.while_loop(lambda carry: carry[2], once, (states, nothing, number <= last))
        return states, info

    return lax.scan(generation, states, first + jnp.arange(most))
