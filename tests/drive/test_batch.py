"""Batches of environments against a plain loop over the functions of one environment."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from driving_oracle import drawn_maps
from refusals import refused

from elitelanes_jax.drive import (
    Environment,
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    RoadTraffic,
    RoadTrafficParams,
    Transition,
    make_levels,
    make_traffic_levels,
)
from elitelanes_jax.drive._batch import Batch
from elitelanes_jax.drive._batch_programs import DISABLED, NEXT_STEP, SAME_STEP
from elitelanes_jax.drive._flat import flattened
from elitelanes_jax.network.bits import seed_key

LEVELS = make_levels(jax.random.key(2), drawn_maps(1, 16, (4, 5), fill=True))
PARAMS = RoadNavParams(LEVELS, limit=5, window=3)


class Loop:
    """One environment: its i-th step or reset takes the key that has i folded into the seed's key."""

    def __init__(self, environment, params, seed):
        flat = flattened(environment)
        self.reset_with, self.step_with = (jax.jit(function) for function in (flat.reset, flat.step))
        self.params, self.key, self.used = params, seed_key(seed), 0

    def next_key(self):
        self.used += 1
        return jax.random.fold_in(self.key, self.used - 1)

    def reset(self):
        observation, self.state = self.reset_with(self.next_key(), self.params)
        return observation

    def step(self, action):
        done = self.step_with(self.next_key(), self.state, action, self.params)
        self.state = done.state
        return done


@pytest.mark.parametrize("mode", [NEXT_STEP, SAME_STEP, DISABLED])
def test_a_batch_is_a_loop_over_environments(mode):
    batch = Batch(RoadNav, PARAMS, 3, mode)
    loops = [Loop(RoadNav, PARAMS, seed) for seed in (7, 0, 9)]
    np.testing.assert_array_equal(batch.reset([7, 0, 9]), [loop.reset() for loop in loops])
    actions = np.random.default_rng(0).integers(0, 3, (30, 3))
    over, ends = np.zeros(3, bool), 0
    for chosen in actions:
        outcome = batch.step(chosen)
        for index, loop in enumerate(loops):
            if mode == NEXT_STEP and over[index]:
                np.testing.assert_array_equal(outcome.observation[index], loop.reset())
                assert outcome.reward[index] == 0 and not outcome.terminated[index] and not outcome.truncated[index]
                assert all(metric[index] == 0 for metric in outcome.metrics.values())
                over[index] = False
                continue
            done = loop.step(int(chosen[index]))
            for name in ("reward", "terminated", "truncated"):
                assert getattr(outcome, name)[index] == getattr(done, name)
            assert all(metric[index] == done.info[name] for name, metric in outcome.metrics.items())
            np.testing.assert_array_equal(outcome.reached[index], done.reached)
            over[index] = done.terminated | done.truncated
            ends += over[index]
            expected = loop.reset() if mode == SAME_STEP and over[index] else done.observation
            np.testing.assert_array_equal(outcome.observation[index], expected)
        if mode == DISABLED and over.any():
            # Seeds of environments that are not chosen do nothing.
            seen = batch.reset([5, 5, 5], over)
            for index in np.flatnonzero(over):
                loops[index] = Loop(RoadNav, PARAMS, 5)
                np.testing.assert_array_equal(seen[index], loops[index].reset())
            np.testing.assert_array_equal(seen[~over], outcome.observation[~over])
            over[:] = False
    assert ends > 10


@pytest.mark.parametrize(("environment", "params"), [(RoadNav, PARAMS), (LaneDrive, LaneDriveParams(LEVELS))])
def test_a_reset_to_levels_is_reset_to_level_with_the_same_key(environment, params):
    batch, flat = Batch(environment, params, 3, DISABLED), flattened(environment)
    seen = batch.reset([7, 0, 9], levels=[3, None, np.int64(15)])
    for index, (seed, level) in enumerate([(7, 3), (0, None), (9, 15)]):
        key = jax.random.fold_in(seed_key(seed), 0)
        expected, _ = flat.reset(key, params)
        if level is not None:
            expected, _ = flat.reset_to_level(key, jax.tree.map(lambda part, at=level: part[at], LEVELS), params)
        np.testing.assert_array_equal(seen[index], expected)
    for levels, got in (
        ([16] * 3, "16"),
        ([-1] * 3, "-1"),
        ([1, 2], "[1, 2]"),
    ):
        with refused("level", got):
            batch.reset(levels=levels)


