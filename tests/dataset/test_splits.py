"""Splits: whole groups of alike maps, every split filled, and shares kept where the groups allow it."""

import numpy as np
import pytest
from refusals import refused

from elitelanes_jax import DatasetSpec, RoadMap
from elitelanes_jax._util.progress import reporting
from elitelanes_jax.dataset._splits import split_maps
from elitelanes_jax.maps._splits import _shuffle_groups
from elitelanes_jax.maps.packing import _split
from elitelanes_jax.maps.spec import PackSpec


def maps_of(*sizes):
    """Returns maps in groups of these sizes: those of a group differ from each other in one tile of 36 or two."""
    rng, maps = np.random.default_rng(0), []
    for group, size in enumerate(sizes):
        grid = rng.integers(1, 16, (6, 6)).astype(np.int8)
        for number in range(size):
            other = grid.copy()
            other.flat[number] = other.flat[number] % 15 + 1
            maps.append(RoadMap(other, niche=[group % 5]))
    return maps


def split(sizes, shares):
    maps = maps_of(*sizes)
    spec = DatasetSpec(maps=len(maps), size=6, split=shares)
    splits, groups = split_maps(spec, maps), np.repeat(np.arange(len(sizes)), sizes)
    for group in range(len(sizes)):
        assert np.unique(splits[groups == group]).size == 1, "a group is in one split"
    return np.bincount(splits, minlength=3).tolist()


@pytest.mark.parametrize(
    ("sizes", "shares", "expected"),
    [
        ([1] * 20, (0.8, 0.1, 0.1), [16, 2, 2]),
        ([2] * 10, (0.8, 0.1, 0.1), [16, 2, 2]),
        ([12, *[1] * 8], (0.8, 0.1, 0.1), [16, 2, 2]),
        ([12, *[1] * 8], (0.2, 0.4, 0.4), [12, 4, 4]),
        ([13, *[1] * 7], (0.2, 0.4, 0.4), [14, 3, 3]),
        ([4, 3, 3], (0.8, 0.1, 0.1), [4, 3, 3]),
        ([5, 4, 1], (0, 0.5, 0.5), [0, 5, 5]),
        ([9, 1], (0, 0.5, 0.5), [0, 9, 1]),
        ([5, 5], (0, 0, 1), [0, 0, 10]),
        ([6, 2, 2], (1, 0, 0), [10, 0, 0]),
    ],
)
def test_groups_stay_together_and_no_split_is_empty(sizes, shares, expected):
    assert split(sizes, shares) == expected


def test_other_numbers_than_the_shares_are_announced(capsys):
    with reporting(quiet=False):
        split([18, 1, 1], (0.6, 0.2, 0.2))
    words = (
        "the splits have 18, 1, 1 maps instead of 12, 4, 4: maps that differ in less than 15 % of their tiles are in"
    )
    assert capsys.readouterr().err == f"{words} one split\n"


def test_fewer_groups_than_splits_are_refused():
    with refused("split", "10 maps in 2 groups: ...", expected="3 splits"):
        split([7, 3], (0.8, 0.1, 0.1))


def test_the_order_of_groups_does_not_depend_on_that_of_the_maps():
    groups, niches = [0, 0, 1, 1, 2, 2], ["a", "b", "c", "d", "e", "f"]
    for seed in range(9):
        assert _shuffle_groups(seed, groups, niches) == _shuffle_groups(seed, groups[::-1], niches[::-1])


def test_niches_with_alike_maps_are_in_one_split_of_a_pack():
    maps = maps_of(*[2] * 10)
    for number, road_map in enumerate(maps):
        road_map.niche[:] = [number // 2 + number % 2]  # each group is in two niches
    with refused("split", "11 in all, in 1 group ... 15 %", expected="2 splits"):
        _split(PackSpec(split=(0.5, 0.5, 0)), maps)
    apart = [road_map for road_map in maps if road_map.niche != [5]]
    packed = _split(PackSpec(split=(0.5, 0.5, 0)), apart)
    assert len({one.split for one in packed if one.niche < "6x6-05"}) == 1
    assert len({one.split for one in packed}) == 2
