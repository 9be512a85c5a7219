"""The oracle: levels are drawn in proportion to the agent's true regret, which no other method knows.

The regret of all levels is computed again at eight times of the training.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout
from experiments.navigation.ued.regret import evaluate
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["train"]

TIMES = 8


def train(key: Key[Array, ""], space: Space, ppo: Ppo) -> Iterator[Agent]:
    """Trains an agent; yields it after each round."""
    agent = new_agent(key, levels_of(space, draw(key, space, ppo.envs)), ppo)
    refresh = -(-ppo.updates // TIMES)
    for number in range(ppo.updates):
        drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 3)
        if number % refresh == 0:
            regret = np.asarray(evaluate(agent.weights, space, greedy=False).regret, np.float64)
            total = np.cumsum(regret.clip(0))
        at = np.asarray(jax.random.uniform(drawing, (ppo.envs,)), np.float64) * total[-1]
        levels = levels_of(space, jnp.asarray(np.searchsorted(total, at, side="right")))
        driven = rollout(driving, agent, levels, ppo)
        agent = learn(learning, agent, driven, ppo)
        yield agent
