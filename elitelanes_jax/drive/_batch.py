"""Environments that step together, with arrays of NumPy: the core of all wrappers.

Each environment has a stream of random keys. Its next step or reset takes the next key of the
stream. Therefore environment i of a batch does the same, bit for bit, as an environment alone with
the seed of environment i.

To its callers, a batch of environments with R robots each has a row for each robot. An environment
takes the seed and the level that its first robot gets.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from operator import itemgetter
from typing import NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key, UInt8, UInt32
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, is_whole, none_or, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.records import Record, check_names
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Pytree, Untyped, UserValue
from elitelanes_jax.drive._environment import Environment, Transition, level_at
from elitelanes_jax.network.bits import THREEFRY, fold_in

NEXT_STEP, SAME_STEP, DISABLED = "NextStep", "SameStep", "Disabled"
"""Gymnasium's names of the ways to reset after the end of an episode.

A reset replaces the next step, is in the same step, or does not happen.
"""

# The number of keys that a seed can name.
_SEEDS = 2**64


@name_wrong_arguments
def flatten(observation: Pytree) -> Float[Array, " N"] | UInt8[Array, "rows columns 3"]:
    """Returns an observation as one float32 vector, its parts in order.

    A tile code is four bits, N, E, S, W. A camera's picture is returned unchanged. Raises
    `InputError` for an observation that is no pytree of arrays of numbers.
    """
    leaves = jax.tree.leaves(observation)
    if not leaves or not all(map(_has_numbers, leaves)):
        raise InputError("observation", "arrays of numbers", shorten(repr(observation)))
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
    environment with actions.
    """
    check_named("environment", instance(Environment), environment)
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

    def reset(key: Key[Array, ""], params: Pytree) -> tuple[Array, Pytree]:
        observation, state = environment.reset(key, params)
        return to_array(observation), state

    def reset_to_level(key: Key[Array, ""], level: Pytree, params: Pytree) -> tuple[Array, Pytree]:
        observation, state = environment.reset_to_level(key, level, params)
        return to_array(observation), state

    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree) -> Transition:
        transition = environment.step(key, state, action, params)
        # Metrics that the environment does not have are None. No array stands for them.
        info = transition.info._asdict()
        metrics = {name: metric for name, metric in info.items() if metric is not None}
        return transition._replace(
            observation=to_array(transition.observation),
            reached=to_array(transition.reached),
            info=metrics,
        )

    def observe(state: Pytree, params: Pytree) -> Array:
        return to_array(environment.observe(state, params))

    return Environment(
        reset=reset,
        reset_to_level=reset_to_level,
        step=step,
        observe=observe,
        actions=environment.actions,
        action_size=environment.action_size,
        shared=environment.shared,
    )


def check_module(params: Pytree, module: Untyped, name: str, argument: str, needed: str) -> None:
    """Checks the options of an environment, and that a module has what is needed.

    `needed` is the name of a class or module, such as ``vector.VectorEnv``.
    """
    attribute = module
    for attribute_name in needed.split("."):
        attribute = getattr(attribute, attribute_name, None)
    if attribute is None:
        raise InputError(argument, f"the module {name}", shorten(repr(module)))
    if not isinstance(params, Record):
        expected = "RoadNavParams, LaneDriveParams or RoadTrafficParams"
        raise InputError("params", expected, shorten(repr(params)))


def check_render(render: UserValue) -> None:
    """Checks the function that draws a state, or None."""
    if render is not None and not callable(render):
        raise InputError(
            "render",
            "a function that takes a state and returns a picture, or None",
            shorten(repr(render)),
        )


def picture_of(render: Callable[[Pytree], UserValue], state: Pytree) -> NDArray[np.uint8]:
    """Returns the picture that a function draws of a state.

    Raises `InputError` if it draws none.
    """
    picture = np.asarray(render(state))
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        got = f"{picture.dtype} {list(picture.shape)}"
        raise InputError("render", "a function that returns a picture uint8 [H, W, 3]", got)
    return picture


def action_space(environment: Environment, spaces: Untyped) -> Untyped:
    """Returns the space of actions of an environment, from a module with `Discrete` and `Box`."""
    if environment.actions is not None:
        return spaces.Discrete(environment.actions)
    return spaces.Box(-1.0, 1.0, (environment.action_size,))


