"""Emitters against what they say, niche by niche."""

import itertools
from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.optimizers._emitters import (
    Niches,
    draw_goal,
    draw_true,
    nearest_elite,
    penalise_distance,
    reachable,
)
from elitelanes_jax.problem.archive import VACANT
from elitelanes_jax.problem.descriptor import Axis

# Two free axes, and one with a target bin between them.
AXES = (Axis("crossings", 4), Axis("dead_ends", 2, target=0), Axis("cyclomatic", 3))
NICHES = Niches.of(AXES)
PLACES = list(itertools.product(range(4), range(2), range(3)))


def archives():
    """Which niches are filled, in many archives: none, all, and random ones."""
    rng = np.random.default_rng(0)
    return [np.zeros(24, bool), np.ones(24, bool), *(rng.random((60, 24)) < rng.random((60, 1)))]


def slow_reachable(valid):
    filled = {place for place, is_filled in zip(PLACES, valid, strict=True) if is_filled}
    columns = {(place[0], place[2]) for place in filled}
    steps = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)]
    return {
        (x, 0, z)
        for x, y, z in PLACES
        if y == 0 and (x, 0, z) not in filled and any((x + dx, z + dz) in columns for dx, dz in steps)
    }


@pytest.fixture(scope="module")
def drawn():
    """For each archive, goals drawn many times."""
    bits = random_bits(jax.random.key(0), (400, 2))
    targets = jax.jit(jax.vmap(lambda bits, valid: draw_goal(NICHES, bits, valid, 0.5), (0, None)))
    return [[tuple(row) for row in np.asarray(targets(bits, jnp.asarray(valid))).tolist()] for valid in archives()]


def test_niches_are_in_the_order_of_their_indices():
    assert [tuple(place) for place in NICHES.bins.tolist()] == PLACES
    assert NICHES.targeted.tolist() == [place[1] == 0 for place in PLACES]


def test_a_vacant_niche_beside_a_filled_column_is_reachable():
    for valid in archives():
        found = np.asarray(reachable(NICHES, jnp.asarray(valid)))
        assert {PLACES[niche] for niche in np.flatnonzero(found)} == slow_reachable(valid)


def test_targets_are_reachable_vacant_niches_and_filled_ones_alike(drawn):
    for valid, targets in zip(archives(), drawn, strict=True):
        near = slow_reachable(valid)
        kept = {place for place, is_filled in zip(PLACES, valid, strict=True) if is_filled and place[1] == 0}
        if not kept:  # those beside the target bin stand for the ones in it
            kept = {(x, 0, z) for (x, _, z), is_filled in zip(PLACES, valid, strict=True) if is_filled}
        kept = kept or {place for place in PLACES if place[1] == 0}
        assert set(targets) <= near | kept
        vacant = sum(target in near - kept for target in targets)
        if near and not near & kept:
            assert 0.35 < vacant / 400 < 0.65
            assert set(targets) == near | kept
        if not near:
            assert max(Counter(targets).values()) < 60, "all 12 are equally likely"


def test_the_nearest_elite_has_the_lowest_penalised_fitness_and_no_vacant_niche_has():
    rng = np.random.default_rng(1)
    fitness = np.where(rng.random((80, 24)) < 0.5, rng.integers(-900, 900, (80, 24)), VACANT).astype(np.int32)
    target = np.array(PLACES, np.int32)[rng.integers(0, 24, 80)]
    nearest = jax.jit(jax.vmap(lambda fitness, target: nearest_elite(fitness, NICHES.bins, target, 300)))
    found = nearest(fitness, target)
    for row, goal, niche in zip(fitness, target, np.asarray(found), strict=True):
        prices = [int(f) + 300 * sum(abs(goal - np.array(place))) for f, place in zip(row, PLACES, strict=True)]
        prices = [2**40 if f == VACANT else price for f, price in zip(row, prices, strict=True)]
        if min(prices) < 2**40:
            assert niche == np.argmin(prices)


def test_a_large_float_fitness_is_nearer_than_a_vacant_niche():
    fitness = jnp.array([jnp.inf, 3e9, 2e9, jnp.inf], jnp.float32)
    bins, goal = np.arange(4, dtype=np.int32)[:, None], jnp.zeros(1, jnp.int32)
    assert nearest_elite(fitness, bins, goal, 300) == 2


def test_each_axis_may_have_a_penalty_of_its_own():
    place, target = np.array([3, 1, 0], np.int32), np.array([0, 0, 2], np.int32)
    assert penalise_distance(jnp.int32(-7), place, target, 10) == -7 + 60
    assert penalise_distance(jnp.int32(-7), place, target, np.array([100, 0, 1], np.int32)) == -7 + 302


def test_places_that_are_true_are_drawn_alike():
    valid = jnp.asarray([False, True, False, True, True, False])
    drawn = np.asarray(draw_true(random_bits(jax.random.key(2), (6000,)), valid))
    counts = np.bincount(drawn, minlength=6)
    assert (counts[[0, 2, 5]] == 0).all()
    assert (abs(counts[[1, 3, 4]] - 2000) < 200).all()
    assert draw_true(jnp.uint32(5), jnp.zeros(6, bool)) == 5
