"""The metrics of a network, their weights, and the features of a town: records, without JAX."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.network.checks import LONGEST_SIDE

if TYPE_CHECKING:
    from jaxtyping import Array, ArrayLike, Float32, Int, Int32


class Metrics(NamedTuple):
    """The metrics of one network, or of many networks.

    They are int32 scalars, `coverage` a float32; or arrays ``[...]`` for many networks. The graph's
    nodes are the non-empty tiles, its edges the links: neighbouring tiles that both connect to each
    other. A connection that the neighbour does not return, or that leaves the grid, is unmatched.
    Letters are the paper's (section "Evaluation Metrics").

    Attributes:
      components: connected components (CO).
      cyclomatic: cyclomatic number, edges - tiles + components (CY).
      dead_ends: tiles with exactly one connection or with an unmatched one (DE).
      boundary_violations: tiles with a connection that leaves the grid (BV).
      bridges: cut-edges, edges whose removal adds a component.
      crossings: tiles with three or four connections (CR).
      adjacent_crossings: linked pairs of crossings, counted from both tiles, so 2 a pair.
      adjacent_crossing_score: sum of the connections of both tiles over linked pairs of crossings
        (ACV).
      adjacent_turns: pairs of turns that share a side, linked or not (AT).
      straight_score: sum of L² over maximal runs of L straight tiles of one orientation, lined up
        along it (SR).
      straights: tiles with two connections on opposite sides.
      turns: tiles with two connections on adjacent sides.
      crowded_crossings: pairs of tiles that share a side, linked or not, of which one is a crossing
        and the other a crossing or a turn; Duckietown's rules allow none.
      unlinked_neighbours: pairs of non-empty tiles that share a side without a link; Duckietown's
        rules allow none.
      tiles: non-empty tiles.
      empty_cells: cells with no connection.
      edges: links.
      mismatches: unmatched connections inside the grid.
      off_alphabet: cells whose code is not in the alphabet given to `measure`; 0 without an
        alphabet.
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
    """Returns an upper bound of each metric in `METRIC_NAMES`, by name.

    The bounds are those on grids ``(height, width)``.
    """
    height, width = shape
    area, pairs = height * width, 2 * height * width - height - width
    # Most metrics count cells, and some count pairs of cells.
    most = dict.fromkeys(METRIC_NAMES, area)
    most |= dict.fromkeys(
        ("edges", "adjacent_turns", "crowded_crossings", "unlinked_neighbours"), pairs
    )
    # A pair of tiles has up to two unmatched connections. A pair of crossings counts twice, and
    # scores at most eight.
    most |= {
        "mismatches": 2 * pairs,
        "adjacent_crossings": 2 * pairs,
        "adjacent_crossing_score": 8 * pairs,
    }
    most |= {"bridges": area - 1, "cyclomatic": (height - 1) * (width - 1)}
    # The straight score is largest if one run fills each line along the longer side.
    most |= {"boundary_violations": cells_on_border(shape), "straight_score": max(shape) * area}
    return most


class Weights(NamedTuple):
    """The amount that one unit of each metric adds to the fitness: integers; negative ones reward.

    The default is the paper's equation (section "Fitness Function"), with a(x) read as adjacent
    crossings and b(x) as bridges. `jax.vmap` may map over arrays of weights.

    Attributes:
      components: the amount for each component beyond the first.
      constant: added once.
      others: each for one unit of the metric with its name.
    """

    components: "Int[ArrayLike, '...']" = 300
    cyclomatic: "Int[ArrayLike, '...']" = -2
    dead_ends: "Int[ArrayLike, '...']" = 480
    boundary_violations: "Int[ArrayLike, '...']" = 150
    bridges: "Int[ArrayLike, '...']" = 100
    crossings: "Int[ArrayLike, '...']" = 0
    adjacent_crossings: "Int[ArrayLike, '...']" = 100
    adjacent_crossing_score: "Int[ArrayLike, '...']" = 0
    adjacent_turns: "Int[ArrayLike, '...']" = 80
    straight_score: "Int[ArrayLike, '...']" = -2
    straights: "Int[ArrayLike, '...']" = 0
    turns: "Int[ArrayLike, '...']" = 0
    crowded_crossings: "Int[ArrayLike, '...']" = 0
    unlinked_neighbours: "Int[ArrayLike, '...']" = 0
    tiles: "Int[ArrayLike, '...']" = 0
    empty_cells: "Int[ArrayLike, '...']" = 0
    edges: "Int[ArrayLike, '...']" = 0
    mismatches: "Int[ArrayLike, '...']" = 0
    off_alphabet: "Int[ArrayLike, '...']" = 480
    constant: "Int[ArrayLike, '...']" = 0


def check_weights(weights: UserValue, shape: tuple[int, int], more: int = 0) -> Weights:
    """Checks weights; returns them as ints.

    Raises `InputError` if one is not a whole number, or the fitness of a grid of the shape might
    not fit int32 together with ranges and other features, which add at most `more` in size.
    """
    if not isinstance(weights, Weights):
        raise InputError("weights", "Weights", type(weights).__name__)
    for name, weight in weights._asdict().items():
        if np.ndim(weight) or not np.issubdtype(np.asarray(weight).dtype, np.integer):
            raise InputError("weights", "whole numbers", f"{name}={weight!r}")
    # Integers of Python have no limit, so the bound below is exact.
    exact = Weights(*(int(np.asarray(weight)) for weight in weights))
    largest = _largest_fitness(exact, shape) + more
    if largest >= 2**31:
        raise InputError(
            "weights",
            f"a fitness within int32 for every grid of {describe_size(shape)}",
            f"weights with which it might reach {largest:,}",
        )
    return exact


