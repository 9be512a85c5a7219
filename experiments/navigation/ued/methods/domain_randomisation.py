"""Domain randomisation: every round drives on levels drawn uniformly."""

from collections.abc import Iterator

import jax
from jaxtyping import Array, Key

from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["train"]


def train(key: Key[Array, ""], space: Space, ppo: Ppo) -> Iterator[Agent]:
    """Trains an agent; yields it after each round."""
    levels = levels_of(space, draw(key, space, ppo.envs))
    agent = new_agent(key, levels, ppo)
    for number in range(ppo.updates):
        drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 3)
        levels = levels_of(space, draw(drawing, space, ppo.envs))
        driven = rollout(driving, agent, levels, ppo)
        agent = learn(learning, agent, driven, ppo)
        yield agent
