"""Graphs, against NetworkX and the metrics."""

import io
import re
from itertools import pairwise

import networkx as nx
import numpy as np
import pytest
from conftest import grids
from hypothesis import given
from oracle import road_graph

from elitelanes_jax.formats.graph import reduced_graph, tile_graph, to_graphml
from elitelanes_jax.network.metrics import measure


def cyclomatic(graph):
    return graph.number_of_edges() - graph.number_of_nodes() + nx.number_connected_components(graph)


@given(grids(thin=True))
def test_the_tile_graph_has_what_is_measured(grid):
    graph, metrics = tile_graph(grid), measure(grid)
    assert nx.utils.graphs_equal(nx.Graph(graph.edges), nx.Graph(road_graph(grid).edges))
    assert list(graph) == sorted(road_graph(grid))
    assert graph.number_of_nodes() == metrics.tiles
    assert graph.number_of_edges() == metrics.edges
    assert nx.number_connected_components(graph) == metrics.components
    assert cyclomatic(graph) == metrics.cyclomatic
    assert sum(1 for _ in nx.bridges(graph)) == metrics.bridges
    assert sum(kind.startswith("crossing") for _, kind in graph.nodes(data="kind")) == metrics.crossings
    assert sum(kind == "turn" for _, kind in graph.nodes(data="kind")) == metrics.turns


@given(grids(thin=True))
def test_the_reduced_graph_keeps_what_matters(grid):
    tiles, graph, metrics = tile_graph(grid), reduced_graph(grid), measure(grid)
    assert nx.number_connected_components(graph) == metrics.components
    assert cyclomatic(graph) == metrics.cyclomatic
    assert sum(length for *_, length in graph.edges(data="length")) == metrics.edges
    kinds = dict(graph.nodes(data="kind"))
    assert sum(kind == "crossing" for kind in kinds.values()) == metrics.crossings
    assert list(graph) == sorted(graph)
    walked = set()
    for one, other, data in graph.edges(data=True):
        path = data["path"]
        assert {path[0], path[-1]} == {one, other} and path[0] <= path[-1]
        assert not set(path[1:-1]) & set(graph)
        assert data["length"] == len(path) - 1
        walked |= {frozenset(step) for step in pairwise(path)}
    assert walked == {frozenset(edge) for edge in tiles.edges}
    for node, kind in kinds.items():
        links = tiles.degree(node)
        assert graph.degree(node) == links
        assert kind == "crossing" or links == {"end": min(links, 1), "ring": 2}[kind]


def test_loops_parallel_roads_and_ends():
    ring = np.array([[6, 3], [12, 9]])
    assert list(reduced_graph(ring).edges(keys=True, data=True)) == [
        ((0, 0), (0, 0), 0, {"length": 4, "path": [(0, 0), (0, 1), (1, 1), (1, 0), (0, 0)]})
    ]
    eight = reduced_graph([[6, 7, 3], [12, 13, 9]])  # the second row's crossing leads to the east: unanswered there
    assert dict(eight.nodes(data="kind")) == {(0, 1): "crossing", (1, 1): "crossing"}
    assert sorted(eight.edges(keys=True, data="length")) == [
        ((0, 1), (1, 1), 0, 3),
        ((0, 1), (1, 1), 1, 1),
        ((0, 1), (1, 1), 2, 3),
    ]
    loop_and_end = reduced_graph([[6, 3, 0], [12, 13, 1], [0, 0, 2]])
    assert dict(loop_and_end.nodes(data="kind")) == {(1, 1): "crossing", (1, 2): "end", (2, 2): "end"}
    assert sorted(loop_and_end.edges(data="length")) == [((1, 1), (1, 1), 4), ((1, 1), (1, 2), 1)]
    assert reduced_graph([[0, 0], [0, 0]]).number_of_nodes() == 0


@pytest.mark.parametrize("reduce", [tile_graph, reduced_graph])
def test_graphml_gives_the_graph_back(reduce):
    graph = reduce([[6, 7, 3], [14, 15, 11], [12, 13, 9]])
    back = nx.read_graphml(io.StringIO(to_graphml(graph)))
    assert to_graphml(graph) == to_graphml(graph)
    names = {tile: f"{tile[0]},{tile[1]}" for tile in graph}
    assert nx.is_isomorphic(nx.Graph(back), nx.Graph(nx.relabel_nodes(graph, names)))
    assert {name: (data["row"], data["column"]) for name, data in back.nodes(data=True)} == {
        name: tile for tile, name in names.items()
    }
    if reduce is reduced_graph:
        lengths = sorted((data["length"], data["path"]) for *_, data in back.edges(data=True))
        assert lengths[0] == (1, "0,1 1,1")
        assert len(lengths) == graph.number_of_edges() == 8
        names = re.findall(r'<edge [^>]*id="(\w+)"', to_graphml(graph))
        assert len(set(names)) == 8