def observation_space(environment: Environment, params: Pytree, spaces: Untyped) -> Untyped:
    """Returns the space of observations of a flattened environment, from a module with `Box`.

    It is that of one robot.
    """
    observation = _observation_shape(environment, params)
    if environment.shared:
        observation = jax.ShapeDtypeStruct(observation.shape[1:], observation.dtype)
    if observation.dtype == jnp.uint8:
        return spaces.Box(0, 255, observation.shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, observation.shape)


def robots_of(environment: Environment, params: Pytree) -> int:
    """Returns the number of robots that share a state; checks that the options have it."""
    if not environment.shared:
        return 1
    if not hasattr(params, "robots"):
        expected = "options with robots, such as RoadTrafficParams"
        raise InputError("params", expected, type(params).__name__)
    robots: int = params.robots
    return robots


def _observation_shape(environment: Environment, params: Pytree) -> jax.ShapeDtypeStruct:
    observation, _ = jax.eval_shape(lambda: environment.reset(jax.random.key(0), params))
    return observation


def read_options(options: UserValue, *known: str) -> Mapping[str, UserValue]:
    """Returns the options of a reset, a dictionary with some of the known names, or None."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise InputError("options", "a dictionary", shorten(repr(options)))
    check_names(map(str, options), known)
    return options


class Outcome(NamedTuple):
    """What a step of a batch returns, as arrays of NumPy that the caller may write to.

    There are N rows: one for each environment, or for each robot of each environment.

    Attributes:
      observation: float32 ``[N, size]`` or uint8 pictures; where an episode was reset, the first of
        the next one.
      reward: float32 ``[N]``.
      terminated: bool ``[N]``.
      truncated: bool ``[N]``.
      metrics: the metrics of the info by name, each ``[N]``; 0 for an environment that was reset
        instead of a step.
      reached: the observation after the action, before a reset in the same step.
    """

    observation: np.ndarray
    reward: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    metrics: dict[str, np.ndarray]
    reached: np.ndarray


_Packed = tuple[dict[str, AnyArray], list[AnyArray]]


class _Carry(NamedTuple):
    """The state of a batch between two steps.

    Attributes:
      streams: the two words of a key, and the number of keys of its stream that are used.
      state: the states, packed.
      over: whether the episode has ended.
    """

    streams: UInt32[Array, "N 3"]
    state: _Packed
    over: Bool[Array, " N"]


class Batch:
    """A batch of environments.

    Two calls make a step: `send` starts it, and `receive` waits for its outcome.
    """

    @runs_jax
    def __init__(
        self,
        environment: Environment,
        params: Pytree,
        envs: int,
        mode: str,
        *,
        channels_first: bool = False,
    ) -> None:
        """Makes `envs` environments; see `flattened` for `channels_first`.

        Raises:
          InputError: for another number than 1 or more, anything but an environment, or arrays in
            the options.
        """
        self._count = check_named("envs", whole(1), envs)
        self.environment = flattened(environment, channels_first=channels_first)
        self.params = params
        self.robots = robots_of(environment, params)
        # The rows that callers see.
        self.envs = self._count * self.robots
        # Puts the numbers on the device once, because each would be transferred in every step.
        self._device_params = jax.device_put(params)
        self._action = _action_shape(self.environment, params)
        self._mode = mode
        # The environments that have been reset.
        self._begun = np.zeros(self._count, bool)
        # XLA simplifies a batch of one row to other arithmetic, with other last bits. Therefore
        # there are at least two.
        self._rows = max(self._count, 2)
        states, result = _shapes(self.environment, self._device_params, self._rows)
        self._states = _Layout.of(states)
        reward, terminated, truncated, _ = result
        reward_shape = (self._rows, self.robots) if environment.shared else (self._rows,)
        if reward.shape != reward_shape or any(
            leaf.shape != (self._rows,) for leaf in (terminated, truncated)
        ):
            raise InputError(
                "params", "numbers for all environments", "arrays, which only jax.vmap maps over"
            )
        self._result = _Layout.of(result)
        # Without seeds each batch is different, as in Gymnasium.
        random_seeds = np.random.default_rng().integers(_SEEDS, size=self._rows, dtype=np.uint64)
        blank_states = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), states)
        self._carry = _Carry(
            streams=jnp.asarray(_to_streams(random_seeds)),
            state=self._states.pack(blank_states),
            over=jnp.zeros(self._rows, bool),
        )

    @runs_jax
    def replace_params(self, params: Pytree) -> None:
        """Replaces the options.

        The next step uses them. An episode that has begun stays on its level, and later resets
        draw from the new levels. But the state of robots that share a town is only valid with its
        levels and slots. If these are replaced, all environments need a reset.

        Raises:
          InputError: for another type, or if a state or an observation would have another shape.
        """
        check_named("params", instance(type(self.params)), params)
        device_params = jax.device_put(params)
        if _forms(self.environment, device_params, self._rows) != _forms(
            self.environment, self._device_params, self._rows
        ):
            raise InputError(
                "params",
                "maps of the same size, and the same number of robots"
                if self.environment.shared
                else (
                    "maps of the same size, the same camera, and objects only if the former levels "
                    "have them"
                ),
                "other shapes of states or observations",
                "make a second environment",
            )
        if self.environment.shared and not _share_places(params, self.params):
            self._begun = np.zeros_like(self._begun)
        self.params, self._device_params = params, device_params

    @runs_jax
    def reset(
        self,
        seeds: Sequence[UserValue] | None = None,
        chosen: NDArray[np.bool_] | None = None,
        levels: Sequence[UserValue] | None = None,
    ) -> np.ndarray:
        """Starts episodes in the chosen environments, by default in all.

        Returns the observations of all rows.

        Args:
          seeds: the seed of each row, or None to go on with its keys. At first the keys are random.
          chosen: bool ``[N]``, the same for all robots of an environment.
          levels: the index of the level of each row in ``params.levels``, or None where it is drawn.

        Raises:
          InputError: for seeds or levels out of range, or fewer or more of them.
        """
        indices = self._check_levels(levels)
        chosen = np.ones(self._count, bool) if chosen is None else self._check_chosen(chosen)
        if seeds is not None:
            self._seed(seeds, chosen)
        # A single environment has two rows, which both get its values.
        chosen_rows = np.resize(chosen, self._rows)
        self._carry, observation = _reset(
            self._carry, chosen_rows, indices, self._device_params, environment=self.environment
        )
        self._begun = self._begun | chosen
        return self._to_rows(_writable(observation)[: self._count])

    def _to_rows(self, array: np.ndarray) -> np.ndarray:
        """Returns values of environments as values of rows.

        The values of robots are the second axis. A value of a whole environment is repeated.
        """
        if not self.environment.shared:
            return array
        if array.ndim == 1:
            return np.repeat(array, self.robots)
        return array.reshape(-1, *array.shape[2:])

    def _check_chosen(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Returns which environments are chosen, from the rows."""
        by_robot = chosen.reshape(self._count, self.robots)
        if (by_robot != by_robot[:, :1]).any():
            expected = f"the same for all {self.robots} robots of an environment"
            raise InputError("reset_mask", expected, shorten(repr(chosen)))
        return by_robot[:, 0]

    def _check_levels(self, levels: Sequence[UserValue] | None) -> NDArray[np.int32] | None:
        """Returns the index of the level of each row, -1 where it is drawn; None if all are."""
        if levels is None or all(level is None for level in levels):
            return None
        if len(levels) != self.envs:
            expected = f"the index of a level, or {self.envs} of them"
            raise InputError("level", expected, shorten(repr(levels)))
        last = len(self.params.levels.grid) - 1
        check = none_or(whole(0, last))
        checked = [check_named("level", check, level) for level in levels]
        indices = [-1 if level is None else level for level in checked[:: self.robots]]
        return np.resize(np.array(indices, np.int32), self._rows)

    def _seed(self, seeds: Sequence[UserValue], chosen: NDArray[np.bool_]) -> None:
        """Starts the streams of keys of the chosen environments that have a seed."""
        is_list = hasattr(seeds, "__len__") and getattr(seeds, "ndim", 1) == 1
        if not is_list or len(seeds) != self.envs:
            expected = f"a whole number, or {self.envs} of them"
            raise InputError("seed", expected, shorten(repr(seeds)))
        indices = []
        numbers = []
        for index, seed in enumerate(seeds[:: self.robots]):
            if seed is None or not chosen[index]:
                continue
            if not is_whole(seed) or not 0 <= seed < _SEEDS:
                raise InputError("seed", f"a whole number, 0 to {_SEEDS - 1}", repr(seed))
            indices.append(index)
            numbers.append(seed)
        # NumPy's view of an array of JAX is read-only, so this is a copy.
        streams = np.array(self._carry.streams)
        streams[indices] = _to_streams(np.array(numbers, np.uint64))
        self._carry = self._carry._replace(streams=jnp.asarray(streams))

    @runs_jax
    def send(self, actions: UserValue) -> None:
        """Starts a step with whole numbers ``[N]``, or real ones ``[N, action_size]``."""
        self._check_begun("step")
        array = self._check_actions(actions)
        array = array.reshape(self._count, *self._action.shape)
        if self._count < self._rows:
            array = np.repeat(array, self._rows, axis=0)
        self._carry, self._observations, self._packed_result = _step(
            self._carry,
            array,
            self._device_params,
            environment=self.environment,
            mode=self._mode,
        )

    @runs_jax
    def receive(self) -> Outcome:
        """Waits for the outcome of the step that was sent."""
        observation = _writable(self._observations[0])
        reached = observation
        if self._observations[1] is not None:
            reached = _writable(self._observations[1])
        stacks, others = self._packed_result
        # The caller may write to the results, so they are copied, a stack at a time.
        copied_stacks = {dtype: np.array(stack) for dtype, stack in stacks.items()}
        copied_others = [np.array(array) for array in others]
        reward, terminated, truncated, metrics = self._result.unpack((copied_stacks, copied_others))
        outcome = Outcome(observation, reward, terminated, truncated, metrics, reached)
        if self._count < self._rows:
            # The second row is there only for XLA.
            outcome = jax.tree.map(lambda array: array[:1], outcome)
        return jax.tree.map(self._to_rows, outcome)

    def step(self, actions: UserValue) -> Outcome:
        """Makes a step; see `send` and `receive`."""
        self.send(actions)
        return self.receive()

    @runs_jax
    def states(self, name: str) -> list[Pytree]:
        """Returns the state of each environment, as arrays of NumPy.

        Before a reset, an error says that `name` needs it.
        """
        self._check_begun(name)
        states = self._states.unpack(jax.device_get(self._carry.state))
        return [jax.tree.map(itemgetter(index), states) for index in range(self._count)]

    def spaces(self, spaces: Untyped) -> tuple[Untyped, Untyped]:
        """Returns the spaces of the actions and of the observations of one row.

        `spaces` is a module of spaces.
        """
        actions = action_space(self.environment, spaces)
        observations = observation_space(self.environment, self._device_params, spaces)
        return actions, observations

    def _check_begun(self, name: str) -> None:
        if self._begun.all():
            return
        of_whom = ""
        if self._begun.any():
            of_whom = f" of environments {np.flatnonzero(~self._begun).tolist()}"
        hint = "also after other levels or slots" if self.environment.shared else ""
        raise InputError(name, f"a reset{of_whom} before the first {name}", "none", hint)

    def _check_actions(self, actions: UserValue) -> np.ndarray:
        """Returns actions as an array of one dtype, so that JAX compiles one program."""
        array = read_actions(actions)
        action = self._action
        shape = (
            (self.envs, *action.shape[1:])
            if self.environment.shared
            else (self.envs, *action.shape)
        )
        choices = self.environment.actions
        allowed_kinds = "iuf" if choices is None else "iu"
        if array.shape != shape or array.dtype.kind not in allowed_kinds:
            numbers = "numbers" if choices is None else "whole numbers"
            got = f"{array.dtype} {list(array.shape)}"
            raise InputError("actions", f"{numbers} {list(shape)}", got)
        if choices is not None:
            # Clipped here, because a number of more than 32 bits would wrap around.
            array = np.minimum(np.maximum(array, 0).astype(np.uint64), choices - 1)
        # Larger numbers become infinite, and environments clip these.
        with np.errstate(over="ignore"):
            # A copy, because the caller may write to its array before the step is made.
            return array.astype(action.dtype)


