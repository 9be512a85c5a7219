"""Batches of environments in the interfaces of Gymnasium, Stable-Baselines3 and PufferLib.

This module does not import these libraries. Each wrapper takes the module of its library as an
argument.
"""

import inspect
import multiprocessing
import warnings
from collections.abc import Callable, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, is_whole, items_of, one_of
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.drive._batch import Batch, Outcome
from elitelanes_jax.drive._batch_programs import DISABLED, NEXT_STEP, SAME_STEP
from elitelanes_jax.drive._environment import Environment
from elitelanes_jax.drive._library_types import (
    GymnasiumVectorEnv,
    Params,
    PufferLibEnv,
    StableBaselines3VecEnv,
)
from elitelanes_jax.drive._wrapper_base import (
    HasParams,
    check_module,
    check_render,
    read_options,
)

_Render = Callable[[Pytree], NDArray[np.uint8]]


@name_wrong_arguments
def gymnasium_vector_env(
    environment: Environment,
    params: Params,
    gymnasium: Untyped,
    *,
    envs: int = 256,
    autoreset_mode: UserValue = NEXT_STEP,
    render: _Render | None = None,
) -> GymnasiumVectorEnv:
    """Makes a `VectorEnv` of Gymnasium 1.1 or later, for programs without JAX.

    Its arrays are NumPy's. It does what Gymnasium's `SyncVectorEnv` of `envs` environments of
    `gymnasium_env` does, with the same results, except that rewards are float32. Its attribute
    `next_observations` has the observations after the last actions, before any reset in the same
    step.

    ``reset(options={"level": 3})`` starts all environments on the level with index 3 of
    ``params.levels``, and a list has an index or None for each. The attribute `params` may be
    replaced, also by ``set_attr("params", other)``. Later resets draw from the new levels.

    With `RoadTraffic` each robot is a row, and the R robots of an environment are consecutive. An
    environment takes the seed and the level of its first row. Other levels or slots in `params` need
    a reset of all environments. `render` has a picture for each environment.

    Args:
      environment: `RoadNav`, `LaneDrive` or `RoadTraffic`.
      params: its options.
      gymnasium: the module ``gymnasium``.
      envs: the number of environments.
      autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode` of Gymnasium.
      render: takes a state and returns a picture uint8 ``[H, W, 3]``; with it `render_mode` is
        "rgb_array".

    Raises:
      InputError: for options out of their range, another module, or a `render` that is no function.
    """
    check_module(params, gymnasium, "gymnasium", "gymnasium", "vector.AutoresetMode")
    draw = check_render(render)
    # An `AutoresetMode` is an enumeration, whose value is the name of the mode.
    words = getattr(autoreset_mode, "value", autoreset_mode)
    mode = check_named("autoreset_mode", one_of(NEXT_STEP, SAME_STEP, DISABLED), words)
    batch = Batch(environment, params, envs, mode)
    batch_space = gymnasium.vector.utils.batch_space

    class VectorEnv(HasParams, gymnasium.vector.VectorEnv):
        """The environments."""

        def __init__(self) -> None:
            self.metadata = {"render_modes": ["rgb_array"], "render_fps": 30}
            self.metadata["autoreset_mode"] = gymnasium.vector.AutoresetMode(mode)
            self.render_mode = None if draw is None else "rgb_array"
            self.num_envs = batch.envs
            self.single_action_space, self.single_observation_space = batch.spaces(gymnasium.spaces)
            self.action_space = batch_space(self.single_action_space, batch.envs)
            self.observation_space = batch_space(self.single_observation_space, batch.envs)
            # Whether the episode of each environment has ended.
            self._over = np.zeros(batch.envs, bool)

        def reset(
            self, *, seed: UserValue = None, options: UserValue = None
        ) -> tuple[np.ndarray, dict[str, Untyped]]:
            named = read_options(options, "level", "reset_mask")
            chosen = _check_mask(named.get("reset_mask"), batch.envs)
            levels = _list_levels(named.get("level"), batch.envs)
            if is_whole(seed):
                observation = self._batch.reset(_list_seeds(seed, batch.envs), chosen, levels)
                super().reset(seed=int(seed))
            else:
                seeds: Untyped = seed
                observation = self._batch.reset(seeds, chosen, levels)
            self._over = self._over & ~chosen
            return observation, {}

        def step(
            self, actions: UserValue
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Untyped]]:
            over = self._over
            # Without resets, a step after the end of an episode has no meaning.
            if mode == DISABLED and over.any():
                ended = quote(np.flatnonzero(over).tolist())
                raise InputError(
                    "step", f"a reset of environments {ended}, whose episodes have ended", "none"
                )
            done = self._batch.step(actions)
            self._over, self.next_observations = done.terminated | done.truncated, done.reached
            if mode != SAME_STEP:
                # Both are the same observations, and the caller may write to each array.
                self.next_observations = done.reached.copy()
            if mode == SAME_STEP and self._over.any():
                infos = _final_infos(done.metrics, self._over, done.reached)
            else:
                infos = _with_masks(
                    done.metrics, ~over if mode == NEXT_STEP else np.ones(batch.envs, bool)
                )
            return done.observation, done.reward, done.terminated, done.truncated, infos

        def render(self) -> tuple[np.ndarray, ...] | None:
            # Robots that share a state share its picture.
            return None if draw is None else tuple(draw(self._batch))

        def get_attr(self, name: str) -> tuple[UserValue, ...]:
            return (getattr(self, name),) * batch.envs

        def set_attr(self, name: str, values: UserValue) -> None:
            self.check_settable(name)
            params = values if isinstance(values, list | tuple) else [values]
            if not params or any(value is not params[0] for value in params):
                raise InputError(
                    "set_attr",
                    "one params, which all environments share",
                    f"{len(params)} of them",
                )
            self.params = params[0]

    return VectorEnv().made(batch)


