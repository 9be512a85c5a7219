"""Robots that share a town: their model against a slow one in plain Python, and the figures of the trial."""

import json
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest

from elitelanes_jax.lanes.movements import lane_graph
from experiments.gridlock import robots as model
from experiments.gridlock import sharing

ROOT = Path(__file__).parents[2]
STEPS = ((-1, 0), (0, 1), (1, 0), (0, -1))
ROBOTS = 40


@pytest.fixture(scope="module")
def grids():
    """Some of the towns of training."""
    towns = json.loads(sharing.TOWNS.read_text())
    return [np.array(grid) for grid in towns["train"][:5]]


def lane_of(shape, index):
    """The row, the column and the heading of a lane."""
    return tuple(map(int, np.unravel_index(index, (*shape, 4))))


def leave_heading(heading, turn):
    return (heading + 1 - turn) % 4


def lane_after(lane, turn):
    row, column, heading = lane
    out = leave_heading(heading, turn)
    return row + STEPS[out][0], column + STEPS[out][1], out


def ways_cross(way, other):
    """By their lines across the tile: robots keep right of the middle of each side."""
    points = {"in": ((0.75, 1), (0, 0.75), (0.25, 0), (1, 0.25)), "out": ((0.75, 0), (1, 0.75), (0.25, 1), (0, 0.25))}
    (a, b), (c, d) = (
        (points["in"][heading], points["out"][leave_heading(heading, turn)]) for heading, turn in (way, other)
    )

    def side(p, q, r):
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    return b == d or (side(a, b, c) * side(a, b, d) < 0 and side(c, d, a) * side(c, d, b) < 0)


def gives_way(rule, robot, other):
    """Whether a robot waits for another one at its tile, if both want to go."""
    way, other_way = (robot["lane"][2], robot["turn"]), (other["lane"][2], other["turn"])
    if not ways_cross(way, other_way):
        return False
    if rule == "all-way stop":
        return rank(other) < rank(robot)
    side = (other_way[0] - way[0]) % 4
    return side == 3 or (side == 2 and way[1] == 2 and other_way[1] != 2)


def rank(robot):
    return robot["came"], robot["lane"][2]


def moving(robots, wants, rule):
    """The robots that move."""
    goes = set()
    for number in wants:
        beside = [
            other for other in wants if other != number and robots[other]["lane"][:2] == robots[number]["lane"][:2]
        ]
        if not any(gives_way(rule, robots[number], robots[other]) for other in beside):
            goes.add(number)
    for number in wants:
        same = [other for other in wants if robots[other]["lane"][:2] == robots[number]["lane"][:2]]
        if not goes.intersection(same):
            goes.add(min(same, key=lambda other: rank(robots[other])))
    return goes


def stuck(robots):
    """Robots that can never move: lanes get free from the ends of lines on."""
    lanes = {robot["lane"]: number for number, robot in enumerate(robots)}
    blockers = [lanes.get(lane_after(robot["lane"], robot["turn"])) for robot in robots]
    free = {None}
    while more := [number for number in range(len(robots)) if number not in free and blockers[number] in free]:
        free.update(more)
    return set(range(len(robots))) - free


def slow_observation(grid, robot, robots, time):
    """What a robot sees: `here`, `turns` and `allowed`, from a graph of lanes."""
    graph = nx.DiGraph()
    lanes = lane_graph(grid)
    names = [tuple(map(int, lanes.node(index))) for index in range(len(lanes.nodes.row))]
    for start, end in lanes.edges.tolist():
        graph.add_edge(names[start], names[end])
    taken = {other["lane"] for other in robots}

    def is_crossing(lane):
        return sum((*lane[:2], heading) in graph for heading in range(4)) > 2

    def street(lane):
        tiles = [lane]
        while not is_crossing(tiles[-1]):
            (onward,) = graph[tiles[-1]]
            tiles.append(onward)
        return tiles

    def share(lane):
        return np.mean([tile in taken for tile in street(lane)])

    own = lane_after(robot["lane"], robot["turn"])
    left = nx.shortest_path_length(graph, own, robot["goal"])
    around = sum((*own[:2], heading) in taken for heading in range(4))
    waits = min(time - robot["came"], 16)
    here = (
        left / 8,
        is_crossing(robot["lane"]),
        waits / 16,
        is_crossing(own),
        share(own),
        len(street(own)) / 4,
        around / 4,
    )
    turns, allowed = np.zeros((3, 6)), [False] * 3 + [own in taken or is_crossing(robot["lane"])]
    for turn in range(3):
        after = lane_after(own, turn)
        if after not in graph[own]:
            continue
        further = [share(lane) for lane in graph[street(after)[-1]]]
        extra = min(nx.shortest_path_length(graph, after, robot["goal"]) + 1 - left, 32)
        turns[turn] = extra / 8, after in taken, share(after), len(street(after)) / 4, min(further), max(further)
        allowed[turn] = own not in taken
    return np.array(here), turns, allowed


