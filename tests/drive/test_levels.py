"""Levels are as they were asked for, and wrong arguments are named."""

import jax
import networkx as nx
import numpy as np
import pytest
from driving_oracle import drawn_maps, lane_graph, pick
from refusals import refused

from elitelanes_jax.drive import UNREACHABLE, make, make_levels, random_level
from elitelanes_jax.drive._distances import shortest_ways

SHAPE = (4, 5)


@pytest.fixture(scope="module")
def maps():
    return drawn_maps(1, 16, SHAPE)


def test_drawn_levels_are_as_far_as_asked(maps):
    for least, most in ((1, UNREACHABLE), (4, 6), (5, 2)):
        levels = jax.device_get(make_levels(jax.random.key(2), maps, 16, least=least, most=most))
        starts = set()
        for number in range(16):
            one = pick(levels, number)
            np.testing.assert_array_equal(one.ways, shortest_ways(one.grid, one.goal))
            graph = lane_graph(maps[number])
            lengths = nx.single_source_shortest_path_length(graph.reverse(copy=False), tuple(one.goal))
            assert lengths[tuple(one.start)] == one.shortest > 0
            furthest, asked = max(lengths.values()), [length for length in lengths.values() if least <= length <= most]
            assert one.shortest in asked or (not asked and (one.shortest == furthest or one.shortest > most))
            starts.add(tuple(one.start))
        assert len(starts) > 8


@pytest.mark.slow
def test_goals_are_drawn_from_all_places_that_can_be_reached():
    grid = np.array([[6, 7, 3], [14, 15, 11], [12, 13, 9]], np.int8)
    levels = jax.device_get(make_levels(jax.random.key(3), grid[None], 400))
    graph = lane_graph(grid)
    goals, counts = np.unique(np.stack(levels.goal, axis=1), axis=0, return_counts=True)
    expected = {node for node in graph if graph.in_degree(node)}
    assert {tuple(goal) for goal in goals.tolist()} == expected
    each = 400 / len(expected)
    assert (abs(counts - each) < 5 * np.sqrt(each)).all()


def test_the_same_key_draws_the_same(maps):
    one, other, third = (make_levels(jax.random.key(seed), maps) for seed in (4, 4, 5))
    jax.tree.map(np.testing.assert_array_equal, one, other)
    assert (one.start.row != third.start.row).any()


def test_what_is_wrong_is_named(maps, any_types):
    key = jax.random.key(0)
    for subject, got, expected, fault in (
        ("grids[1]", "one without any movement", "", lambda: make_levels(key, maps[:2] * [[[1]], [[0]]])),
        ("grids: map 0: grid", "16 at A1 ([0, 0])", "", lambda: make_levels(key, np.full((1, *SHAPE), 16))),
        ("grids", "several sizes", "", lambda: make_levels(key, [maps[0], maps[0].T])),
        ("least", "nan", "1 or more", lambda: make_levels(key, maps, least=float("nan"))),
        ("grid", "none", "a lane", lambda: random_level(key, [[2], [8]])),
        ("least", "nan", "whole number", lambda: random_level(key, maps[0], least=float("nan"))),
        ("most", "2.5", "whole number", lambda: random_level(key, maps[0], most=2.5)),
        ("least", "array([1, 2, 3, 4])", "whole", lambda: random_level(key, maps[0], least=np.arange(1, 5))),
        ("most", "[2, 3]", "whole number", lambda: random_level(key, maps[0], most=[2, 3])),
    ):
        with refused(subject, got, expected):
            fault()


@pytest.mark.parametrize("most", [2**40, np.int64(2**40), np.array(2**40)])
def test_a_distance_of_more_than_32_bits_is_the_largest(maps, most):
    level = random_level(jax.random.key(0), maps[0], least=most, most=most)
    expected = random_level(jax.random.key(0), maps[0], least=2**31 - 1, most=2**31 - 1)
    assert level.shortest == expected.shortest > 1


def test_make_names_its_own_argument(maps):
    """Messages once named `grids`, an argument of `make_levels`."""
    for wrong, subject, got, expected in (
        ([], "maps", "none", "size"),
        ([maps[0], maps[0].T], "maps", "several sizes", ""),
        ([[[2, 8]]], "maps[0]", "one without any movement", ""),
        (5, "maps", "5", "grids"),
    ):
        with refused(subject, got, expected):
            make("RoadNav", wrong)


def test_make_takes_maps_in_place_of_levels(maps):
    for name in ("RoadNav", "LaneDrive"):
        with refused("cuont", "'cuont'", expected="count, seed", hint="count"):
            make(name, maps, cuont=3)
    with refused("levels", "'levels'", expected="limit"):
        make("RoadNav", maps, levels=make_levels(jax.random.key(0), maps))
