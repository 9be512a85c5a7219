"""The lanes of maps: the graph against NetworkX, curves against the oracle's polylines."""

from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from conftest import grids
from drive.driving_oracle import POINTS, lane_graph, links, polyline
from hypothesis import example, given
from refusals import refused

from elitelanes_jax.lanes import movements
from elitelanes_jax.lanes.curves import lane_curves, lane_lengths, lane_polyline
from elitelanes_jax.lanes.links import linked_codes, linked_tiles, walk_roads
from elitelanes_jax.lanes.movements import BACK, Movement, turn_between

BLOCK = np.full((4, 5), 15, np.int8)
EVERY = [(heading, turn) for heading in range(4) for turn in range(4)]


def graph_with_ways_back(grid):
    """The oracle's graph, and at each dead end a way back to the tile before."""
    graph = lane_graph(grid)
    for row, column, heading in list(graph.nodes):
        if len(links(grid, row, column)) == 1:
            down, right = [(-1, 0), (0, 1), (1, 0), (0, -1)][heading]
            before = (row - down, column - right, (heading + 2) % 4)
            graph.add_edge((row, column, heading), before, turn=BACK)
    return graph


@given(grids())
@example(BLOCK)
def test_the_graph_is_the_oracles(grid):
    assert sum(map(len, linked_tiles(grid).values())) == sum(code.bit_count() for code in linked_codes(grid).flat)
    for turn_back, expected in ((False, lane_graph(grid)), (True, graph_with_ways_back(grid))):
        if not expected.edges:
            with refused("grid", "none", expected="a road" if turn_back else "a lane"):
                movements.lane_graph(grid, turn_back=turn_back)
            continue
        graph = movements.lane_graph(grid, turn_back=turn_back)
        nodes = [graph.node(index) for index in range(graph.nodes.row.size)]
        assert nodes == sorted({node for edge in expected.edges for node in edge})
        listed = graph.list_movements()
        assert listed == sorted(listed)
        ours = nx.DiGraph()
        for movement, (start, end) in zip(listed, graph.edges.tolist(), strict=True):
            assert (nodes[start], nodes[end]) == (movement.node, movement.next_node)
            assert movement.turn == turn_between(movement.heading, movement.exit)
            assert movement.next_node.tile_before == movement.node.tile
            ours.add_edge(nodes[start], nodes[end], turn=movement.turn)
        assert sorted(ours.edges(data="turn")) == sorted(expected.edges(data="turn"))
        for movement, successors in zip(listed, graph.list_successors(), strict=True):
            assert [listed[index] for index in successors] == [m for m in listed if m.node == movement.next_node]


@given(grids())
@example(BLOCK)
def test_each_road_is_listed_once_in_the_order_of_its_first_end(grid):
    linked = linked_tiles(grid)
    nodes = {tile for tile in linked if len(linked[tile]) != 2}
    roads = walk_roads(linked, nodes)
    first_ends = [road[0] for road in roads if road[0] in nodes]
    assert first_ends == sorted(first_ends)
    steps = [sorted(step) for road in roads for step in pairwise(road)]
    assert sorted(steps) == [[tile, other] for tile in sorted(linked) for other in sorted(linked[tile]) if tile < other]


@pytest.mark.parametrize(("heading", "turn"), EVERY)
def test_curves_lead_from_lane_to_lane(heading, turn):
    """Each curve starts where the last one ends; the first one starts on the lane, and the next tile's goes on."""
    movement = Movement(3, 5, heading, turn)
    for offset in (0.2, 0.31):
        curves = lane_curves(movement, offset)
        onward = lane_curves(Movement(*movement.next_node, 1), offset)
        ends = np.array([0.0, 1.0])
        for curve, following in zip(curves, [*curves[1:], *onward], strict=True):
            np.testing.assert_allclose(curve.points(ends)[1], following[:2], atol=1e-12)
            turned = round(curve.curvature * curve.length / (np.pi / 2))
            assert (curve.heading - turned) % 4 == following.heading
        line = lane_polyline(movement, offset)
        np.testing.assert_allclose(line[[0, -1]], [curves[0][:2], onward[0][:2]], atol=1e-12)
        if turn != BACK:
            assert sum(curve.length for curve in curves) == pytest.approx(lane_lengths(offset)[turn])


@pytest.mark.parametrize(("heading", "turn"), [(heading, turn) for heading, turn in EVERY if turn != BACK])
def test_curves_are_the_oracles_polylines(heading, turn):
    (curve,) = lane_curves(Movement(3, 5, heading, turn))
    expected = polyline(heading, turn) + np.array([5, 3])
    np.testing.assert_allclose(curve.points(np.linspace(0, 1, POINTS)), expected, atol=1e-9)
    chords = lane_polyline(Movement(3, 5, heading, turn))
    assert len(chords) == (2 if turn == 1 else 17)
    np.testing.assert_allclose(chords, curve.points(np.linspace(0, 1, len(chords))), atol=1e-12)
