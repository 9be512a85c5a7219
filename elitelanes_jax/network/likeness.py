"""Compares sets of maps by their roads, as `difference` does; in NumPy alone."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import KIND_OF, KINDS
from elitelanes_jax.network.symmetry import box_of_roads, canonical_forms, images_of

ALIKE = 0.15
"""Two maps are alike if their `difference` is less."""

# The grids that are compared with a set at once.
_COMPARED = 64
# The bits of a word.
_WORD = 64
# The positions whose bits are in memory at once.
_TOGETHER = 64

# The index of the kind of each code. The kind of an empty cell is 0.
_KIND_INDEX = np.array([[*KINDS].index(KIND_OF[code]) for code in range(16)])

_Grid: TypeAlias = NDArray[np.int8]
_Grids: TypeAlias = Sequence[_Grid] | NDArray[np.int8]


def road_forms(grids: _Grids) -> list[bytes]:
    """Returns the `canonical_form` of the roads of each of many checked grids, of any sizes."""
    forms = [b""] * len(grids)
    for indices, boxes in _by_box(grids):
        for index, form in zip(indices, canonical_forms(boxes), strict=True):
            forms[index] = form
    return forms


def group_alike(grids: _Grids, labels: NDArray[np.int_] | None = None) -> NDArray[np.int_]:
    """Assigns checked grids to groups, int ``[grids]``.

    No two grids of different groups are `ALIKE`. Two grids that are alike are in one group, and so
    are two that a chain of such pairs joins. With `labels`, an int for each grid, grids with equal
    labels are in one group too.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    roads, nodes = RoadSet(grids), np.arange(len(grids))
    starts, ends, _ = roads.pairs(grids, ALIKE)
    if labels is not None:
        # Each grid is paired with the first grid of its label.
        _, firsts, inverse = np.unique(labels, return_index=True, return_inverse=True)
        starts, ends = np.concatenate([starts, nodes]), np.concatenate([ends, firsts[inverse]])
    pairs = coo_array((np.ones(len(ends)), (starts, ends)), shape=(len(grids), len(grids)))
    return np.asarray(connected_components(pairs, directed=False)[1], int)


class Pairs(NamedTuple):
    """Pairs of grids that differ little.

    Attributes:
      first: int ``[P]``, indices of the grids that were compared with a set.
      second: int ``[P]``, indices in the set.
      difference: float64 ``[P]``.
    """

    first: NDArray[np.int_]
    second: NDArray[np.int_]
    difference: NDArray[np.float64]


