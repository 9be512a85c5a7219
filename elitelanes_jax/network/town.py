"""The features of a town, as whole numbers.

They describe the blocks, streets, outline, symmetry, repetition and detours of one grid.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Int8, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import ArrayOrRows
from elitelanes_jax.network._faces import label_faces
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import CORNERS, EAST, KINDS, NORTH, SOUTH, WEST
from elitelanes_jax.network.gridlock import girth
from elitelanes_jax.network.links import links_between
from elitelanes_jax.network.records import LONGEST_DETOUR, LONGEST_TOWN, TownFeatures
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import PaddedLayout, vary_together


@name_wrong_arguments
@runs_jax
def measure_town(grid: ArrayOrRows, *, detour: bool = True) -> TownFeatures:
    """Measures the features of one town; `jax.vmap` it for many.

    Within `jax.jit` features that are not used cost no time. Under `jax.jit` and `jax.vmap` codes
    are not checked, and their four lowest bits are read.

    Args:
      grid: integer codes ``[H, W]``, repaired or not. A connection that the neighbour does not
        return is no link.
      detour: whether to measure the mean detour, which takes longest; without it, it is 0.

    Raises:
      InputError: for a bad grid, or one with a side over 128, or over 32 with detours.
    """
    grid = check_grid(grid)
    most = LONGEST_DETOUR if detour else LONGEST_TOWN
    if max(grid.shape) > most:
        what = "the mean detour" if detour else "the features of a town"
        raise InputError("grid", f"sides of at most {most} for {what}", grid.shape)
    return _measure_town(grid, detour=detour)


@partial(jax.jit, static_argnames="detour")
@divide_batches
def _measure_town(grid: Int8[Array, "H W"], *, detour: bool) -> TownFeatures:
    # The four lowest bits of a traced code are read.
    grid = grid & 15
    east, south = links_between(grid)
    to_east, to_west, to_south, to_north = _ends_of_links(east, south)
    links = to_east + to_west + to_south + to_north
    tile = grid > 0
    tiles = _count(tile)
    areas, blocks = _block_areas(grid)
    area = areas.sum(dtype=jnp.int32)
    lengths, streets = _street_lengths(east, south, links)
    box, height, width = _box(tile)
    rows, columns = np.arange(grid.shape[0])[:, None], np.arange(grid.shape[1])[None]
    along = (rows == box[0]) | (rows == box[1]) | (columns == box[2]) | (columns == box[3])
    turn = jnp.isin(grid, np.array(KINDS["turn"], np.int8))
    return TownFeatures(
        crossings3=_count(jnp.isin(grid, np.array(KINDS["crossing3"], np.int8))),
        crossings4=_count(grid == KINDS["crossing4"][0]),
        largest_block=areas.max(initial=0),
        smallest_block=_least(areas),
        mean_block=_thousandths(area, blocks),
        # Multiplied by the number of blocks, the differences from the mean area are whole numbers.
        block_spread=_thousandths(
            jnp.where(areas > 0, jnp.abs(areas * blocks - area), 0).sum(), blocks * area
        ),
        # The block around one cell has an area of 4.
        small_blocks=_thousandths(_count((areas > 0) & (areas <= 4)), blocks),
        loops_per_tile=_thousandths(blocks, tiles),
        longest_street=lengths.max(initial=0),
        shortest_street=_least(lengths),
        mean_street=_thousandths(lengths.sum(dtype=jnp.int32), streets),
        border_share=_thousandths(_count(tile & along), tiles),
        box_fill=_thousandths(tiles, height * width),
        box_share=_thousandths(height * width, jnp.int32(grid.size)),
        box_length=_thousandths(jnp.maximum(height, width), jnp.minimum(height, width)),
        symmetry=_thousandths(_most_alike(tile, box), height * width),
        repetition=_thousandths(_repeated(grid), tiles),
        adjacent_turns_per_tile=_thousandths(
            _count(turn[:, :-1] & turn[:, 1:]) + _count(turn[:-1] & turn[1:]), tiles
        ),
        signable=_signable(tile, links),
        gridlock_number=jnp.maximum(girth(east, south) - 1, 0),
        mean_detour=_detour(east, south) if detour else jnp.int32(0),
    )


def _count(cells: Bool[Array | np.ndarray, "..."]) -> Int32[Array, ""]:
    return jnp.sum(cells, dtype=jnp.int32)


def _least(numbers: Int32[Array, " N"]) -> Int32[Array, ""]:
    # An entry of 0 is no block or street.
    least = jnp.where(numbers > 0, numbers, 2**30).min(initial=2**30)
    return jnp.where(least == 2**30, 0, least)


def _thousandths(part: Int[Array, ""], whole: Int[Array, ""]) -> Int32[Array, ""]:
    """Returns floor(1000 · part / whole), or 0 if the whole is 0.

    The division goes digit by digit, because the product may not fit int32.
    """
    rest, whole = part.astype(jnp.uint32), jnp.maximum(whole, 1).astype(jnp.uint32)
    result = rest // whole
    for _ in range(3):
        rest = rest % whole * 10
        result = result * 10 + rest // whole
    return result.astype(jnp.int32)


def _ends_of_links(
    east: Bool[Array, "H w"], south: Bool[Array, "h W"]
) -> tuple[Int8[Array, "H W"], Int8[Array, "H W"], Int8[Array, "H W"], Int8[Array, "H W"]]:
    """Returns where links leave tiles to the east, west, south and north: 1 there, 0 elsewhere."""
    east, south = east.astype(jnp.int8), south.astype(jnp.int8)
    return (
        jnp.pad(east, ((0, 0), (0, 1))),
        jnp.pad(east, ((0, 0), (1, 0))),
        jnp.pad(south, ((0, 1), (0, 0))),
        jnp.pad(south, ((1, 0), (0, 0))),
    )


def _block_areas(grid: Int8[Array, "H W"]) -> tuple[Int32[Array, " N"], Int32[Array, ""]]:
    """Returns the area of each inner face, and the number of inner faces.

    The area is 0 for a label without a face.
    """
    layout = PaddedLayout(*grid.shape)
    labels = label_faces(layout, layout.pad(grid))
    # The area of a block is its number of corners. The outer face, which is the first one, is no
    # block.
    areas = jnp.zeros(labels.size, jnp.int32).at[labels].add(1)[1:]
    return areas, _count(areas > 0)


def _street_lengths(
    east: Bool[Array, "H w"], south: Bool[Array, "h W"], links: Int8[Array, "H W"]
) -> tuple[Int32[Array, " N"], Int32[Array, ""]]:
    """Returns the number of links of each street, and the number of streets.

    The number of links is 0 for a label without a street. `links` are those of each tile.
    """
    height, width = links.shape
    passed = links == 2
    # Tiles that a road passes through are the corners of a larger grid, with walls where no road
    # continues. A street is a face of this grid.
    layout = PaddedLayout(height + 1, width + 1)
    across = jnp.pad(~(south & passed[:-1] & passed[1:]), ((1, 1), (0, 0)), constant_values=True)
    upright = jnp.pad(
        ~(east & passed[:, :-1] & passed[:, 1:]), ((0, 0), (1, 1)), constant_values=True
    )
    to_east, to_west, to_south, to_north = _ends_of_links(across, upright)
    codes = to_east * EAST | to_west * WEST | to_south * SOUTH | to_north * NORTH
    labels = label_faces(layout, layout.pad(codes))
    street = layout.unpad(layout.here(labels))[:height, :width]
    # Half of each link is counted at either end, in the street of the tile there. If only one end
    # is a tile that a road passes through, its street gets the other half too. A link between two
    # other tiles is a street by itself.
    halves = (
        jnp.zeros(labels.size, jnp.int32)
        .at[street.reshape(-1)]
        .add(jnp.where(passed, 2, 0).reshape(-1))
    )
    direct = []
    for link, one, other in ((east, np.s_[:, :-1], np.s_[:, 1:]), (south, np.s_[:-1], np.s_[1:])):
        first, second = passed[one], passed[other]
        label = jnp.where(first, street[one], street[other]).reshape(-1)
        halves = halves.at[label].add((link & (first ^ second)).astype(jnp.int32).reshape(-1))
        direct.append((link & ~first & ~second).astype(jnp.int32).reshape(-1))
    lengths = jnp.concatenate([halves // 2, *direct])
    return lengths, _count(lengths > 0)


def _box(
    tile: Bool[Array, "H W"],
) -> tuple[tuple[Array, Array, Array, Array], Int32[Array, ""], Int32[Array, ""]]:
    """Returns the ends of the box around all tiles, and the box's height and width.

    The ends are the first and last row, and the first and last column, with tiles. Without tiles,
    height and width are 0.
    """
    ends = []
    for cells in (tile.any(axis=1), tile.any(axis=0)):
        ends += [
            cells.argmax().astype(jnp.int32),
            (cells.size - 1 - cells[::-1].argmax()).astype(jnp.int32),
        ]
    # Without tiles `argmax` returns 0, and the ends would be those of the whole grid.
    some = tile.any()
    north, south, west, east = ends
    return (
        (north, south, west, east),
        jnp.where(some, south - north + 1, 0),
        jnp.where(some, east - west + 1, 0),
    )


def _most_alike(
    tile: Bool[Array, "H W"], box: tuple[Array, Array, Array, Array]
) -> Int32[Array, ""]:
    """Returns the largest number of cells of the box that agree with an image of it.

    The images are two mirror images and the half turn.
    """
    north, south, west, east = box
    rows, columns = np.arange(tile.shape[0]), np.arange(tile.shape[1])
    inside = ((rows >= north) & (rows <= south))[:, None] & ((columns >= west) & (columns <= east))[
        None
    ]
    # The whole grid is mirrored around the middle of the box. Cells outside the box have no
    # meaning.
    back_rows = jnp.clip(north + south - rows, 0, tile.shape[0] - 1)
    back_columns = jnp.clip(west + east - columns, 0, tile.shape[1] - 1)
    flipped, mirrored = tile[back_rows], tile[:, back_columns]
    images = (flipped, mirrored, flipped[:, back_columns])
    most = jnp.stack([_count(inside & (tile == image)) for image in images]).max()
    return jnp.where(tile.any(), most, 0)


def _repeated(grid: Int8[Array, "H W"]) -> Int32[Array, ""]:
    """Counts the tiles whose neighbourhood of 3 x 3 cells equals that of another tile.

    Cells outside the grid are empty.
    """
    height, width = grid.shape
    padded = jnp.pad(grid, 1).astype(jnp.uint32)
    around = [
        padded[row : row + height, column : column + width]
        for row in range(3)
        for column in range(3)
    ]
    # Nine codes of four bits need two numbers: eight codes, and the ninth. Equal numbers are equal
    # neighbourhoods.
    first = sum(cells << 4 * index for index, cells in enumerate(around[:8])).reshape(-1)  # type: ignore[union-attr]
    last, tile = around[8].reshape(-1), grid.reshape(-1) > 0
    same = (first[:, None] == first[None]) & (last[:, None] == last[None]) & tile[None]
    return _count(tile & (same.sum(axis=1) > 1))


def _signable(tile: Bool[Array, "H W"], links: Int8[Array, "H W"]) -> Int32[Array, ""]:
    """Returns the part of the crossings without a road at a corner, in thousandths.

    A crossing is a tile with three or four links, because links are what signs are placed by.
    """
    height, width = tile.shape
    around = jnp.pad(tile, 1)
    corners = [
        around[1 + down : 1 + down + height, 1 + right : 1 + right + width]
        for down, right in CORNERS
    ]
    crossing = links > 2
    crossings = _count(crossing)
    # The signs of a crossing stand at its corners, where a road leaves them no room. A town without
    # crossings needs no sign.
    free = crossing & ~(corners[0] | corners[1] | corners[2] | corners[3])
    return jnp.where(crossings > 0, _thousandths(_count(free), crossings), 1000)


def _detour(east: Bool[Array, "H w"], south: Bool[Array, "h W"]) -> Int32[Array, ""]:
    """Returns the `mean_detour` of a grid with these links.

    Each round extends the tiles that each tile reaches by one link. The rounds end when one adds no
    tile.
    """
    height, width = east.shape[0], south.shape[1]
    cells = height * width
    start = jnp.eye(cells, dtype=bool).reshape(cells, height, width)

    def once(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        reached, ways, length, _ = carry
        to_east = jnp.pad(reached[:, :, :-1] & east[None], ((0, 0), (0, 0), (1, 0)))
        to_west = jnp.pad(reached[:, :, 1:] & east[None], ((0, 0), (0, 0), (0, 1)))
        to_south = jnp.pad(reached[:, :-1] & south[None], ((0, 0), (1, 0), (0, 0)))
        to_north = jnp.pad(reached[:, 1:] & south[None], ((0, 0), (0, 1), (0, 0)))
        # A tile that is reached first in this round is `length` links away.
        further = reached | to_east | to_west | to_south | to_north
        new = _count(further) - _count(reached)
        return further, ways + new * length, length + 1, new > 0

    first = (start, jnp.int32(0), jnp.int32(1), jnp.array(True))
    carry = vary_together(first, east, south)
    reached, ways, *_ = lax.while_loop(lambda carry: carry[3], once, carry)
    # On a full grid of streets the way between two tiles is the difference of rows plus that of
    # columns.
    rows, columns = np.divmod(np.arange(cells), width)
    straight = np.abs(rows[:, None] - rows) + np.abs(columns[:, None] - columns)
    return _thousandths(
        ways, jnp.where(reached.reshape(cells, cells), straight, 0).sum(dtype=jnp.int32)
    )
