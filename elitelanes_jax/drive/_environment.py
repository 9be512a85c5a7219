"""Environments: pure functions on one state, and steps that begin a new episode by themselves."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import NamedTuple, ParamSpec, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import Check, check_named, instance
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric, Pytree, Tree, Untyped, UserValue
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.sharding import divide_batches

P = ParamSpec("P")
R = TypeVar("R")


def checks_first(**checks: Check) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorates a compiled function with checks of its arguments before the call.

    The results of the checks replace the arguments. In the compiled function arguments are tracers:
    a message would not show what came, and a number of more than 32 bits would have lost its upper
    bits.
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        names = list(signature(function).parameters)

        def check(name: str, value: Untyped) -> Untyped:
            return check_named(name, checks[name], value) if name in checks else value

        @wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            # Too many arguments are passed on, so that Python raises its own error.
            by_position = [check(name, value) for name, value in zip(names, args, strict=False)]
            by_position += args[len(names) :]
            by_name = {name: check(name, value) for name, value in kwargs.items()}
            return function(*by_position, **by_name)

        return call

    return decorate


class EnvironmentParams(Record):
    """The base of the options of environments, which all have a limit of steps."""

    limit: Numeric

    @property
    def max_steps_in_episode(self) -> Numeric:
        """The limit, by the name in Gymnax."""
        return self.limit


class Transition(NamedTuple):
    """The result of a step.

    Attributes:
      observation: the observation of the state.
      state: the next state.
      reward: float32.
      terminated: bool, whether the episode is over.
      truncated: bool, whether the episode was cut off at its limit of steps.
      info: a record of metrics, such as `success`.
      reached: the observation after the action. It differs from `observation` after an automatic
        reset.
    """

    observation: Pytree
    state: Pytree
    reward: Float[Array, ""]
    terminated: Bool[Array, ""]
    truncated: Bool[Array, ""]
    info: Pytree
    reached: Pytree


class Environment(NamedTuple):
    """An environment. `jax.jit` and `jax.vmap` its functions; keys are consumed.

    Attributes:
      reset: (key, params) -> (observation, state), on a level drawn uniformly from
        ``params.levels``.
      reset_to_level: (key, level, params) -> (observation, state). A level is what the method `at`
        of ``params.levels`` returns for an index; without this method, the row of each array.
      step: (key, state, action, params) -> `Transition`. It does not reset; see `auto_reset`.
      observe: (state, params) -> observation.
      actions: the number of discrete actions, or None for real ones.
      action_size: the number of values of a real action, each within -1 to 1; 0 for discrete ones.
      shared: whether ``params.robots`` robots share a state. Then observations, actions, rewards and
        metrics have an axis of robots. All robots terminate or are truncated together.
      restarts: whether steps begin a new episode when one ends, as those of `auto_reset` and
        `auto_replay`. Wrappers refuse such an environment, because they begin episodes themselves.
    """

    reset: Callable[[Key[Array, ""], Pytree], tuple[Pytree, Pytree]]
    reset_to_level: Callable[[Key[Array, ""], Pytree, Pytree], tuple[Pytree, Pytree]]
    step: Callable[[Key[Array, ""], Pytree, Pytree, Pytree], Transition]
    observe: Callable[[Pytree, Pytree], Pytree]
    actions: int | None
    action_size: int = 0
    shared: bool = False
    restarts: bool = False


def check_environment(environment: UserValue) -> None:
    """Raises `InputError` for anything else than an environment, or if its steps begin episodes."""
    if check_named("environment", instance(Environment), environment).restarts:
        got = "one of auto_reset or auto_replay"
        raise InputError("environment", "one that does not begin episodes itself", got)


def draw_level(key: Key[Array, ""], levels: Pytree) -> Pytree:
    """Draws a level uniformly from a batch; the key is consumed."""
    return level_at(levels, randint(random_bits(key, ()), levels.grid.shape[0]))


def level_at(levels: Pytree, index: Array) -> Pytree:
    """Returns the level with an index of a batch: by its method `at`, or else the row of each array."""
    return levels.at(index) if hasattr(levels, "at") else read_at(levels, index)


def read_at(tree: Tree, *index: Array) -> Tree:
    """Returns the elements of a pytree's arrays at an index, one number for each of the first axes."""
    # Arrays of NumPy cannot be read at a traced index.
    return jax.tree.map(lambda part: jnp.asarray(part)[index], tree)