def _share_places(params: Pytree, other: Pytree) -> bool:
    """Returns whether a lane and a slot mean the same with other options of `RoadTraffic`."""
    leaves, other_leaves = jax.tree.leaves(params.levels), jax.tree.leaves(other.levels)
    # Options keep the arrays that they get, so that nothing needs to be compared.
    same_levels = all(one is two for one, two in zip(leaves, other_leaves, strict=True))
    return same_levels and params.slots == other.slots


def read_actions(actions: UserValue) -> np.ndarray:
    """Returns actions as an array of NumPy, which may be of any shape and dtype."""
    try:
        return np.asarray(actions)
    except ValueError:
        # The actions are lists of several lengths.
        raise InputError("actions", "numbers", shorten(repr(actions))) from None


def _action_shape(environment: Environment, params: Pytree) -> jax.ShapeDtypeStruct:
    """Returns the shape and dtype of the action of one environment."""
    robots = (params.robots,) if environment.shared else ()
    if environment.actions is not None:
        return jax.ShapeDtypeStruct(robots, jnp.int32)
    return jax.ShapeDtypeStruct((*robots, environment.action_size), jnp.float32)


def _shapes(environment: Environment, params: Pytree, envs: int) -> tuple[Pytree, Pytree]:
    """Returns the shapes and dtypes of the states, and of what `_result` returns."""
    action = _action_shape(environment, params)

    def step(key: Array) -> tuple[Pytree, Pytree]:
        _, state = environment.reset(key, params)
        no_action = jnp.zeros(action.shape, action.dtype)
        return state, _result(environment.step(key, state, no_action, params))

    # Nothing is computed here: `eval_shape` only traces.
    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), envs))
    return jax.eval_shape(jax.vmap(step), keys)