@pytest.mark.parametrize("rule", model.RULES)
def test_robots_see_and_move_as_in_the_slow_model(grids, rule):
    rng = np.random.default_rng(0)
    move, observe, is_gridlock = map(
        jax.jit, (partial(model.move, rule=model.RULES[rule]), model.observe, model.is_gridlock)
    )
    gridlocks = 0
    for number, grid in enumerate(grids):
        town, name = model.make_town(grid), partial(lane_of, grid.shape)
        traffic = model.place(jax.random.key(number), town, ROBOTS)
        for time in range(20):
            state = jax.tree.map(np.asarray, traffic)
            robots = [
                {"lane": name(lane), "turn": turn, "goal": name(goal), "came": came}
                for lane, turn, goal, came in zip(*(field.tolist() for field in state[:4]), strict=True)
            ]
            assert len({robot["lane"] for robot in robots}) == ROBOTS
            assert set(np.flatnonzero(is_gridlock(town, traffic)).tolist()) == stuck(robots)
            seen = jax.tree.map(np.asarray, observe(town, traffic))
            if time % 5 == 0:
                for robot, *row in zip(robots, *seen, strict=True):
                    here, turns, allowed = slow_observation(grid, robot, robots, time)
                    np.testing.assert_allclose(row[0], here, atol=1e-6)
                    np.testing.assert_allclose(row[1], turns, atol=1e-6)
                    np.testing.assert_array_equal(row[3], allowed)
            # Robots that can move seldom wait.
            chances = seen.allowed * rng.random((ROBOTS, 4)) * [1, 1, 1, 0.5]
            choice = chances.argmax(axis=1)
            goes = moving(robots, np.flatnonzero(choice != model.WAIT).tolist(), rule)
            traffic, reached = move(jax.random.key(time), town, traffic, jnp.asarray(choice))
            assert int(traffic.time) == time + 1
            for index, robot in enumerate(robots):
                lane = lane_after(robot["lane"], robot["turn"]) if index in goes else robot["lane"]
                assert name(int(traffic.lane[index])) == lane
                assert int(traffic.turn[index]) == (choice[index] if index in goes else robot["turn"])
                assert int(traffic.came[index]) == (time + 1 if index in goes else robot["came"])
                assert bool(reached[index]) == (index in goes and lane == robot["goal"])
                assert bool(reached[index]) or int(traffic.goal[index]) == state.goal[index]
        gridlocks += len(stuck(robots)) > 0
    assert gridlocks


def test_a_line_closes_if_and_only_if_its_robots_are_then_in_gridlock(grids):
    robots, rule = 24, model.RULES["all-way stop"]

    @jax.jit
    def look_and_move(key, town, traffic):
        """Returns which choices are possible, which close a line or make a gridlock alone, and the next state."""
        seen = model.observe(town, traffic)

        def makes_gridlock(robot, turn):
            choice = jnp.full(robots, model.WAIT).at[robot].set(turn)
            return model.is_gridlock(town, model.move(key, town, traffic, choice, rule)[0]).any()

        numbers, turns = jnp.mgrid[:robots, :3]
        makes = jax.vmap(jax.vmap(makes_gridlock))(numbers, turns)
        after, _ = model.move(key, town, traffic, sharing.shortest(key, seen), rule)
        return seen.allowed[:, :3], seen.closes, makes, after

    closed, is_gridlock = 0, jax.jit(model.is_gridlock)
    for number, grid in enumerate(grids[:3]):
        town = model.make_town(grid)
        traffic = model.place(jax.random.key(number), town, robots)
        for time in range(60):
            if is_gridlock(town, traffic).any():
                break
            allowed, closes, makes, traffic = look_and_move(jax.random.key(time), town, traffic)
            np.testing.assert_array_equal(closes[allowed], makes[allowed])
            closed += int(closes[allowed].sum())
    assert closed


def test_the_outcome_of_a_run_is_that_of_its_steps(grids):
    """Until the first gridlock, goals count twice: in all goals, and in the goals before."""
    robots, steps, rule = 36, 40, model.RULES["right before left"]
    town, ended_early = model.make_town(grids[0]), 0
    run = partial(sharing.drive, policy=sharing.shortest, rule="right before left", robots=robots, steps=steps)
    move, is_gridlock = jax.jit(partial(model.move, rule=rule)), jax.jit(model.is_gridlock)
    choose = jax.jit(lambda key, town, traffic: sharing.shortest(key, model.observe(town, traffic)))
    for number in range(4):
        placing, driving = jax.random.split(jax.random.key(number))
        traffic, free, goals, before = model.place(placing, town, robots), 0, 0, 0
        for key in jax.random.split(driving, steps):
            choosing, going = jax.random.split(key)
            is_free = not is_gridlock(town, traffic).any()
            traffic, reached = move(going, town, traffic, choose(choosing, town, traffic))
            free, goals, before = free + is_free, goals + int(reached.sum()), before + is_free * int(reached.sum())
        assert tuple(map(int, run(jax.random.key(number), town))) == (free, before, goals)
        ended_early += free < steps
    assert ended_early


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
