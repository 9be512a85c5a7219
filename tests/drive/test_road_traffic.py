"""RoadTraffic: tables of lanes by NetworkX, steps and gridlock by a slow model in plain Python."""

import json
from itertools import product
from pathlib import Path

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from driving_oracle import drawn_maps
from refusals import refused
from traffic_oracle import Traffic, town_graph, yields

from elitelanes_jax.drive import (
    RoadTraffic,
    RoadTrafficParams,
    TrafficRule,
    make_traffic_levels,
    traffic_rule,
)
from elitelanes_jax.drive._traffic_rules import check_rule
from elitelanes_jax.network import gridlock_number

TOWNS = Path(__file__).parents[2] / "experiments" / "gridlock" / "results" / "shared_towns.json"
RING = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]], np.int8)
RULES = ("allway_stop", "right_before_left", "traffic_light")


def loops(maps, count):
    """The first maps with a loop."""
    return np.array([grid for grid in maps if len(town_graph(grid))][:count])


@pytest.fixture(scope="module")
def small():
    """Maps of 4 x 5 tiles, some with dead ends, rings or several parts."""
    drawn = np.concatenate([drawn_maps(1, 20, (4, 5)), drawn_maps(2, 20, (4, 5), fill=True)])
    ring = np.pad(RING, ((0, 1), (0, 2)))
    two_rings = ring.copy()
    two_rings[:2, 3:] = [[6, 3], [12, 9]]
    return np.concatenate([[ring, two_rings], loops(drawn, 8)])


@pytest.fixture(scope="module")
def towns():
    """Some of the towns in which experiments train robots."""
    return np.array(json.loads(TOWNS.read_text())["train"][:3])


def names_of(levels, number):
    """The nodes of a town's lanes, in the order of their numbers."""
    count = int(levels.lanes[number])
    return [tuple(int(field[number, lane]) for field in levels.node) for lane in range(count)]


def test_tables_are_those_of_the_graph_of_lanes(small):
    levels = jax.device_get(make_traffic_levels(small))
    none = levels.onward.shape[1] - 1
    several_parts = 0
    for number, grid in enumerate(small):
        graph, names = town_graph(grid), names_of(levels, number)
        traffic = Traffic(graph, [], "allway_stop", False, 1)
        assert sorted(names) == sorted(graph)
        index = {name: lane for lane, name in enumerate(names)} | {None: none}
        lengths = dict(nx.all_pairs_shortest_path_length(graph))
        parts = {lane: part for part in nx.strongly_connected_components(graph) for lane in part}
        several_parts += len(parts[names[0]]) < len(names)
        for lane, name in enumerate(names):
            onward = [traffic.after(name, turn) for turn in range(3)]
            assert levels.onward[number, lane].tolist() == [index[after] for after in onward]
            for turn in range(3):
                assert onward[levels.turn_taken[number, lane, turn]]
                assert onward[turn] is None or levels.turn_taken[number, lane, turn] == turn
            same_tile = [(*name[:2], heading) for heading in range(4)]
            beside = [index.get(other, none) for other in same_tile]
            assert levels.beside[number, lane].tolist() == beside
            assert levels.at_crossing[number, lane] == traffic.is_crossing(name)
            street = traffic.street(name)
            first, stop = levels.street[number, lane].tolist()
            assert {names[other] for other in range(first, stop)} == set(street)
            assert names[stop - 1] == street[-1] or not traffic.is_crossing(street[-1])
            first, stop = levels.part[number, lane].tolist()
            assert {names[other] for other in range(first, stop)} == parts[name]
            for goal, other in enumerate(names):
                expected = lengths[name].get(other, 2**15 - 1)
                assert levels.distance[number, goal, lane] == expected
        # No lane has a number beyond these.
        assert (levels.onward[number, len(names) :] == none).all()
        assert (levels.distance[number, len(names) :] == 2**15 - 1).all()
        assert (levels.distance[number, :, len(names) :] == 2**15 - 1).all()
    assert several_parts >= 2


@pytest.mark.parametrize("name", RULES)
def test_rules_are_those_of_lines_across_a_tile(name):
    rule = traffic_rule(name)
    for one, two in np.ndindex(12, 12):
        assert rule.yields[one, two] == yields(name, divmod(one, 3), divmod(two, 3))
    assert rule.by_arrival == (name == "allway_stop")


def read_robots(levels, number, state):
    """The robots of a state as the slow model has them."""
    names = names_of(levels, number)
    rows = zip(*(field.tolist() for field in state[1:6]), strict=True)
    return [
        {"lane": names[lane], "slot": slot, "turn": turn, "goal": names[goal], "arrived": arrived}
        for lane, slot, turn, goal, arrived in rows
    ]