def _forms(environment: Environment, params: Pytree, envs: int) -> Pytree:
    """Returns what must not change with the options: a structure, and its shapes and dtypes."""
    observation = _observation_shape(environment, params)
    leaves, structure = jax.tree.flatten((observation, _shapes(environment, params, envs)))
    return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]


def _result(transition: Transition) -> Pytree:
    return transition.reward, transition.terminated, transition.truncated, transition.info


@partial(jax.jit, static_argnames="environment", donate_argnames="carry")
def _reset(
    carry: _Carry,
    chosen: Array,
    levels: Array | None,
    params: Pytree,
    *,
    environment: Environment,
) -> tuple[_Carry, Array]:
    """Starts new episodes in the chosen environments, on levels as `_check_levels` returns them.

    Returns the carry and the observations of all environments.
    """
    state_shapes, _ = _shapes(environment, params, len(chosen))
    layout = _Layout.of(state_shapes)
    keys, later_streams = _next_keys(carry.streams)
    states = _renew(environment, chosen, keys, layout.unpack(carry.state), params, levels)
    # A key is used up only where an episode begins.
    streams = jnp.where(chosen[:, None], later_streams, carry.streams)
    observation = jax.vmap(environment.observe, (0, None))(states, params)
    # The barrier gives the observation memory of its own, see `_step`.
    carry = _Carry(streams, layout.pack(states), carry.over & ~chosen)
    return carry, jax.lax.optimization_barrier(observation)


