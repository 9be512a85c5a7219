"""Road networks as graphs: linked tiles, the roads between crossings, and a graph of NetworkX."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import KIND_OF, SIDE_TOWARDS, SIDES, Side

if TYPE_CHECKING:
    import networkx

Cell = tuple[int, int]
"""A cell of a grid: row and column, from the north-west corner."""


def side_towards(cell: Cell, neighbour: Cell) -> Side:
    """Returns the side of a cell that faces a neighbour."""
    return SIDE_TOWARDS[neighbour[0] - cell[0], neighbour[1] - cell[1]]


def linked_tiles(codes: ArrayLike) -> dict[Cell, list[Cell]]:
    """Returns the linked neighbours of each non-empty tile, clockwise from north; tiles in the order of rows."""
    rows = np.asarray(check_grid(codes)).tolist()
    tiles = {(row, column): code for row, line in enumerate(rows) for column, code in enumerate(line) if code}
    return {
        (row, column): [
            (row + down, column + right)
            for bit, _, _, down, right, opposite in SIDES
            if code & bit and tiles.get((row + down, column + right), 0) & opposite
        ]
        for (row, column), code in tiles.items()
    }


def tile_graph(codes: ArrayLike) -> "networkx.Graph":
    """Returns the graph of a grid's tiles and their links.

    Args:
      codes: integer codes ``[H, W]``.

    Returns:
      A graph whose nodes are the non-empty tiles, as (row, column), in the order of their rows; each with `code`, an
      int, and `kind`, a name of `codes.KINDS`. Edges are the links: neighbours that both connect to each other.

    Raises:
      InputError: for a bad grid, or without NetworkX.
    """
    nx = import_optional("networkx", "graphs need NetworkX")
    grid = np.asarray(check_grid(codes))
    links = linked_tiles(grid)
    graph = nx.Graph()
    graph.add_nodes_from((tile, {"code": int(grid[tile]), "kind": KIND_OF[int(grid[tile])]}) for tile in links)
    graph.add_edges_from((tile, other) for tile, others in links.items() for other in others if other > tile)
    return graph


def walk_roads(links: dict[Cell, list[Cell]], nodes: set[Cell]) -> list[list[Cell]]:
    """Lists the tiles of each road from node to node, with both; each road once.

    `links` are those of `linked_tiles`. `nodes` are the tiles where roads end; all other tiles have two links. Roads
    are in the order of their first ends, those of an end clockwise from north. Rings without a node come last; each
    starts and ends at its first tile.
    """
    paths: list[list[Cell]] = []
    walked: set[tuple[Cell, Cell]] = set()  # the last steps of roads: they are first steps from the other end
    passed = set(nodes)

    def walk(node: Cell, ends: set[Cell]) -> None:
        for other in links[node]:
            if (node, other) not in walked:
                path = [node, other]
                while path[-1] not in ends:
                    path.append(next(tile for tile in links[path[-1]] if tile != path[-2]))
                walked.add((path[-1], path[-2]))
                passed.update(path)
                paths.append(path)

    for node in sorted(nodes):
        walk(node, nodes)
    for tile in links:
        if tile not in passed:
            walk(tile, {tile})
    return paths
