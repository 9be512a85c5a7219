"""Sampling for learnability: rounds drive on levels that the agent sometimes solves, and on random ones.

Rutherford et al., "No regrets: investigating and improving regret approximations for curriculum discovery", 2024.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout, score
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["train"]

SCORED, LEARNED = 4, 8
"""Rounds that score candidates, and then rounds that learn from the most learnable batch and as many random levels."""


def train(key: Key[Array, ""], space: Space, ppo: Ppo) -> Iterator[Agent]:
    """Trains an agent; yields it after each round, also after those that only score levels."""
    levels = levels_of(space, draw(key, space, ppo.envs))
    rounds = ppo.updates
    ppo = ppo._replace(updates=max(1, rounds * LEARNED // (SCORED + LEARNED)))
    agent = new_agent(key, levels, ppo)
    candidates: list[Array] = []
    learnability: list[Array] = []
    for number in range(rounds):
        drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 3)
        phase = number % (SCORED + LEARNED)
        drawn = draw(drawing, space, ppo.envs)
        if phase < SCORED:
            if phase == 0:
                candidates, learnability = [], []
            driven = rollout(driving, agent, levels_of(space, drawn), ppo)
            candidates.append(drawn)
            learnability.append(score(driven, ppo).learnability)
        else:
            order = jnp.argsort(-jnp.concatenate(learnability))
            best = jnp.concatenate(candidates)[order[: ppo.envs]]
            half = ppo.envs // 2
            chosen = jax.random.choice(drawing, best, (half,))
            levels = levels_of(space, jnp.concatenate([chosen, drawn[half:]]))
            driven = rollout(driving, agent, levels, ppo)
            agent = learn(learning, agent, driven, ppo)
        yield agent
