"""Choosing maps: valid, different, spread."""

from collections import Counter
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from certified import evolve
from refusals import refused

from elitelanes_jax import Result, SearchSpec, measure, mirror, repair, rotate
from elitelanes_jax.network import canonical_form
from elitelanes_jax.network.codes import ROAD_ALPHABET
from elitelanes_jax.network.metrics import stack_metrics
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.descriptor import compute_descriptor, paper_axes
from elitelanes_jax.problem.ranges import parse_ranges
from elitelanes_jax.search import History, MeasuredElites
from elitelanes_jax.search.records import RunState
from elitelanes_jax.search.resolve import resolve
from elitelanes_jax.search.selection import _spread
from elitelanes_jax.search.style import CROSSING

AXES = paper_axes((6, 6))


@partial(jax.jit, static_argnums=1)
def measured(grids, alphabet):
    return jax.vmap(jax.vmap(lambda grid: measure(grid, alphabet)))(grids)


def result(grids, fitness, alphabet=None):
    """A result of some seeds with the given elites ``[S][N]``."""
    grids = jnp.asarray(np.array(grids, np.int8))
    metrics = measured(grids, None if alphabet is None else tuple(alphabet))
    valid = jnp.ones(grids.shape[:2], bool)
    found = MeasuredElites(
        grids, jnp.asarray(fitness), compute_descriptor(stack_metrics(metrics), METRIC_NAMES, AXES), valid, metrics, {}
    )
    search = replace(resolve(SearchSpec(), (6, 6)), axes=AXES)
    return Result(found, History(*[np.zeros(0)] * 6), RunState(0, None, 0), replace(search, shape=grids.shape[-2:]))


def again(evolved, **options):
    """The result of the same search with other options."""
    spec = evolved.search.to_spec().replace(**options)
    return replace(evolved, search=resolve(spec, evolved.search.shape, room_for="anything"))


@pytest.fixture(scope="module")
def evolved():
    keys = jax.random.split(jax.random.key(2), 4)
    return evolve(keys, (6, 6), preset="paper", generations=300, fill=True)


def test_what_is_chosen_is_valid_and_different(evolved):
    choice = evolved.choose(30, seed=9)
    assert len(choice.maps) == 30
    forms = {canonical_form(road_map.codes) for road_map in choice.maps}
    assert len(forms) == 30
    for road_map in choice.maps:
        metrics = measure(road_map.codes)
        assert (metrics.components, metrics.dead_ends, metrics.boundary_violations, metrics.mismatches) == (1, 0, 0, 0)
        assert road_map.metrics == {name: value.item() for name, value in metrics._asdict().items()}
        assert road_map.descriptor["cyclomatic"] == metrics.cyclomatic
        assert road_map.seed[0] == 9
        grids = evolved.elites.grids[road_map.seed[1]]
        assert (grids == road_map.codes).all(axis=(1, 2)).any()


def test_elites_with_flaws_are_counted_by_reason(evolved):
    flawless, reasons = evolved.without_flaws()
    metrics = evolved.elites.by_name()
    for name, right in (("components", 1), ("dead_ends", 0), ("boundary_violations", 0)):
        assert (metrics[name][flawless] == right).all()
    assert flawless.any() and (flawless <= evolved.satisfies()).all()
    assert sum(reasons.values()) == (evolved.satisfies() & ~flawless).sum() > 0


def test_a_result_hands_its_maps_over(evolved):
    plain = [road_map.codes.tolist() for road_map in evolved.choose(16).maps]
    assert [road_map.codes.tolist() for road_map in evolved.maps()] == plain
    few = evolved.maps(5, where="turns=8.. cyclomatic=..4")
    assert 0 < len(few) <= 5
    for road_map in few:
        assert road_map.metrics["turns"] >= 8 and road_map.metrics["cyclomatic"] <= 4
        assert "\n" not in repr(road_map) and repr(road_map).startswith("RoadMap(6 x 6, fitness ")
        assert measure(road_map.codes).turns == road_map.metrics["turns"]
    ranged = again(evolved, where="turns=100..")
    with pytest.warns(UserWarning, match=r"^found 0 of 16 .* outside the ranges\); a wider range than turns=100\.\., "):
        assert not ranged.maps()
    assert len(ranged.maps(where={"turns": (8, None)})) == 16
    alone = jax.tree.map(lambda array: array[1] if array.ndim else array, evolved.elites)
    of_one = replace(evolved, elites=alone).maps(3)
    assert len(of_one) == 3 and {road_map.seed for road_map in of_one} == {(0, 0)}
    with refused("count", "0"):
        evolved.maps(0)
    with refused("where 'turn=3'", "'turn'"):
        evolved.maps(where="turn=3")


