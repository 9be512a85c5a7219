"""TRACED: ACCEL whose levels are scored by value loss, transition-prediction loss and co-learnability.

Cho et al., "TRACED: Transition-aware regret approximation with co-learnability for environment design", 2025 (arXiv
2506.19997). The difficulty of a level is its positive value loss plus the loss of a model that predicts the next
observation. The co-learnability of the levels of a replay is by how much the difficulty of the next replay's levels has
fallen since they were last driven. Both weights are 1, as in the article's mazes.

Four things differ from the article's mazes. The model has no memory, because our agent has none and sees the whole
network. Its loss is the squared error: most of what the agent sees is 0, and a model that always predicts 0 has a small
absolute error. The loop is the one of our `accel`, so that the two rows differ in the score alone. Only replays have a
co-learnability.
"""

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import linen as nn
from jaxtyping import Array, Bool, Float, Key

from experiments.common import Pytree
from experiments.navigation.ppo import Driven, Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout, score
from experiments.navigation.ued.methods.accel import edit
from experiments.navigation.ued.methods.plr import LevelBuffer
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["TransitionModel", "train", "transition_loss"]

LOSS_WEIGHT = COLEARNABILITY_WEIGHT = 1.0
"""The article's alpha and beta."""

NEVER = -1
"""The round of learning of a level that the agent has not learned from."""


class TransitionModel(nn.Module):
    """Predicts what the agent sees after a decision, from what it sees before and the decision."""

    width: int = 256

    @nn.compact
    def __call__(self, picture: Float[Array, "T B P"], action: Array) -> Float[Array, "T B P"]:
        """Returns the predicted picture, see `_picture`, each number between 0 and 1."""
        x = jnp.concatenate([picture, jax.nn.one_hot(action, 3)], axis=-1)
        x = nn.relu(nn.Dense(self.width)(x))
        x = nn.relu(nn.Dense(self.width)(x))
        return nn.sigmoid(nn.Dense(picture.shape[-1])(x))


_MODEL = TransitionModel()
_OPTIMIZER = optax.adam(1e-3)


class Predictor:
    """A `TransitionModel` that scores levels by its loss, and then learns from them."""

    def __init__(self, key: Key[Array, ""], driven: Driven) -> None:
        """Makes a model with random weights for such rollouts; the key is consumed."""
        self._weights = _MODEL.init(key, _picture(driven.seen), driven.action)
        self._optimizer = _OPTIMIZER.init(self._weights)

    def difficulty(self, key: Key[Array, ""], driven: Driven, ppo: Ppo) -> Float[Array, " B"]:
        """Returns the difficulty of the levels of a rollout; the key is consumed."""
        self._weights, self._optimizer, loss = _score_and_learn(key, self._weights, self._optimizer, driven, ppo)
        return score(driven, ppo).positive_value_loss + LOSS_WEIGHT * loss


def train(key: Key[Array, ""], space: Space, ppo: Ppo, *, capacity: int = 2048) -> Iterator[Agent]:
    """Trains an agent; yields it after each round, also after those that only score levels."""
    levels = levels_of(space, draw(key, space, ppo.envs))
    rounds = ppo.updates
    # A third of the rounds replays, see `accel`.
    ppo = ppo._replace(updates=max(1, rounds // 3))
    agent = new_agent(key, levels, ppo)
    unscored = {"difficulty": np.float32(0), "learned": np.int32(NEVER)}
    buffer = LevelBuffer(jax.tree.map(lambda part: part[0], levels), capacity, unscored)
    predictor = None
    edits_follow, last_replay = False, NEVER
    for number in range(rounds):
        deciding, drawing, driving, predicting, learning = jax.random.split(jax.random.fold_in(key, number), 5)
        if edits_follow:
            levels = edit(drawing, levels)
        elif replays := buffer.replays(deciding):
            places, levels, extra = buffer.sample(drawing, ppo.envs)
        else:
            levels = levels_of(space, draw(drawing, space, ppo.envs))
        driven = rollout(driving, agent, levels, ppo)
        predictor = predictor or Predictor(key, driven)
        difficulty = predictor.difficulty(predicting, driven, ppo)
        if not edits_follow and replays:
            if last_replay != NEVER:
                gain = (extra["difficulty"] - difficulty).mean()
                buffer.state = _credit(buffer.state, last_replay, COLEARNABILITY_WEIGHT * gain)
            buffer.update(places, difficulty, {"difficulty": difficulty, "learned": jnp.full(ppo.envs, number)})
            agent = learn(learning, agent, driven, ppo)
            edits_follow, last_replay = True, number
        else:
            buffer.insert(levels, difficulty, {"difficulty": difficulty, "learned": jnp.full(ppo.envs, NEVER)})
            edits_follow = False
        yield agent


def _credit(state: Pytree, replay: int, gain: Array) -> Pytree:
    """Adds the co-learnability of a replay to the scores of its levels that are still in the buffer."""
    is_credited = state["levels_extra"]["learned"] == replay
    return {**state, "scores": state["scores"] + jnp.where(is_credited, gain, 0)}


def _picture(seen: Pytree) -> Float[Array, "T B P"]:
    """Returns the links ahead of and left of each tile of the window, and the goal's tile, as numbers 0 and 1."""
    layers = jnp.stack([seen.window & 8 > 0, seen.window & 1 > 0, seen.mark], axis=-1)
    return layers.reshape(*seen.mark.shape[:-2], -1).astype(jnp.float32)


def transition_loss(
    predicted: Float[Array, "T B P"], seen: Float[Array, "T B P"], ended: Bool[Array, "T B"]
) -> Float[Array, " B"]:
    """Returns the mean squared error of each level's predictions, without those across the end of an episode."""
    error = ((predicted[:-1] - seen[1:]) ** 2).mean(axis=-1)
    counts = ~ended[:-1]
    return (error * counts).sum(axis=0) / jnp.maximum(counts.sum(axis=0), 1)


@partial(jax.jit, static_argnames="ppo")
def _score_and_learn(
    key: Array, weights: Pytree, optimizer: Pytree, driven: Driven, ppo: Ppo
) -> tuple[Pytree, Pytree, Array]:
    """Returns new weights, a new state of the optimiser, and the loss of each level by the old weights."""
    picture = _picture(driven.seen)

    def losses(weights: Pytree, levels: Array) -> Array:
        seen = picture[:, levels]
        predicted = _MODEL.apply(weights, seen, driven.action[:, levels])
        return transition_loss(predicted, seen, driven.ended[:, levels])  # type: ignore[arg-type]

    def improve(carry: tuple[Pytree, Pytree], levels: Array) -> tuple[tuple[Pytree, Pytree], None]:
        weights, optimizer = carry
        gradient = jax.grad(lambda weights: losses(weights, levels).mean())(weights)
        updates, optimizer = _OPTIMIZER.update(gradient, optimizer)
        return (optax.apply_updates(weights, updates), optimizer), None

    loss = losses(weights, jnp.arange(ppo.envs))
    orders = jax.vmap(lambda key: jax.random.permutation(key, ppo.envs))(jax.random.split(key, ppo.epochs))
    parts = orders.reshape(ppo.epochs * ppo.minibatches, -1)
    (weights, optimizer), _ = jax.lax.scan(improve, (weights, optimizer), parts)
    return weights, optimizer, loss
