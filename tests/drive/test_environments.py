"""What all environments promise: compiled or not, alone or in a batch, with other levels, whatever the action."""

from functools import cache

import jax
import numpy as np
import pytest
from compiled_programs import compilations
from driving_oracle import drawn_maps, pick

from elitelanes_jax.drive import (
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    RoadTraffic,
    RoadTrafficParams,
    auto_replay,
    auto_reset,
    make_levels,
    make_traffic_levels,
)
from elitelanes_jax.drive._environment import level_at
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.robot import Robot, drive, still

SHAPE, COUNT = (4, 5), 16
ROBOTS = 20
ROUGH = Robot(noise=0.1, latency=0.5, trim=0.02)
ENVIRONMENTS = {
    "road-nav": (RoadNav, RoadNavParams, {"limit": 9, "goal": "both"}),
    "lane-drive": (LaneDrive, LaneDriveParams, {"limit": 15, "robot": ROUGH, "task": "lane"}),
    "road-traffic": (RoadTraffic, RoadTrafficParams, {"limit": 9, "robots": ROBOTS}),
}
FULL = np.array([[6, 7, 7, 7, 3], [14, 15, 15, 15, 11], [14, 15, 15, 15, 11], [12, 13, 13, 13, 9]], np.int8)
every_environment = pytest.mark.parametrize("name", list(ENVIRONMENTS))


@cache
def made(name, seed=1):
    environment, settings, few = ENVIRONMENTS[name]
    if name == "road-traffic":
        # The tables of towns have the same shape if both batches have a town with all roads.
        maps = np.concatenate([[FULL], drawn_maps(seed, COUNT - 1, SHAPE, fill=True)])
        return environment, settings(make_traffic_levels(maps), **few)
    return environment, settings(make_levels(jax.random.key(seed), drawn_maps(seed, COUNT, SHAPE)), **few)


@cache
def programs(name):
    environment, _ = made(name)
    start = jax.jit(jax.vmap(environment.reset, in_axes=(0, None)))
    return start, jax.jit(jax.vmap(auto_reset(environment).step, in_axes=(0, 0, 0, None)))


def draw_actions(environment, rng):
    if environment.actions:
        shape = (COUNT, ROBOTS) if environment.shared else COUNT
        return rng.integers(0, environment.actions, shape).astype(np.int32)
    return rng.uniform(0.2, 1, (COUNT, environment.action_size)).astype(np.float32)


def ride(name, seed=1, steps=20):
    """States and transitions of a batch that is reset automatically."""
    environment, params = made(name, seed)
    start, step = programs(name)
    rng, keys = np.random.default_rng(0), jax.random.split(jax.random.key(3), (steps, COUNT))
    _, state = start(keys[0], params)
    for number in range(steps):
        action = draw_actions(environment, rng)
        done = jax.device_get(step(keys[number], state, action, params))
        yield keys[number], state, action, done
        state = done.state


def close(one, other):
    for left, right in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if np.asarray(left).dtype.kind == "f":
            np.testing.assert_allclose(left, right, rtol=1e-5, atol=1e-6)
        else:
            np.testing.assert_array_equal(left, right)


@pytest.mark.slow
@every_environment
def test_alone_compiled_or_not_is_as_in_a_batch(name):
    environment, params = made(name)
    step = auto_reset(environment).step
    compiled = jax.jit(step)
    for keys, state, action, done in ride(name, steps=2):
        for number in range(0, COUNT, 5):
            alone = keys[number], *jax.device_put((pick(state, number), action[number])), params
            close(compiled(*alone), pick(done, number))
        close(step(*alone), pick(done, number))


@every_environment
def test_an_episode_that_ends_goes_on_with_a_new_one(name):
    environment, params = made(name)
    begin = jax.jit(environment.reset)
    ended = cut = 0
    for keys, _, _, done in ride(name, steps=25):
        assert not (done.terminated & done.truncated).any()
        for number in np.flatnonzero(done.terminated | done.truncated):
            first = jax.device_get(begin(jax.random.fold_in(keys[number], 1), params))
            close((pick(done.observation, number), pick(done.state, number)), first)
            ended += done.terminated[number]
            cut += done.truncated[number]
        for number in np.flatnonzero(~(done.terminated | done.truncated)):
            close(pick(done.observation, number), pick(done.reached, number))
    assert ended and cut


