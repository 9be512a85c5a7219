"""Proximal policy optimisation: its parts against slow ones, and that it learns."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from elitelanes_jax.drive import Environment, LaneNode, Level, RoadNav, RoadNavParams, Transition, distances
from elitelanes_jax.drive._distances import shortest_ways
from elitelanes_jax.drive._environment import draw_level

ppo = pytest.importorskip("experiments.navigation.ppo", reason="flax and optax are not here", exc_type=ImportError)
from flax import linen as nn  # noqa: E402

from experiments.navigation import drivers  # noqa: E402


class Levels(NamedTuple):
    grid: jax.Array


class Params(NamedTuple):
    levels: Levels


class Info(NamedTuple):
    steps: jax.Array


def _begin(key, level, params):
    return level.grid, (level.grid, jnp.int32(0))


def _step(key, state, action, params):
    """Pays 1 for the action that is shown; 5 steps terminate an episode of levels over 0, 3 truncate that of 0."""
    shown, steps = state
    after = shown, steps + 1
    over = steps + 1 >= jnp.where(shown > 0, 5, 3)
    reward = (action == shown).astype(jnp.float32)
    return Transition(shown, after, reward, over & (shown > 0), over & (shown == 0), Info(steps + 1), shown)


def _observe(state, params):
    return state[0]


ECHO = Environment(lambda key, params: _begin(key, draw_level(key, params.levels), params), _begin, _step, _observe, 3)
PARAMS = Params(Levels(jnp.array([0, 1, 2])))


class Echo(nn.Module):
    """Counts the steps of an episode in its memory."""

    memory: int = 1

    @nn.compact
    def __call__(self, memory, seen, first):
        x = jax.nn.one_hot(seen, 3)
        return memory + 1, nn.Dense(3)(x), nn.Dense(1)(x)[..., 0]


def test_advantages_are_those_of_a_walk_back():
    rng = np.random.default_rng(0)
    reward, value, after = rng.normal(size=(3, 7, 4)).astype(np.float32)
    terminated, truncated = rng.random((2, 7, 4)) < 0.2
    found = ppo.advantages(reward, value, after, terminated, terminated | truncated, 0.9, 0.8)
    for column in range(4):
        for start in range(7):
            total, weight = 0.0, 1.0
            for step in range(start, 7):
                beyond = 0 if terminated[step, column] else 0.9 * after[step, column]
                total += weight * (reward[step, column] + beyond - value[step, column])
                weight *= 0.9 * 0.8
                if terminated[step, column] or truncated[step, column]:
                    break
            assert found[start, column] == pytest.approx(total, abs=1e-4)


def test_distributions_are_those_of_scipy():
    head = np.random.default_rng(1).normal(size=(5, 4)).astype(np.float32)
    _, chance, entropy = ppo.distribution(head, discrete=False)
    action = np.float32([[0.3, -1.0]] * 5)
    normal = stats.norm(head[:, :2], np.exp(head[:, 2:]))
    np.testing.assert_allclose(chance(action), normal.logpdf(action).sum(axis=1), rtol=1e-4)
    np.testing.assert_allclose(entropy(), normal.entropy().sum(axis=1), rtol=1e-4)
    _, chance, entropy = ppo.distribution(head, discrete=True)
    shares = np.exp(head) / np.exp(head).sum(axis=1, keepdims=True)
    np.testing.assert_allclose(chance(np.arange(5) % 4), np.log(shares[range(5), np.arange(5) % 4]), rtol=1e-4)
    np.testing.assert_allclose(entropy(), stats.entropy(shares, axis=1), rtol=1e-4)


def test_it_learns_the_same_again_and_drives_each_level_to_its_end(any_types):
    settings = ppo.Ppo(25, envs=16, steps=8, minibatches=2, rate=0.02)
    outcomes = [
        [(jax.device_get(weights), float(reward)) for weights, reward in ppo.train(key, ECHO, PARAMS, Echo(), settings)]
        for key in [jax.random.key(0)] * 2
    ]
    jax.tree.map(np.testing.assert_array_equal, *outcomes)
    assert outcomes[0][0][1] < 0.6 and outcomes[0][-1][1] > 0.9
    levels, weights = Levels(jnp.array([0, 1, 2, 0])), outcomes[0][-1][0]
    info = ppo.drive_levels(jax.random.key(1), weights, levels, PARAMS, ECHO, Echo(), steps=4)
    assert info.steps.tolist() == [3, 4, 4, 3]


def test_a_decision_goes_on_to_the_next_choice():
    grid = np.array([[6, 5, 7, 3], [10, 0, 10, 10], [12, 5, 13, 9]], np.int8)
    start, goal = (LaneNode(*map(jnp.int32, node)) for node in ((0, 1, 1), (2, 0, 3)))
    level = Level(jnp.asarray(grid), start, goal, distances(grid, goal)[start], shortest_ways(grid, goal))
    params = RoadNavParams(jax.tree.map(lambda part: jnp.asarray(part)[None], level), limit=9)
    _, state = RoadNav.reset_to_level(jax.random.key(0), level, params)
    decide, step = (jax.jit(e.step) for e in (drivers.at_choices(RoadNav), RoadNav))
    key, slow, rewards, decisions = jax.random.key(0), state, 0.0, 0
    for action in (1, 0, 1, 2, 1):
        done = decide(key, state, action, params)
        state, decisions, rewards = done.state, decisions + 1, 0.0
        while True:
            one = step(key, slow, action, params)
            slow, rewards = one.state, rewards + float(one.reward)
            if one.terminated or one.truncated or int(one.observation.ways.sum()) > 1:
                break
        jax.tree.map(np.testing.assert_array_equal, done._replace(reward=0), one._replace(reward=0))
        assert float(done.reward) == pytest.approx(rewards)
        if done.terminated or done.truncated:
            break
    assert decisions < int(done.info.tiles)