@partial(jax.jit, static_argnames=("environment", "mode"), donate_argnames="carry")
def _step(
    carry: _Carry, actions: Array, params: Pytree, *, environment: Environment, mode: str
) -> tuple[_Carry, tuple[Array, Array | None], _Packed]:
    """Makes a step of all environments.

    Returns the carry, the observations as `Outcome` has them, and the packed result.
    """
    observe = jax.vmap(environment.observe, (0, None))
    step = jax.vmap(environment.step, (0, 0, 0, None))
    state_shapes, _ = _shapes(environment, params, len(actions))
    layout = _Layout.of(state_shapes)
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
        result = jax.tree.map(partial(_zero_where, was_over), result)
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
    # `_writable` needs arrays of their own. Without the barrier JAX may return an array of the
    # carry twice.
    observations = jax.lax.optimization_barrier((observation, reached))
    carry = _Carry(streams, layout.pack(states), over)
    return carry, observations, _Layout.of(result).pack(result)


def _zero_where(condition: Bool[Array, " N"], array: Array) -> Array:
    """Returns an array ``[N, ...]`` with zeros where the condition is true."""
    blank = jnp.zeros((), array.dtype)
    zeroed: Array = jax.vmap(lambda is_zero, row: jnp.where(is_zero, blank, row))(condition, array)
    return zeroed


