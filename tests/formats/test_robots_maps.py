"""Maps for robots: MovingAI's files, by a reader of their format's rules; and the graph of lanes."""

import math

import networkx as nx
import numpy as np
import pytest
from conftest import grids
from hypothesis import assume, example, given, settings
from oracle import road_graph
from refusals import refused
from simulator_maps import KNOT

from elitelanes_jax.drive import lane_nodes, movements
from elitelanes_jax.drive.lanes import lane_length, lane_point
from elitelanes_jax.formats.movingai import to_movingai
from elitelanes_jax.lanes.curves import lane_curves, lane_lengths
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import Movement, lane_graph
from elitelanes_jax.network import wfc

TOWN = wfc.generate_batch(np.random.default_rng(0), 1, (9, 7), border="closed").grid[0]
ANY = np.random.default_rng(1).integers(0, 16, (9, 7)).astype(np.int8)


@pytest.mark.parametrize("grid", [TOWN, ANY], ids=["town", "any"])
def test_the_graph_of_lanes_is_that_of_the_drive_room(grid):
    moves = np.argwhere(np.asarray(movements(grid)))
    graph = lane_graph(grid)
    assert np.asarray(lane_nodes(grid))[tuple(graph.nodes)].all()
    nodes = np.stack(graph.nodes, axis=1)
    np.testing.assert_array_equal(np.stack(graph.movements, axis=1), moves)
    np.testing.assert_array_equal(nodes[graph.edges[:, 0]], moves[:, :3])
    every = Movement(*moves.T.astype(np.int32))
    after = np.stack(every.next_node, axis=-1)
    np.testing.assert_array_equal(nodes[graph.edges[:, 1]], after)
    np.testing.assert_allclose(lane_lengths()[moves[:, 3]], np.asarray(lane_length(every.turn)), rtol=1e-6)
    for share in (0, 0.3, 1):
        there = lane_point(every, share * lane_length(every.turn))
        curves = [curve for movement in graph.list_movements() for curve in lane_curves(movement)]
        ours = np.concatenate([curve.points(np.array([share])) for curve in curves])
        np.testing.assert_allclose(ours, np.stack([there.x, there.y], axis=1), atol=1e-5)


def test_a_map_without_a_lane_is_refused():
    with refused("grid", "none", expected="lane"):
        lane_graph([[4, 1], [0, 0]])
    with refused("grid", "none", expected="road"):
        to_movingai([[0, 0], [0, 0]], "town.map")


def read_movingai(text):
    """Which cells of a MovingAI map can be entered."""
    kind, height, width, start, *rows = text.splitlines()
    assert (kind, start) == ("type octile", "map")
    assert height == f"height {len(rows)}" and {f"width {len(row)}" for row in rows} == {width}
    assert set("".join(rows)) <= set(".@")
    return np.array([[cell == "." for cell in row] for row in rows])


def octile_steps(free, cell):
    """The neighbours of a cell, with the straight and the diagonal steps to them; no corner is cut."""
    row, column = cell
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            beside = [(row + down, column + right), (row + down, column), (row, column + right)]
            within = all(0 <= y < free.shape[0] and 0 <= x < free.shape[1] for y, x in beside)
            if (down or right) and within and all(free[place] for place in beside):
                yield beside[0], abs(down * right)


def cells_of(free):
    """The graph of the cells that can be entered, with the lengths of steps."""
    graph = nx.Graph()
    for cell in map(tuple, np.argwhere(free).tolist()):
        graph.add_node(cell)
        for other, slanted in octile_steps(free, cell):
            graph.add_edge(cell, other, length=math.sqrt(1 + slanted))
    return graph


@pytest.mark.parametrize(("codes", "cells"), [(TOWN, 5), (TOWN, 8), (KNOT, 6), ([[6, 3], [12, 9]], 5)])
def test_the_lengths_of_tasks_are_those_of_shortest_paths(codes, cells):
    grid, tasks = to_movingai(codes, "town.map", cells)
    free, (version, *lines) = read_movingai(grid), tasks.splitlines()
    assert version == "version 1" and len(lines) == 100
    assert to_movingai(codes, "town.map", cells) == (grid, tasks)
    listed, graph = [], cells_of(free)
    for line in lines:
        bucket, name, width, height, *ends, length = line.split("\t")
        assert (name, int(height), int(width)) == ("town.map", *free.shape)
        x, y, goal_x, goal_y = map(int, ends)
        assert (x, y) != (goal_x, goal_y)
        shortest = nx.dijkstra_path_length(graph, (y, x), (goal_y, goal_x), "length")
        assert float(length) == pytest.approx(shortest, abs=6e-9)
        assert int(bucket) == float(length) // 4
        listed.append(float(length))
    assert listed == sorted(listed)


@settings(max_examples=40)
@given(grids())
@example(TOWN)
def test_cells_are_connected_as_tiles_are(grid):
    """The roads of tiles that are not linked do not touch, not even over a corner."""
    assume(linked_codes(np.asarray(grid)).any())
    links = road_graph(np.asarray(linked_codes(np.asarray(grid))))
    for cells in (5, 6, 7):
        free = read_movingai(to_movingai(grid, "town.map", cells)[0])
        graph = cells_of(free)
        found = {(one[0] // cells, one[1] // cells, two[0] // cells, two[1] // cells) for one, two in graph.edges}
        pairs = {frozenset(((a, b), (c, d))) for a, b, c, d in found if (a, b) != (c, d)}
        assert set(map(frozenset, links.edges)) == {
            pair for pair in pairs if sum(abs(one - two) for one, two in zip(*pair, strict=True)) == 1
        }
        assert nx.number_connected_components(graph) == nx.number_connected_components(links)


@pytest.mark.parametrize("name", [None, "", "a\tmap", "a\nmap"])
def test_names_that_no_list_of_tasks_can_hold_are_refused(name):
    with refused("name", repr(name)):
        to_movingai(TOWN, name)
