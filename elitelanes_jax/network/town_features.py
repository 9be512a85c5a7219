"""The features of a town by name: the record, without JAX."""

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from jaxtyping import Array, Int32

LONGEST_TOWN = 128
"""The longest side of grids whose features fit 32 bits."""

LONGEST_DETOUR = 32
"""The longest side of grids whose mean detour fits 32 bits."""


class TownFeatures(NamedTuple):
    """The features of one town, int32 scalars, or arrays ``[...]`` of many.

    None but `box_share` depends on the size of the grid around the town. Parts of 1 and ratios are in thousandths,
    rounded down; what is measured of nothing is 0. Areas are in squares of a tile between the middles of roads, so that
    the block around one cell has 4. A street is the road from a crossing or dead end to the next; a ring without either
    is one street.

    Attributes:
      largest_block: area of the largest block, an inner face of the network.
      smallest_block: area of the smallest block.
      mean_block: mean area of the blocks, a ratio.
      block_spread: mean difference of a block's area from their mean, as a ratio to the mean.
      small_blocks: part of the blocks that have an area of at most 4, such as those around one cell.
      loops_per_tile: cyclomatic number to tiles, a ratio.
      longest_street: links of the longest street.
      shortest_street: links of the shortest street.
      mean_street: mean of the streets' links, a ratio.
      border_share: part of the tiles that lie along the sides of the smallest box around the town.
      box_fill: part of that box that has tiles.
      box_share: part of the grid that this box covers.
      box_length: longer side of that box to the shorter one, a ratio.
      symmetry: largest part of the box whose cells are tiles or empty as when it is mirrored either way or turned half.
      repetition: part of the tiles whose neighbourhood of 3 x 3 cells, codes and all, some other tile has too.
      adjacent_turns_per_tile: pairs of turns that share a side, to tiles, a ratio.
      signable: part of the crossings that have room for Duckietown's signs: no road on the four cells at their corners;
        all if there is no crossing.
      mean_detour: way by road to way on a full grid of streets, summed over all pairs of linked tiles, a ratio.
    """

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
    mean_detour: "Int32[Array, '...']"


TOWN_PARTS = ("small_blocks", "border_share", "box_fill", "box_share", "symmetry", "repetition", "signable")
"""The features that are parts of 1, in thousandths."""

TOWN_RATIOS = (
    *("mean_block", "block_spread", "loops_per_tile", "mean_street", "box_length"),
    *("adjacent_turns_per_tile", "mean_detour"),
)
"""The features that are other ratios, in thousandths."""


def features_without_gaps(shape: tuple[int, int]) -> dict[str, int]:
    """Returns the features that are equal on all grids ``(height, width)`` without empty cells, by name."""
    height, width = shape
    along = height * width - max(height - 2, 0) * max(width - 2, 0)
    length = 1000 * max(shape) // min(shape)
    return dict.fromkeys(("box_fill", "box_share", "symmetry"), 1000) | {
        "border_share": 1000 * along // (height * width),
        "box_length": length,
    }


def largest_town_feature(name: str, shape: tuple[int, int]) -> int:
    """Returns an upper bound of a feature on grids ``(height, width)``."""
    if name in TOWN_PARTS:
        return 1000
    return (1000 if name in TOWN_RATIOS else 1) * max(2, shape[0] * shape[1])
