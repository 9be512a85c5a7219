"""Environments that step together, with arrays of NumPy: the core of all wrappers.

Each environment has a stream of random keys. Its next step or reset takes the next key of the
stream. Therefore environment i of a batch does the same, bit for bit, as an environment alone with
the seed of environment i.

To its callers, a batch of environments with R robots each has a row for each robot. An environment
takes the seed and the level that its first robot gets.
"""

from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance, is_whole, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.drive._batch_programs import (
    Carry,
    forms_of,
    reset_batch,
    shapes_of,
    step_batch,
    to_streams,
)
from elitelanes_jax.drive._environment import Environment
from elitelanes_jax.drive._flat import (
    action_shape,
    action_space,
    flattened,
    observation_space,
    robots_of,
)
from elitelanes_jax.drive._host_arrays import Layout, writable
from elitelanes_jax.drive._library_types import Params

# The number of keys that a seed can name.
_SEEDS = 2**64


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


class Batch:
    """A batch of environments.

    Two calls make a step: `send` starts it, and `receive` waits for its outcome.
    """

    @runs_jax
    def __init__(
        self,
        environment: Environment,
        params: Params,
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
        self._action = action_shape(self.environment, params)
        self._mode = mode
        # The environments that have been reset.
        self._begun = np.zeros(self._count, bool)
        # XLA simplifies a batch of one row to other arithmetic, with other last bits. Therefore
        # there are at least two.
        self._rows = max(self._count, 2)
        states, result = shapes_of(self.environment, self._device_params, self._rows)
        self._states = Layout.of(states)
        reward, terminated, truncated, _ = result
        reward_shape = (self._rows, self.robots) if environment.shared else (self._rows,)
        if reward.shape != reward_shape or any(
            leaf.shape != (self._rows,) for leaf in (terminated, truncated)
        ):
            raise InputError(
                "params", "numbers for all environments", "arrays, which only jax.vmap maps over"
            )
        self._result = Layout.of(result)
        # Without seeds each batch is different, as in Gymnasium.
        random_seeds = np.random.default_rng().integers(_SEEDS, size=self._rows, dtype=np.uint64)
        blank_states = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), states)
        self._carry = Carry(
            streams=jnp.asarray(to_streams(random_seeds)),
            state=self._states.pack(blank_states),
            over=jnp.zeros(self._rows, bool),
        )

    @runs_jax
    def replace_params(self, params: UserValue) -> None:
        """Replaces the options.

        The next step uses them. An episode that has begun stays on its level, and later resets
        draw from the new levels. But the state of robots that share a town is only valid with its
        levels and slots. If these are replaced, all environments need a reset.

        Raises:
          InputError: for another type, or if a state or an observation would have another shape.
        """
        params = check_named("params", instance(type(self.params)), params)
        device_params = jax.device_put(params)
        if forms_of(self.environment, device_params, self._rows) != forms_of(
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
        seeds: Untyped = None,
        chosen: NDArray[np.bool_] | None = None,
        levels: Untyped = None,
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
        self._carry, observation = reset_batch(
            self._carry, chosen_rows, indices, self._device_params, environment=self.environment
        )
        self._begun = self._begun | chosen
        return self._to_rows(writable(observation)[: self._count])

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
            raise InputError("reset_mask", expected, quote(chosen))
        return by_robot[:, 0]

    def _check_levels(self, levels: Untyped) -> NDArray[np.int32] | None:
        """Returns the index of the level of each row, -1 where it is drawn; None if all are."""
        if levels is None or all(level is None for level in levels):
            return None
        if len(levels) != self.envs:
            expected = f"the index of a level, or {self.envs} of them"
            raise InputError("level", expected, quote(levels))
        last = len(self.params.levels.grid) - 1
        for level in levels:
            if level is not None and not (is_whole(level) and 0 <= level <= last):
                raise InputError("level", f"a whole number, 0 to {last}", quote(level, 40))
        # A level that is no number is None.
        indices = [level if is_whole(level) else -1 for level in levels[:: self.robots]]
        return np.resize(np.array(indices, np.int32), self._rows)

    def _seed(self, seeds: Untyped, chosen: NDArray[np.bool_]) -> None:
        """Starts the streams of keys of the chosen environments that have a seed."""
        is_list = hasattr(seeds, "__len__") and getattr(seeds, "ndim", 1) == 1
        if not is_list or len(seeds) != self.envs:
            expected = f"a whole number, or {self.envs} of them"
            raise InputError("seed", expected, quote(seeds))
        indices = []
        numbers = []
        for index, seed in enumerate(seeds[:: self.robots]):
            if seed is None or not chosen[index]:
                continue
            if not is_whole(seed) or not 0 <= seed < _SEEDS:
                raise InputError("seed", f"a whole number, 0 to {_SEEDS - 1}", quote(seed))
            indices.append(index)
            numbers.append(seed)
        # NumPy's view of an array of JAX is read-only, so this is a copy.
        streams = np.array(self._carry.streams)
        streams[indices] = to_streams(np.array(numbers, np.uint64))
        self._carry = self._carry._replace(streams=jnp.asarray(streams))

    @runs_jax
    def send(self, actions: UserValue) -> None:
        """Starts a step with whole numbers ``[N]``, or real ones ``[N, action_size]``."""
        self._check_begun("step")
        array = self._check_actions(actions)
        array = array.reshape(self._count, *self._action.shape)
        if self._count < self._rows:
            array = np.repeat(array, self._rows, axis=0)
        self._carry, self._observations, self._packed_result = step_batch(
            self._carry,
            array,
            self._device_params,
            environment=self.environment,
            mode=self._mode,
        )

    @runs_jax
    def receive(self) -> Outcome:
        """Waits for the outcome of the step that was sent."""
        observation = writable(self._observations[0])
        reached = observation
        if self._observations[1] is not None:
            reached = writable(self._observations[1])
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
            of_whom = f" of environments {quote(np.flatnonzero(~self._begun).tolist())}"
        hint = "also after other levels or slots" if self.environment.shared else ""
        raise InputError(name, f"a reset{of_whom} before the first {name}", "none", hint)

    def _check_actions(self, actions: UserValue) -> np.ndarray:
        """Returns actions as an array of one dtype, so that JAX compiles one program."""
        action = self._action
        shape = (
            (self.envs, *action.shape[1:])
            if self.environment.shared
            else (self.envs, *action.shape)
        )
        choices = self.environment.actions
        array = check_actions(actions, shape, whole=choices is not None)
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


def check_actions(
    actions: UserValue, shape: tuple[int, ...], *, whole: bool, subject: str = "actions"
) -> np.ndarray:
    """Returns actions as an array of NumPy of a shape.

    Raises `InputError` for another shape, and for anything but numbers, or whole ones if asked.
    """
    try:
        array = np.asarray(actions)
    except ValueError:
        # The actions are lists of several lengths.
        raise InputError(subject, "numbers", quote(actions)) from None
    if array.shape != shape or array.dtype.kind not in ("iu" if whole else "iuf"):
        numbers = "numbers" if not whole else "whole numbers" if shape else "a whole number"
        expected = f"{numbers} {list(shape)}" if shape else numbers
        got = f"{array.dtype} {list(array.shape)}"
        raise InputError(subject, expected, got)
    return array