def spl(success: Array, shortest: Array, tiles: Array) -> Float[Array, ""]:
    """Returns success times shortest / tiles, see `RoadNavInfo`."""
    # The divisor is at least `shortest`, because a robot that turns round on a tile may need fewer
    # tiles, and the metric is at most 1. There is a second reason. In a batch of agents that started
    # together `tiles` is one number, and XLA would multiply by its reciprocal, which may have
    # another last bit.
    most = jnp.maximum(jnp.maximum(tiles, shortest), 1)
    return (success.astype(jnp.int32) * shortest / most).astype(jnp.float32)


@name_wrong_arguments
def auto_reset(environment: Environment) -> Environment:
    """Returns the environment with steps that reset at the end of an episode.

    A new episode has a newly drawn level. `reward`, `terminated`, `truncated`, `info` and `reached`
    are those of the step, `observation` and `state` those of the new episode. Raises `InputError`
    for anything else than an environment, and for one that begins episodes itself.
    """
    check_environment(environment)

    @runs_jax
    @divide_batches
    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree) -> Transition:
        return _step_on(environment, environment.reset, key, state, action, params)

    return environment._replace(step=name_wrong_arguments(step), restarts=True)


def _step_on(
    environment: Environment,
    begin: Callable[[Key[Array, ""], Pytree], tuple[Pytree, Pytree]],
    key: Key[Array, ""],
    state: Pytree,
    action: Pytree,
    params: Pytree,
) -> Transition:
    """Makes a step. If the episode ends, the state and the observation are those of a new one.

    `begin` starts an episode, as `Environment.reset` does.
    """
    # Folded in instead of split, so that an unused key costs nothing.
    transition = environment.step(jax.random.fold_in(key, 0), state, action, params)
    # Both states are computed, because under `jax.vmap` a branch would compute both, too.
    _, first = begin(jax.random.fold_in(key, 1), params)
    ended = transition.terminated | transition.truncated
    state = jax.tree.map(lambda new, old: jnp.where(ended, new, old), first, transition.state)
    # Observed again instead of chosen, so that XLA drops an unused `reached`.
    return transition._replace(observation=environment.observe(state, params), state=state)


class ReplayState(NamedTuple):
    """The state of an environment that begins its level again.

    Attributes:
      state: the state of the environment.
      level: the level that every episode begins on.
    """

    state: Pytree
    level: Pytree


@name_wrong_arguments
def auto_replay(environment: Environment) -> Environment:
    """Returns the environment with steps that begin the same level again at the end of an episode.

    A curriculum that chooses levels can reset N environments to N levels, and knows which steps
    belong to which level. Fields of a step are those of `auto_reset`. A state is a record of
    `state`, that of the environment, and `level`, the one that every episode begins on. Raises
    `InputError` for anything else than an environment, and for one that begins episodes itself.
    """
    check_environment(environment)

    def reset(key: Key[Array, ""], params: Pytree) -> tuple[Pytree, ReplayState]:
        if not hasattr(params, "levels"):
            got = quote(params)
            raise InputError("params", "options with levels", got)
        return reset_to_level(key, draw_level(key, params.levels), params)

    def reset_to_level(
        key: Key[Array, ""], level: Pytree, params: Pytree
    ) -> tuple[Pytree, ReplayState]:
        # JAX may read an array of NumPy after the call, so the copy comes first.
        level = jax.tree.map(frozen_copy, level)
        seen, state = environment.reset_to_level(key, level, params)
        return seen, ReplayState(state, level)

    @runs_jax
    @divide_batches
    def step(key: Key[Array, ""], state: ReplayState, action: Pytree, params: Pytree) -> Transition:
        def begin(key: Key[Array, ""], params: Pytree) -> tuple[Pytree, Pytree]:
            return environment.reset_to_level(key, state.level, params)

        transition = _step_on(environment, begin, key, state.state, action, params)
        return transition._replace(state=ReplayState(transition.state, state.level))

    def observe(state: ReplayState, params: Pytree) -> Pytree:
        return environment.observe(state.state, params)

    return environment._replace(
        reset=name_wrong_arguments(reset),
        reset_to_level=name_wrong_arguments(reset_to_level),
        step=name_wrong_arguments(step),
        observe=name_wrong_arguments(observe),
        restarts=True,
    )
