"""Assigns the maps of a pack to splits for training, validation and test."""

from collections import Counter
from collections.abc import Mapping, Sequence
from hashlib import sha256

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.maps.spec import SPLITS
from elitelanes_jax.network.likeness import ALIKE, group_alike


def split_niches(
    codes: Sequence[NDArray[np.int8]], niches: Sequence[str], shares: Sequence[float], seed: int
) -> list[str]:
    """Returns the name of the split of each map. Whole niches are assigned, in a random order.

    Each niche goes to the split that lacks most maps. No split stays empty. Niches with maps that
    are alike, see `group_alike`, are in one split.

    Args:
      codes: the codes of each map, without empty rows and columns around the roads.
      niches: the name of the niche of each map.
      shares: the share of the maps that each of `SPLITS` has. A split with a share of 0 gets none.
      seed: the seed of the order.

    Raises:
      InputError: if there are fewer groups of niches than splits.
    """
    # Maps of one niche, and maps that are alike, are in one group. A group is never divided.
    _, niche_indices = np.unique(niches, return_inverse=True)
    groups = group_alike(codes, niche_indices).tolist()
    sizes = Counter(groups)
    # A split with a share of 0 gets no map.
    lacking = {
        split: share * len(codes) for split, share in zip(SPLITS, shares, strict=True) if share
    }
    if len(sizes) < len(lacking):
        raise _few_groups_error(len(lacking), len(sizes), len(set(niches)))
    order = _shuffle_groups(seed, groups, niches)
    split_of = _assign_groups(order, sizes, lacking)
    return [split_of[group] for group in groups]


def _few_groups_error(splits: int, groups: int, niches: int) -> InputError:
    """Returns the error for fewer groups than splits; the arguments are their numbers."""
    got = f"{niches} in all"
    if niches > groups:
        limit = f"less than {100 * ALIKE:g} %"
        got += f", in {pluralize(groups, 'group')} with maps that differ in {limit}"
    hint = "a split of 1 0 0 trains on all"
    return InputError("split", f"a niche for each of {splits} splits", got, hint)


def _assign_groups(
    order: Sequence[int], sizes: Mapping[int, int], lacking: Mapping[str, float]
) -> dict[int, str]:
    """Returns the split of each group.

    Args:
      order: the groups, at least one for each split.
      sizes: the number of maps in each group.
      lacking: the number of maps that each split lacks at first.
    """
    lacking = dict(lacking)
    groups_of: dict[str, list[int]] = {split: [] for split in lacking}
    for group in order:
        # Of splits that lack equally many maps, the first one gets the group.
        neediest = max(lacking, key=lacking.__getitem__)
        groups_of[neediest].append(group)
        lacking[neediest] -= sizes[group]
    # A large group may fill a split beyond its share, and leave others without a group. These get
    # the last group of the split with most groups.
    for split_groups in groups_of.values():
        if not split_groups:
            fullest = max(groups_of.values(), key=len)
            split_groups.append(fullest.pop())
    split_of: dict[int, str] = {}
    for split, split_groups in groups_of.items():
        split_of |= dict.fromkeys(split_groups, split)
    return split_of


def _shuffle_groups(seed: int, groups: Sequence[int], niches: Sequence[str]) -> list[int]:
    """Returns each group once, in an order that depends on the seed and on the niches alone."""
    draws: dict[int, bytes] = {}
    for group, niche in zip(groups, niches, strict=True):
        # A digest for each niche is used, because random numbers would depend on the order of the
        # maps. The least digest of its niches is that of a group.
        draw = sha256(f"{seed} {niche}".encode()).digest()
        draws[group] = min(draw, draws.get(group, draw))
    return sorted(draws, key=draws.__getitem__)
