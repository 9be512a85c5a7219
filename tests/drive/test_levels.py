"""Levels: drawn ones are as asked for, and faults are named."""

import re
from functools import partial

import jax
import networkx as nx
import numpy as np
import pytest
from driving_oracle import drawn_maps, lane_graph, pick

from elitelanes_jax import InputError
from elitelanes_jax.drive import UNREACHABLE, LaneNode, check_level, make_levels
from elitelanes_jax.drive._levels import make_level

SHAPE = (4, 5)
make = jax.jit(make_level)

# A ring to the west; to the east a road with two ends.
RING = np.array([[6, 3, 0, 0], [12, 9, 0, 2], [0, 0, 4, 9]], np.int8)


@pytest.fixture(scope="module")
def maps():
    return drawn_maps(1, 16, SHAPE)


def test_drawn_levels_are_as_far_as_asked(maps):
    for least, most in ((1, UNREACHABLE), (4, 6)):
        levels = jax.device_get(check_level(make_levels(jax.random.key(2), maps, 16, least=least, most=most), SHAPE))
        starts = set()
        for number in range(16):
            one = pick(levels, number)
            graph = lane_graph(maps[number])
            lengths = nx.single_source_shortest_path_length(graph.reverse(copy=False), tuple(one.goal))
            assert lengths[tuple(one.start)] == one.shortest > 0
            furthest, asked = max(lengths.values()), [length for length in lengths.values() if least <= length <= most]
            assert one.shortest in asked or (not asked and (one.shortest == furthest or one.shortest > most))
            starts.add(tuple(one.start))
        assert len(starts) > 8


@pytest.mark.slow
def test_goals_are_drawn_from_all_places_that_can_be_reached():
    grid = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    levels = jax.device_get(make_levels(jax.random.key(3), grid[None], 400))
    graph = lane_graph(grid)
    goals, counts = np.unique(np.stack(levels.goal, axis=1), axis=0, return_counts=True)
    expected = {node for node in graph if graph.in_degree(node)}
    assert {tuple(goal) for goal in goals.tolist()} == expected
    each = 400 / len(expected)
    assert (abs(counts - each) < 5 * np.sqrt(each)).all()


def test_the_same_key_draws_the_same(maps):
    one, other, third = (make_levels(jax.random.key(seed), maps) for seed in (4, 4, 5))
    jax.tree.map(np.testing.assert_array_equal, one, other)
    assert (one.start.row != third.start.row).any()


ROAD = "expected a tile of the road .* got row"


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((2, 0, 1), (0, 1, 1), f"start: {ROAD} 2, column 0, heading 1"),
        ((0, 0, 1), (0, 1, 1), f"start: {ROAD} 0, column 0, heading 1"),  # nothing behind that heading
        ((0, 1, 1), (-1, 0, 1), f"goal: {ROAD} -1"),
        ((0, 1, 1), (0, 1, 4), f"goal: {ROAD} 0, column 1, heading 4"),
        ((0, 1, 1), (2, 2, 3), "goal: expected a node ahead .* got one that no way leads to"),
        ((0, 1, 1), (0, 1, 1), "goal: expected a node ahead that can be reached from the start, got its start"),
        ((1, 3, 0), (2, 2, 3), "goal: expected a node ahead that can be reached"),  # a dead end
    ],
)
def test_faults_of_a_level_are_named(start, goal, message):
    with pytest.raises(InputError, match=f"level.{message}"):
        check_level(make(RING, LaneNode(*start), LaneNode(*goal)))


def test_faults_of_a_batch_are_named(maps, any_types):
    key, level = jax.random.key(0), make(RING, LaneNode(0, 1, 1), LaneNode(1, 0, 3))
    levels = make_levels(key, maps[:3])
    assert check_level(level) is level and level.shortest == 2
    loose = np.array(level.grid)
    loose[2, 0] = 8
    faults = {
        "level.grid: expected 4 x 5 tiles, got 3 x 4": lambda: check_level(level, SHAPE),
        "level.shortest: expected 2, the distance, got 3": lambda: check_level(level._replace(shortest=np.int32(3))),
        "level.ways: expected the result of": lambda: check_level(level._replace(ways=level.ways ^ 1)),
        "level.grid: expected connections that the neighbour returns, got another at row 2, column 0": lambda: (
            check_level(level._replace(grid=loose))
        ),
        "level[1].shortest: expected": lambda: check_level(levels._replace(shortest=levels.shortest.at[1].set(99))),
        "level: expected equally many grids": lambda: check_level(levels._replace(shortest=levels.shortest[:2])),
        "level: expected one of make_level, or a batch of make_levels, got None": lambda: check_level(None),
        "grids[1]: expected a map with a lane, got one without": lambda: make_levels(key, maps[:2] * [[[1]], [[0]]]),
        "grids: map 0: grid: expected tile codes 0 to 15, got 16": lambda: make_levels(key, np.full((1, *SHAPE), 16)),
        "grids: expected one or more of one size, got several sizes": lambda: make_levels(key, [maps[0], RING]),
        "least: expected a whole number, 1 or more, got nan": lambda: make_levels(key, maps, least=float("nan")),
    }
    for goal in (None, "abc", (1, 2), (float("nan"), 0, 0)):
        words = f"goal: expected a row, a column and a heading, whole numbers, got {goal!r}"
        faults[words] = partial(make_level, RING, LaneNode(0, 1, 1), goal)
    for words, fault in faults.items():
        with pytest.raises(InputError, match=re.escape(words)):
            fault()