@pytest.mark.parametrize("mode", [NEXT_STEP, SAME_STEP, DISABLED])
def test_replaced_params_are_those_of_later_resets(mode):
    other = PARAMS.replace(levels=jax.tree.map(lambda part: part[:5], LEVELS), limit=2)
    changed, new = Batch(RoadNav, PARAMS, 4, mode), Batch(RoadNav, other, 4, mode)
    changed.reset([1, 2, 3, 4])
    changed.replace_params(other)
    assert changed.params is other
    np.testing.assert_array_equal(changed.reset([5, 6, 7, 8]), new.reset([5, 6, 7, 8]))
    for actions in np.random.default_rng(0).integers(0, 3, (8, 4)):
        one, expected = changed.step(actions), new.step(actions)
        jax.tree.map(np.testing.assert_array_equal, one, expected)


def test_params_of_other_shapes_are_refused():
    batch = Batch(RoadNav, PARAMS, 2, SAME_STEP)
    larger = make_levels(jax.random.key(2), drawn_maps(1, 2, (5, 5), fill=True))
    for other in (PARAMS.replace(levels=larger), PARAMS.replace(window=5), PARAMS.replace(goal="mark")):
        with refused("params", "other shapes of states or observations", expected="the same size"):
            batch.replace_params(other)
    with refused("params", "LaneDriveParams(...", expected="RoadNavParams"):
        batch.replace_params(LaneDriveParams(LEVELS))
    assert batch.params is PARAMS


def test_an_environment_alone_does_the_same_bit_for_bit():
    params = LaneDriveParams(LEVELS, limit=20, task="lane")
    batch, alone = Batch(LaneDrive, params, 12, SAME_STEP), Batch(LaneDrive, params, 1, SAME_STEP)
    seen = batch.reset([*range(11), 2**40])
    assert (alone.reset([2**40]) == seen[11:]).all() and (seen[0] != seen[11]).any()
    for actions in np.random.default_rng(0).uniform(-1, 1, (60, 12, 2)):
        together, one = batch.step(actions), alone.step(actions[11:])
        for ours, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(together), strict=True):
            np.testing.assert_array_equal(ours, theirs[11:], strict=True)


