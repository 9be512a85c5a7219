"""Localisation by elimination, against a driver that keeps a list of the nodes where it may be."""

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.drive._localization import NEVER, ambiguity, localization_steps
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.movements import EXIT

grids = hnp.arrays(np.int8, (4, 5), elements=st.integers(0, 15))
asked = st.lists(st.integers(0, 2), min_size=9, max_size=9)
steps_of, ambiguity_of = jax.jit(localization_steps), jax.jit(ambiguity)


def linked_sides(grid):
    """The headings with which each tile can be left."""
    out = {}
    for row, column in np.ndindex(grid.shape):
        out[row, column] = set()
        for heading, side in enumerate(SIDES):
            beside = row + side.down, column + side.right
            if all(0 <= part < most for part, most in zip(beside, grid.shape, strict=True)):
                there = grid[beside] & side.opposite
                out[row, column] |= {heading} if grid[row, column] & side.bit and there else set()
    return out


def slow_steps(grid, asked):
    sides = linked_sides(grid)
    starts = [(*tile, heading) for tile, out in sides.items() for heading in range(4) if (heading + 2) % 4 in out]

    def seen(node):
        return [int(EXIT[node[2], turn]) in sides[node[:2]] for turn in range(3)]

    def go(node, turn):
        for wanted in (turn, turn + 1, turn + 2):
            out = int(EXIT[node[2], wanted % 3])
            if out in sides[node[:2]]:
                return node[0] + SIDES[out].down, node[1] + SIDES[out].right, out
        return node

    found = np.full((*grid.shape, 4), NEVER)
    for start in starts:
        here, possible = start, list(starts)
        for step in range(len(asked) + 1):
            possible = [node for node in possible if seen(node) == seen(here)]
            if len(set(possible)) == 1:
                found[start] = step
                break
            if step < len(asked):
                here, possible = go(here, asked[step]), [go(node, asked[step]) for node in possible]
    return found


@settings(max_examples=40)
@given(grids, asked)
def test_steps_are_those_of_a_driver_with_a_list_of_places(grid, asked):
    assert (np.asarray(steps_of(grid, np.array(asked))) == slow_steps(grid, asked)).all()


@settings(max_examples=15)
@given(grids)
def test_ambiguity_is_the_mean_over_places(grid):
    steps = slow_steps(grid, (np.arange(18) % 3).tolist())
    sides = linked_sides(grid)
    count = sum(map(len, sides.values()))
    never = count - (steps < NEVER).sum()
    total = steps[steps < NEVER].sum() + 18 * never
    assert int(ambiguity_of(grid)) == (100 * total // count if count else 0)


def test_on_a_ring_nobody_knows_and_a_stub_has_nothing_more_to_see():
    ring, pair = np.zeros((2, 4, 5), np.int8)
    ring[:2, :2] = [[6, 3], [12, 9]]
    assert (np.asarray(steps_of(ring, np.arange(9) % 3)) == NEVER).all()
    assert int(ambiguity_of(ring)) == 1800
    pair[0, :2] = [4, 1]
    assert np.asarray(steps_of(pair, np.arange(9) % 3))[0, 1, 1] == NEVER
    assert int(ambiguity_of(np.zeros((4, 5), np.int8))) == 0


def test_many_maps_are_measured_as_one_by_one():
    some = np.random.default_rng(0).integers(0, 16, (5, 4, 5), np.int8)
    assert jax.vmap(ambiguity)(some).tolist() == [int(ambiguity_of(grid)) for grid in some]


def test_turning_a_map_changes_nothing():
    some = np.random.default_rng(1).integers(0, 16, (4, 4, 4), np.int8)
    many = jax.jit(jax.vmap(ambiguity))
    quarter = (np.rot90(some, -1, (1, 2)).astype(int) >> 1) | ((np.rot90(some, -1, (1, 2)) & 1) << 3)
    assert many(some).tolist() == many(quarter.astype(np.int8)).tolist()


def test_a_bad_grid_is_named():
    with pytest.raises(InputError, match="grid"):
        ambiguity(np.full((3, 3), 16))