QUICK = {
    ("allway_stop", False, 1),
    ("right_before_left", True, 1),
    ("traffic_light", False, 2),
    ("allway_stop", True, 2),
}
CASES = [
    pytest.param(*case, marks=[] if case in QUICK else [pytest.mark.slow])
    for case in product(RULES, (False, True), (1, 2))
]


@pytest.mark.parametrize(("rule", "strict", "slots"), CASES)
def test_steps_are_those_of_the_slow_model(small, rule, strict, slots):
    levels, steps = make_traffic_levels(small), 16
    params = RoadTrafficParams(
        levels, robots=16 * slots - 1, slots=slots, rule=rule, strict=strict, ends_in_gridlock=False, limit=steps,
        progress_reward=0.5, goal_reward=2.0, gridlock_cost=3.0,
    )  # fmt: skip
    host, rng, gridlocks, goals = jax.device_get(levels), np.random.default_rng(0), 0, 0
    for number, grid in enumerate(small):
        seen, state = jax.device_get(RoadTraffic.reset_to_level(jax.random.key(number), number, params))
        graph = town_graph(grid)
        lengths = dict(nx.all_pairs_shortest_path_length(graph))
        for time in range(steps):
            model = Traffic(graph, read_robots(host, number, state), rule, strict, slots)
            assert len(model.occupants()) == params.robots
            stuck = model.stuck()
            assert set(np.flatnonzero(state.gridlocked).tolist()) == stuck
            if time % 8 == number % 8:
                for index in range(params.robots):
                    for name, expected in model.seen_by(index, time, lengths).items():
                        np.testing.assert_allclose(getattr(seen, name)[index], expected, atol=1e-6, err_msg=name)
            # Most robots drive shortest ways. The others turn at random or wait.
            shortest = np.where(seen.allowed[:, :3], seen.detour, 100).argmin(axis=1)
            at_random = rng.integers(0, 4, params.robots)
            actions = np.where(rng.random(params.robots) < 0.8, shortest, at_random)
            before = [dict(robot) for robot in model.robots]
            moved, reached = model.move(actions.tolist(), time)
            assert not moved & stuck
            done = jax.device_get(RoadTraffic.step(jax.random.key(time), state, actions, params))
            new = model.stuck() - stuck
            for index, robot in enumerate(read_robots(host, number, done.state)):
                lane, goal = robot["lane"], before[index]["goal"]
                if index in reached:
                    assert robot["goal"] != lane
                    robot["goal"] = goal
                assert robot == model.robots[index]
                nearer = lengths[before[index]["lane"]][goal] - lengths[lane][goal]
                reward = 0.5 * nearer + 2 * (index in reached) - 3 * (index in new)
                assert done.reward[index] == pytest.approx(reward)
                assert done.info.reached[index] == (index in reached)
                assert done.info.tiles[index] == state.tiles[index] + (lane != before[index]["lane"])
                assert done.info.goals[index] == state.goals[index] + (index in reached)
            assert not done.terminated and done.truncated == (time == steps - 1)
            seen, state = done.observation, done.state
            goals += len(reached)
        gridlocks += bool(stuck)
    assert gridlocks and goals, (gridlocks, goals)


def test_without_gridlock_somebody_moves_soon(towns):
    """Robots that always want to move: whoever is not in gridlock moves within a cycle of the lights."""
    levels = make_traffic_levels(towns)
    for rule, strict in product(RULES, (False, True)):
        params = RoadTrafficParams(levels, robots=24, rule=rule, strict=strict, ends_in_gridlock=False)
        step = jax.jit(jax.vmap(RoadTraffic.step, in_axes=(0, 0, 0, None)))
        keys = jax.random.split(jax.random.key(0), 60)
        _, state = jax.vmap(RoadTraffic.reset, in_axes=(0, None))(keys, params)
        positions, stuck = [], []
        for time in range(60):
            # Robots only wait if the actions say so; 0 to 2 are turns.
            actions = jax.random.randint(jax.random.key(time), (60, 24), 0, 3)
            state = step(keys, state, actions, params).state
            positions.append(np.asarray(state.lane))
            stuck.append(np.asarray(state.gridlocked))
        stuck, positions = np.array(stuck), np.array(positions)
        # Once in gridlock, always in gridlock, and in the same lane.
        assert (stuck[1:] >= stuck[:-1]).all()
        assert (positions[1:][stuck[:-1]] == positions[:-1][stuck[:-1]]).all()
        for time in range(40):
            stood_still = (positions[time : time + 17] == positions[time]).all(axis=0)
            assert (stuck[time] | ~stood_still).any(axis=1).all()
        assert stuck[-1].any() and not stuck[-1].all()


