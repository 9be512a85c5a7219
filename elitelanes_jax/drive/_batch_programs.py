"""The compiled programs of a batch: a reset and a step of all its environments.

Each environment has a stream of random keys. Its next step or reset takes the next key of the
stream.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, UInt32
from numpy.typing import NDArray

from elitelanes_jax._util.types import Pytree, Tree
from elitelanes_jax.drive._environment import Environment, Transition, level_at
from elitelanes_jax.drive._flat import action_shape, observation_shape
from elitelanes_jax.drive._host_arrays import Layout, Packed
from elitelanes_jax.drive._library_types import Params
from elitelanes_jax.network.bits import THREEFRY, fold_in

NEXT_STEP, SAME_STEP, DISABLED = "NextStep", "SameStep", "Disabled"
"""Gymnasium's names of the ways to reset after the end of an episode.

A reset replaces the next step, is in the same step, or does not happen.
"""


class Carry(NamedTuple):
    """The state of a batch between two steps.

    Attributes:
      streams: the two words of a key, and the number of keys of its stream that are used.
      state: the states, packed.
      over: whether the episode has ended.
    """

    streams: UInt32[Array, "N 3"]
    state: Packed
    over: Bool[Array, " N"]


@partial(jax.jit, static_argnames="environment", donate_argnames="carry")
def reset_batch(
    carry: Carry,
    chosen: Array,
    levels: Array | None,
    params: Params,
    *,
    environment: Environment,
) -> tuple[Carry, Array]:
    """Starts new episodes in the chosen environments.

    `levels` has the index of the level of each environment, -1 where it is drawn; None if all are.
    Returns the carry and the observations of all environments.
    """
    state_shapes, _ = shapes_of(environment, params, len(chosen))
    layout = Layout.of(state_shapes)
    keys, later_streams = _next_keys(carry.streams)
    states = _renew(environment, chosen, keys, layout.unpack(carry.state), params, levels)
    # A key is used up only where an episode begins.
    streams = jnp.where(chosen[:, None], later_streams, carry.streams)
    observation = jax.vmap(environment.observe, (0, None))(states, params)
    # The barrier gives the observation memory of its own, see `step_batch`.
    carry = Carry(streams, layout.pack(states), carry.over & ~chosen)
    return carry, jax.lax.optimization_barrier(observation)


@partial(jax.jit, static_argnames=("environment", "mode"), donate_argnames="carry")
def step_batch(
    carry: Carry, actions: Array, params: Params, *, environment: Environment, mode: str
) -> tuple[Carry, tuple[Array, Array | None], Packed]:
    """Makes a step of all environments.

    Returns the carry, the observations as `Outcome` has them, and the packed result.
    """
    observe = jax.vmap(environment.observe, (0, None))
    step = jax.vmap(environment.step, (0, 0, 0, None))
    state_shapes, _ = shapes_of(environment, params, len(actions))
    layout = Layout.of(state_shapes)
    keys, streams = _next_keys(carry.streams)
    transition = step(keys, layout.unpack(carry.state), actions, params)
    states = transition.state
    result = _result(transition)
    over = transition.terminated | transition.truncated
    if mode == NEXT_STEP:
        # An environment whose episode ended in the last step is reset instead of this step.
        # The reset uses the key of the step, because the step's result is dropped there.
        was_over = carry.over
        states = _renew(environment, was_over, keys, states, params)
        result = _choose(was_over, jax.tree.map(jnp.zeros_like, result), result)
        over &= ~was_over
    if mode == SAME_STEP:
        # An environment that is reset uses two keys, as one that is reset by its caller.
        reset_keys, later_streams = _next_keys(streams)
        states = _renew(environment, over, reset_keys, states, params)
        streams = jnp.where(over[:, None], later_streams, streams)
    observation = observe(states, params)
    reached = None
    if mode == SAME_STEP:
        # Unless an episode has ended, the pictures of a camera are rendered once.
        reached = jax.lax.cond(
            over.any(), lambda: observe(transition.state, params), lambda: observation
        )
    # `writable` needs arrays of their own. Without the barrier JAX may return an array of the
    # carry twice.
    observations = jax.lax.optimization_barrier((observation, reached))
    carry = Carry(streams, layout.pack(states), over)
    return carry, observations, Layout.of(result).pack(result)


def _renew(
    environment: Environment,
    chosen: Array,
    keys: Array,
    state: Pytree,
    params: Params,
    levels: Array | None = None,
) -> Pytree:
    """Returns the states of new episodes for the chosen environments.

    The states of all other environments are returned as they are. `levels` are those of
    `reset_batch`.
    """

    def renew() -> Pytree:
        _, first = jax.vmap(environment.reset, (0, None))(keys, params)
        if levels is not None:
            named = jax.vmap(level_at, (None, 0))(params.levels, jnp.maximum(levels, 0))
            _, on_named = jax.vmap(environment.reset_to_level, (0, 0, None))(keys, named, params)
            first = _choose(levels >= 0, on_named, first)
        return _choose(chosen, first, state)

    # A step of 256 `LaneDrive` takes a fifth less time if no episode begins.
    return jax.lax.cond(chosen.any(), renew, lambda: state)


def _choose(condition: Bool[Array, " N"], chosen: Tree, others: Tree) -> Tree:
    """Returns the first pytree's rows where the condition is true, and the others elsewhere."""
    return jax.tree.map(
        lambda one, other: jax.vmap(jnp.where)(condition, one, other), chosen, others
    )


def _result(transition: Transition) -> Pytree:
    return transition.reward, transition.terminated, transition.truncated, transition.info


def shapes_of(environment: Environment, params: Params, envs: int) -> tuple[Pytree, Pytree]:
    """Returns the shapes and dtypes of the states, and of what `_result` returns."""
    action = action_shape(environment, params)

    def step(key: Array) -> tuple[Pytree, Pytree]:
        _, state = environment.reset(key, params)
        no_action = jnp.zeros(action.shape, action.dtype)
        return state, _result(environment.step(key, state, no_action, params))

    # Nothing is computed here: `eval_shape` only traces.
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), envs))
    return jax.eval_shape(jax.vmap(step), keys)


def forms_of(environment: Environment, params: Params, envs: int) -> Pytree:
    """Returns what must not change with the options: a structure, and its shapes and dtypes."""
    observation = observation_shape(environment, params)
    leaves, structure = jax.tree.flatten((observation, shapes_of(environment, params, envs)))
    return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]


def to_streams(seeds: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """Returns streams ``[N, 3]`` that begin with the keys of the seeds.

    For seeds below 2**32 the keys are those of `seed_key`.
    """
    # The two words of a key in the order of JAX: the upper one first.
    upper_word = seeds >> np.uint64(32)
    lower_word = seeds & np.uint64(0xFFFFFFFF)
    used_keys = np.zeros_like(seeds)
    return np.stack([upper_word, lower_word, used_keys], axis=-1).astype(np.uint32)


def _next_keys(streams: Array) -> tuple[Array, Array]:
    """Returns the next key of each stream, and the streams after it."""
    return jax.vmap(_next_key)(streams), streams.at[:, 2].add(1)


def _next_key(stream: Array) -> Array:
    # A key depends on the stream's seed and on how many keys are used, so a stream is three words.
    key = jax.random.wrap_key_data(stream[:2], impl=THREEFRY)
    used_keys = stream[2].astype(jnp.int32)
    return fold_in(key, used_keys)
