"""The environments by name, and one at a time in the interfaces of Gymnax and Gymnasium.

This module does not import these libraries. Each wrapper takes the module of its library as an
argument.
"""

from collections.abc import Callable, Mapping
from types import SimpleNamespace
from typing import Literal, overload

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, is_whole, one_of
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import Record, check_names
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import OptionValue, Pytree, Untyped, UserValue
from elitelanes_jax.drive._batch import Batch, check_actions
from elitelanes_jax.drive._batch_programs import DISABLED
from elitelanes_jax.drive._environment import Environment, auto_reset
from elitelanes_jax.drive._flat import action_shape, action_space, flattened, observation_space
from elitelanes_jax.drive._lane_drive import LaneDrive
from elitelanes_jax.drive._lane_drive_records import LaneDriveParams
from elitelanes_jax.drive._levels import check_maps, draw_levels
from elitelanes_jax.drive._library_types import GymnasiumEnv, Params
from elitelanes_jax.drive._road_nav import RoadNav, RoadNavParams
from elitelanes_jax.drive._road_traffic import RoadTraffic
from elitelanes_jax.drive._road_traffic_records import RoadTrafficParams
from elitelanes_jax.drive._traffic_levels import make_traffic_levels
from elitelanes_jax.drive._wrapper_base import (
    HasParams,
    check_module,
    check_render,
    read_options,
)
from elitelanes_jax.network.bits import seed_key

_ONE_ROBOT: dict[str, tuple[Environment, type[RoadNavParams | LaneDriveParams]]] = {
    "RoadNav": (RoadNav, RoadNavParams),
    "LaneDrive": (LaneDrive, LaneDriveParams),
}


@overload
def make(
    name: Literal["RoadNav"],
    maps: UserValue,
    *,
    count: int = ...,
    seed: int = ...,
    **settings: OptionValue,
) -> tuple[Environment, RoadNavParams]: ...


@overload
def make(
    name: Literal["LaneDrive"],
    maps: UserValue,
    *,
    count: int = ...,
    seed: int = ...,
    **settings: OptionValue,
) -> tuple[Environment, LaneDriveParams]: ...


@overload
def make(
    name: Literal["RoadTraffic"], maps: UserValue, **settings: OptionValue
) -> tuple[Environment, RoadTrafficParams]: ...


@overload
def make(
    name: str,
    maps: UserValue,
    *,
    count: int | None = ...,
    seed: int | None = ...,
    **settings: OptionValue,
) -> tuple[Environment, RoadNavParams | LaneDriveParams | RoadTrafficParams]: ...


@name_wrong_arguments
def make(
    name: str,
    maps: UserValue,
    *,
    count: int | None = None,
    seed: int | None = None,
    **settings: OptionValue,
) -> tuple[Environment, RoadNavParams | LaneDriveParams | RoadTrafficParams]:
    """Returns an environment and its parameters, with levels on the maps.

    The levels of `RoadNav` and `LaneDrive` are random. Those of `RoadTraffic` are the maps.

    Args:
      name: "RoadNav", "LaneDrive" or "RoadTraffic".
      maps: a `RoadMap`, several of one size, or integer codes ``[M, H, W]``.
      count: the number of random levels, by default 256. Level i is on map i modulo M.
      seed: the seed of random levels, 0 to 2**32 - 1, by default 0.
      settings: fields of the parameters, such as ``limit``.

    Raises:
      InputError: for another name, for a `count` or `seed` of `RoadTraffic`, and as `make_levels`,
        `make_traffic_levels` and the parameters do.
    """
    check_named("name", one_of(*_ONE_ROBOT, "RoadTraffic"), name)
    if name == "RoadTraffic":
        _check_settings(RoadTrafficParams, settings)
        for argument, value in (("count", count), ("seed", seed)):
            if value is not None:
                raise InputError(argument, "None, because each map is a level", quote(value))
        return RoadTraffic, RoadTrafficParams(make_traffic_levels(maps), **settings)
    environment, params = _ONE_ROBOT[name]
    _check_settings(params, settings, "count", "seed")
    key = seed_key(check_named("seed", SEED, 0 if seed is None else seed))
    levels = draw_levels(key, check_maps("maps", maps), 256 if count is None else count)
    return environment, params(levels, **settings)


def _check_settings(
    params: type[Record], settings: Mapping[str, UserValue], *arguments: str
) -> None:
    """Checks that settings are fields of the parameters; a message also lists the arguments."""
    fields = [option for option in params.options() if option != "levels"]
    check_names(settings, [*arguments, *fields])


def _makers(params: Params, spaces: Untyped) -> Untyped:
    """Takes the needed classes out of a module.

    Rejax copies environments, and modules cannot be copied.
    """
    check_module(params, spaces, "gymnax.environments.spaces", "spaces", "Discrete")
    return SimpleNamespace(Discrete=spaces.Discrete, Box=spaces.Box)


def _check_alone(environment: UserValue) -> None:
    """Checks that the environment is not one of many robots."""
    if isinstance(environment, Environment) and environment.shared:
        raise InputError(
            "environment",
            "one of one robot",
            "one of many robots",
            "gymnasium_vector_env, jaxmarl_env and pettingzoo_env take it",
        )