def test_a_step_does_the_same_bit_for_bit_in_a_program_without_resets():
    """The compiler joins products with sums in one program and not in the other, unless `rounded` prevents it."""
    params = LaneDriveParams(LEVELS, limit=20, task="lane")
    resetting, stepping = Batch(LaneDrive, params, 12, SAME_STEP), Batch(LaneDrive, params, 12, DISABLED)
    np.testing.assert_array_equal(resetting.reset(range(12)), stepping.reset(range(12)))
    for actions in np.random.default_rng(0).uniform(-1, 1, (30, 12, 2)):
        expected, outcome = resetting.step(actions), stepping.step(actions)
        is_over = outcome.terminated | outcome.truncated
        if is_over.any():
            outcome = outcome._replace(observation=stepping.reset(chosen=is_over))
        for ours, theirs in zip(jax.tree.leaves(outcome), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(ours, theirs, strict=True)


@pytest.mark.usefixtures("standard")
def test_what_a_caller_writes_changes_nothing():
    class Metrics(tuple):
        def _asdict(self):
            return {"sum": self[0]}

    def step(key, state, action, params):
        after = state + action
        never = jnp.bool_(False)
        return Transition(after, after, action, never, never, Metrics((after.sum(),)), after)

    def reset(key, params):
        return jnp.zeros(3), jnp.zeros(3)

    adding = Environment(reset, lambda key, level, params: reset(key, params), step, lambda state, params: state, 3)
    for mode in (NEXT_STEP, SAME_STEP, DISABLED):
        batch = Batch(adding, PARAMS, 4, mode)
        batch.reset()[:] = 7
        for number in range(1, 4):
            outcome = batch.step(np.ones(4, int))
            assert (outcome.observation == number).all() and (outcome.metrics["sum"] == 3 * number).all()
            for part in jax.tree.leaves(outcome):
                part[:] = 9


def test_without_a_seed_episodes_differ_and_go_on():
    batch = Batch(RoadNav, PARAMS, 32, NEXT_STEP)
    first, second = batch.reset(), batch.reset()
    assert (first != second).any() and (Batch(RoadNav, PARAMS, 32, NEXT_STEP).reset() != first).any()
    seeded = batch.reset([3] * 32)
    assert (seeded == seeded[0]).all()


@pytest.mark.usefixtures("any_types")
def test_what_is_wrong_is_named():
    batch = Batch(RoadNav, PARAMS, 2, NEXT_STEP)
    real = Batch(LaneDrive, LaneDriveParams(LEVELS), 2, NEXT_STEP)
    with refused("step", "none", expected="reset before"):
        batch.step([0, 1])
    batch.reset()
    real.reset()
    for call, subject, got in (
        (lambda: Batch(RoadNav, PARAMS, 0, NEXT_STEP), "envs", "0"),
        (lambda: batch.step([0]), "actions", "int64 [1]"),
        (lambda: batch.step([0.0, 1.0]), "actions", "float64 [2]"),
        (lambda: real.step([0, 1]), "actions", "int64 [2]"),
        (lambda: real.step([[0, 1], [0]]), "actions", "[[0, 1], [0]]"),
        (lambda: batch.reset(np.array(5)), "seed", "array(5)"),
        (lambda: Batch([], PARAMS, 2, NEXT_STEP), "environment", "[]"),
        (lambda: batch.reset([1]), "seed", "[1]"),
        (lambda: batch.reset([1, -1]), "seed", "-1"),
    ):
        with refused(subject, got):
            call()


def test_each_environment_needs_a_reset():
    """A first reset of some environments once let the others step from states of zeros."""
    batch = Batch(RoadNav, PARAMS, 3, NEXT_STEP)
    batch.reset([1, 2, 3], np.array([True, False, False]))
    with refused("step", "none", expected="environments [1, 2]"):
        batch.step([0, 0, 0])
    with refused("render", "none", expected="environments [1, 2]"):
        batch.states("render")
    whole = Batch(RoadNav, PARAMS, 3, NEXT_STEP)
    expected = whole.reset([1, 2, 3])
    np.testing.assert_array_equal(batch.reset([1, 2, 3], np.array([False, True, True])), expected)
    np.testing.assert_array_equal(batch.step([0, 1, 2]).observation, whole.step([0, 1, 2]).observation)


def test_a_large_number_is_clipped_without_a_warning():
    batch = Batch(LaneDrive, LaneDriveParams(LEVELS), 2, DISABLED)
    outcomes = []
    for actions in ([[1e300, 0.0]] * 2, [[1.0, 0.0]] * 2):
        batch.reset([7, 0])
        outcomes.append(batch.step(np.array(actions)).observation)
    np.testing.assert_array_equal(*outcomes)


def test_actions_beyond_32_bits_are_clipped():
    """2**32 once wrapped around to 0."""
    batch = Batch(RoadNav, PARAMS, 3, DISABLED)
    outcomes = []
    for actions in ([2, 0, 2], [2**32, -(2**32), 2**63 - 1]):
        batch.reset([7, 0, 9])
        outcomes.append(batch.step(np.array(actions)).observation)
    np.testing.assert_array_equal(*outcomes)


@pytest.mark.parametrize("mode", [NEXT_STEP, SAME_STEP, DISABLED])
def test_robots_that_share_a_town_are_rows(mode):
    params = RoadTrafficParams(make_traffic_levels(drawn_maps(1, 3, (4, 5), fill=True)), robots=5, limit=4)
    batch = Batch(RoadTraffic, params, 3, mode)
    loops = [Loop(RoadTraffic, params, seed) for seed in (7, 0, 9)]
    seeds = np.repeat([7, 0, 9], 5)
    assert batch.envs == 15
    np.testing.assert_array_equal(batch.reset(seeds), np.concatenate([loop.reset() for loop in loops]))
    over, ends = np.zeros(3, bool), 0
    for actions in np.random.default_rng(0).integers(0, 4, (12, 15)):
        outcome = batch.step(actions)
        for index, loop in enumerate(loops):
            rows = slice(5 * index, 5 * index + 5)
            if mode == NEXT_STEP and over[index]:
                np.testing.assert_array_equal(outcome.observation[rows], loop.reset())
                assert not outcome.reward[rows].any() and not outcome.truncated[rows].any()
                assert not any(metric[rows].any() for metric in outcome.metrics.values())
                over[index] = False
                continue
            done = loop.step(actions[rows].astype(np.int32))
            for name in ("reward", "terminated", "truncated"):
                assert (getattr(outcome, name)[rows] == getattr(done, name)).all()
            for name, metric in done.info.items():
                np.testing.assert_array_equal(outcome.metrics[name][rows], metric)
            np.testing.assert_array_equal(outcome.reached[rows], done.reached)
            over[index] = done.terminated | done.truncated
            ends += over[index]
            expected = loop.reset() if mode == SAME_STEP and over[index] else done.observation
            np.testing.assert_array_equal(outcome.observation[rows], expected)
        if mode == DISABLED and over.any():
            seen = batch.reset(None, np.repeat(over, 5))
            for index in np.flatnonzero(over):
                np.testing.assert_array_equal(seen[5 * index : 5 * index + 5], loops[index].reset())
            over[:] = False
    assert ends > 5
    alone = Batch(RoadTraffic, params, 1, mode)
    np.testing.assert_array_equal(alone.reset([7] * 5), batch.reset(seeds)[:5])
    actions = np.arange(15) % 4
    for one, three in zip(alone.step(actions[:5]), batch.step(actions), strict=True):
        jax.tree.map(np.testing.assert_array_equal, one, jax.tree.map(lambda part: part[:5], three))
    batch.reset(levels=np.repeat([2, 0, 1], 5))
    assert [state.level for state in batch.states("states")] == [2, 0, 1]
    with refused("params", "RoadNavParams"):
        Batch(RoadTraffic, RoadNavParams(make_levels(jax.random.key(0), drawn_maps(1, 3, (4, 5)), 3)), 3, mode)
    with refused("reset_mask", "array([...", expected="5 robots"):
        batch.reset(None, np.arange(15) < 7)
    with refused("actions", "int64 [3]"):
        batch.step(np.zeros(3, int))


def test_other_towns_need_a_reset_of_robots_that_share_them():
    """Their state has numbers of lanes, which mean other lanes in other towns, or none."""
    towns = make_traffic_levels(drawn_maps(1, 6, (4, 5), fill=True))
    first, last = (jax.tree.map(lambda part, at=half: part[at], towns) for half in (slice(0, 3), slice(3, 6)))
    params = RoadTrafficParams(first, robots=5)
    batch, actions = Batch(RoadTraffic, params, 2, NEXT_STEP), np.zeros(10, int)
    batch.reset()
    batch.replace_params(params.replace(limit=9))
    batch.step(actions)
    for other in (params.replace(levels=last), params.replace(levels=last, slots=2)):
        batch.replace_params(other)
        with refused("step", "none", expected="reset before"):
            batch.step(actions)
        batch.reset()
        batch.step(actions)
    with refused("params", "other shapes of states or observations", expected="number of robots"):
        batch.replace_params(params.replace(robots=4))
