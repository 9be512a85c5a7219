"""Road networks as graphs of NetworkX."""

from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.lanes.links import linked_tiles
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import KIND_OF

if TYPE_CHECKING:
    import networkx


@name_wrong_arguments
def tile_graph(codes: ArrayLike) -> "networkx.Graph":
    """Returns the graph of a grid's tiles and their links.

    Args:
      codes: integer codes ``[H, W]``.

    Returns:
      A graph whose nodes are the non-empty tiles, as (row, column), in the order of their rows;
      each with `code`, an int, and `kind`, a name of `codes.KINDS`. Edges are the links: neighbours
      that both connect to each other.

    Raises:
      InputError: for a bad grid, or without NetworkX.
    """
    nx = import_optional("networkx", "graphs need NetworkX")
    grid = known_grid(codes)
    links = linked_tiles(grid)
    graph = nx.Graph()
    graph.add_nodes_from(
        (tile, {"code": int(grid[tile]), "kind": KIND_OF[int(grid[tile])]}) for tile in links
    )
    # Each link is found at both of its tiles, and added at the first one.
    graph.add_edges_from(
        (tile, other) for tile, others in links.items() for other in others if other > tile
    )
    return graph
