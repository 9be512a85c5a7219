"""The environments by name, and in the interfaces of Gymnax and Gymnasium.

This module imports none of these libraries.

A wrapper that needs classes of the other library takes the library's module. Observations become one vector (see
`flatten`), or remain the camera's picture.
"""

from collections.abc import Callable
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.checks import SEED, check_named, is_whole, one_of
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.records import Record, check_names
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.drive._environment import Environment, auto_reset
from elitelanes_jax.drive._lane_drive import LaneDrive, LaneDriveParams
from elitelanes_jax.drive._levels import make_levels
from elitelanes_jax.drive._road_nav import RoadNav, RoadNavParams
from elitelanes_jax.network.bits import seed_key

_ENVIRONMENTS: dict[str, tuple[Environment, type[RoadNavParams | LaneDriveParams]]] = {
    "RoadNav": (RoadNav, RoadNavParams),
    "LaneDrive": (LaneDrive, LaneDriveParams),
}


def make(
    name: str, maps: UserValue, *, count: int = 256, seed: int = 0, **settings: UserValue
) -> tuple[Environment, RoadNavParams | LaneDriveParams]:
    """Returns an environment and its parameters, with random levels on the maps.

    Args:
      name: "RoadNav" or "LaneDrive".
      maps: a `RoadMap`, several of one size, or integer codes ``[M, H, W]``.
      count: the number of levels. Level i is on map i modulo M.
      seed: of the levels, 0 or more.
      settings: fields of `RoadNavParams` or `LaneDriveParams`, such as ``limit``.

    Raises:
      InputError: for another name, and as `make_levels` and the parameters do.
    """
    environment, params = _ENVIRONMENTS[check_named("name", one_of(*_ENVIRONMENTS), name)]
    check_names(settings, params.options())
    key = seed_key(check_named("seed", SEED, seed))
    return environment, params(make_levels(key, maps, count), **settings)


def flatten(observation: Pytree) -> Float[Array, " N"] | UInt8[Array, "rows columns 3"]:
    """Returns an observation as one float32 vector: its parts in order, tile codes as four bits each, N, E, S, W.

    A camera's picture is returned unchanged.
    """
    parts = [jnp.asarray(part) for part in jax.tree.leaves(observation)]
    if len(parts) == 1 and parts[0].dtype == jnp.uint8:
        return parts[0]

    def numbers(part: Array) -> Array:
        if part.dtype == jnp.int8:
            part = part[..., None] & jnp.array([8, 4, 2, 1], jnp.int8) > 0
        return part.astype(jnp.float32).reshape(-1)

    return jnp.concatenate([numbers(part) for part in parts])


def _check(params: Pytree, module: Untyped, name: str, argument: str, needed: str) -> None:
    """Checks the options of an environment, and that a module has a class."""
    if not hasattr(module, needed):
        raise InputError(f"{argument}: expected the module {name}, got {shorten(repr(module))}")
    if not isinstance(params, Record):
        raise InputError(f"params: expected RoadNavParams or LaneDriveParams, got {shorten(repr(params))}")


def _makers(params: Pytree, spaces: Untyped) -> Untyped:
    """Takes the needed classes out of a module, because Rejax copies environments, and modules cannot be copied."""
    _check(params, spaces, "gymnax.environments.spaces", "spaces", "Discrete")
    return SimpleNamespace(Discrete=spaces.Discrete, Box=spaces.Box)


def _action_space(environment: Environment, spaces: Untyped) -> Untyped:
    if environment.actions is not None:
        return spaces.Discrete(environment.actions)
    return spaces.Box(-1.0, 1.0, (environment.action_size,))


def _observation_space(environment: Environment, params: Pytree, spaces: Untyped) -> Untyped:
    seen = jax.eval_shape(lambda key: flatten(environment.reset(key, params)[0]), seed_key(0))
    if seen.dtype == jnp.uint8:
        return spaces.Box(0, 255, seen.shape, np.uint8)
    return spaces.Box(-np.inf, np.inf, seen.shape)


