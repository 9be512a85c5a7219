"""Environments that step together, with arrays of NumPy: the core of all wrappers.

Each environment has a stream of random keys. Its next step or reset takes the next key of the stream. Therefore
environment i of a batch does the same, bit for bit, as an environment alone with the seed of environment i.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key, UInt8, UInt32
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, is_whole, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.records import Record
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Pytree, Untyped, UserValue
from elitelanes_jax.drive._environment import Environment, Transition
from elitelanes_jax.network.bits import THREEFRY, fold_in

NEXT_STEP, SAME_STEP, DISABLED = "NextStep", "SameStep", "Disabled"
"""Gymnasium's names for a reset instead of the step after an end, a reset in the same step, and no reset."""

_SEEDS = 2**64  # the number of keys


@name_wrong_arguments
def flatten(observation: Pytree) -> Float[Array, " N"] | UInt8[Array, "rows columns 3"]:
    """Returns an observation as one float32 vector: its parts in order, tile codes as four bits each, N, E, S, W.

    A camera's picture is returned unchanged. Raises `InputError` for an observation that is no pytree of arrays of
    numbers.
    """
    leaves = jax.tree.leaves(observation)
    if not leaves or not all(map(_has_numbers, leaves)):
        raise InputError(f"observation: expected arrays of numbers, got {shorten(repr(observation))}")
    parts = [jnp.asarray(part) for part in leaves]
    if len(parts) == 1 and parts[0].dtype == jnp.uint8:
        return parts[0]

    def numbers(part: Array) -> Array:
        if part.dtype == jnp.int8:
            bits = np.array([8, 4, 2, 1], np.int8).reshape(*(1,) * part.ndim, 4)
            part = part[..., None] & bits > 0
        return part.astype(jnp.float32).reshape(-1)

    return jnp.concatenate([numbers(part) for part in parts])


def _has_numbers(leaf: Pytree) -> bool:
    dtype = getattr(leaf, "dtype", None)
    return dtype is not None and (jnp.issubdtype(dtype, jnp.bool_) or jnp.issubdtype(dtype, jnp.number))


@lru_cache(maxsize=32)  # so that batches of one environment share compiled functions
def flattened(environment: Environment, *, channels_first: bool = False) -> Environment:
    """Returns the environment with observations as `flatten` makes them, and the info as a dictionary.

    Pictures are uint8 ``[rows, columns, 3]``, or ``[3, rows, columns]`` with `channels_first`.
    """
    check_named("environment", instance(Environment), environment)
    if environment.actions is None and environment.action_size < 1:
        raise InputError(f"environment: expected actions, or action_size of 1 or more, got {environment.action_size}")

    def see(observation: Pytree) -> Array:
        seen = flatten(observation)
        return jnp.moveaxis(seen, -1, 0) if channels_first and seen.dtype == jnp.uint8 else seen

    def seeing(reset: Callable[..., tuple[Pytree, Pytree]]) -> Callable[..., tuple[Array, Pytree]]:
        def see_first(*arguments: Pytree) -> tuple[Array, Pytree]:
            observation, state = reset(*arguments)
            return see(observation), state

        return see_first

    def step(key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree) -> Transition:
        done = environment.step(key, state, action, params)
        metrics = {name: metric for name, metric in done.info._asdict().items() if metric is not None}
        return done._replace(observation=see(done.observation), reached=see(done.reached), info=metrics)

    return Environment(
        reset=seeing(environment.reset),
        reset_to_level=seeing(environment.reset_to_level),
        step=step,
        observe=lambda state, params: see(environment.observe(state, params)),
        actions=environment.actions,
        action_size=environment.action_size,
    )


def check_module(params: Pytree, module: Untyped, name: str, argument: str, needed: str) -> None:
    """Checks the options of an environment, and that a module has a class or module, such as ``vector.VectorEnv``."""
    part = module
    for word in needed.split("."):
        part = getattr(part, word, None)
    if part is None:
        raise InputError(f"{argument}: expected the module {name}, got {shorten(repr(module))}")
    if not isinstance(params, Record):
        raise InputError(f"params: expected RoadNavParams or LaneDriveParams, got {shorten(repr(params))}")


def action_space(environment: Environment, spaces: Untyped) -> Untyped:
    """Returns the space of actions of an environment, from a module with `Discrete` and `Box`."""
    if environment.actions is not None:
        return spaces.Discrete(environment.actions)
    return spaces.Box(-1.0, 1.0, (environment.action_size,))