def test_a_hint_names_the_range_that_rejects_most(evolved):
    for where, wider in (
        ("turns=1.. bridges=90..", "a wider range than bridges=90.."),
        ("bridges=90.. turns=1..", "a wider range than bridges=90.."),
    ):
        narrow = again(evolved, where=where)
        assert narrow.choose(4).hint(narrow.search).startswith(f"{wider}, ")
    of_shelf = again(evolved, inventory={"straight": 9, "turn": 9, "crossing3": 9, "crossing4": 9}).search
    straights = next(item for item in of_shelf.ranges if item.name == "straights")
    choice = evolved.choose(4)._replace(narrowest=straights)
    assert choice.hint(of_shelf).startswith("more straights in the inventory, ")
    # Where the user asks for many of them, more tiles alone do not help.
    both = choice._replace(narrowest=straights._replace(low=straights.high))
    assert both.hint(of_shelf).startswith(
        "more straights in the inventory, a wider range than straights=9.., more seeds"
    )
    user = choice._replace(narrowest=straights._replace(low=straights.high, high=None))
    assert user.hint(of_shelf).startswith("a wider range than straights=9.., ")
    rings = choice._replace(narrowest=CROSSING)
    assert rings.hint(again(evolved, style="town").search).startswith("where crossings=0.., which allows rings, ")


def test_ranges_leave_the_axes_of_a_result_as_they_are():
    """A file of an earlier version may have other axes than its preset has now."""
    found = result([random_maps(1, 6)], [[0]])
    assert resolve(SearchSpec(), (6, 6)).axes != AXES
    assert found.with_ranges(parse_ranges("turns=0..")).search.axes == AXES


def random_maps(count, size, seed=0):
    """Connected filled grids that have little in common."""
    rng = np.random.default_rng(seed)
    maps = []
    while len(maps) < count:
        grid = np.array(repair(rng.integers(0, 16, (size, size)).astype(np.int8), fill=True))
        if measure(grid).components == 1:
            maps.append(grid)
    return maps


def test_all_niches_have_a_turn_before_any_has_a_second():
    found = result([random_maps(40, 6)], [np.arange(40)])
    everything = found.choose(10**6).maps
    assert len(everything) == 40
    niches = {tuple(road_map.niche) for road_map in everything}
    few = found.choose(len(niches) - 2).maps
    assert len({tuple(road_map.niche) for road_map in few}) == len(few)
    more = Counter(tuple(road_map.niche) for road_map in found.choose(len(niches) + 1).maps)
    assert set(more) == niches
    assert max(more.values()) == 2


def nearly(grid):
    """The same but for one link."""
    for row, column in np.ndindex(grid.shape[0], grid.shape[1] - 1):
        other = grid.copy()
        other[row, column] ^= 4
        other[row, column + 1] ^= 1
        metrics = measure(other, ROAD_ALPHABET)
        if metrics.components == 1 and not metrics.dead_ends and not metrics.off_alphabet:
            return other
    raise AssertionError("no such link")


def test_maps_that_hardly_differ_come_last():
    """Three maps and three near-copies, turned, which would be fitter and have niches of their own."""
    originals = random_maps(3, 10)
    copies = [np.asarray(rotate(mirror(nearly(grid)), 1)) for grid in originals]
    found = result([[*copies, *originals]], [[-9, -9, -9, 5, 5, 5]])
    first = {canonical_form(road_map.codes) for road_map in found.choose(3).maps}
    for original, copy in zip(originals, copies, strict=True):
        assert len({canonical_form(original), canonical_form(copy)} & first) == 1
    assert len(found.choose(6).maps) == 6
    assert len(found.choose(6, min_difference=(0.15,)).maps) == 3
    # A near-copy has another cyclomatic number. It is no second choice where the other one is on target.
    on_target = int(measure(originals[0]).cyclomatic)
    axes = (AXES[0]._replace(bins=99, target=on_target), *AXES[1:])
    aimed = replace(found, search=replace(found.search, axes=axes))
    assert len(aimed.choose(6, min_difference=(0.15,)).maps) == 3


def test_niches_that_lie_apart_come_first(evolved):
    two, everything = evolved.choose(2).maps, evolved.choose(10**6).maps
    cyclomatic = [road_map.metrics["cyclomatic"] for road_map in everything]
    fittest = min(everything, key=lambda road_map: road_map.fitness)
    assert fittest.niche in [road_map.niche for road_map in two]
    assert abs(two[0].metrics["cyclomatic"] - two[1].metrics["cyclomatic"]) >= np.ptp(cyclomatic) / 3
    assert [road_map.niche for road_map in everything] == sorted(road_map.niche for road_map in everything)


@pytest.mark.parametrize(("cyclomatic", "second"), [(20, (0, 0, 0, 0, 1)), (24, (24, 0, 0, 0, 0))])
def test_distances_between_niches_are_shares_of_each_axis(cyclomatic, second):
    """From bin 0 of 25, bin 20 is nearer than the other bin of a flag, and bin 24 is as far and comes first."""
    found = result([random_maps(3, 6)], [[0, 1, 2]])
    descriptor = np.array([[[0, 1, 0, 0, 0], [cyclomatic, 1, 0, 0, 0], [0, 1, 0, 0, 1]]], np.int32)
    found = replace(found, elites=found.elites._replace(descriptor=descriptor))
    niches = {tuple(road_map.niche) for road_map in found.choose(2).maps}
    assert niches == {(0, 0, 0, 0, 0), second}