@pytest.mark.slow
def test_a_circle_closes_if_and_only_if_its_robots_are_then_in_gridlock(towns):
    levels, robots, closed = make_traffic_levels(towns), 32, 0
    for slots in (1, 2):
        params = RoadTrafficParams(levels, robots=robots * slots, slots=slots)
        numbers, turns = jnp.mgrid[: robots * slots, :3]

        @jax.jit
        def look(key, state, params=params, numbers=numbers, turns=turns):
            """Which turns close a circle, and which make a gridlock if the robot alone moves."""

            def makes_gridlock(robot, choice):
                action = jnp.full(params.robots, 3).at[robot].set(choice)
                return RoadTraffic.step(key, state, action, params).info.gridlocked.any()

            seen = RoadTraffic.observe(state, params)
            return seen, jax.vmap(jax.vmap(makes_gridlock))(numbers, turns)

        for number in range(len(towns)):
            seen, state = RoadTraffic.reset_to_level(jax.random.key(number), number, params)
            for time in range(50):
                if state.gridlocked.any():
                    break
                seen, makes = look(jax.random.key(time), state)
                allowed = np.asarray(seen.allowed[:, :3])
                np.testing.assert_array_equal(np.asarray(seen.closes)[allowed], np.asarray(makes)[allowed])
                assert not seen.closes[~allowed].any()
                closed += int(seen.closes.sum())
                turn = jnp.argmin(jnp.where(allowed, seen.detour, jnp.inf), axis=1)
                action = jnp.where(allowed.any(axis=1), turn, 3)
                state = RoadTraffic.step(jax.random.key(time), state, action, params).state
    assert closed


def test_no_more_robots_than_the_gridlock_number_are_never_in_gridlock(towns):
    for slots in (1, 2):
        numbers = [int(gridlock_number(town, slots=slots)) for town in towns]
        for number, robots in enumerate(numbers):
            params = RoadTrafficParams(make_traffic_levels(towns[number : number + 1]), robots=robots, slots=slots)

            @jax.jit
            def drive(key, params=params):
                def step(state, key):
                    choosing, going = jax.random.split(key)
                    action = jax.random.randint(choosing, (params.robots,), 0, 4)
                    done = RoadTraffic.step(going, state, action, params)
                    return done.state, done.terminated

                _, state = RoadTraffic.reset(key, params)
                return jax.lax.scan(step, state, jax.random.split(key, 100))[1].any()

            assert not jax.vmap(drive)(jax.random.split(jax.random.key(0), 50)).any()


def test_one_robot_more_than_the_gridlock_number_can_be_in_gridlock():
    robots = int(gridlock_number(RING)) + 1
    assert robots == 8
    params = RoadTrafficParams(make_traffic_levels(RING[None]), robots=2 * robots)
    # All lanes of both directions are taken.
    _, state = RoadTraffic.reset(jax.random.key(0), params)
    assert state.gridlocked.all()
    done = RoadTraffic.step(jax.random.key(1), state, np.zeros(16, np.int32), params)
    assert done.terminated and not done.truncated and not done.reward.any()


def test_rules_are_data_that_a_batch_maps_over(towns):
    levels = make_traffic_levels(towns)
    rules = jax.tree.map(lambda *fields: jnp.stack(fields), *(traffic_rule(name, phase_steps=2) for name in RULES))

    def drive(rule):
        params = RoadTrafficParams(levels, robots=20, rule=rule)
        _, state = RoadTraffic.reset(jax.random.key(0), params)

        def step(state, key):
            action = jax.random.randint(key, (20,), 0, 3)
            return RoadTraffic.step(key, state, action, params).state, None

        return jax.lax.scan(step, state, jax.random.split(jax.random.key(1), 20))[0]

    together = jax.jit(jax.vmap(drive))(rules)
    for number, name in enumerate(RULES):
        alone = jax.jit(drive)(traffic_rule(name, phase_steps=2))
        jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda x, at=number: x[at], together), alone)
    assert len({tuple(tiles) for tiles in together.tiles.tolist()}) == len(RULES)


