"""Robots that share a town: the runs and the figures of the trial."""

import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.drive import RoadTraffic, make_traffic_levels
from experiments.gridlock import sharing

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def towns():
    """Some of the towns of training."""
    return make_traffic_levels(np.array(json.loads(sharing.TOWNS.read_text())["train"][:2]))


def test_the_outcome_of_a_run_is_that_of_its_steps(towns):
    """Until the first gridlock, goals count twice: in all goals, and in the goals before."""
    steps, params, ended_early = 40, sharing.options_of(towns, "right_before_left", 48), 0
    run = partial(sharing.drive, policy=sharing.shortest, steps=steps)
    choose = jax.jit(sharing.shortest)
    for number in range(4):
        placing, driving = jax.random.split(jax.random.key(number))
        seen, traffic = RoadTraffic.reset_to_level(placing, 1, params)
        free = goals = before = 0
        for key in jax.random.split(driving, steps):
            choosing, going = jax.random.split(key)
            is_free = not traffic.gridlocked.any()
            done = RoadTraffic.step(going, traffic, choose(choosing, seen), params)
            seen, traffic, reached = done.observation, done.state, int(done.info.reached.sum())
            free, goals, before = free + is_free, goals + reached, before + is_free * reached
        assert tuple(map(int, run(jax.random.key(number), 1, params))) == (free, before, goals)
        ended_early += free < steps
    assert ended_early


def test_policies_choose_only_what_makes_sense(towns):
    params = sharing.options_of(towns, "allway_stop", 36)
    seen, _ = RoadTraffic.reset_to_level(jax.random.key(0), 0, params)
    for _, policy in sharing.POLICIES.values():
        if policy is sharing.learned:
            continue
        choice = policy(jax.random.key(1), seen)
        # Robots in a lane without a crossing at its end may also wait, to leave room.
        allowed = np.asarray(seen.allowed.at[:, 3].set(True))
        assert allowed[np.arange(36), np.asarray(choice)].all()
    numbers, allowed = sharing.features(seen)
    assert numbers.shape == (36, 25) and allowed is seen.allowed
    assert jnp.abs(numbers).max() <= 8


def test_ratios_and_shares_are_those_of_the_runs():
    constant = sharing.ratio(np.array([1.0, 2.0, 4.0]), np.array([2.0, 4.0, 8.0]))
    assert constant == [0.5, 0.5, 0.5]
    low, high = sharing.ratio(np.array([0.0, 3.0]), np.array([3.0, 3.0]))[1:]
    assert (low, high) == (0, 1)
    # Two runs in two towns: steps without gridlock, goals before, goals.
    rules = [[[300, 100], [300, 300]], [[90, 30], [90, 90]], [[90, 40], [90, 90]]]
    best = [[[300, 300], [300, 300]], [[99, 99], [99, 99]], [[99, 99], [99, 99]]]
    runs = {"all-way stop": rules, "around full streets": rules, "learned 0": rules, "learned 1": best}
    summary = sharing.summarize({name: {"24": fields} for name, fields in runs.items()}, 24)
    assert list(summary) == ["all-way stop", "around full streets", "learned"]
    stop, learned = summary["all-way stop"], summary["learned"]
    assert (stop["gridlocks"], learned["gridlocks"]) == (0.25, 0.125)
    assert learned["gridlocks / all-way stop"][0] == 0.5
    assert stop["goals"] == pytest.approx(1000 * 310 / (4 * 300 * 24))
    assert stop["goals_before"] == pytest.approx(1000 * 300 / (1000 * 24))
    assert learned["goals / around full streets"][0] == pytest.approx((310 + 396) / 2 / 310)


def test_the_page_has_the_tables_of_the_trial():
    tables = (ROOT / "experiments" / "gridlock" / "results" / "sharing.md").read_text()
    assert tables in (ROOT / "docs" / "gridlock.md").read_text()