def _list_seeds(first: UserValue, envs: int) -> range:
    """Returns the seeds of environments: the first one, and the whole numbers after it."""
    if not is_whole(first):
        raise InputError("seed", "a whole number", quote(first))
    # The end may be too large for a small number of NumPy.
    start = int(first)
    return range(start, start + envs)


def _list_levels(level: UserValue, envs: int) -> Sequence[UserValue]:
    """Returns the level of each environment: a list of them, or one for all."""
    if isinstance(level, list | tuple) or getattr(level, "ndim", 0) == 1:
        return list(items_of(level))
    return [level] * envs


def _check_mask(mask: UserValue, envs: int) -> NDArray[np.bool_]:
    """Returns the environments that a reset starts anew, bool ``[N]``."""
    if mask is None:
        return np.ones(envs, bool)
    if (
        not isinstance(mask, np.ndarray)
        or mask.dtype != bool
        or mask.shape != (envs,)
        or not mask.any()
    ):
        raise InputError("reset_mask", f"bool [{envs}] with a True", quote(mask))
    return mask


def _with_masks(
    metrics: dict[str, np.ndarray], present: NDArray[np.bool_]
) -> dict[str, np.ndarray]:
    """Returns metrics as Gymnasium's infos: each with a mask of the environments that have it."""
    if not present.any():
        return {}
    return metrics | {f"_{name}": present for name in metrics}


def _masked(metrics: dict[str, np.ndarray], present: NDArray[np.bool_]) -> dict[str, np.ndarray]:
    """Returns infos that are 0 where the metrics are not present."""
    zero = {
        name: np.where(present, metric, np.zeros((), metric.dtype))
        for name, metric in metrics.items()
    }
    return _with_masks(zero, present)


def _final_infos(
    metrics: dict[str, np.ndarray], over: NDArray[np.bool_], reached: np.ndarray
) -> dict[str, Untyped]:
    """Returns the infos of a step after which some environments were reset.

    They also have the last observations of the episodes that are over.
    """
    # Gymnasium has an array of objects here, with None where no episode is over.
    last = np.full(len(over), None, object)
    for index in np.flatnonzero(over):
        last[index] = reached[index].copy()
    final = {
        "final_obs": last,
        "_final_obs": over,
        "final_info": _masked(metrics, over),
        "_final_info": over,
    }
    return final | _masked(metrics, ~over)