class GymnaxEnv:
    """The interface of Gymnax's environments, for its loops and those of Rejax and PureJaxRL.

    `step` resets automatically, `step_env` does not. The info is a dictionary of the environment's
    metrics, ``terminated``, ``truncated``, ``final_observation``, the observation after the action,
    and ``discount``, 0 if the episode terminated.
    """

    def __init__(
        self, environment: Environment, params: Params, spaces: Untyped, *, values: int = 6
    ) -> None:
        """Wraps an environment.

        Args:
          environment: `RoadNav` or `LaneDrive`.
          params: its options.
          spaces: the module ``gymnax.environments.spaces``.
          values: the number of values that `step` returns: 6 as in Gymnax 1.0 (observation, state,
            reward, terminated, truncated, info), or 5 as before and in Rejax 0.1 (observation,
            state, reward, done, info).

        Raises:
          InputError: for an environment of many robots, options out of their range, or another
            module or number of values.
        """
        _check_alone(environment)
        if not is_whole(values) or values not in (5, 6):
            raise InputError("values", "5 or 6", quote(values))
        self._environment = flattened(environment)
        self._resetting = auto_reset(self._environment)
        self._spaces = _makers(params, spaces)
        self._returns_six = values == 6
        self.default_params = params
        self.name = type(params).__name__.removesuffix("Params")
        self.num_actions = environment.actions or environment.action_size

    def __setattr__(self, name: str, value: UserValue) -> None:
        """Sets an attribute; raises `InputError` for options, which would change nothing."""
        options = {"params"}
        if "default_params" in vars(self):
            options |= self.default_params.options().keys()
        if name in options:
            raise InputError(name, "it in the argument params of reset and step", "an attribute")
        if name == "num_actions" and name in vars(self):
            raise InputError(name, f"{self.num_actions}, as the environment has", quote(value))
        super().__setattr__(name, value)

    @runs_jax
    def reset(self, key: Key[Array, ""], params: Params | None = None) -> tuple[Array, Pytree]:
        """Starts an episode on a level drawn from the parameters: (observation, state)."""
        return self._environment.reset(key, self._or_default(params))

    def step(
        self, key: Key[Array, ""], state: Pytree, action: Pytree, params: Params | None = None
    ) -> tuple[Pytree, ...]:
        """Makes a step, and a reset if the episode ended."""
        return self._step(self._resetting, key, state, action, params)

    def reset_env(self, key: Key[Array, ""], params: Params | None = None) -> tuple[Array, Pytree]:
        """Does the same as `reset`."""
        return self.reset(key, params)

    def step_env(
        self, key: Key[Array, ""], state: Pytree, action: Pytree, params: Params | None = None
    ) -> tuple[Pytree, ...]:
        """Makes a step without a reset."""
        return self._step(self._environment, key, state, action, params)

    def action_space(self, params: Params | None = None) -> Untyped:
        """Returns the space of actions."""
        return action_space(self._environment, self._spaces)

    def observation_space(self, params: Params | None = None) -> Untyped:
        """Returns the space of observations."""
        return observation_space(self._environment, self._or_default(params), self._spaces)

    def _or_default(self, params: Params | None) -> Params:
        return self.default_params if params is None else params

    @runs_jax
    def _step(
        self,
        environment: Environment,
        key: Array,
        state: Pytree,
        action: Pytree,
        params: Params | None,
    ) -> tuple[Pytree, ...]:
        done = environment.step(key, state, action, self._or_default(params))
        info = done.info | {
            "terminated": done.terminated,
            "truncated": done.truncated,
            "final_observation": done.reached,
            "discount": 1 - done.terminated.astype(jnp.float32),
        }
        if self._returns_six:
            ends: tuple[Array, ...] = (done.terminated, done.truncated)
        else:
            ends = (done.terminated | done.truncated,)
        return done.observation, done.state, done.reward, *ends, info


@name_wrong_arguments
def gymnasium_env(
    environment: Environment,
    params: Params,
    gymnasium: Untyped,
    *,
    render: Callable[[Pytree], NDArray[np.uint8]] | None = None,
) -> GymnasiumEnv:
    """Makes an environment of Gymnasium for programs without JAX: its arrays are NumPy's.

    ``reset(options={"level": 3})`` starts on the level with index 3 of ``params.levels``. The
    attribute `params` may be replaced. Later resets draw from the new levels.

    Args:
      environment: `RoadNav` or `LaneDrive`.
      params: its options.
      gymnasium: the module ``gymnasium``.
      render: takes a state and returns a picture uint8 ``[H, W, 3]``; with it `render_mode` is
        "rgb_array".

    Raises:
      InputError: for an environment of many robots, options out of their range, another module, or
        a `render` that is no function.
    """
    _check_alone(environment)
    check_module(params, gymnasium, "gymnasium", "gymnasium", "Env")
    draw = check_render(render)
    # Gymnasium's environments do not reset by themselves.
    batch = Batch(environment, params, 1, DISABLED)
    shape, whole = action_shape(environment, params).shape, environment.actions is not None

    class Env(HasParams, gymnasium.Env):
        """The environment."""

        metadata = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012
        render_mode = None if draw is None else "rgb_array"
        action_space, observation_space = batch.spaces(gymnasium.spaces)

        def reset(
            self, *, seed: int | None = None, options: Untyped = None
        ) -> tuple[Pytree, dict[str, Untyped]]:
            level = read_options(options, "level").get("level")
            observation = self._batch.reset([seed], levels=[level])[0]
            # Gymnasium takes no number of NumPy.
            super().reset(seed=None if seed is None else int(seed))
            return observation, {}

        def step(self, action: Pytree) -> tuple[Pytree, float, bool, bool, dict[str, Untyped]]:
            # Checked here too, because messages of the batch have its axis.
            array = check_actions(action, shape, whole=whole, subject="action")
            done = self._batch.step(array[None])
            # The ellipsis keeps an array of NumPy. A plain index would return a scalar.
            metrics = {name: metric[0, ...] for name, metric in done.metrics.items()}
            ended = bool(done.terminated[0]), bool(done.truncated[0])
            return done.observation[0], float(done.reward[0]), *ended, metrics

        def render(self) -> Untyped:
            return None if draw is None else draw(self._batch)[0]

    return Env().made(batch)
