"""The split of each map of a dataset."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.progress import announce
from elitelanes_jax.dataset.spec import DatasetSpec, maps_by_split
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network.likeness import ALIKE, group_alike
from elitelanes_jax.network.plain_metrics import cut_to_roads

_REASON = f"maps that differ in less than {100 * ALIKE:g} % of their tiles are in one split"


def split_maps(spec: DatasetSpec, maps: Sequence[RoadMap]) -> NDArray[np.int_]:
    """Assigns each map to a split, an index in `SPLITS`, int ``[maps]``.

    Every split has its share of every size and every niche, as evenly as possible. All maps of a
    group that `group_alike` makes are in one split. If large groups leave too few maps for the
    other splits, these splits get fewer maps than their shares, which is announced.

    Raises:
      InputError: if there are fewer groups than splits.
    """
    codes = [road_map.codes for road_map in maps]
    if spec.maps_from is not None:
        # People leave any number of empty rows and columns. With these, all small maps in a large
        # grid would be alike.
        codes = [cut_to_roads(grid) for grid in codes]
    # Two maps that are alike must not be in different splits, so splits consist of whole groups.
    groups = group_alike(codes)
    counts = maps_by_split(spec)
    filled = [split for split in (2, 1, 0) if counts[split]]
    if groups.max() + 1 < len(filled):
        raise InputError(
            "split",
            f"a group of maps for each of {len(filled)} splits",
            f"{len(maps)} maps in {pluralize(int(groups.max()) + 1, 'group')}: {_REASON}",
            "a split of 1 0 0 trains on all",
        )
    # Maps are sorted by size and niche, so that evenly spaced ones have all of them.
    niches = [(*road_map.codes.shape, *(road_map.niche or ())) for road_map in maps]
    order = np.array(sorted(range(len(niches)), key=lambda index: (niches[index], index)))
    # The last split, training if it has maps, gets what the others leave.
    *others, rest = filled
    splits = np.full(len(maps), rest)
    for split, count in _counts_of_others(others, counts, groups).items():
        _take_evenly(splits, order[splits[order] == rest], groups, split, count)
    # A split that the user asked for has at least one group.
    _fill_empty(splits, groups, others)
    # Large groups may change the sizes of the splits, which the user has to know.
    numbers = np.bincount(splits, minlength=len(SPLITS)).tolist()
    if numbers != list(counts):
        got = ", ".join(map(str, numbers))
        expected = ", ".join(map(str, counts))
        announce(f"the splits have {got} maps instead of {expected}: {_REASON}")
    return splits


def _counts_of_others(
    others: Sequence[int], counts: Sequence[int], groups: NDArray[np.int_]
) -> dict[int, int]:
    """Returns the number of maps for each split in `others`.

    The number is less than in `counts` if few groups are small enough.
    """
    if not others:
        return {}
    # Each map has the size of its group.
    sizes = np.bincount(groups)[groups]
    # Groups larger than the smallest of these splits do not fit into it. Their maps do not count.
    small = int((sizes <= min(counts[split] for split in others)).sum())
    # If too few maps are in small groups, all splits shrink by the same factor.
    expected = sum(counts[split] for split in others)
    return {split: counts[split] * min(small, expected) // expected for split in others}


def _take_evenly(
    splits: NDArray[np.int_],
    free: NDArray[np.int_],
    groups: NDArray[np.int_],
    split: int,
    count: int,
) -> None:
    """Assigns up to `count` of the maps `free` to a split, each with all of its group.

    The maps are evenly spaced in their order.
    """
    sizes, lacking = np.bincount(groups)[groups], count
    # The positions are the middles of equal parts of the order.
    for position in (np.arange(count) * 2 + 1) * len(free) // (2 * max(count, 1)):
        # If the map is taken or its group does not fit, the next map in order is tried.
        waiting = np.roll(free, -position)
        fitting = waiting[(splits[waiting] != split) & (sizes[waiting] <= lacking)]
        if fitting.size:
            # The whole group moves, and counts against what is lacking.
            members = groups == groups[fitting[0]]
            splits[members] = split
            lacking -= int(members.sum())


def _fill_empty(splits: NDArray[np.int_], groups: NDArray[np.int_], others: Sequence[int]) -> None:
    """Assigns a group to each split in `others` without maps.

    This is the smallest group of the split with most groups.
    """
    sizes = np.bincount(groups)
    for split in others:
        if not (splits == split).any():
            # The split with most groups can spare one, and the smallest group changes the shares
            # least.
            donor = max(
                (np.unique(groups[splits == other]) for other in range(len(SPLITS))), key=len
            )
            splits[groups == donor[np.argmin(sizes[donor])]] = split
