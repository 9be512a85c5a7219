"""Compares maps by their roads, at any position, rotation and reflection; in NumPy alone."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.plain_metrics import cut_to_roads
from elitelanes_jax.network.symmetry import canonical_forms, images_of

ALIKE = 0.15
"""Two maps are alike if their `difference` is less."""

_TOGETHER = 64  # the positions whose bits are in memory at once

_Grid: TypeAlias = NDArray[np.int8]
_Grids: TypeAlias = Sequence[_Grid] | NDArray[np.int8]


@name_wrong_arguments
def road_form(grid: AnyArray) -> bytes:
    """Returns bytes that are equal for two grids if and only if their roads are the same.

    Roads stay the same if they are moved, rotated or mirrored, or if the grid gets more empty rows and columns. Raises
    `InputError` for a bad grid.
    """
    return road_forms([np.asarray(check_grid(grid), np.int8)])[0]


def road_forms(grids: _Grids) -> list[bytes]:
    """Returns the `road_form` of each of many checked grids, of any sizes."""
    forms = [b""] * len(grids)
    for indices, boxes in _by_box(grids):
        for index, form in zip(indices, canonical_forms(boxes), strict=True):
            forms[index] = form
    return forms


@name_wrong_arguments
def difference(grid: AnyArray, other: AnyArray) -> float:
    """Returns the share of tiles in which two grids differ, at the position where they are most alike.

    One grid's roads are laid on the other's at every position, rotated and mirrored in all eight ways. In each way, the
    cells with different codes are counted; a tile on an empty cell differs too. The least count is divided by the
    number of cells of the larger grid, empty cells at its border included. The share is 0 if and only if the roads are
    the same.

    Raises `InputError` for a bad grid.
    """
    first, second = (np.asarray(check_grid(codes), np.int8) for codes in (grid, other))
    roads, share = RoadSet([first]), np.inf
    for below in (0.15, 0.3, 0.6, np.inf):
        # The smaller the limit, the fewer positions are compared.
        share = float(roads.differences(second, below)[0])
        if share < below:
            break
    return share


def group_alike(grids: _Grids, labels: NDArray[np.int_] | None = None) -> NDArray[np.int_]:
    """Assigns checked grids to groups, int ``[grids]``, such that no two grids of different groups are `ALIKE`.

    Two grids that are alike are in one group, and so are two that a chain of such pairs joins. With `labels`, an int
    for each grid, grids with equal labels are in one group too.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    roads, nodes = RoadSet(grids), np.arange(len(grids))
    neighbours = [np.flatnonzero(roads.differences(grid, ALIKE) < ALIKE) for grid in grids]
    if labels is not None:
        _, firsts, inverse = np.unique(labels, return_index=True, return_inverse=True)
        neighbours = [np.append(others, first) for others, first in zip(neighbours, firsts[inverse], strict=True)]
    starts = np.repeat(nodes, [len(others) for others in neighbours])
    ends = np.concatenate(neighbours)
    pairs = coo_array((np.ones(len(ends)), (starts, ends)), shape=(len(grids), len(grids)))
    return np.asarray(connected_components(pairs, directed=False)[1], int)


class _Group(NamedTuple):
    """Grids of one size whose boxes around the roads have one shape.

    Attributes:
      cells: the number of cells of a grid.
      shape: (height, width) of the boxes.
      indices: int ``[N]``, of the grids in the set, sorted by their number of tiles.
      tiles: int ``[N]``, these numbers.
      planes: uint64 ``[4, words, N]``, the cells of the boxes as bits: a bit of the codes in each plane.
    """

    cells: int
    shape: tuple[int, int]
    indices: NDArray[np.int_]
    tiles: NDArray[np.int_]
    planes: NDArray[np.uint64]


