"""Robots that share a town, in the interfaces of JaxMARL and PettingZoo.

This module does not import these libraries. Each wrapper takes the module of its library as an
argument.
"""

import warnings
from collections.abc import Callable, Mapping

import jax
import numpy as np
from jaxtyping import Array, Key
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree, Untyped, UserValue
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._batch_programs import DISABLED
from elitelanes_jax.drive._environment import Environment
from elitelanes_jax.drive._flat import action_space, flattened, observation_space, robots_of
from elitelanes_jax.drive._library_types import JaxMarlEnv, Params, PettingZooEnv
from elitelanes_jax.drive._wrapper_base import (
    HasParams,
    check_module,
    check_render,
    read_options,
)


@name_wrong_arguments
def jaxmarl_env(environment: Environment, params: Params, jaxmarl: Untyped) -> JaxMarlEnv:
    """Makes a `MultiAgentEnv` of JaxMARL 0.2, for its loops: a robot is an agent.

    Observations are float32 vectors, see `flatten`. `step` resets automatically, `step_env` does
    not. The info is a dictionary of the environment's metrics, each ``[R]``, ``terminated`` and
    ``truncated``. `get_avail_actions` returns the actions that make sense. Compiled programs contain
    the options, so other options need another environment.

    Args:
      environment: `RoadTraffic`.
      params: its options.
      jaxmarl: the module ``jaxmarl``.

    Raises:
      InputError: for an environment of one robot, options out of their range, or another module.
    """
    _check_shared(environment)
    check_module(params, jaxmarl, "jaxmarl", "jaxmarl", "environments.multi_agent_env")
    spaces: Untyped = jaxmarl.environments.spaces
    flat, robots = flattened(environment), robots_of(environment, params)

    class MultiAgentEnv(jaxmarl.environments.multi_agent_env.MultiAgentEnv):
        """The environment."""

        name = type(params).__name__.removesuffix("Params")

        def __init__(self) -> None:
            super().__init__(num_agents=robots)
            self.action_spaces = {agent: action_space(flat, spaces) for agent in self.agents}
            self.observation_spaces = {
                agent: observation_space(flat, params, spaces) for agent in self.agents
            }
            self.params = params

        def __setattr__(self, name: str, value: UserValue) -> None:
            if "params" in vars(self) and (name == "params" or name in params.options()):
                raise InputError(name, "it in params of a new environment", "an attribute")
            super().__setattr__(name, value)

        def reset(self, key: Key[Array, ""]) -> tuple[dict[str, Array], Pytree]:
            observation, state = flat.reset(key, params)
            return self._by_agent(observation), state

        @runs_jax
        def step_env(
            self, key: Key[Array, ""], state: Pytree, actions: Mapping[str, Array]
        ) -> tuple[Pytree, ...]:
            _check_actions(actions, self.agents)
            stacked = jax.numpy.stack([jax.numpy.asarray(actions[agent]) for agent in self.agents])
            done = flat.step(key, state, stacked, params)
            over = done.terminated | done.truncated
            dones = dict.fromkeys([*self.agents, "__all__"], over)
            ends = {"terminated": done.terminated, "truncated": done.truncated}
            by_robot = {name: jax.numpy.broadcast_to(end, robots) for name, end in ends.items()}
            observations = self._by_agent(done.observation)
            return (
                observations,
                done.state,
                self._by_agent(done.reward),
                dones,
                done.info | by_robot,
            )

        def get_obs(self, state: Pytree) -> dict[str, Array]:
            return self._by_agent(flat.observe(state, params))

        def get_avail_actions(self, state: Pytree) -> dict[str, Array]:
            return self._by_agent(environment.observe(state, params).allowed)

        @property
        def agent_classes(self) -> dict[str, list[str]]:
            return {"robot": self.agents}

        def _by_agent(self, rows: Array) -> dict[str, Array]:
            return dict(zip(self.agents, rows, strict=True))

    return MultiAgentEnv()