class GymnaxEnv:
    """The interface of Gymnax's environments, for its loops and those of Rejax and PureJaxRL.

    `step` resets automatically, `step_env` does not. The info is a dictionary of the environment's metrics,
    ``terminated``, ``truncated``, ``final_observation``, the observation after the action, and ``discount``, 0 if the
    episode terminated.
    """

    def __init__(self, environment: Environment, params: Pytree, spaces: Untyped, *, values: int = 6) -> None:
        """Wraps an environment.

        Args:
          environment: `RoadNav` or `LaneDrive`.
          params: its options.
          spaces: the module ``gymnax.environments.spaces``.
          values: the number of values that `step` returns: 6 as in Gymnax 1.0 (observation, state, reward, terminated,
            truncated, info), or 5 as before and in Rejax 0.1 (observation, state, reward, done, info).

        Raises:
          InputError: for options out of their range, or another module or number of values.
        """
        if not is_whole(values) or values not in (5, 6):
            raise InputError(f"values: expected 5 or 6, got {values!r}")
        self._environment, self._resetting = environment, auto_reset(environment)
        self._spaces, self._six = _makers(params, spaces), values == 6
        self.default_params = params
        self.name = type(params).__name__.removesuffix("Params")
        self.num_actions = environment.actions or environment.action_size

    def reset(self, key: Key[Array, ""], params: Pytree = None) -> tuple[Array, Pytree]:
        """Starts an episode on a level drawn from the parameters: (observation, state)."""
        observation, state = self._environment.reset(key, self.default_params if params is None else params)
        return flatten(observation), state

    def step(self, key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree = None) -> tuple[Pytree, ...]:
        """Makes a step, and a reset if the episode ended."""
        return self._step(self._resetting, key, state, action, params)

    def reset_env(self, key: Key[Array, ""], params: Pytree = None) -> tuple[Array, Pytree]:
        """Does the same as `reset`."""
        return self.reset(key, params)

    def step_env(self, key: Key[Array, ""], state: Pytree, action: Pytree, params: Pytree = None) -> tuple[Pytree, ...]:
        """Makes a step without a reset."""
        return self._step(self._environment, key, state, action, params)

    def action_space(self, params: Pytree = None) -> Untyped:
        """Returns the space of actions."""
        return _action_space(self._environment, self._spaces)

    def observation_space(self, params: Pytree = None) -> Untyped:
        """Returns the space of observations."""
        return _observation_space(self._environment, self.default_params if params is None else params, self._spaces)

    def _step(
        self, environment: Environment, key: Array, state: Pytree, action: Pytree, params: Pytree
    ) -> tuple[Pytree, ...]:
        done = environment.step(key, state, action, self.default_params if params is None else params)
        info = done.info._asdict() | {
            "terminated": done.terminated,
            "truncated": done.truncated,
            "final_observation": flatten(done.reached),
            "discount": 1 - done.terminated.astype(jnp.float32),
        }
        ended = (done.terminated, done.truncated) if self._six else (done.terminated | done.truncated,)
        return flatten(done.observation), done.state, done.reward, *ended, info


def _numpy(tree: Pytree) -> Pytree:
    return jax.tree.map(np.array, jax.device_get(tree))


def gymnasium_env(
    environment: Environment,
    params: Pytree,
    gymnasium: Untyped,
    *,
    render: Callable[[Pytree], NDArray[np.uint8]] | None = None,
) -> Untyped:
    """Makes an environment of Gymnasium for programs without JAX: its arrays are NumPy's.

    Args:
      environment: `RoadNav` or `LaneDrive`.
      params: its options.
      gymnasium: the module ``gymnasium``.
      render: takes a state and returns a picture uint8 ``[H, W, 3]``; with it `render_mode` is "rgb_array".

    Raises:
      InputError: for options out of their range, or another module.
    """
    _check(params, gymnasium, "gymnasium", "gymnasium", "Env")
    begin, go, draw = jax.jit(environment.reset), jax.jit(environment.step), render

    class Env(gymnasium.Env):
        """The environment."""

        metadata = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012
        render_mode = None if draw is None else "rgb_array"
        action_space = _action_space(environment, gymnasium.spaces)
        observation_space = _observation_space(environment, params, gymnasium.spaces)

        def _key(self) -> Array:
            return seed_key(int(self.np_random.integers(2**31)))

        def reset(self, *, seed: int | None = None, options: Untyped = None) -> tuple[Pytree, dict[str, Untyped]]:
            super().reset(seed=seed)
            observation, self._state = begin(self._key(), params)
            return _numpy(flatten(observation)), {}

        def step(self, action: Pytree) -> tuple[Pytree, float, bool, bool, dict[str, Untyped]]:
            done = go(self._key(), self._begun("step"), jnp.asarray(action), params)
            self._state = done.state
            ended = bool(done.terminated), bool(done.truncated)
            return _numpy(flatten(done.observation)), float(done.reward), *ended, _numpy(done.info._asdict())

        def render(self) -> Untyped:
            return None if draw is None else np.asarray(draw(self._begun("render")))

        def _begun(self, name: str) -> Pytree:
            if not hasattr(self, "_state"):
                raise InputError(f"{name}: expected a reset before the first {name}, got none")
            return self._state

    return Env()
