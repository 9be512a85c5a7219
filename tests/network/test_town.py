"""Features of towns against a slow oracle: faces by flooding, streets and ways with NetworkX, the rest cell by cell."""

import jax
import networkx as nx
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from gridlock_oracle import gridlock_number
from hypothesis import given
from oracle import road_graph
from refusals import refused
from sparse_towns import sparse_towns

from elitelanes_jax import mirror, rotate
from elitelanes_jax.network import measure_town
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.records import TownFeatures, largest_town_feature

measure_all = jax.jit(jax.vmap(measure_town))


def thousandths(part, whole):
    return 1000 * int(part) // int(whole) if whole else 0


def block_areas(graph, shape):
    """Squares between four tiles, joined where no link parts them; those joined to the outside are no blocks."""
    squares = nx.Graph()
    for row, column in np.ndindex(shape[0] + 1, shape[1] + 1):  # square (r, c) has tile (r, c) to its south-east
        squares.add_node((row, column))
        if column and not graph.has_edge((row - 1, column - 1), (row, column - 1)):  # to the west
            squares.add_edge((row, column), (row, column - 1))
        if row and not graph.has_edge((row - 1, column - 1), (row - 1, column)):
            squares.add_edge((row, column), (row - 1, column))
    for column in range(shape[1] + 1):
        squares.add_edges_from([((0, column), "outside"), ((shape[0], column), "outside")])
    for row in range(shape[0] + 1):
        squares.add_edges_from([((row, 0), "outside"), ((row, shape[1]), "outside")])
    return sorted(len(part) for part in nx.connected_components(squares) if "outside" not in part)


def street_lengths(graph):
    """Splits every tile that is no mere passage into one end for each link; what hangs together is a street."""
    split = nx.Graph()
    for one, other in graph.edges:
        ends = [tile if graph.degree(tile) == 2 else (tile, one, other) for tile in (one, other)]
        split.add_edge(*ends)
    return sorted(split.subgraph(part).number_of_edges() for part in nx.connected_components(split))


def oracle(grid):
    graph, road = road_graph(grid), grid > 0
    areas, streets = block_areas(graph, grid.shape), street_lengths(graph)
    tiles, mean = int(road.sum()), sum(areas) / len(areas) if areas else 0
    rows, columns = np.flatnonzero(road.any(axis=1)), np.flatnonzero(road.any(axis=0))
    box = road[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if tiles else road[:0, :0]
    inner, images = box[1:-1, 1:-1].sum(), (box[::-1], box[:, ::-1], box[::-1, ::-1])
    padded = np.pad(grid, 1)
    around = [padded[r : r + 3, c : c + 3].tobytes() for r, c in np.argwhere(road)]
    turn = np.isin(grid, KINDS["turn"])
    ways = [
        (length, abs(one[0] - other[0]) + abs(one[1] - other[1]))
        for one, lengths in nx.all_pairs_shortest_path_length(graph)
        for other, length in lengths.items()
    ]
    crossings = [cell for cell, links in graph.degree if links > 2]
    free = [cell for cell in crossings if not padded[cell[0] :, cell[1] :][:3:2, :3:2].any()]
    spread = sum(abs(len(areas) * area - sum(areas)) for area in areas)
    assert not areas or spread == pytest.approx(len(areas) * sum(abs(area - mean) for area in areas))
    return TownFeatures(
        crossings3=sum(code.bit_count() == 3 for code in grid.ravel().tolist()),
        crossings4=(grid == 15).sum(),
        largest_block=max(areas, default=0),
        smallest_block=min(areas, default=0),
        mean_block=thousandths(sum(areas), len(areas)),
        block_spread=thousandths(spread, len(areas) * sum(areas)),
        small_blocks=thousandths(sum(area <= 4 for area in areas), len(areas)),
        loops_per_tile=thousandths(len(nx.cycle_basis(graph)), tiles),
        longest_street=max(streets, default=0),
        shortest_street=min(streets, default=0),
        mean_street=thousandths(sum(streets), len(streets)),
        border_share=thousandths(tiles - inner, tiles),
        box_fill=thousandths(tiles, box.size),
        box_share=thousandths(box.size, grid.size),
        box_length=thousandths(max(box.shape), min(box.shape)),
        symmetry=thousandths(max((box == other).sum() for other in images), box.size),
        repetition=thousandths(sum(around.count(one) > 1 for one in around), tiles),
        adjacent_turns_per_tile=thousandths((turn[1:] & turn[:-1]).sum() + (turn[:, 1:] & turn[:, :-1]).sum(), tiles),
        signable=thousandths(len(free), len(crossings)) if crossings else 1000,
        gridlock_number=gridlock_number(grid),
        mean_detour=thousandths(sum(way for way, _ in ways), sum(straight for _, straight in ways)),
    )


def as_ints(features):
    return {name: int(value) for name, value in features._asdict().items()}


@given(grids([(2, 2), (2, 5), (6, 6), (5, 1)]))
def test_features_of_any_grid_are_the_oracles(grid):
    assert as_ints(measure_town(grid)) == as_ints(oracle(grid))


@pytest.mark.slow
@given(grids(ALL_SHAPES))
def test_features_of_grids_of_more_shapes_are_the_oracles(grid):
    assert as_ints(measure_town(grid)) == as_ints(oracle(grid))


def test_features_of_made_towns(towns):
    found = measure_all(towns)
    for index, grid in enumerate(towns):
        assert as_ints(jax.tree.map(lambda values, index=index: values[index], found)) == as_ints(oracle(grid))


@pytest.fixture(scope="module")
def towns():
    return sparse_towns(60, 9)


def test_a_known_town():
    """A ring round one cell beside a ring of 3 x 5 tiles."""
    grid = np.array([[6, 5, 7, 5, 5, 5, 3], [10, 0, 10, 0, 0, 0, 10], [12, 5, 13, 5, 5, 5, 9]])
    found = as_ints(measure_town(grid))
    known = {"largest_block": 8, "smallest_block": 4, "mean_block": 6000, "block_spread": 333, "small_blocks": 500}
    known |= {"longest_street": 10, "shortest_street": 2, "mean_street": 6000, "border_share": 941, "box_fill": 809}
    known |= {"box_length": 2333, "symmetry": 1000, "adjacent_turns_per_tile": 0}
    assert {name: found[name] for name in known} == known


@pytest.mark.slow
def test_the_grid_around_a_town_changes_nothing(towns):
    padded = np.pad(towns[:20], [(0, 0), (2, 1), (3, 0)])
    alone, within = (measure_all(grids)._replace(box_share=0) for grids in (towns[:20], padded))
    jax.tree.map(np.testing.assert_array_equal, within, alone)


def test_rotating_and_mirroring_change_nothing(towns):
    for grid in towns[:5]:
        assert as_ints(measure_town(mirror(grid))) == as_ints(measure_town(rotate(grid))) == as_ints(measure_town(grid))


def test_values_are_within_their_bounds(towns):
    full = np.array(jax.random.randint(jax.random.key(0), (60, 9, 9), 0, 16), np.int8)
    for found in (measure_all(towns), measure_all(full)):
        for name, values in found._asdict().items():
            assert values.min() >= 0 and values.max() <= largest_town_feature(name, (9, 9))


def test_large_grids_are_refused():
    with refused("grid", "(33, 2)", expected="at most 32"):
        measure_town(np.zeros((33, 2), np.int8))
    with refused("grid", "(2, 129)", expected="at most 128"):
        measure_town(np.zeros((2, 129), np.int8), detour=False)
    assert int(measure_town(np.full((40, 3), 15, np.int8), detour=False).largest_block) == 1