def test_draws_are_uniform(small):
    levels = make_traffic_levels(small[1:2])
    params = RoadTrafficParams(levels, robots=2, slots=2)
    keys = jax.random.split(jax.random.key(0), 4000)
    _, state = jax.jit(jax.vmap(RoadTraffic.reset, in_axes=(0, None)))(keys, params)
    count = int(levels.lanes[0])
    slots = np.bincount(np.asarray(state.lane * 2 + state.slot).ravel(), minlength=2 * count)
    assert slots.min() > 0.6 * slots.mean() and slots.max() < 1.5 * slots.mean()
    goals = np.asarray(state.goal)[np.asarray(state.lane) == 0]
    first, stop = levels.part[0, 0].tolist()
    assert set(goals.tolist()) == set(range(first, stop)) - {0}


def test_levels_that_robots_cannot_share_are_refused():
    with refused("maps[1]", "one without any"):
        make_traffic_levels([RING, np.pad([[4, 5, 1]], ((0, 2), (0, 0)))])
    with refused("robots", "17", expected="at most 16"):
        RoadTrafficParams(make_traffic_levels([RING]), robots=17)
    assert RoadTrafficParams(make_traffic_levels([RING]), robots=17, slots=2).robots == 17
    rule = traffic_rule("allway_stop")
    for wrong, subject, got in (
        ("zebra", "rule", "'zebra'"),
        (3, "rule", "3"),
        (rule._replace(green=np.ones((0, 4), bool)), "rule: green", "array([], ..."),
        (rule._replace(phase_steps=0), "rule: phase_steps", "0"),
        (rule._replace(phase_steps=2**40), "rule: phase_steps", 2**40),
        (rule._replace(yields=3), "rule: yields", "3"),
        (rule._replace(yields=np.eye(12, dtype=bool)), "rule: yields", "True on the diagonal"),
        (rule._replace(yields=[[True], [True, True]]), "rule: yields", "[[True], [True, True]]"),
        (rule._replace(by_arrival="yes"), "rule: by_arrival", "'yes'"),
        (rule._replace(by_arrival="bool"), "rule: by_arrival", "'bool'"),
        (rule._replace(green=[[1, 0, 1, 0]]), "rule: green", "[[1, 0, 1, 0]]"),
        (rule._replace(phase_steps="4"), "rule: phase_steps", "'4'"),
    ):
        with refused(subject, got):
            RoadTrafficParams(make_traffic_levels([RING]), rule=wrong)
    lists = TrafficRule(rule.yields.tolist(), True, rule.green.tolist(), 4)
    jax.tree.map(np.testing.assert_array_equal, check_rule(lists), rule)


@pytest.mark.usefixtures("any_types")
def test_a_state_belongs_to_one_town_and_its_robots():
    levels, key = make_traffic_levels([RING]), jax.random.key(0)
    three, four = (RoadTrafficParams(levels, robots=robots) for robots in (3, 4))
    _, state = RoadTraffic.reset(key, three)
    with refused("state", "lanes [3]", expected="robots=4"):
        RoadTraffic.step(key, state, np.zeros(3, np.int32), four)
    with refused("state", "lanes [3]", expected="robots=4"):
        RoadTraffic.observe(state, four)
    batch = jax.tree.map(lambda field: jnp.stack([field, field]), state)
    with refused("state", "lanes [2, 3]", expected="robots=3"):
        RoadTraffic.step(key, batch, np.zeros((2, 3), np.int32), three)


@pytest.mark.usefixtures("any_types")
def test_actions_beyond_32_bits_are_clipped():
    params = RoadTrafficParams(make_traffic_levels([RING]), robots=3)
    _, state = RoadTraffic.reset(jax.random.key(0), params)
    waits = RoadTraffic.step(jax.random.key(1), state, np.full(3, 3), params).state
    for actions in (np.full(3, 2**32), [2**40, 2**32, 3]):
        after = RoadTraffic.step(jax.random.key(1), state, actions, params).state
        jax.tree.map(np.testing.assert_array_equal, after, waits)


@pytest.mark.parametrize("level", [-1, 2, 2**40])
def test_a_town_that_is_none_is_refused_unless_jax_has_it(level):
    """The first or the last town was taken instead."""
    params = RoadTrafficParams(make_traffic_levels([RING, RING]), robots=3)
    key = jax.random.key(0)
    with refused("level", level, expected="0 to 1"):
        RoadTraffic.reset_to_level(key, level, params)
    with refused("level", level, expected="0 to 1"):
        RoadTraffic.reset_to_level(key, np.array(level), params)
    assert RoadTraffic.reset_to_level(key, np.int8(1), params)[1].level == 1
    traced = jnp.int32(np.clip(level, -1, 2))
    assert RoadTraffic.reset_to_level(key, traced, params)[1].level == (0 if level < 0 else 1)
