"""Furnished maps: signs by Duckietown's rules, objects where they fit, the same for the same seed."""

import math
import re
from collections import Counter
from itertools import pairwise

import check_objects
import numpy as np
import pytest

from elitelanes_jax import InputError, RoadMap
from elitelanes_jax.formats import to_duckietown
from elitelanes_jax.maps import FurnishSpec, furnish

# A 4-way crossing amid T crossings of all four directions, with straight tiles between.
TOWN = np.array(
    [
        [6, 5, 7, 5, 3],
        [10, 0, 10, 0, 10],
        [14, 5, 15, 5, 11],
        [10, 0, 10, 0, 10],
        [12, 5, 13, 5, 9],
    ],
    np.int8,
)


def faults(road_map):
    return check_objects.check(to_duckietown(road_map.codes, objects=road_map.objects))


@pytest.mark.parametrize("spec", ["signs", "all", "all signs lights=1", "signs lights=0.5 trees=0.9 houses=0.5"])
def test_no_rule_is_broken(spec):
    """As a checker finds that reads the file alone."""
    for seed in range(5):
        assert faults(furnish(TOWN, spec, seed=seed)) == []


def test_the_checker_finds_what_is_wrong():
    """Each change of a furnished map breaks a rule."""
    town = furnish(TOWN, "signs lights=0.3 trees=3", seed=1)
    kinds = [thing.kind for thing in town.objects]
    stop, tree, light = kinds.index("sign_stop"), kinds.index("tree"), kinds.index("trafficlight")
    for place, change in (
        (stop, {"tag": 2}),
        (stop, {"angle": town.objects[stop].angle + 1.6}),
        (stop, {"kind": "sign_t_light_ahead"}),
        (stop, {"x": town.objects[stop].x - 1}),
        (tree, {"x": 2.5, "y": 1.5}),
        (tree, {"x": town.objects[stop].x, "y": town.objects[stop].y}),
        (light, {"angle": town.objects[light].angle + 1}),
    ):
        objects = list(town.objects)
        objects[place] = objects[place]._replace(**change)
        assert faults(RoadMap(TOWN, objects=objects)), change
    assert faults(RoadMap(TOWN, objects=town.objects[1:]))


def test_signs_of_a_crossing_are_where_the_manual_has_them():
    """From the south of the 4-way crossing: the topology at the far right corner, the stop sign at the far left one."""
    facing_south = {
        (thing.kind, round(thing.x, 2), round(thing.y, 2))
        for thing in furnish(TOWN, "signs").objects
        if abs(thing.angle + math.pi / 2) < 1e-9 and 1 < thing.x < 4 and 1 < thing.y < 4
    }
    assert ("sign_4_way_intersect", 3.08, 1.92) in facing_south
    assert ("sign_stop", 1.8, 1.92) in facing_south


def test_the_same_seed_gives_the_same_objects():
    """Whatever else the map has; another seed gives others."""
    town = furnish(TOWN, "all", seed=4)
    assert furnish(RoadMap(TOWN, fitness=1.0), "all", seed=4).objects == town.objects
    assert furnish(town, "all", seed=4) == town
    assert furnish(TOWN, "all", seed=5) != town
    assert furnish(TOWN, FurnishSpec(trees=3), seed=4) == furnish(TOWN, {"trees": 3}, seed=4)


def test_amounts_are_counts_or_shares():
    """Whole numbers are exact; shares are of the cells without road."""
    found = Counter(thing.kind for thing in furnish(TOWN, "duckies=6 trees=0.5 lane_robots=2 lane_duckies=3").objects)
    assert found == {"duckie": 9, "tree": 2, "duckiebot": 2}
    walking = furnish(TOWN, "crossing_duckies=3").objects
    assert [thing.static for thing in walking] == [False] * 3


def test_only_asked_for_objects_are_in_lanes():
    """Objects in lanes are in the middle of one, in the direction of traffic."""
    for thing in furnish(TOWN, "lane_robots=6", seed=2).objects:
        right = (math.sin(thing.angle), math.cos(thing.angle))
        across = [(thing.x % 1 - 0.5, right[0]), (thing.y % 1 - 0.5, right[1])]
        assert any(abs(offset - 0.2 * part) < 1e-5 for offset, part in across if abs(part) > 0.9)


def test_tags_are_reused_far_away_or_refused():
    """No number twice while there are unused ones; later the farthest."""
    grid = np.kron(np.ones((9, 9), np.int8), np.array([[15, 5], [10, 0]], np.int8))[:-1, :-1]
    grid[0], grid[-1] = np.tile([7, 5], 9)[:-1], np.tile([13, 5], 9)[:-1]
    grid[:, 0], grid[:, -1] = np.tile([14, 10], 9)[:-1], np.tile([11, 10], 9)[:-1]
    grid[0, 0], grid[0, -1], grid[-1, 0], grid[-1, -1] = 6, 3, 12, 9
    town = furnish(grid, "signs")
    assert faults(town) == []
    places = {}
    for thing in town.objects:
        places.setdefault((thing.kind, thing.tag), []).append((thing.x, thing.y))
    apart = [math.dist(*pair) for group in places.values() for pair in pairwise(group)]
    assert len([tag for kind, tag in places if kind == "sign_stop"]) == 55
    assert min(apart) > 2
    with pytest.raises(InputError, match=re.escape("unique_tags: expected at most 55 of sign_stop")):
        furnish(grid, "signs unique_tags")


def test_crossings_without_room_are_refused_or_left_out():
    """A road at the corner of a crossing leaves no room for signs."""
    full = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    with pytest.raises(InputError, match="no roads at the four corners of each crossing, got one at row 0, column 1"):
        furnish(full, "signs")
    assert furnish(full, "signs=possible").objects == ()


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("sign", "expected all, signs"),
        ({"tree": 1}, "tree: expected one of"),
        (3, "expected a FurnishSpec, or words"),
        ("lights=2", "lights: expected a number, 0 to 1"),
        ("houses=500", "houses: expected a number that fits, got 500, of which"),
        ("lane_duckies=500", "lane_duckies: expected a number that fits"),
    ],
)
def test_wrong_specifications_are_refused(spec, words):
    """One message names the setting."""
    with pytest.raises(InputError, match=re.escape(words)):
        furnish(TOWN, spec)