def _renew(
    environment: Environment,
    chosen: Array,
    keys: Array,
    state: Pytree,
    params: Pytree,
    levels: Array | None = None,
) -> Pytree:
    """Returns the states of new episodes for the chosen environments.

    The states of all other environments are returned as they are. `levels` is as `_check_levels`
    returns it.
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


def _choose(condition: Bool[Array, " N"], chosen: Pytree, others: Pytree) -> Pytree:
    """Returns the first states where the condition is true, and the others elsewhere."""
    return jax.tree.map(
        lambda one, other: jax.vmap(jnp.where)(condition, one, other), chosen, others
    )


def _to_streams(seeds: NDArray[np.uint64]) -> NDArray[np.uint32]:
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


class _Layout(NamedTuple):
    """How the leaves of a pytree become few arrays.

    Each array that a compiled function returns takes 2 us.

    Attributes:
      structure: the structure of the pytree.
      rows: the dtype of each leaf ``[N]``, and its row in the stack of all such leaves of this
        dtype; None for another leaf.
    """

    structure: Pytree
    rows: list[tuple[str, int] | None]

    @classmethod
    def of(cls, tree: Pytree) -> "_Layout":
        """Returns the layout of a pytree of arrays, or of their shapes and dtypes."""
        counts: Counter[str] = Counter()
        rows: list[tuple[str, int] | None] = []
        for leaf in jax.tree.leaves(tree):
            if leaf.ndim != 1:
                rows.append(None)
                continue
            dtype = leaf.dtype.name
            rows.append((dtype, counts[dtype]))
            counts[dtype] += 1
        return cls(jax.tree.structure(tree), rows)

    def pack(self, tree: Pytree) -> _Packed:
        """Returns the stacks by dtype, and all other leaves."""
        leaves_by_dtype: dict[str, list[AnyArray]] = {}
        others = []
        for row, leaf in zip(self.rows, jax.tree.leaves(tree), strict=True):
            if row is None:
                others.append(leaf)
            else:
                dtype, _ = row
                leaves_by_dtype.setdefault(dtype, []).append(leaf)
        stacks = {dtype: jnp.stack(leaves) for dtype, leaves in leaves_by_dtype.items()}
        return stacks, others

    def unpack(self, packed: _Packed) -> Pytree:
        """Returns the pytree of packed arrays of JAX or NumPy."""
        stacks, others = packed
        remaining = iter(others)
        leaves = []
        for row in self.rows:
            if row is None:
                leaves.append(next(remaining))
            else:
                dtype, index = row
                leaves.append(stacks[dtype][index])
        return self.structure.unflatten(leaves)


# Attributes that are fixed when a wrapper is made. Another value would change nothing.
_FIXED = frozenset(
    {"action_space", "observation_space", "single_action_space", "single_observation_space"}
    | {"num_envs", "num_agents", "autoreset_mode", "render_mode"}
)


class HasParams:
    """The options of a wrapper, which the caller may replace, see `Batch.replace_params`."""

    _batch: Batch
    _is_made = False

    @property
    def params(self) -> Pytree:
        return self._batch.params

    @params.setter
    def params(self, params: Pytree) -> None:
        self._batch.replace_params(params)

    def __setattr__(self, name: str, value: UserValue) -> None:
        # The constructors of libraries set these names too.
        if self._is_made and name in _FIXED:
            raise InputError(
                name,
                "the value that the environment has",
                shorten(repr(value)),
                "make another environment",
            )
        # An attribute of this name would change nothing.
        if "_batch" in vars(self) and name in self.params.options():
            raise InputError(
                name,
                f"it in params, as env.params = env.params.replace({name}=...)",
                "an attribute",
            )
        super().__setattr__(name, value)

    def made(self) -> Self:
        """Returns the environment, which is complete from here on."""
        self._is_made = True
        return self

    def check_settable(self, name: UserValue) -> None:
        """Checks a name that `set_attr` got."""
        if name != "params":
            got = shorten(repr(name))
            raise InputError("set_attr", "params, the only attribute to set", got)


class _Memory:
    """Shows NumPy the memory of an array that nothing else reads, as memory to read and write."""

    def __init__(self, array: np.ndarray) -> None:
        # Keeps the memory, which the interface alone would not.
        self._array = array
        address, _ = array.__array_interface__["data"]
        self.__array_interface__ = array.__array_interface__ | {"data": (address, False)}


def _writable(array: Array) -> np.ndarray:
    """Returns an array of a compiled function as one of NumPy that can be written to.

    The array of the compiled function must not be used again. On a processor nothing is copied.
    `numpy.asarray` alone makes one that cannot be written to, about which PyTorch warns.
    """
    return np.asarray(_Memory(np.asarray(array)))
