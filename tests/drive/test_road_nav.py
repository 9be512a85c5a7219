"""RoadNav: every step as a walk in the graph of nodes, every observation as a turned map."""

import jax
import numpy as np
import pytest
from driving_oracle import BITS, drawn_maps, lane_graph, turned
from refusals import refused

from elitelanes_jax.drive import LaneNode, RoadNav, RoadNavParams, auto_reset, make_levels
from elitelanes_jax.network.codes import rotate_codes

SHAPE, COUNT, LIMIT = (4, 5), 24, 12


@pytest.fixture(scope="module")
def params():
    maps = drawn_maps(1, COUNT, SHAPE).copy()
    maps[0] = np.pad([[4, 5, 1]], [(1, 2), (1, 1)])  # its goals are dead ends
    levels = make_levels(jax.random.key(2), maps)
    return RoadNavParams(
        levels, limit=LIMIT, goal_reward=2.0, tile_cost=0.25, stuck_cost=3.0, goal="both", whole_map=True
    )


def test_episodes_are_walks_in_the_graph_of_places(params):
    step = jax.jit(jax.vmap(RoadNav.step, in_axes=(0, 0, 0, None)))
    start = jax.jit(jax.vmap(RoadNav.reset_to_level, in_axes=(0, 0, None)))
    keys = jax.random.split(jax.random.key(0), COUNT)
    seen, states = start(keys, params.levels, params)
    levels = jax.device_get(params.levels)
    graphs = [lane_graph(grid) for grid in levels.grid]
    nodes = [tuple(int(part[number]) for part in levels.start) for number in range(COUNT)]
    goals = [tuple(int(part[number]) for part in levels.goal) for number in range(COUNT)]
    over, rng = np.zeros(COUNT, bool), np.random.default_rng(0)
    ends = {"success": 0, "stuck": 0, "cut": 0}
    for tiles in range(1, LIMIT + 1):
        check_observations(params, jax.device_get(seen), nodes, goals, over)
        # Half of the time the way ahead is one that leads to the goal, so that some episodes get there.
        actions = rng.integers(-1, 4, COUNT)
        best = [levels.ways[n][node[:2]] >> (2 * node[2]) & 3 for n, node in enumerate(nodes)]
        actions = np.where(rng.random(COUNT) < 0.7, np.minimum(best, 2), actions).astype(np.int32)
        seen, states, reward, terminated, truncated, info, _ = jax.device_get(step(keys, states, actions, params))
        for n in np.flatnonzero(~over):
            ways = {data["turn"]: there for _, there, data in graphs[n].out_edges(nodes[n], data=True)}
            wanted = min(max(int(actions[n]), 0), 2)
            nodes[n] = next(ways[turn % 3] for turn in range(wanted, wanted + 3) if turn % 3 in ways)
            success, stuck = nodes[n] == goals[n], nodes[n] != goals[n] and not graphs[n].out_degree(nodes[n])
            assert terminated[n] == (success or stuck)
            assert truncated[n] == (not terminated[n] and tiles == LIMIT)
            assert reward[n] == pytest.approx(2 * success - 3 * stuck - 0.25)
            assert info.success[n] == success and info.tiles[n] == tiles and info.shortest[n] == levels.shortest[n]
            assert info.spl[n] == pytest.approx(levels.shortest[n] / tiles if success else 0)
            over[n] = terminated[n]
            ends["success"] += success
            ends["stuck"] += stuck
            ends["cut"] += truncated[n]
    assert min(ends.values()) > 0


def check_observations(params, seen, nodes, goals, over):
    for n, (row, column, heading) in enumerate(nodes):
        if over[n]:
            continue
        assert seen.here[n].tolist() == [row, column, heading]
        grid = np.asarray(params.levels.grid[n])
        assert seen.there[n].tolist() == list(goals[n])
        np.testing.assert_array_equal(seen.whole_map[n], grid)
        around = np.pad(grid, 2)[row : row + 5, column : column + 5]
        np.testing.assert_array_equal(seen.window[n], np.rot90(rotate_codes(around, heading), heading))
        goal = np.zeros(SHAPE, bool)
        goal[goals[n][:2]] = True
        marked = np.pad(goal, 2)[row : row + 5, column : column + 5]
        np.testing.assert_array_equal(seen.mark[n], np.rot90(marked, heading))
        assert seen.ways[n].tolist() == [bool(grid[row, column] & BITS[turned(heading, turn)]) for turn in range(3)]
        towards = complex(goals[n][1] - column, row - goals[n][0])  # east, north
        egocentric = towards / 1j * np.exp(1j * np.pi / 2 * heading)
        expected = [egocentric.real / max(abs(towards), 1), egocentric.imag / max(abs(towards), 1), abs(towards)]
        np.testing.assert_allclose(seen.compass[n], expected, atol=1e-5)


def test_what_is_not_asked_for_is_not_observed(params):
    def shapes(**settings):
        asked = RoadNavParams(params.levels, **settings)
        seen = jax.eval_shape(RoadNav.reset, jax.random.key(0), asked)[0]
        return {name: part.shape for name, part in seen._asdict().items() if part is not None}

    assert shapes() == {"ways": (3,), "window": (5, 5), "compass": (3,)}
    assert shapes(window=0, goal="none") == {"ways": (3,)}
    assert shapes(window=3, goal="mark") == {"ways": (3,), "window": (3, 3), "mark": (3, 3)}
    everything = {"ways": (3,), "whole_map": SHAPE, "here": (3,)}
    assert shapes(window=0, goal="none", whole_map=True) == everything
    assert shapes(window=0, goal="mark", whole_map=True) == everything | {"there": (3,)}


@pytest.mark.parametrize("goal", ["mark", "both"])
def test_a_goal_that_would_be_marked_in_no_window_is_refused(params, goal):
    with refused("window", "0", expected="more"):
        RoadNavParams(params.levels, window=0, goal=goal)


@pytest.mark.parametrize(
    ("action", "turn"),
    [(2**40, 2), (-(2**40), 0), (np.int64(2**40 + 1), 2), (np.array(-(2**40) + 2), 0), (np.uint64(2**63), 2)],
)
def test_an_action_of_more_than_32_bits_is_clipped(params, action, turn):
    crossing = np.pad(np.array([[0, 2, 0], [4, 15, 1], [0, 8, 0]], np.int8), [(0, 1), (0, 2)])
    _, state = RoadNav.reset(jax.random.key(0), params)
    state = state._replace(grid=crossing, node=LaneNode(*np.array([1, 1, 0], np.int32)))
    expected = RoadNav.step(jax.random.key(0), state, turn, params)
    for transition in (
        RoadNav.step(jax.random.key(0), state, action, params),
        RoadNav.step(jax.random.key(0), state, action=action, params=params),
        auto_reset(RoadNav).step(jax.random.key(0), state, action, params),
    ):
        np.testing.assert_array_equal(transition.reached.ways, expected.reached.ways)
        np.testing.assert_array_equal(transition.reached.here, expected.reached.here)