class _Group(NamedTuple):
    """Grids of one size whose boxes around the roads have one shape.

    Attributes:
      cells: the number of cells of a grid.
      shape: (height, width) of the boxes.
      indices: int ``[N]``, of the grids in the set, sorted by their number of tiles.
      tiles: int ``[N]``, these numbers.
      kinds: int32 ``[kinds, N]``, the number of tiles of each kind.
      planes: uint64 ``[4, words, N]``, the cells of the boxes as bits: a bit of the codes in each
        plane.
    """

    cells: int
    shape: tuple[int, int]
    indices: NDArray[np.int_]
    tiles: NDArray[np.int_]
    kinds: NDArray[np.int32]
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
            # Sorted by tiles, the grids with about as many tiles as an image are one slice.
            order = np.argsort(tiles, kind="stable")
            boxes = boxes[order]
            cells = grids[indices[0]].size
            group = _Group(
                cells,
                boxes.shape[1:],
                indices[order],
                tiles[order],
                _count_kinds(boxes),
                _pack(boxes),
            )
            self._groups.append(group)

    def differences(self, grid: _Grid, below: float) -> NDArray[np.float64]:
        """Returns the `difference` of each grid of the set from a checked grid.

        The result is float64 ``[grids]``. Differences of `below` or more are not computed; infinity
        is returned for these.
        """
        return self.least_differences([grid], below)

    def least_differences(self, grids: _Grids, below: float) -> NDArray[np.float64]:
        """Returns the least difference of each grid of the set from some checked grids.

        See `differences`.
        """
        shares = np.full(self._size, np.inf)
        pairs = self.pairs(grids, below)
        np.minimum.at(shares, pairs.second, pairs.difference)
        return shares

    def pairs(self, grids: _Grids, below: float) -> Pairs:
        """Returns the pairs whose `difference` is less than `below`.

        A pair has one of some checked grids and one grid of the set. The pairs are in no particular
        order.
        """
        pairs = [Pairs(np.zeros(0, int), np.zeros(0, int), np.zeros(0))]
        for indices, boxes in _by_box(grids):
            size = grids[indices[0]].size
            for start in range(0, len(boxes), _COMPARED):
                compared = boxes[start : start + _COMPARED]
                kinds = _count_kinds(compared)
                for group in self._groups:
                    # Pairs with too different numbers of tiles of each kind need no comparison of
                    # cells.
                    cells = max(size, group.cells)
                    near = _least_difference(kinds, group.kinds) < below * cells
                    if not near.any():
                        continue
                    first, second, count = _count_differing(group, compared, near, below * cells)
                    share = count / cells
                    differs_little = share < below
                    first, second = first[differs_little], second[differs_little]
                    pairs.append(
                        Pairs(indices[start + first], group.indices[second], share[differs_little])
                    )
        return Pairs(*(np.concatenate(parts) for parts in zip(*pairs, strict=True)))


def _least_difference(kinds: NDArray[np.int32], others: NDArray[np.int32]) -> NDArray[np.int32]:
    """Returns a lower bound of the number of cells in which grids differ.

    The bound is int32 ``[N, M]``. It follows from the numbers of tiles of each kind, ``[kinds, N]``
    and ``[kinds, M]``. Kinds do not change when a grid is moved, rotated or mirrored. The surplus
    of either grid in any kind differs.
    """
    more = np.zeros((kinds.shape[1], others.shape[1]), np.int32)
    fewer = np.zeros_like(more)
    for count, other in zip(kinds, others, strict=True):
        surplus = count[:, None] - other
        more += np.maximum(surplus, 0)
        fewer -= np.minimum(surplus, 0)
    # One cell that differs can hold a surplus tile of each grid. So the larger number is the
    # bound, not the sum of both.
    return np.maximum(more, fewer)


def _count_differing(
    group: _Group, boxes: NDArray[np.int8], near: NDArray[np.bool_], below: float
) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int32]]:
    """Counts the cells in which boxes ``[N, H, W]`` differ from the grids of a group.

    Each pair is compared at the position where it is most similar.

    Args:
      group: a group of M grids.
      boxes: the boxes around the roads of other grids.
      near: bool ``[N, M]``, the pairs to compare.
      below: pairs that differ in this many cells or more may be left out.

    Returns:
      The indices of boxes, the indices in the group, and the counts.
    """
    images = images_of(boxes)
    rows, columns, counts = [], [], []
    # Every other image is rotated by a quarter turn, so the images have two shapes.
    for stack in (np.concatenate(images[::2]), np.concatenate(images[1::2])):
        for row, column, count in _compare(group, stack, near, below):
            rows.append(row)
            columns.append(column)
            counts.append(count)
    if not counts:
        return np.zeros(0, int), np.zeros(0, int), np.zeros(0, np.int32)
    # A pair may come from several positions and images, and the least count is its difference.
    pairs = np.concatenate(rows) * len(group.tiles) + np.concatenate(columns)
    unique, inverse = np.unique(pairs, return_inverse=True)
    least = np.full(len(unique), np.iinfo(np.int32).max, np.int32)
    np.minimum.at(least, inverse, np.concatenate(counts))
    row, column = np.divmod(unique, len(group.tiles))
    return row, column, least


