"""Graphs, against NetworkX and the metrics."""

import networkx as nx
from conftest import ALL_SHAPES, grids
from hypothesis import given
from oracle import road_graph

from elitelanes_jax.formats.graph import tile_graph
from elitelanes_jax.network.plain_metrics import plain_measure


def cyclomatic(graph):
    return graph.number_of_edges() - graph.number_of_nodes() + nx.number_connected_components(graph)


@given(grids(ALL_SHAPES))
def test_the_tile_graph_has_what_is_measured(grid):
    graph, metrics = tile_graph(grid), plain_measure(grid)
    assert nx.utils.graphs_equal(nx.Graph(graph.edges), nx.Graph(road_graph(grid).edges))
    assert list(graph) == sorted(road_graph(grid))
    assert graph.number_of_nodes() == metrics["tiles"]
    assert graph.number_of_edges() == metrics["edges"]
    assert nx.number_connected_components(graph) == metrics["components"]
    assert cyclomatic(graph) == metrics["cyclomatic"]
    assert sum(1 for _ in nx.bridges(graph)) == metrics["bridges"]
    assert sum(kind.startswith("crossing") for _, kind in graph.nodes(data="kind")) == metrics["crossings"]
    assert sum(kind == "turn" for _, kind in graph.nodes(data="kind")) == metrics["turns"]