def largest_side(weights: Weights, more: int = 0) -> int:
    """Returns the longest side of a square grid whose fitness always fits int32.

    The result is 0 if the weights are too large. Ranges and other features add at most `more` in
    size.
    """
    fits = [
        side
        for side in range(2, LONGEST_SIDE + 1)
        if _largest_fitness(weights, (side, side)) + more < 2**31
    ]
    return max(fits, default=0)


def _largest_fitness(weights: Weights, shape: tuple[int, int]) -> int:
    units = largest_metrics(shape) | {"constant": 1}
    return sum(abs(int(getattr(weights, name))) * most for name, most in units.items())


LONGEST_TOWN = 128
"""The longest side of grids whose features fit 32 bits."""

LONGEST_DETOUR = 32
"""The longest side of grids whose mean detour fits 32 bits."""


class TownFeatures(NamedTuple):
    """The features of one town, int32 scalars, or arrays ``[...]`` of many.

    Only `box_share` depends on the size of the grid around the town. Parts of 1 and ratios are in
    thousandths, rounded down. A mean or part of nothing is 0. Areas are in squares of a tile
    between the middles of roads, so that the block around one cell has 4. A street is the road from
    a crossing or dead end to the next; a ring without either is one street.

    Attributes:
      crossings3: tiles with three connections, linked or not.
      crossings4: tiles with four connections, linked or not.
      largest_block: area of the largest block, an inner face of the network.
      smallest_block: area of the smallest block.
      mean_block: mean area of the blocks, a ratio.
      block_spread: mean difference between a block's area and the mean area, a ratio to the mean
        area.
      small_blocks: part of the blocks that have an area of at most 4, such as those around one
        cell.
      loops_per_tile: cyclomatic number / tiles, a ratio.
      longest_street: links of the longest street.
      shortest_street: links of the shortest street.
      mean_street: mean number of links of a street, a ratio.
      border_share: part of the tiles that are along the sides of the smallest box around the town.
      box_fill: part of the smallest box around the town that has tiles.
      box_share: part of the grid that the smallest box around the town covers.
      box_length: longer side / shorter side of the smallest box around the town, a ratio.
      symmetry: part of the cells of the smallest box around the town that agree (both tiles or both
        empty) with its most similar image: mirrored either way, or rotated by half a turn.
      repetition: part of the tiles whose neighbourhood of 3 x 3 codes equals that of another tile.
      adjacent_turns_per_tile: pairs of turns that share a side / tiles, a ratio.
      signable: part of the tiles with three or four links that have room for Duckietown's signs: no
        road on the four cells at their corners; all if there is no such tile.
      gridlock_number: the most robots that can never block each other for ever, one on each lane of a
        tile: tiles of the shortest loop - 1; 0 without a loop.
      mean_detour: way by road / way on a full grid of streets, both summed over all pairs of linked
        tiles, a ratio.
    """

    crossings3: "Int32[Array, '...']"
    crossings4: "Int32[Array, '...']"
    largest_block: "Int32[Array, '...']"
    smallest_block: "Int32[Array, '...']"
    mean_block: "Int32[Array, '...']"
    block_spread: "Int32[Array, '...']"
    small_blocks: "Int32[Array, '...']"
    loops_per_tile: "Int32[Array, '...']"
    longest_street: "Int32[Array, '...']"
    shortest_street: "Int32[Array, '...']"
    mean_street: "Int32[Array, '...']"
    border_share: "Int32[Array, '...']"
    box_fill: "Int32[Array, '...']"
    box_share: "Int32[Array, '...']"
    box_length: "Int32[Array, '...']"
    symmetry: "Int32[Array, '...']"
    repetition: "Int32[Array, '...']"
    adjacent_turns_per_tile: "Int32[Array, '...']"
    signable: "Int32[Array, '...']"
    gridlock_number: "Int32[Array, '...']"
    mean_detour: "Int32[Array, '...']"


TOWN_PARTS = (
    "small_blocks",
    "border_share",
    "box_fill",
    "box_share",
    "symmetry",
    "repetition",
    "signable",
)
"""The features that are parts of 1, in thousandths."""

TOWN_RATIOS = (
    *("mean_block", "block_spread", "loops_per_tile", "mean_street", "box_length"),
    *("adjacent_turns_per_tile", "mean_detour"),
)
"""The features that are other ratios, in thousandths."""


def features_without_gaps(shape: tuple[int, int]) -> dict[str, int]:
    """Returns the features that are equal on all grids without empty cells, by name.

    The grids have the shape ``(height, width)``.
    """
    return dict.fromkeys(("box_fill", "box_share", "symmetry"), 1000) | {
        "border_share": 1000 * cells_on_border(shape) // (shape[0] * shape[1]),
        "box_length": 1000 * max(shape) // min(shape),
    }


def cells_on_border(shape: tuple[int, int]) -> int:
    return shape[0] * shape[1] - max(shape[0] - 2, 0) * max(shape[1] - 2, 0)


def largest_town_feature(name: str, shape: tuple[int, int]) -> int:
    """Returns an upper bound of a feature on grids ``(height, width)``."""
    if name in TOWN_PARTS:
        return 1000
    # Block spread and adjacent turns per tile are at most 2, also on a grid of one cell.
    return (1000 if name in TOWN_RATIOS else 1) * max(2, shape[0] * shape[1])
