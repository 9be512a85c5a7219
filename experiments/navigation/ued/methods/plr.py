"""Prioritised level replay, and its robust form, which learns from replayed levels alone.

Jiang et al., "Prioritized level replay", 2021, and "Replay-guided adversarial environment design", 2021. The levels are
kept by JaxUED's sampler, and scored by MaxMC.
"""

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Key

from elitelanes_jax.drive import Level
from experiments.common import Untyped
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout, score
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["UNSEEN", "LevelBuffer", "robust_train", "train"]

REPLAY = 0.5
"""The probability that a round replays levels, once half of the buffer is filled."""

Extra: TypeAlias = Mapping[str, Array | np.generic]
"""The extra numbers of one level, or of a batch, by name."""

UNSEEN: Extra = {"highest_return": np.float32(-np.inf)}
"""The extra numbers of a level for MaxMC, before its first rollout."""


class LevelBuffer:
    """JaxUED's `LevelSampler` with its state. A level that comes again updates its score.

    Beside its score, a level has extra numbers by name.
    """

    def __init__(self, level: Level, capacity: int, extra: Extra) -> None:
        """Makes an empty buffer of levels like this one, with such extra numbers."""
        # JaxUED 0.0.1 calls it, and JAX 0.10 has it no longer.
        jax.tree_map = jax.tree.map  # type: ignore[attr-defined]
        from jaxued.level_sampler import LevelSampler

        self._sampler = LevelSampler(
            capacity,
            replay_prob=REPLAY,
            staleness_coeff=0.3,
            minimum_fill_ratio=0.5,
            prioritization="rank",
            prioritization_params={"temperature": 0.3},
            duplicate_check=True,
        )
        self._sample = jax.jit(self._sampler.sample_replay_levels, static_argnums=2)
        self._insert, self._update = jax.jit(self._sampler.insert_batch), jax.jit(self._sampler.update_batch)
        self.state: Untyped = self._sampler.initialize(level, extra)

    def replays(self, key: Array) -> bool:
        """Draws whether the next round replays levels."""
        return bool(self._sampler.sample_replay_decision(self.state, key))

    def sample(self, key: Array, count: int) -> tuple[Array, Level, dict[str, Array]]:
        """Draws levels by score and age: their places, the levels, and their extra numbers."""
        self.state, (places, levels) = self._sample(self.state, key, count)
        return places, levels, {name: values[places] for name, values in self.state["levels_extra"].items()}

    def insert(self, levels: Level, scores: Array, extra: Extra) -> None:
        """Inserts levels that score higher than the levels that they replace."""
        self.state, _ = self._insert(self.state, levels, scores, extra)

    def update(self, places: Array, scores: Array, extra: Extra) -> None:
        """Changes the scores and the extra numbers of levels."""
        self.state = self._update(self.state, places, scores, extra)


def train(
    key: Key[Array, ""], space: Space, ppo: Ppo, *, robust: bool = False, capacity: int = 2048
) -> Iterator[Agent]:
    """Trains an agent; yields it after each round, also after those that only score new levels."""
    levels = levels_of(space, draw(key, space, ppo.envs))
    if robust:
        ppo = ppo._replace(updates=max(1, int(ppo.updates * REPLAY)))  # for the rate, which falls as the agent learns
    agent = new_agent(key, levels, ppo)
    buffer = LevelBuffer(jax.tree.map(lambda part: part[0], levels), capacity, UNSEEN)
    rounds = int(ppo.updates / REPLAY) if robust else ppo.updates
    for number in range(rounds):
        deciding, drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 4)
        replays = buffer.replays(deciding)
        if replays:
            places, levels, extra = buffer.sample(drawing, ppo.envs)
            driven = rollout(driving, agent, levels, ppo)
            scores = score(driven, ppo, extra["highest_return"])
            buffer.update(places, scores.max_mc, {"highest_return": scores.highest_return})
        else:
            levels = levels_of(space, draw(drawing, space, ppo.envs))
            driven = rollout(driving, agent, levels, ppo)
            scores = score(driven, ppo)
            buffer.insert(levels, scores.max_mc, {"highest_return": scores.highest_return})
        if replays or not robust:
            agent = learn(learning, agent, driven, ppo)
        yield agent


robust_train = partial(train, robust=True)