@name_wrong_arguments
def sb3_vec_env(
    environment: Environment,
    params: Params,
    stable_baselines3: Untyped,
    *,
    envs: int = 256,
    render: _Render | None = None,
) -> StableBaselines3VecEnv:
    """Makes a `VecEnv` of Stable-Baselines3 2, for programs without JAX.

    Its arrays are NumPy's, and pictures are uint8 ``[3, rows, columns]``. The info of an
    environment is empty until its episode ends. Then it has the metrics, `is_success` for the logs
    of Stable-Baselines3, "TimeLimit.truncated" and "terminal_observation". The attribute `metrics`
    has the metrics of every step by name, each ``[N]``.

    ``set_options({"level": 3})`` starts the next reset on the level with index 3 of
    ``params.levels``. ``set_attr("params", other)`` replaces the options of all environments. Later
    resets draw from the new levels.

    With `RoadTraffic` each robot is a row, and the R robots of an environment are consecutive. An
    environment takes the seed and the level of its first row. Other levels or slots in `params` need
    a reset.

    Args:
      environment: `RoadNav`, `LaneDrive` or `RoadTraffic`.
      params: its options.
      stable_baselines3: the module ``stable_baselines3``.
      envs: the number of environments.
      render: takes a state and returns a picture uint8 ``[H, W, 3]``; with it `render_mode` is
        "rgb_array".

    Raises:
      InputError: for options out of their range, another module, or a `render` that is no function.
    """
    name = "stable_baselines3"
    check_module(params, stable_baselines3, name, name, "common.vec_env.VecEnv")
    draw = check_render(render)
    base: Untyped = stable_baselines3.common.vec_env.base_vec_env
    batch = Batch(environment, params, envs, SAME_STEP, channels_first=True)

    class VecEnv(HasParams, base.VecEnv):
        """The environments."""

        render_mode = None if draw is None else "rgb_array"

        def reset(self) -> np.ndarray:
            try:
                named = [read_options(options, "level") for options in self._options]
                levels = [options.get("level") for options in named]
                return self._batch.reset(self._seeds, levels=levels)
            finally:
                # Stable-Baselines3 uses seeds and options for one reset only. Refused options would
                # be refused at each later reset.
                self._reset_seeds()
                self._reset_options()

        def step_async(self, actions: UserValue) -> None:
            self._batch.send(actions)

        def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Untyped]]]:
            done = self._batch.receive()
            over, self.metrics = done.terminated | done.truncated, done.metrics
            infos = [_last_info(done, index) if ended else {} for index, ended in enumerate(over)]
            return done.observation, done.reward, over, infos

        def close(self) -> None:
            pass

        def get_images(self) -> Sequence[np.ndarray | None]:
            if draw is None:
                warnings.warn(
                    "sb3_vec_env: expected render, to get pictures, got none", stacklevel=2
                )
                return [None] * batch.envs
            return draw(self._batch)

        def get_attr(self, attr_name: str, indices: UserValue = None) -> list[UserValue]:
            # The environments are one object.
            value = getattr(self, attr_name)
            return [value for _ in self._get_indices(indices)]

        def set_attr(self, attr_name: str, value: UserValue, indices: UserValue = None) -> None:
            self.check_settable(attr_name)
            chosen = set(self._get_indices(indices))
            if chosen != set(range(batch.envs)):
                got = quote(sorted(chosen))
                raise InputError("indices", "all environments, which share params", got)
            self.params = value

        def env_method(
            self,
            method_name: str,
            *arguments: UserValue,
            indices: UserValue = None,
            **options: UserValue,
        ) -> list[UserValue]:
            if method_name != "render":
                raise InputError(
                    "method_name", "render, the only method of one environment", quote(method_name)
                )
            images = self.get_images()
            # Robots that share a state share its picture.
            return [images[index // batch.robots] for index in self._get_indices(indices)]

        def env_is_wrapped(
            self, wrapper_class: type, indices: Iterable[int] | int | None = None
        ) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

    action_space, observation_space = batch.spaces(base.spaces)
    return VecEnv(batch.envs, observation_space, action_space).made(batch)


def _last_info(done: Outcome, index: int) -> dict[str, Untyped]:
    """Returns the info of an environment whose episode has ended, for Stable-Baselines3."""
    info = {name: metric[index].tolist() for name, metric in done.metrics.items()}
    # Stable-Baselines3 logs a rate of success from this name.
    if "success" in info:
        info["is_success"] = info["success"]
    info["TimeLimit.truncated"] = bool(done.truncated[index])
    info["terminal_observation"] = done.reached[index]
    return info


@name_wrong_arguments
def puffer_env(
    environment: Environment,
    params: Params,
    pufferlib: Untyped,
    *,
    envs: int = 256,
    buf: UserValue = None,
    seed: int = 0,
) -> PufferLibEnv:
    """Makes a native environment of PufferLib 3, a `PufferEnv` of `envs` environments.

    Pictures are ``[3, rows, columns]``. ``pufferlib.vector.make`` calls it: `buf` and `seed` are
    for that. Its backend `Multiprocessing` needs the start method spawn. The infos of a step are a
    list with the means of the metrics of the episodes that ended, or an empty list. The attribute
    `params` may be replaced. Later resets draw from the new levels. With `RoadTraffic`, other levels or
    slots need a reset.

    Args:
      environment: `RoadNav`, `LaneDrive` or `RoadTraffic`.
      params: its options.
      pufferlib: the module ``pufferlib``.
      envs: the number of environments. Each has one agent, or R of `RoadTraffic`.
      buf: the arrays that are written to; None for arrays of its own.
      seed: the seed of a reset that gets no seed, 0 to 2**32 - 1.

    Raises:
      InputError: for options out of their range, another module, or workers that would be forked.
    """
    check_module(params, pufferlib, "pufferlib", "pufferlib", "PufferEnv")
    _check_workers(pufferlib)
    start = check_named("seed", SEED, seed)
    batch = Batch(environment, params, envs, SAME_STEP, channels_first=True)

    class PufferEnv(HasParams, pufferlib.PufferEnv):
        """The environments."""

        single_action_space, single_observation_space = batch.spaces(
            pufferlib.emulation.gymnasium.spaces
        )
        num_agents = batch.envs

        def reset(self, seed: int | None = None) -> tuple[np.ndarray, list[dict[str, float]]]:
            seeds = _list_seeds(start if seed is None else seed, batch.envs)
            # PufferLib reads these arrays, so they are filled and not replaced.
            self.observations[:] = self._batch.reset(seeds)
            for zeroed in (self.rewards, self.terminals, self.truncations):
                zeroed[:] = 0
            return self.observations, []

        def step(
            self, actions: UserValue
        ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[dict[str, float]]]:
            done = self._batch.step(actions)
            self.observations[:], self.rewards[:] = done.observation, done.reward
            self.terminals[:], self.truncations[:] = done.terminated, done.truncated
            over, infos = done.terminated | done.truncated, []
            if over.any():
                infos.append(
                    {name: float(metric[over].mean()) for name, metric in done.metrics.items()}
                )
            return self.observations, self.rewards, self.terminals, self.truncations, infos

        def close(self) -> None:
            pass

    return PufferEnv(buf).made(batch)


def _check_workers(pufferlib: Untyped) -> None:
    """Checks that the workers of PufferLib's `Multiprocessing` are not forked.

    `Multiprocessing` makes an environment before its workers. Each forked worker would then raise an
    error, and `Multiprocessing` waits for its workers forever.
    """
    backend = getattr(getattr(pufferlib, "vector", None), "Multiprocessing", None)
    # The first method is the default. Asking for the method itself would set it.
    default, *_ = multiprocessing.get_all_start_methods()
    method = multiprocessing.get_start_method(allow_none=True) or default
    if backend is None or method != "fork":
        return
    frame = inspect.currentframe()
    while frame is not None:
        if isinstance(frame.f_locals.get("self"), backend):
            raise InputError(
                "Multiprocessing",
                "workers that are spawned",
                "the start method fork, with which JAX does not run",
                "call multiprocessing.set_start_method('spawn')",
            )
        frame = frame.f_back