@name_wrong_arguments
def pettingzoo_env(
    environment: Environment,
    params: Params,
    pettingzoo: Untyped,
    *,
    render: Callable[[Pytree], NDArray[np.uint8]] | None = None,
) -> PettingZooEnv:
    """Makes a `ParallelEnv` of PettingZoo, for programs without JAX: a robot is an agent.

    Its arrays are NumPy's. Observations are float32 vectors, see `flatten`. The info of an agent has
    its metrics, and "action_mask", the actions that make sense, int8 ``[4]``. All agents leave
    together, at the end of the episode.

    ``reset(options={"level": 3})`` starts on the level with index 3 of ``params.levels``. Other
    options are ignored with a warning, because PettingZoo's own test gives one. The attribute
    `params` may be replaced. Other levels or slots need a reset.

    Args:
      environment: `RoadTraffic`.
      params: its options.
      pettingzoo: the module ``pettingzoo``.
      render: takes a state and returns a picture uint8 ``[H, W, 3]``; with it `render_mode` is
        "rgb_array".

    Raises:
      InputError: for an environment of one robot, options out of their range, another module, or a
        `render` that is no function.
    """
    _check_shared(environment)
    check_module(params, pettingzoo, "pettingzoo", "pettingzoo", "utils.env.ParallelEnv")
    draw = check_render(render)
    spaces: Untyped = pettingzoo.utils.env.gymnasium.spaces
    batch = Batch(environment, params, 1, DISABLED)
    names = [f"robot_{index}" for index in range(batch.robots)]

    class ParallelEnv(HasParams, pettingzoo.ParallelEnv):
        """The environment."""

        metadata = {  # noqa: RUF012
            "name": type(params).__name__.removesuffix("Params"),
            "render_modes": ["rgb_array"],
            "render_fps": 10,
        }
        render_mode = None if draw is None else "rgb_array"

        def __init__(self) -> None:
            self.possible_agents = list(names)
            self.agents: list[str] = []
            # PettingZoo asks for a space of its own for each agent, which has a seed.
            agents_spaces = {agent: batch.spaces(spaces) for agent in names}
            self.action_spaces = {agent: actions for agent, (actions, _) in agents_spaces.items()}
            self.observation_spaces = {agent: seen for agent, (_, seen) in agents_spaces.items()}

        def action_space(self, agent: str) -> Untyped:
            return self.action_spaces[agent]

        def observation_space(self, agent: str) -> Untyped:
            return self.observation_spaces[agent]

        def reset(
            self, seed: UserValue = None, options: UserValue = None
        ) -> tuple[dict[str, np.ndarray], dict[str, dict[str, Untyped]]]:
            level = _read_level(options)
            rows = self._batch.reset([seed] * len(names), levels=[level] * len(names))
            self.agents = list(names)
            observations = dict(zip(names, rows, strict=True))
            return observations, {agent: _with_mask({}, row) for agent, row in observations.items()}

        def step(
            self, actions: Mapping[str, UserValue]
        ) -> tuple[
            dict[str, np.ndarray],
            dict[str, float],
            dict[str, bool],
            dict[str, bool],
            dict[str, dict[str, Untyped]],
        ]:
            if not self.agents:
                raise InputError("step", "a reset, because no robot drives", "none")
            _check_actions(actions, names)
            done = self._batch.step([actions[agent] for agent in names])
            observations = dict(zip(names, done.observation, strict=True))
            infos = {}
            for index, (agent, row) in enumerate(observations.items()):
                metrics = {name: metric[index] for name, metric in done.metrics.items()}
                infos[agent] = _with_mask(metrics, row)
            terminated, truncated = bool(done.terminated[0]), bool(done.truncated[0])
            if terminated or truncated:
                self.agents = []
            return (
                observations,
                dict(zip(names, done.reward.tolist(), strict=True)),
                dict.fromkeys(names, terminated),
                dict.fromkeys(names, truncated),
                infos,
            )

        def render(self) -> Untyped:
            return None if draw is None else draw(self._batch)[0]

    return ParallelEnv().made(batch)


def _check_shared(environment: UserValue) -> None:
    if isinstance(environment, Environment) and not environment.shared:
        raise InputError(
            "environment", "one of many robots, such as RoadTraffic", "one of one robot"
        )


def _check_actions(actions: UserValue, agents: list[str]) -> None:
    if not isinstance(actions, Mapping) or set(actions) != set(agents):
        expected = f"an action of each agent, {agents[0]} to {agents[-1]}"
        raise InputError("actions", expected, quote(actions))


def _read_level(options: UserValue) -> UserValue:
    """Returns the option "level"; warns of any other."""
    if isinstance(options, Mapping):
        for name in options:
            if name != "level":
                message = f"pettingzoo_env: expected the option level, got {quote(name)}"
                warnings.warn(message, stacklevel=3)
        options = {name: options[name] for name in options if name == "level"}
    return read_options(options, "level").get("level")


def _with_mask(metrics: dict[str, Untyped], observation: np.ndarray) -> dict[str, Untyped]:
    # An observation begins with the actions that make sense.
    return metrics | {"action_mask": (observation[:4] > 0).astype(np.int8)}