def _compare(
    group: _Group, images: NDArray[np.int8], near: NDArray[np.bool_], below: float
) -> Iterator[tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int32]]]:
    """Compares images of boxes with the grids of a group at all positions.

    The images are ``[4 N, H, W]``, four for each of N boxes in order.

    Yields the indices of boxes, the indices in the group, and the numbers of cells that differ: for
    each position where a pair differs in less than `below` cells.
    """
    # The padding gives all positions at which a box of the group overlaps an image.
    height, width = group.shape
    padded = np.pad(images, ((0, 0), (height - 1, height - 1), (width - 1, width - 1)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, group.shape, axis=(1, 2))
    inside = _count_inside(padded > 0, group.shape)
    outside = np.count_nonzero(images, axis=(1, 2))[:, None, None] - inside
    # Tiles without a partner differ: the tiles outside the box, and the surplus of either grid
    # inside. So only grids with about as many tiles as the image has inside the box are compared.
    surplus = below - outside
    first, last = np.searchsorted(group.tiles, (inside - surplus, inside + surplus))
    positions = np.argwhere(first < last)
    for start in range(0, len(positions), _TOGETHER):
        some = tuple(positions[start : start + _TOGETHER].T)
        box = some[0] % len(near)
        bits, beyond = _pack(windows[some]), outside[some].astype(np.int32)
        # Few grids are near in the first 64 cells, in one bit of the codes, and fewer are near in
        # all cells.
        most = np.clip(np.ceil(below - beyond), 0, _WORD + 1).astype(np.uint8)
        hits = []
        for word, limit, row, low, high in zip(
            bits[0, 0], most, near[box], first[some], last[some], strict=True
        ):
            alike = np.bitwise_count(group.planes[0, 0, low:high] ^ word) < limit
            alike &= row[low:high]
            hits.append(low + np.flatnonzero(alike))
        position, grid = (
            np.repeat(np.arange(len(box)), [len(hit) for hit in hits]),
            np.concatenate(hits),
        )
        counts = beyond[position] + _count_bits(bits[0][:, position] ^ group.planes[0][:, grid])
        position, grid = position[counts < below], grid[counts < below]
        # The codes of a cell differ if any of their four bits differs.
        codes = np.bitwise_or.reduce(bits[:, :, position] ^ group.planes[:, :, grid])
        yield box[position], grid, beyond[position] + _count_bits(codes)


def _count_inside(road: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.int_]:
    """Counts the tiles in a box of `shape` at every position in images ``[N, H, W]``.

    The axes of the result are image, row and column.
    """
    height, width = shape
    # A summed-area table gives the count of any box by four look-ups.
    sums = np.pad(road, ((0, 0), (1, 0), (1, 0))).cumsum(axis=1).cumsum(axis=2)
    rows = sums[:, height:] - sums[:, :-height]
    return np.asarray(rows[:, :, width:] - rows[:, :, :-width])


def _count_kinds(boxes: NDArray[np.int8]) -> NDArray[np.int32]:
    """Counts the tiles of each kind in boxes ``[N, H, W]``, int32 ``[kinds, N]``."""
    kinds = _KIND_INDEX[boxes.reshape(len(boxes), -1)]
    counts = [np.count_nonzero(kinds == kind, axis=1) for kind in range(1, len(KINDS))]
    return np.stack(counts).astype(np.int32)


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


def _by_box(grids: _Grids) -> Iterator[tuple[NDArray[np.int_], NDArray[np.int8]]]:
    """Yields grids by their size and the size of the box around their roads.

    Each item is the indices ``[N]`` of the grids, and their boxes ``[N, H, W]``.
    """
    boxes = [box_of_roads(grid) for grid in grids]
    by_size: dict[tuple[int, ...], list[int]] = {}
    for index, box in enumerate(boxes):
        by_size.setdefault((grids[index].size, *box.shape), []).append(index)
    for indices in by_size.values():
        yield np.array(indices), np.stack([boxes[index] for index in indices])
