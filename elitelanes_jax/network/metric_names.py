"""The metrics of a network by name: the record, without JAX."""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from jaxtyping import Array, Float32, Int32


class Metrics(NamedTuple):
    """The metrics of one network, int32 scalars, `coverage` a float32; or arrays ``[...]`` of many networks.

    The graph's nodes are the non-empty tiles, its edges the links: neighbouring tiles that both connect to each other.
    A connection that the neighbour does not return, or that leaves the grid, is unmatched. Letters are the paper's
    (section "Evaluation Metrics").

    Attributes:
      components: connected components (CO).
      cyclomatic: cyclomatic number, edges - tiles + components (CY).
      dead_ends: tiles with exactly one connection or with an unmatched one (DE).
      boundary_violations: tiles with a connection that leaves the grid (BV).
      bridges: cut-edges, edges whose removal adds a component.
      crossings: tiles with three or four connections (CR).
      adjacent_crossings: linked pairs of crossings, counted from both tiles, so 2 a pair.
      adjacent_crossing_score: sum of the connections of both tiles over linked pairs of crossings (ACV).
      adjacent_turns: pairs of turns that share a side, linked or not (AT).
      straight_score: sum of L² over maximal runs of L straight tiles of one orientation, lined up along it (SR).
      straights: tiles with two connections on opposite sides.
      turns: tiles with two connections on adjacent sides.
      crowded_crossings: pairs of tiles that share a side, linked or not, of which one is a crossing and the other a
        crossing or a turn; Duckietown's rules allow none.
      unlinked_neighbours: pairs of non-empty tiles that share a side without a link; Duckietown's rules allow none.
      tiles: non-empty tiles.
      empty_cells: cells with no connection.
      edges: links.
      mismatches: unmatched connections inside the grid.
      off_alphabet: tiles whose code is not in the alphabet given to `measure`; 0 without an alphabet.
      coverage: tiles / all cells, in [0, 1] (CV).
    """

    components: "Int32[Array, '...']"
    cyclomatic: "Int32[Array, '...']"
    dead_ends: "Int32[Array, '...']"
    boundary_violations: "Int32[Array, '...']"
    bridges: "Int32[Array, '...']"
    crossings: "Int32[Array, '...']"
    adjacent_crossings: "Int32[Array, '...']"
    adjacent_crossing_score: "Int32[Array, '...']"
    adjacent_turns: "Int32[Array, '...']"
    straight_score: "Int32[Array, '...']"
    straights: "Int32[Array, '...']"
    turns: "Int32[Array, '...']"
    crowded_crossings: "Int32[Array, '...']"
    unlinked_neighbours: "Int32[Array, '...']"
    tiles: "Int32[Array, '...']"
    empty_cells: "Int32[Array, '...']"
    edges: "Int32[Array, '...']"
    mismatches: "Int32[Array, '...']"
    off_alphabet: "Int32[Array, '...']"
    coverage: "Float32[Array, '...']"


METRIC_NAMES = Metrics._fields[:-1]
"""The metrics that are whole numbers: all except `coverage`, which follows from `tiles`."""


def largest_metrics(shape: tuple[int, int]) -> dict[str, int]:
    """Returns an upper bound of each metric in `METRIC_NAMES` on grids ``(height, width)``, by name."""
    area = shape[0] * shape[1]
    # Two links, two pairs and four connections per tile. A pair of crossings counts twice, and scores at most eight
    # each time. One run in each row or column scores L².
    others = {
        "bridges": 2 * area,
        "edges": 2 * area,
        "adjacent_turns": 2 * area,
        "crowded_crossings": 2 * area,
        "unlinked_neighbours": 2 * area,
        "adjacent_crossings": 4 * area,
        "mismatches": 4 * area,
        "adjacent_crossing_score": 16 * area,
        "straight_score": max(shape) * area,
    }
    return {name: others.get(name, area) for name in METRIC_NAMES}
