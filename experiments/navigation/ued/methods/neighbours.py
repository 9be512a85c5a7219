"""Levels are drawn by a predicted regret: each round computes it exactly for a few goals, and spreads it to neighbours.

A goal is a node of a network. One dynamic programme gives the exact regret from all starts to one goal, and asks the
policy only at the choices of one network. The method remembers these figures until it looks at the goal again. The
regret of a level whose goal it never looked at is predicted from the levels with the same start, and a goal one tile
away.
"""

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float32, Int, Key

from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout
from experiments.navigation.ued.regret import regret_to_goals
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["next_goals", "predict", "train", "train_without_spread"]

GOALS = 96
"""The goals that a round looks at, of 2,320 in 6 x 6 A. Two pilot seeds: worst 1 % 0.51 with 96, and 0.92 with 48."""

UNKNOWN = 1.0
"""The predicted regret before any regret is known."""


def train(key: Key[Array, ""], space: Space, ppo: Ppo, *, goals: int = GOALS, spread: bool = True) -> Iterator[Agent]:
    """Trains an agent; yields it after each round.

    Args:
      key: consumed.
      space: the levels.
      ppo: settings of the training.
      goals: how many goals a round looks at. Half are drawn by their predicted regret, and half uniformly.
      spread: whether the regret spreads to neighbours. Otherwise an unknown regret is predicted as the mean of all
        known ones.
    """
    agent = new_agent(key, levels_of(space, draw(key, space, ppo.envs)), ppo)
    is_level = np.asarray(space.distance) > 0
    is_next = next_goals(space) if spread else np.zeros_like(is_level)
    regret = np.full(is_level.shape, np.nan, np.float32)
    for number in range(ppo.updates):
        choosing, drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 4)
        network, goal = _choose_goals(choosing, predict(regret, is_level, is_next), is_level, goals)
        exact = regret_to_goals(agent.weights, space, jnp.asarray(network), jnp.asarray(goal))
        regret[network, :, goal] = np.where(is_level[network, :, goal], exact, np.nan)
        levels = levels_of(space, _draw_levels(drawing, space, predict(regret, is_level, is_next), ppo.envs))
        driven = rollout(driving, agent, levels, ppo)
        agent = learn(learning, agent, driven, ppo)
        yield agent


train_without_spread = partial(train, spread=False)


def next_goals(space: Space) -> Bool[np.ndarray, "G N N"]:
    """Returns which nodes of each network are one tile apart: a turn leads from one to the other."""
    onward = np.asarray(space.onward)
    networks, count = onward.shape[:2]
    is_next = np.zeros((networks, count, count), bool)
    is_next[np.arange(networks)[:, None, None], np.arange(count)[:, None], onward] = True
    return is_next | is_next.swapaxes(1, 2)


def predict(
    regret: Float32[np.ndarray, "G N N"], is_level: Bool[np.ndarray, "G N N"], is_next: Bool[np.ndarray, "G N N"]
) -> Float32[np.ndarray, "G N N"]:
    """Predicts the regret of all levels of a space; 0 where a start and a goal are no level.

    A known regret stays. An unknown one becomes the mean of the known ones with the same start whose goal is one tile
    away. Without such neighbours it becomes the mean of all known ones, or `UNKNOWN`.

    Args:
      regret: by network, start and goal; NaN where it is unknown.
      is_level: whether a start and a goal are a level.
      is_next: see `next_goals`.
    """
    is_known = ~np.isnan(regret)
    known, near = np.where(is_known, regret, 0), is_next.astype(np.float32)
    neighbours = is_known.astype(np.float32) @ near
    mean = known.sum() / is_known.sum() if is_known.any() else UNKNOWN
    spread = np.where(neighbours > 0, known @ near / np.maximum(neighbours, 1), mean)
    return np.where(is_known, regret, np.where(is_level, spread, 0)).astype(np.float32)


def _choose_goals(
    key: Array, predicted: Float32[np.ndarray, "G N N"], is_level: Bool[np.ndarray, "G N N"], count: int
) -> tuple[Int[np.ndarray, " K"], Int[np.ndarray, " K"]]:
    """Draws goals without repetition: the networks and the nodes. A goal's weight is the sum over its starts."""
    first, second = jax.random.split(key)
    is_goal = is_level.any(axis=1).reshape(-1)
    weight = np.where(is_goal, predicted.sum(axis=1).reshape(-1).clip(1e-6), 0)
    count = min(count, is_goal.sum())
    by_regret = _draw_apart(first, weight, count // 2)
    is_goal[by_regret] = False
    uniform = _draw_apart(second, is_goal, count - count // 2)
    return np.divmod(np.concatenate([by_regret, uniform]), predicted.shape[2])


def _draw_apart(key: Array, weight: np.ndarray, count: int) -> Int[np.ndarray, " K"]:
    """Draws different numbers in proportion to weights, one after the other: the largest of log-weights with noise."""
    with np.errstate(divide="ignore"):
        log = np.log(weight.astype(np.float32))
    return np.asarray(jnp.argsort(-(log + jax.random.gumbel(key, log.shape)))[:count])


def _draw_levels(key: Array, space: Space, predicted: Float32[np.ndarray, "G N N"], count: int) -> Array:
    """Draws numbers of levels in proportion to their predicted regret."""
    total = np.cumsum(predicted.reshape(-1)[np.asarray(space.pairs)].clip(0), dtype=np.float64)
    at = np.asarray(jax.random.uniform(key, (count,)), np.float64) * total[-1]
    return jnp.asarray(np.searchsorted(total, at, side="right"))