@every_environment
def test_other_levels_and_numbers_compile_nothing_and_a_state_goes_in_as_it_came_out(name):
    first = [done.state for *_, done in ride(name, steps=3)]
    made(name, 2)
    with compilations() as compiled:
        second = list(ride(name, 2, steps=3))
    assert not compiled
    for _, state, _, done in second:
        one, other = (jax.tree.map(lambda part: (part.shape, part.dtype), tree) for tree in (state, done.state))
        assert one == other
    if name == "road-traffic":
        assert any((one.lane != two.lane).any() for one, (_, two, *_) in zip(first, second, strict=True))
    else:
        assert any((one.grid != two.grid).any() for one, (_, two, *_) in zip(first, second, strict=True))


@pytest.mark.usefixtures("any_types")
def test_an_action_may_be_a_list():
    environment, params = made("lane-drive")
    key = jax.random.key(2)
    before = key, environment.reset(key, params)[1]
    for action in ([0.5, 0.25], (0.5, 0.25)):
        same = jax.tree.map(np.array_equal, *(environment.step(*before, a, params) for a in (action, np.array(action))))
        assert all(jax.tree.leaves(same))


@every_environment
def test_no_action_makes_what_is_no_number(name):
    environment, params = made(name)
    start, step = programs(name)
    keys = jax.random.split(jax.random.key(3), COUNT)
    _, state = start(keys, params)
    worst = np.int32([-(2**31), -1, 3, 2**31 - 1])
    if not environment.actions:
        worst = np.float32([np.nan, np.inf, -np.inf, 3e38])
    for number in range(12):
        action = np.resize(np.roll(worst, number), draw_actions(environment, np.random.default_rng(0)).shape)
        done = step(keys, state, action, params)
        assert all(np.isfinite(part).all() for part in jax.tree.leaves(done))
        state = done.state


@pytest.mark.parametrize("robot", [Robot(), Robot(noise=0.1), Robot(latency=0.5)])
def test_states_keep_their_dtypes_with_numbers_of_64_bits(robot):
    jax.config.update("jax_enable_x64", True)
    try:
        wheels, pose, command = still(robot), Pose(*np.ones(3, np.float32)), np.ones(2, np.float32)
        after = drive(jax.random.key(0), pose, wheels, command, robot)
        assert [leaf.dtype for leaf in jax.tree.leaves(after)] == [np.float32] * len(jax.tree.leaves((pose, wheels)))
    finally:
        jax.config.update("jax_enable_x64", False)


@every_environment
def test_a_level_begins_again_when_its_episode_ends(name):
    environment, params = made(name)
    replaying, keys = auto_replay(environment), jax.random.split(jax.random.key(5), COUNT)
    levels = jax.vmap(level_at, (None, 0))(params.levels, np.arange(COUNT))
    _, state = jax.vmap(replaying.reset_to_level, (0, 0, None))(keys, levels, params)
    step = jax.jit(jax.vmap(replaying.step, (0, 0, 0, None)))
    plain = jax.jit(jax.vmap(environment.step, (0, 0, 0, None)))
    rng, ends = np.random.default_rng(0), 0
    for number in range(20):
        action = draw_actions(environment, rng)
        keys = jax.random.split(jax.random.key(number), COUNT)
        done = jax.device_get(step(keys, state, action, params))
        inner = jax.vmap(jax.random.fold_in, (0, None))(keys, 0)
        close(done.reward, plain(inner, state.state, action, params).reward)
        ended = done.terminated | done.truncated
        assert jax.tree.all(jax.tree.map(np.array_equal, done.state.level, levels))
        if name == "road-traffic":
            assert (done.state.state.level == levels).all() and (done.state.state.steps[ended] == 0).all()
        if name == "road-nav":
            assert (done.state.state.tiles[ended] == 0).all()
            assert (done.state.state.node.row == params.levels.start.row)[ended].all()
        ends += ended.sum()
        state = done.state
    assert ends > COUNT / 2
