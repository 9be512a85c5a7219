"""The archive of MAP-Elites as the source of levels: each niche of a search is drawn as often as the others.

The archive is evolved once, by cyclomatic number and share of straights, and knows nothing of the space or the agent.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Key

from elitelanes_jax import evolve
from elitelanes_jax.drive import Level, random_level
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout
from experiments.navigation.ued.spaces import Space

__all__ = ["train"]

AXES = "cyclomatic:10:1 straight_share:10:80"


def train(key: Key[Array, ""], space: Space, ppo: Ppo, *, evaluations: int = 20_000) -> Iterator[Agent]:
    """Trains an agent; yields it after each round."""
    fill = bool((space.grids > 0).all())
    height, width = space.grids.shape[1:]
    shape = (height, width)
    archive = evolve(key, shape, evaluations=evaluations, fill=fill, axes=AXES, progress=False)
    elites = np.asarray(archive.elites.grids)[np.asarray(archive.elites.valid)]
    grids = jnp.asarray(elites.reshape(-1, *shape))
    agent = new_agent(key, _draw_levels(key, grids, ppo.envs), ppo)
    for number in range(ppo.updates):
        drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 3)
        driven = rollout(driving, agent, _draw_levels(drawing, grids, ppo.envs), ppo)
        agent = learn(learning, agent, driven, ppo)
        yield agent


def _draw_levels(key: Array, grids: Array, count: int) -> Level:
    choosing, placing = jax.random.split(key)
    chosen = grids[jax.random.randint(choosing, (count,), 0, len(grids))]
    return _place(jax.random.split(placing, count), chosen)


_place = jax.jit(jax.vmap(random_level))
