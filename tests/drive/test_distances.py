"""Distances and ways: NetworkX finds the same."""

import jax
import networkx as nx
import numpy as np
import pytest
from compiled_programs import compilations
from driving_oracle import drawn_maps, lane_graph
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from refusals import refused

from elitelanes_jax.drive import UNREACHABLE, LaneNode, distances, lane_nodes
from elitelanes_jax.drive._distances import NO_WAY, shortest_ways

SHAPE = (5, 6)
find = jax.jit(distances)
find_ways = jax.jit(shortest_ways)
find_nodes = jax.jit(lane_nodes)
any_grids = hnp.arrays(np.int8, (3, 4), elements=st.integers(0, 15))
small_grids = hnp.arrays(np.int8, (3, 4), elements=st.sampled_from((3, 5, 6, 7, 9, 11, 12, 13, 14, 15)))


def lengths_to(graph, goal, shape):
    table = np.full((*shape, 4), UNREACHABLE)
    if goal in graph:
        for node, length in nx.single_source_shortest_path_length(graph.reverse(copy=False), goal).items():
            table[node] = length
    return table


@settings(max_examples=60)
@given(any_grids, st.data())
def test_distances_are_those_of_networkx(grid, data):
    goal = tuple(data.draw(st.integers(0, size - 1)) for size in (*grid.shape, 4))
    graph = lane_graph(grid)
    listed = {tuple(node) for node in np.argwhere(find_nodes(grid)).tolist()}
    assert listed == set(graph)
    np.testing.assert_array_equal(find(grid, LaneNode(*goal)), lengths_to(graph, goal, grid.shape))


@settings(max_examples=40)
@given(small_grids, st.data())
def test_ways_are_shortest(grid, data):
    graph = lane_graph(grid)
    if not graph:
        return
    listed = sorted(graph)
    goal = data.draw(st.sampled_from(listed))
    table = lengths_to(graph, goal, grid.shape)
    ways = np.asarray(find_ways(grid, LaneNode(*goal)))
    for node in listed:
        onward = {data["turn"]: table[there] for _, there, data in graph.out_edges(node, data=True)}
        best = min(onward.values(), default=UNREACHABLE)
        expected = [turn for turn in range(3) if best < UNREACHABLE and onward.get(turn) == best]
        assert ways[node[:2]] >> 2 * node[2] & 3 == (expected[0] if expected else NO_WAY)


def serpentine(height, width):
    """One road that fills the grid row by row, with a loop back at both ends to turn round."""
    grid = np.full((height, width), 5)
    for row in range(height - 1):
        column = width - 1 if row % 2 == 0 else 0
        grid[row, column] = 3 if column else 6
        grid[row + 1, column] = 9 if column else 12
    grid[0, 0] = 4
    grid[height - 1, 0 if height % 2 == 0 else width - 1] = 4 if height % 2 == 0 else 1
    return grid.astype(np.int8)


def test_the_longest_way_is_found():
    grid = serpentine(16, 64)  # its distances need 32 bits
    found = find(grid, LaneNode(15, 0, 3))
    assert found[0, 1, 1] == 16 * 64 - 2
    small = serpentine(4, 5)
    np.testing.assert_array_equal(find(small, LaneNode(3, 0, 3)), lengths_to(lane_graph(small), (3, 0, 3), (4, 5)))

    for nowhere in (LaneNode(0, 0, 1), LaneNode(-1, 0, 0), LaneNode(9, 9, 2)):
        assert (find(small, nowhere) == UNREACHABLE).all()


def many(seed, count):
    grids = np.concatenate([drawn_maps(seed, count // 2, SHAPE, fill=fill) for fill in (True, False)])
    return grids, LaneNode(*np.random.default_rng(seed).integers(0, (*SHAPE, 4), (count, 3), np.int32).T)


@pytest.mark.slow
def test_a_hundred_thousand_distances_are_those_of_networkx():
    compared, find_all = 0, jax.jit(jax.vmap(distances))
    for seed in range(1, 51):
        grids, goals = many(seed, 2000)
        found = np.asarray(find_all(grids, goals))
        compared += (found < UNREACHABLE).sum()
        for grid, table, *goal in zip(grids, found, *goals, strict=True):
            np.testing.assert_array_equal(table, lengths_to(lane_graph(grid), tuple(goal), SHAPE))
    assert compared > 100_000


def test_one_program_serves_all_grids_and_alone_is_as_in_a_batch():
    grids, goals = many(9, 4)
    batch = jax.jit(jax.vmap(distances))(grids, goals)
    find(grids[0], LaneNode(*np.int32([1, 1, 1])))
    with compilations() as compiled:
        alone = [find(grid, LaneNode(*goal)) for grid, *goal in zip(grids, *goals, strict=True)]
    assert not compiled
    np.testing.assert_array_equal(np.stack(alone), batch)
    np.testing.assert_array_equal(distances(grids[0], LaneNode(*(part[0] for part in goals))), batch[0])


def test_a_wrong_grid_is_refused():
    with refused("grid", "-1 at A1 ([0, 0])"):
        distances(np.full((3, 3), -1), LaneNode(0, 0, 0))


@pytest.mark.parametrize("row", [2**32, -(2**32), 2**70, np.int64(2**32), np.array(2**32), np.uint64(2**63)])
def test_no_grid_has_a_node_whose_row_needs_more_than_32_bits(row):
    grid = np.array([[6, 7, 3], [12, 13, 9]])
    assert (distances(grid, LaneNode(0, 1, 1)) < UNREACHABLE).any()
    assert (distances(grid, LaneNode(row, 1, 1)) == UNREACHABLE).all()


@pytest.mark.parametrize("row", ["0", None, True])
def test_a_node_of_anything_but_numbers_is_refused(any_types, row):
    with refused("goal", "LaneNode(row=..., column=0, heading=0)"):
        distances(np.array([[6, 3], [12, 9]]), LaneNode(row, 0, 0))
