"""The agent that all methods train: its task, its network, rollouts on levels, and what a rollout says of a level."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import linen as nn
from jaxtyping import Array, Bool, Float, Key

from elitelanes_jax.drive import Level, RoadNav, RoadNavParams, auto_replay, make_levels
from experiments.common import Pytree
from experiments.navigation.drivers import MapNetwork, at_choices
from experiments.navigation.ppo import Driven, Driver, Ppo, advantages, begin, collect
from experiments.navigation.ppo import learn as learn_from

__all__ = [
    "NETWORK",
    "PPO",
    "Agent",
    "Scores",
    "episode_means",
    "learn",
    "new_agent",
    "params",
    "rollout",
    "score",
    "settings",
]

WINDOW = 13
"""The side of the observed window: all of a map of 7 x 7 tiles from each of its tiles."""

LIMIT = 96
"""The most tiles of an episode. The longest shortest way in a space of 7 x 7 A has 89."""

PPO = Ppo(updates=120, envs=192, steps=48, epochs=3, rate=2e-3, discount=0.99)
"""Rounds of 192 levels and 48 decisions. An episode has at most 48, because crossings are not linked to each other."""


class LevelNetwork(MapNetwork):
    """Sees the map around itself, the goal if it is in the window, and the compass; no memory.

    The compass tells where the goal is on maps that are larger than the window.
    """

    def _goal(self, seen: Pytree) -> Array:
        is_visible = seen.mark.any(axis=(-1, -2))[..., None]
        compass = seen.compass * jnp.array([1, 1, 0.1])
        return super()._goal(seen) * is_visible + nn.Dense(self.width)(compass)


NETWORK = LevelNetwork()


def settings(rounds: int, *, quick: bool) -> Ppo:
    """Returns `PPO` with a number of rounds; a quick one has few levels side by side, to test a program."""
    ppo = PPO._replace(updates=rounds)
    return ppo._replace(envs=16, minibatches=2) if quick else ppo


def params() -> RoadNavParams:
    """Returns the options of the task. The levels in it are not used: methods choose the levels."""
    unused = make_levels(jax.random.key(0), [[[6, 3], [12, 9]]])
    return RoadNavParams(unused, limit=LIMIT, tile_cost=0.01, window=WINDOW, goal="both", whole_map=True)


_ENVIRONMENT = auto_replay(at_choices(RoadNav))


class Agent(NamedTuple):
    """Weights of the network, and the state of their optimiser."""

    weights: Pytree
    optimizer: Pytree


@partial(jax.jit, static_argnames="ppo")
def new_agent(key: Key[Array, ""], levels: Level, ppo: Ppo) -> Agent:
    """Returns an agent with random weights for levels ``[B]`` of this size; the key is consumed."""
    seen, states = jax.vmap(_ENVIRONMENT.reset_to_level, (None, 0, None))(key, levels, params())
    driver = begin(key, seen, states, NETWORK, ppo)
    return Agent(driver.weights, driver.optimizer)


@partial(jax.jit, static_argnames="ppo")
def rollout(key: Key[Array, ""], agent: Agent, levels: Level, ppo: Ppo) -> Driven:
    """Drives ``ppo.steps`` decisions on each of the levels, which begin again when they end; the key is consumed."""
    resetting, driving = jax.random.split(key)
    count = len(levels.grid)
    seen, states = jax.vmap(_ENVIRONMENT.reset_to_level, (None, 0, None))(resetting, levels, params())
    driver = Driver(*agent, states, seen, jnp.ones(count, bool), jnp.zeros((count, NETWORK.memory)))
    return collect(driving, driver, params(), _ENVIRONMENT, NETWORK, ppo.steps)[1]


@partial(jax.jit, static_argnames="ppo")
def learn(key: Key[Array, ""], agent: Agent, driven: Driven, ppo: Ppo) -> Agent:
    """Makes an update of PPO from a rollout; the key is consumed."""
    memory = jnp.zeros((driven.first.shape[1], NETWORK.memory))
    return Agent(*learn_from(key, *agent, memory, driven, NETWORK, ppo, True))


class Scores(NamedTuple):
    """What a rollout says of each of its levels, float32 ``[B]``.

    Attributes:
      positive_value_loss: the mean of the positive advantages (Jiang et al., "Replay-guided adversarial environment
        design", 2021).
      max_mc: the highest return so far less the mean value, in the same article.
      learnability: p (1 - p) of the rate p of success (Rutherford et al., "No regrets", 2024).
      highest_return: so far.
    """

    positive_value_loss: Float[Array, " B"]
    max_mc: Float[Array, " B"]
    learnability: Float[Array, " B"]
    highest_return: Float[Array, " B"]


@partial(jax.jit, static_argnames="ppo")
def score(driven: Driven, ppo: Ppo, highest_return: Array | float = -jnp.inf) -> Scores:
    """Scores the levels of a rollout, from the episodes that ended in it.

    Args:
      driven: the rollout.
      ppo: of the agent.
      highest_return: of earlier rollouts on the same levels.
    """
    outcome = driven.reward, driven.value, driven.after, driven.terminated, driven.ended
    positive = jnp.maximum(advantages(*outcome, ppo.discount, ppo.trace), 0)
    returns, _, is_over = _episodes(driven.reward, driven.ended)
    highest = jnp.maximum(jnp.where(is_over, returns, -jnp.inf).max(axis=0), highest_return)
    # Only the goal pays, and it pays more than the tiles of one decision cost.
    successes = (driven.terminated & (driven.reward > 0)).sum(axis=0)
    success = successes / jnp.maximum(driven.ended.sum(axis=0), 1)
    return Scores(
        episode_means(positive, driven.ended),
        highest - episode_means(driven.value, driven.ended),
        success * (1 - success),
        highest,
    )


def _episodes(numbers: Array, ended: Array) -> tuple[Array, Array, Array]:
    """Sums numbers by episode: sums ``[T, B]`` of episodes 0 to T - 1, their lengths, and which have ended."""
    episode = jnp.cumsum(ended, axis=0) - ended
    add = jax.vmap(partial(jax.ops.segment_sum, num_segments=len(ended)), 1, 1)
    is_over = jnp.arange(len(ended))[:, None] < ended.sum(axis=0)
    return add(numbers, episode), add(jnp.ones_like(numbers), episode), is_over


def episode_means(numbers: Float[Array, "T B"], ended: Bool[Array, "T B"]) -> Float[Array, " B"]:
    """Returns the mean, over the episodes that ended, of each episode's mean; 0 without an episode."""
    sums, lengths, is_over = _episodes(numbers, ended)
    means = jnp.where(is_over, sums / jnp.maximum(lengths, 1), 0)
    return means.sum(axis=0) / jnp.maximum(is_over.sum(axis=0), 1)
