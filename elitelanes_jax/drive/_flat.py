"""Observations as one array each, and the spaces of actions and observations."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import Pytree, Untyped
from elitelanes_jax.drive._environment import Environment, Transition, check_environment
from elitelanes_jax.drive._library_types import Params


@name_wrong_arguments
def flatten(observation: Pytree) -> Float[Array, " N"] | UInt8[Array, "rows columns 3"]:
    """Returns an observation as one float32 vector, its parts in order.

    A tile code is four bits, N, E, S, W. A camera's picture is returned unchanged. Raises
    `InputError` for an observation that is no pytree of arrays of numbers.
    """
    leaves = jax.tree.leaves(observation)
    if not leaves or not all(map(_has_numbers, leaves)):
        raise InputError("observation", "arrays of numbers", quote(observation))
    arrays = [jnp.asarray(leaf) for leaf in leaves]
    if len(arrays) == 1 and arrays[0].dtype == jnp.uint8:
        return arrays[0]
    return jnp.concatenate([_to_vector(array) for array in arrays])


def _to_vector(array: Array) -> Float[Array, " N"]:
    """Returns the numbers of an array, or the four bits of each tile code, in one axis."""
    if array.dtype == jnp.int8:
        # Codes are the only parts of observations with this dtype.
        bits = np.array([8, 4, 2, 1], np.int8)
        # With as many axes as the codes and their bits, see `xla.align`.
        bits = np.expand_dims(bits, tuple(range(array.ndim)))
        array = array[..., None] & bits > 0
    return array.astype(jnp.float32).reshape(-1)


def _has_numbers(leaf: Pytree) -> bool:
    if not hasattr(leaf, "dtype"):
        return False
    return jnp.issubdtype(leaf.dtype, jnp.bool_) or jnp.issubdtype(leaf.dtype, jnp.number)


def flattened(environment: Environment, *, channels_first: bool = False) -> Environment:
    """Returns the environment with observations as `flatten` makes them.

    The info of a step is a dictionary. Pictures are uint8 ``[rows, columns, 3]``, or
    ``[3, rows, columns]`` with `channels_first`. Raises `InputError` for anything but an
    environment with actions, and for one that begins episodes itself.
    """
    check_environment(environment)
    if environment.actions is None and environment.action_size < 1:
        got = environment.action_size
        raise InputError("environment", "actions, or action_size of 1 or more", got)
    return _flattened(environment, channels_first=channels_first)


# Batches of one environment share compiled functions.
@lru_cache(maxsize=32)
def _flattened(environment: Environment, *, channels_first: bool) -> Environment:
    """Does what `flattened` does, for an environment that is checked."""

    def to_array(observation: Pytree) -> Array:
        array = (jax.vmap(flatten) if environment.shared else flatten)(observation)
        if channels_first and array.dtype == jnp.uint8:
            return jnp.moveaxis(array, -1, 0)
        return array

    def reset(key: Key[Array, ""], params: Params) -> tuple[Array, Pytree]:
        observation, state = environment.reset(key, params)
        return to_array(observation), state

    def reset_to_level(key: Key[Array, ""], level: Pytree, params: Params) -> tuple[Array, Pytree]:
        observation, state = environment.reset_to_level(key, level, params)
        return to_array(observation), state

    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Params) -> Transition:
        transition = environment.step(key, state, action, params)
        # An environment may lack some metrics. These are None, and are left out.
        info = transition.info._asdict()
        metrics = {name: metric for name, metric in info.items() if metric is not None}
        return transition._replace(
            observation=to_array(transition.observation),
            reached=to_array(transition.reached),
            info=metrics,
        )

    def observe(state: Pytree, params: Params) -> Array:
        return to_array(environment.observe(state, params))

    return environment._replace(
        reset=reset, reset_to_level=reset_to_level, step=step, observe=observe
    )


def action_space(environment: Environment, spaces: Untyped) -> Untyped:
    """Returns the space of actions of an environment, from a module with `Discrete` and `Box`."""
    if environment.actions is not None:
        return spaces.Discrete(environment.actions)
    return spaces.Box(-1.0, 1.0, (environment.action_size,))


def observation_space(environment: Environment, params: Params, spaces: Untyped) -> Untyped:
    """Returns the space of observations of a flattened environment, from a module with `Box`.

    It is that of one robot.
    """
    observation = observation_shape(environment, params)
    if environment.shared:
        observation = jax.ShapeDtypeStruct(observation.shape[1:], observation.dtype)
    if observation.dtype == jnp.uint8:
        return spaces.Box(0, 255, observation.shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, observation.shape)


def robots_of(environment: Environment, params: Params) -> int:
    """Returns the number of robots that share a state; checks that the options have it."""
    if not environment.shared:
        return 1
    if not hasattr(params, "robots"):
        expected = "options with robots, such as RoadTrafficParams"
        raise InputError("params", expected, type(params).__name__)
    robots: int = params.robots
    return robots


def observation_shape(environment: Environment, params: Params) -> jax.ShapeDtypeStruct:
    observation, _ = jax.eval_shape(lambda: environment.reset(jax.random.key(0), params))
    return observation


def action_shape(environment: Environment, params: Pytree) -> jax.ShapeDtypeStruct:
    """Returns the shape and dtype of the action of one environment."""
    robots = (params.robots,) if environment.shared else ()
    if environment.actions is not None:
        return jax.ShapeDtypeStruct(robots, jnp.int32)
    return jax.ShapeDtypeStruct((*robots, environment.action_size), jnp.float32)
