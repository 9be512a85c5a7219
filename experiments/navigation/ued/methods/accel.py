"""ACCEL: robust prioritised level replay whose replayed levels are edited, and the edited levels scored.

Parker-Holder et al., "Evolving curricula with regret-based environment design", 2022. An edit is one of our moves on
the network. Edited networks may leave the space.
"""

from collections.abc import Iterator

import jax
import jax.numpy as jnp
from jaxtyping import Array, Key

from elitelanes_jax import repair
from elitelanes_jax.drive import UNREACHABLE, Level, distances, random_level
from elitelanes_jax.optimizers import MoveWeights, random_move
from experiments.navigation.ppo import Ppo
from experiments.navigation.ued.agent import Agent, learn, new_agent, rollout, score
from experiments.navigation.ued.methods.plr import UNSEEN, LevelBuffer
from experiments.navigation.ued.spaces import Space, draw, levels_of

__all__ = ["edit", "train"]


def train(key: Key[Array, ""], space: Space, ppo: Ppo, *, capacity: int = 2048) -> Iterator[Agent]:
    """Trains an agent; yields it after each round, also after those that only score levels."""
    levels = levels_of(space, draw(key, space, ppo.envs))
    rounds = ppo.updates
    # A third of the rounds replays: each replay is followed by a round of edits, and as many rounds are new levels.
    ppo = ppo._replace(updates=max(1, rounds // 3))
    agent = new_agent(key, levels, ppo)
    buffer = LevelBuffer(jax.tree.map(lambda part: part[0], levels), capacity, UNSEEN)
    edits_follow = False
    for number in range(rounds):
        deciding, drawing, driving, learning = jax.random.split(jax.random.fold_in(key, number), 4)
        if edits_follow:
            levels = edit(drawing, levels)
        elif replays := buffer.replays(deciding):
            places, levels, extra = buffer.sample(drawing, ppo.envs)
        else:
            levels = levels_of(space, draw(drawing, space, ppo.envs))
        driven = rollout(driving, agent, levels, ppo)
        if not edits_follow and replays:
            scores = score(driven, ppo, extra["highest_return"])
            buffer.update(places, scores.max_mc, {"highest_return": scores.highest_return})
            agent = learn(learning, agent, driven, ppo)
            edits_follow = True
        else:
            scores = score(driven, ppo)
            buffer.insert(levels, scores.max_mc, {"highest_return": scores.highest_return})
            edits_follow = False
        yield agent


@jax.jit
def edit(key: Key[Array, ""], levels: Level) -> Level:
    """Changes the network of each level by a move and repair; the key is consumed.

    The start and the goal stay, unless no way leads from one to the other any more. Then both are drawn.
    """
    move = random_move(MoveWeights(), fill=True)

    def edit_level(key: Array, level: Level) -> Level:
        changing, drawing = jax.random.split(key)
        grid = repair(*move.apply(jax.random.bits(changing, (move.bits,), jnp.uint32), level.grid), fill=True)
        shortest = distances(grid, level.goal)[level.start.row, level.start.column, level.start.heading]
        edited = level._replace(grid=grid, shortest=shortest)
        drawn = random_level(drawing, grid)._replace(ways=level.ways)
        is_level = (shortest > 0) & (shortest < UNREACHABLE)
        return jax.tree.map(lambda new, old: jnp.where(is_level, new, old), edited, drawn)

    return jax.vmap(edit_level)(jax.random.split(key, len(levels.grid)), levels)
