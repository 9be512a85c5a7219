"""Road networks as graphs of NetworkX: tiles as nodes, or crossings as nodes and roads as edges.

`tile_graph` has the nodes and edges that `measure` counts. `reduced_graph` has the same components, cyclomatic number
and total length, without the tiles at which there is no choice of way:

- Its nodes are the tiles with three or four connections ("crossing"), the tiles with one link or none ("end"), and, in
  a component that is a ring without either, the ring's first tile ("ring").
- Its edges are the roads between them. Several roads may join two crossings, and a road may return to its crossing, so
  it is a multigraph with self-loops. A ring is one self-loop.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CONNECTIONS, KIND_OF, SIDES

if TYPE_CHECKING:
    import networkx

Cell = tuple[int, int]
"""A cell of a grid: row and column, from the north-west corner."""


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
      InputError: for a bad grid (see `check_grid`), or without NetworkX.
    """
    nx = _networkx()
    grid = np.asarray(check_grid(codes))
    links = linked_tiles(grid)
    graph = nx.Graph()
    graph.add_nodes_from((tile, {"code": int(grid[tile]), "kind": KIND_OF[int(grid[tile])]}) for tile in links)
    graph.add_edges_from((tile, other) for tile, others in links.items() for other in others if other > tile)
    return graph


def reduced_graph(codes: ArrayLike) -> "networkx.MultiGraph":
    """Returns the graph of a grid's crossings and the roads between them.

    Args:
      codes: integer codes ``[H, W]``.

    Returns:
      A multigraph. Its nodes are tiles as (row, column), in the order of their rows, each with `code`, an int, and
      `kind`, "crossing", "end" or "ring". Each edge has `length`, an int, the steps from tile to tile along the road,
      which is its length in tiles from centre to centre; and `path`, its ``length + 1`` tiles with both ends. The path
      starts at the end that comes first in the order of rows. The path of a self-loop leaves its node by the first side
      clockwise from north. Parallel edges have the keys 0, 1, ..., clockwise from north around the first end.

    Raises:
      InputError: for a bad grid (see `check_grid`), or without NetworkX.
    """
    nx = _networkx()
    grid = np.asarray(check_grid(codes))
    links = linked_tiles(grid)
    graph = nx.MultiGraph()
    for tile, others in links.items():
        if CONNECTIONS[grid[tile]] >= 3:
            graph.add_node(tile, code=int(grid[tile]), kind="crossing")
        elif len(others) < 2:
            graph.add_node(tile, code=int(grid[tile]), kind="end")
    for path in walk_roads(links, set(graph)):
        if path[0] not in graph:
            graph.add_node(path[0], code=int(grid[path[0]]), kind="ring")
        graph.add_edge(path[0], path[-1], length=len(path) - 1, path=path)
    ordered = nx.MultiGraph()
    ordered.add_nodes_from(sorted(graph.nodes(data=True)))
    ordered.add_edges_from(graph.edges(keys=True, data=True))
    return ordered


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


def to_graphml(graph: Untyped) -> str:
    """Returns a graph of `tile_graph` or `reduced_graph` as the text of a GraphML file.

    Nodes are named "row,column" and also have `row` and `column`. A path is the names of its tiles with spaces between.

    Raises:
      InputError: without NetworkX.
    """
    nx = _networkx()
    name = "{0[0]},{0[1]}".format
    written = graph.__class__()
    for tile, data in graph.nodes(data=True):
        written.add_node(name(tile), row=tile[0], column=tile[1], **data)
    for index, (one, other, data) in enumerate(graph.edges(data=True)):
        # The key becomes the edge's name in the file, which must be unique.
        roads = {"path": " ".join(map(name, data["path"])), "key": index} if graph.is_multigraph() else {}
        written.add_edge(name(one), name(other), **data | roads)
    return "\n".join(nx.generate_graphml(written)) + "\n"


def _networkx() -> Untyped:
    return import_optional("networkx", "graphs need NetworkX")