class RoadSet:
    """Compares grids with all grids of a set, by their roads.

    Args:
      grids: checked grids of any sizes.
    """

    def __init__(self, grids: _Grids) -> None:
        self._size = len(grids)
        self._groups = []
        for indices, boxes in _by_box(grids):
            tiles = (boxes > 0).sum(axis=(1, 2))
            order = np.argsort(tiles, kind="stable")
            planes = _pack(boxes[order])
            cells = grids[indices[0]].size
            self._groups.append(_Group(cells, boxes.shape[1:], indices[order], tiles[order], planes))

    def differences(self, grid: _Grid, below: float) -> NDArray[np.float64]:
        """Returns the `difference` of each grid of the set from a checked grid, float64 ``[grids]``.

        Differences of `below` or more are not computed; infinity is returned for these.
        """
        images = images_of(_box(grid))
        stacks = np.stack(images[::2]), np.stack(images[1::2])  # one of two is turned by a quarter
        shares = np.full(self._size, np.inf)
        for group in self._groups:
            cells = max(grid.size, group.cells)
            counts = [_count_differing(group, stack, below * cells) for stack in stacks]
            shares[group.indices] = np.minimum(*counts) / cells
        shares[shares >= below] = np.inf
        return shares


def _count_differing(group: _Group, images: NDArray[np.int8], below: float) -> NDArray[np.float64]:
    """Counts the cells in which each grid of a group differs from the most similar image ``[4, H, W]``.

    A count of `below` or more may be returned as infinity.
    """
    height, width = group.shape
    padded = np.pad(images, ((0, 0), (height - 1, height - 1), (width - 1, width - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, group.shape, axis=(1, 2))
    inside = _count_inside(padded > 0, group.shape)
    outside = np.count_nonzero(images[0]) - inside
    # Tiles without a partner differ: those outside the box, and the surplus of either side inside.
    surplus = below - outside
    first, last = np.searchsorted(group.tiles, (inside - surplus, inside + surplus))
    positions = np.argwhere(first < last)
    least = np.full(len(group.tiles), np.inf)
    for start in range(0, len(positions), _TOGETHER):
        some = tuple(positions[start : start + _TOGETHER].T)
        packed = np.moveaxis(_pack(windows[some]), -1, 0)[..., None]
        for bits, begin, end, tiles in zip(packed, first[some], last[some], outside[some], strict=True):
            planes = group.planes[:, :, begin:end]
            # Few grids are near in one bit of the codes, which takes a quarter of the time.
            near = np.flatnonzero(tiles + _count_bits(planes[0] ^ bits[0]) < below)
            counts = tiles + _count_bits(np.bitwise_or.reduce(planes[:, :, near] ^ bits))
            least[begin + near] = np.minimum(least[begin + near], counts)
    return least


def _count_inside(road: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.int_]:
    """Counts the tiles in a box of `shape` at every position in images ``[4, H, W]``, by image, row and column."""
    height, width = shape
    sums = np.pad(road, ((0, 0), (1, 0), (1, 0))).cumsum(axis=1).cumsum(axis=2)
    rows = sums[:, height:] - sums[:, :-height]
    return np.asarray(rows[:, :, width:] - rows[:, :, :-width])


def _count_bits(words: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Counts the bits in the columns of words ``[words, N]``, int32 ``[N]``."""
    return np.bitwise_count(words).sum(axis=0, dtype=np.int32)


def _pack(boxes: NDArray[np.int8]) -> NDArray[np.uint64]:
    """Packs the codes of boxes ``[N, H, W]`` into planes of bits, uint64 ``[4, words, N]``."""
    cells = boxes.reshape(len(boxes), -1)
    bits = np.array([1, 2, 4, 8], np.int8)[:, None, None]
    planes = np.packbits(cells & bits > 0, axis=-1)
    words = np.zeros((*planes.shape[:2], -(-planes.shape[2] // 8) * 8), np.uint8)
    words[..., : planes.shape[2]] = planes
    return np.ascontiguousarray(words.view(np.uint64).swapaxes(1, 2))


def _box(grid: _Grid) -> _Grid:
    """Returns the smallest box that contains all tiles; one empty cell without tiles."""
    box = cut_to_roads(grid)
    return box if box.any() else box[:1, :1]


def _by_box(grids: _Grids) -> Iterator[tuple[NDArray[np.int_], NDArray[np.int8]]]:
    """Yields grids by their size and the box around their roads: the indices ``[N]``, and the boxes ``[N, H, W]``."""
    boxes = [_box(grid) for grid in grids]
    by_size: dict[tuple[int, ...], list[int]] = {}
    for index, box in enumerate(boxes):
        by_size.setdefault((grids[index].size, *box.shape), []).append(index)
    for indices in by_size.values():
        yield np.array(indices), np.stack([boxes[index] for index in indices])