def test_seeds_take_turns():
    whole = random_maps(12, 6)
    choice = result([whole[:6], whole[6:]], [[0] * 6, [1] * 6]).choose(6)
    assert Counter(road_map.seed[1] for road_map in choice.maps) == {0: 3, 1: 3}


def test_maps_off_the_target_bins_balance_the_seeds_of_those_in_them():
    """Seed 0 gives both maps in the target bin, so seed 1 gives the next one, although seed 0 has a fitter map."""
    whole = random_maps(6, 6)
    found = result([whole[:3], whole[3:]], [[0, 1, 2], [3, 4, 5]])
    flags = jnp.array([[0, 0, 1], [1, 1, 1]])
    descriptor = jnp.zeros_like(found.elites.descriptor).at[..., -1].set(flags)
    search = replace(found.search, axes=(*AXES[:-1], AXES[-1]._replace(target=0)))
    aimed = replace(found, elites=found.elites._replace(descriptor=descriptor), search=search)
    chosen = aimed.choose(4, min_difference=(0.0,)).maps
    assert Counter(road_map.seed[1] for road_map in chosen) == {0: 2, 1: 2}


def test_images_of_one_map_are_one_map_and_the_fittest_stays():
    ring = np.array([[6, 5, 7, 3], [10, 6, 13, 11], [14, 13, 5, 11], [12, 5, 5, 9]])
    images = [ring, rotate(ring), mirror(ring), rotate(mirror(ring), 2)]
    choice = result([images], [[5, 3, 4, 3]]).choose(4)
    assert len(choice.maps) == 1
    assert choice.maps[0].fitness == 3
    np.testing.assert_array_equal(choice.maps[0].codes, images[1])
    assert (choice.found, choice.alike, choice.rejected) == (4, 3, {})


FLAWS = {
    "components": "not in one piece",
    "dead_ends": "with dead ends",
    "boundary_violations": "with roads that leave the grid",
    "mismatches": "with roads that do not meet",
    "off_alphabet": "with tiles that are not in the alphabet",
    "empty_cells": "with empty cells",
}


def test_each_flaw_alone_makes_a_map_useless_and_is_counted():
    """Even one that no grid has alone: the figures are what counts."""
    found = result([random_maps(2, 5)], [[0, 0]])
    for name, reason in FLAWS.items():
        check_flaw(found, name, reason)
    assert result([np.zeros((1, 3, 3), np.int8)], [[0]]).choose(3).maps == []


def check_flaw(found, name, reason):
    spoilt = getattr(found.elites.metrics, name).at[0, 1].set(7)
    elites = found.elites._replace(metrics=found.elites.metrics._replace(**{name: spoilt}))
    choice = replace(found, elites=elites).choose(2)
    assert len(choice.maps) == 1
    assert choice.rejected == {reason: 1}


def test_maps_follow_the_targets(evolved):
    """Of two kinds of targets each gives half of the maps, and all differ."""
    turns = {road_map.metrics["turns"] for road_map in evolved.choose(10**4).maps}
    low, high = min(turns), max(turns)
    aimed = again(evolved, targets={"turns": [low, high]})
    chosen = [road_map.metrics["turns"] for road_map in aimed.choose(6, min_difference=(0.0,)).maps]
    assert low in chosen and high in chosen
    everything = [one.choose(10**4).maps for one in (evolved, aimed)]
    forms = [sorted(canonical_form(road_map.codes) for road_map in maps) for maps in everything]
    assert forms[0] == forms[1] and len(set(forms[1])) == len(forms[1])
    beyond = again(evolved, targets={"turns": [high, high]})
    first = beyond.choose(1).maps[0]
    assert first.metrics["turns"] == high


def test_maps_in_the_target_bins_follow_the_targets_among_themselves():
    """The fittest map is off the target bin, so the others have another index among those in it."""
    found = again(result([random_maps(4, 6)], [range(4)]), targets={"turns": [4, 9]})
    elites = found.elites._replace(
        descriptor=found.elites.descriptor.at[0, :, -1].set(jnp.array([1, 0, 0, 0])),
        metrics=found.elites.metrics._replace(turns=jnp.array([[9, 4, 4, 9]])),
    )
    search = replace(found.search, axes=(*AXES[:-1], AXES[-1]._replace(target=0)))
    chosen = replace(found, elites=elites, search=search).choose(2, min_difference=(0.0,)).maps
    assert {road_map.metrics["turns"] for road_map in chosen} == {4, 9}


def test_a_point_without_a_different_map_passes_its_turn_to_the_next_point():
    points, shares = np.array([[0.0], [1.0], [9.0], [5.0]]), np.full(4, 0.5)
    order = _spread(np.concatenate([points, points]), np.zeros(8, int), Counter())
    difference = np.concatenate([shares, shares])
    given = []
    for index in order(difference, 0.15):
        given.append(index % 4)
        difference[2::4] = 0  # the maps of the third point are like the first map
    assert given == [0, 3, 1]