def observation_space(environment: Environment, params: Pytree, spaces: Untyped) -> Untyped:
    """Returns the space of observations of a flattened environment, from a module with `Box`."""
    seen = jax.eval_shape(lambda: environment.reset(jax.random.key(0), params)[0])
    if seen.dtype == jnp.uint8:
        return spaces.Box(0, 255, seen.shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, seen.shape)


class Outcome(NamedTuple):
    """What a step of a batch returns, as arrays of NumPy that the caller may write to.

    Attributes:
      observation: float32 ``[N, size]`` or uint8 pictures; where an episode was reset, the first of the next one.
      reward: float32 ``[N]``.
      terminated: bool ``[N]``.
      truncated: bool ``[N]``.
      metrics: of the info, by name, each ``[N]``; 0 for an environment that was reset instead of a step.
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
    """The state of a batch between two steps."""

    streams: UInt32[Array, "N 3"]  # the two words of a key, and how many keys of the stream are used
    state: _Packed
    over: Bool[Array, " N"]  # whether the episode has ended


class Batch:
    """A batch of environments. Two calls make a step: `send` starts it, and `receive` waits for its outcome."""

    @runs_jax
    def __init__(
        self, environment: Environment, params: Pytree, envs: int, mode: str, *, channels_first: bool = False
    ) -> None:
        """Makes N = `envs` environments; see `flattened` for `channels_first`.

        Raises:
          InputError: for another number than 1 or more, or anything but an environment.
        """
        self.envs = check_named("envs", whole(1), envs)
        self.environment = flattened(environment, channels_first=channels_first)
        self.params = jax.device_put(params)  # once, because each number would be transferred in every step
        self._mode, self._begun = mode, False
        # XLA simplifies a batch of one row to other arithmetic, with other last bits. Therefore there are at least two.
        self._rows = rows = max(self.envs, 2)
        states, result = _shapes(self.environment, self.params, rows)
        self._states, self._result = _Layout.of(states), _Layout.of(result)
        random_seeds = np.random.default_rng().integers(_SEEDS, size=rows, dtype=np.uint64)
        blank = jax.tree.map(lambda part: jnp.zeros(part.shape, part.dtype), states)
        self._carry = _Carry(jnp.asarray(_to_streams(random_seeds)), self._states.pack(blank), jnp.zeros(rows, bool))

    @runs_jax
    def reset(self, seeds: Sequence[UserValue] | None = None, chosen: NDArray[np.bool_] | None = None) -> np.ndarray:
        """Starts episodes in the chosen environments, by default in all, and returns the observations of all.

        Args:
          seeds: of each environment, or None to go on with its keys. At first the keys are random.
          chosen: bool ``[N]``.

        Raises:
          InputError: for seeds out of range, or fewer or more of them.
        """
        if chosen is None:
            chosen = np.ones(self.envs, bool)
        if seeds is not None:
            self._seed(seeds, chosen)
        self._carry, observation = _reset(
            self._carry, np.resize(chosen, self._rows), self.params, environment=self.environment
        )
        self._begun = True
        return _writable(observation)[: self.envs]

    def _seed(self, seeds: Sequence[UserValue], chosen: NDArray[np.bool_]) -> None:
        if not hasattr(seeds, "__len__") or len(seeds) != self.envs:
            raise InputError(f"seed: expected a whole number, or {self.envs} of them, got {shorten(repr(seeds))}")
        seeded = [index for index, seed in enumerate(seeds) if seed is not None and chosen[index]]
        for index in seeded:
            if not is_whole(seeds[index]) or not 0 <= seeds[index] < _SEEDS:
                raise InputError(f"seed: expected a whole number, 0 to {_SEEDS - 1}, got {seeds[index]!r}")
        streams = np.array(self._carry.streams)
        streams[seeded] = _to_streams(np.array([seeds[index] for index in seeded], np.uint64))
        self._carry = self._carry._replace(streams=jnp.asarray(streams))

    @runs_jax
    def send(self, actions: UserValue) -> None:
        """Starts a step with whole numbers ``[N]``, or real ones ``[N, action_size]``."""
        self._check_begun("step")
        array = self._check_actions(actions)
        if self.envs < self._rows:
            array = np.repeat(array, self._rows, axis=0)
        step = _step(self._carry, array, self.params, environment=self.environment, mode=self._mode)
        self._carry, *self._sent = step

    @runs_jax
    def receive(self) -> Outcome:
        """Waits for the outcome of the step that was sent."""
        (observation, reached), (stacks, others) = self._sent
        seen = _writable(observation)
        before_reset = seen if reached is None else _writable(reached)
        copied = {name: np.array(stack) for name, stack in stacks.items()}, [np.array(part) for part in others]
        reward, terminated, truncated, metrics = self._result.unpack(copied)
        outcome = Outcome(seen, reward, terminated, truncated, metrics, before_reset)
        return jax.tree.map(lambda part: part[:1], outcome) if self.envs < self._rows else outcome

    def step(self, actions: UserValue) -> Outcome:
        """Makes a step; see `send` and `receive`."""
        self.send(actions)
        return self.receive()

    @runs_jax
    def states(self, name: str) -> list[Pytree]:
        """Returns the states, as arrays of NumPy. Before a reset, an error says that `name` needs it."""
        self._check_begun(name)
        states = self._states.unpack(jax.device_get(self._carry.state))
        return [jax.tree.map(lambda part, index=index: part[index], states) for index in range(self.envs)]

    def spaces(self, spaces: Untyped) -> tuple[Untyped, Untyped]:
        """Returns the spaces of the actions and of the observations of one environment, from a module of spaces."""
        return action_space(self.environment, spaces), observation_space(self.environment, self.params, spaces)

    def _check_begun(self, name: str) -> None:
        if not self._begun:
            raise InputError(f"{name}: expected a reset before the first {name}, got none")

    def _check_actions(self, actions: UserValue) -> np.ndarray:
        array = np.asarray(actions)
        discrete = self.environment.actions is not None
        shape = (self.envs,) if discrete else (self.envs, self.environment.action_size)
        kinds, words = ("iu", "whole numbers") if discrete else ("iuf", "numbers")
        if array.shape != shape or array.dtype.kind not in kinds:
            raise InputError(f"actions: expected {words} {list(shape)}, got {array.dtype} {list(array.shape)}")
        # One dtype, so that JAX compiles one program.
        return array.astype(np.int32 if discrete else np.float32, copy=False)


def _shapes(environment: Environment, params: Pytree, envs: int) -> tuple[Pytree, Pytree]:
    """Returns the shapes and dtypes of the states, and of what `_result` returns."""
    shape, dtype = ((), jnp.int32) if environment.actions is not None else ((environment.action_size,), jnp.float32)

    def step(key: Array) -> tuple[Pytree, Pytree]:
        _, state = environment.reset(key, params)
        return state, _result(environment.step(key, state, jnp.zeros(shape, dtype), params))

    keys = jax.eval_shape(lambda: jax.random.split(jax.random.key(0), envs))
    return jax.eval_shape(jax.vmap(step), keys)


def _result(done: Transition) -> Pytree:
    return done.reward, done.terminated, done.truncated, done.info


@partial(jax.jit, static_argnames="environment", donate_argnames="carry")
def _reset(carry: _Carry, chosen: Array, params: Pytree, *, environment: Environment) -> tuple[_Carry, Array]:
    """Starts new episodes in the chosen environments; returns the carry and the observations of all."""
    states = _Layout.of(_shapes(environment, params, len(chosen))[0])
    keys, after = _next_keys(carry.streams)
    state = _renew(environment, chosen, keys, states.unpack(carry.state), params)
    streams = jnp.where(chosen[:, None], after, carry.streams)
    observation = jax.vmap(environment.observe, (0, None))(state, params)
    return _Carry(streams, states.pack(state), carry.over & ~chosen), jax.lax.optimization_barrier(observation)


@partial(jax.jit, static_argnames=("environment", "mode"), donate_argnames="carry")
def _step(
    carry: _Carry, actions: Array, params: Pytree, *, environment: Environment, mode: str
) -> tuple[_Carry, tuple[Array, Array | None], _Packed]:
    """Makes a step; returns the carry, the observations as `Outcome` has them, and the packed result."""
    observe = jax.vmap(environment.observe, (0, None))
    states = _Layout.of(_shapes(environment, params, len(actions))[0])
    keys, streams = _next_keys(carry.streams)
    done = jax.vmap(environment.step, (0, 0, 0, None))(keys, states.unpack(carry.state), actions, params)
    state, result, over, reached = done.state, _result(done), done.terminated | done.truncated, None
    if mode == NEXT_STEP:
        waiting = carry.over
        state = _renew(environment, waiting, keys, state, params)
        result = jax.tree.map(lambda part: jnp.where(waiting, jnp.zeros((), part.dtype), part), result)
        over &= ~waiting
    if mode == SAME_STEP:
        reset_keys, after = _next_keys(streams)
        state = _renew(environment, over, reset_keys, state, params)
        streams = jnp.where(over[:, None], after, streams)
    observation = observe(state, params)
    if mode == SAME_STEP:
        # Unless an episode has ended, the pictures of a camera are rendered once.
        reached = jax.lax.cond(over.any(), lambda: observe(done.state, params), lambda: observation)
    # `_writable` needs arrays of their own. Without the barrier JAX may return an array of the carry twice.
    seen = jax.lax.optimization_barrier((observation, reached))
    return _Carry(streams, states.pack(state), over), seen, _Layout.of(result).pack(result)


def _renew(environment: Environment, chosen: Array, keys: Array, state: Pytree, params: Pytree) -> Pytree:
    """Returns the states of new episodes for the chosen environments, and the states as they are for all others."""

    def renew() -> Pytree:
        _, first = jax.vmap(environment.reset, (0, None))(keys, params)
        return jax.tree.map(lambda new, old: jax.vmap(jnp.where)(chosen, new, old), first, state)

    # A step of 256 `LaneDrive` takes a fifth less time if no episode begins.
    return jax.lax.cond(chosen.any(), renew, lambda: state)


def _to_streams(seeds: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """Returns streams ``[N, 3]`` that begin with the keys of the seeds; below 2**32 they are those of `seed_key`."""
    words = seeds >> np.uint64(32), seeds & np.uint64(0xFFFFFFFF), np.zeros_like(seeds)
    return np.stack(words, axis=-1).astype(np.uint32)


def _next_keys(streams: Array) -> tuple[Array, Array]:
    """Returns the next key of each stream, and the streams after it."""

    def next_key(stream: Array) -> Array:
        return fold_in(jax.random.wrap_key_data(stream[:2], impl=THREEFRY), stream[2].astype(jnp.int32))

    return jax.vmap(next_key)(streams), streams.at[:, 2].add(1)


class _Layout(NamedTuple):
    """How the leaves of a pytree become few arrays, because each array that a compiled function returns takes 2 us.

    Attributes:
      structure: of the pytree.
      rows: for each leaf ``[N]`` its dtype, whose leaves are stacked, and its row there; None for another leaf.
    """

    structure: Pytree
    rows: list[tuple[str, int] | None]

    @classmethod
    def of(cls, tree: Pytree) -> "_Layout":
        """Returns the layout of a pytree of arrays, or of their shapes and dtypes."""
        counts: Counter[str] = Counter()
        rows: list[tuple[str, int] | None] = []
        for leaf in jax.tree.leaves(tree):
            stacked = leaf.ndim == 1
            rows.append((leaf.dtype.name, counts[leaf.dtype.name]) if stacked else None)
            counts[leaf.dtype.name] += stacked
        return cls(jax.tree.structure(tree), rows)

    def pack(self, tree: Pytree) -> _Packed:
        """Returns the stacks by dtype, and all other leaves."""
        leaves = list(zip(self.rows, jax.tree.leaves(tree), strict=True))
        dtypes = {row[0] for row in self.rows if row}
        stacks = {name: jnp.stack([leaf for row, leaf in leaves if row and row[0] == name]) for name in dtypes}
        return stacks, [leaf for row, leaf in leaves if row is None]

    def unpack(self, packed: _Packed) -> Pytree:
        """Returns the pytree of packed arrays of JAX or NumPy."""
        stacks, others = packed
        other = iter(others)
        return self.structure.unflatten([stacks[row[0]][row[1]] if row else next(other) for row in self.rows])


class _Memory:
    """Shows NumPy the memory of an array that nothing else reads, as memory to read and write."""

    def __init__(self, array: np.ndarray) -> None:
        self._array = array  # which keeps the memory
        address, _ = array.__array_interface__["data"]
        self.__array_interface__ = array.__array_interface__ | {"data": (address, False)}


def _writable(array: Array) -> np.ndarray:
    """Returns an array of a compiled function, which is not used again, as one of NumPy: on a processor without a copy.

    `numpy.asarray` alone makes one that cannot be written to, about which PyTorch warns.
    """
    return np.asarray(_Memory(np.asarray(array)))
