"""Strips of three lines: every valid filling is drawn, and no other."""

from functools import partial
from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracle import measure as oracle

from elitelanes_jax.network import repair
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.codes import CROSSINGS, EAST, KINDS, NORTH, SOUTH, WEST
from elitelanes_jax.optimizers import refit_strip

NEIGHBOURS = ((EAST, WEST, 0, 1), (SOUTH, NORTH, 1, 0))
TWO_RINGS = np.array([[6, 5, 5, 3], [10, 6, 5, 11], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)
SPIRAL = np.array([[6, 5, 5, 3, 0], [10, 0, 0, 12, 3], [14, 5, 5, 5, 11], [12, 5, 5, 5, 9]], np.int8)


@partial(jax.jit, static_argnames=("empty", "whole"))
def refitted(bits, grid, straight, **options):
    return jax.vmap(refit_strip(straight=straight, **options).apply, (0, None))(bits, grid)


def drawn(grid, *, count, seed=0, straight=0.5, **options):
    """The strips that were drawn: each changed grid with its dirty tiles, once."""
    bits = random_bits(jax.random.key(seed), (count, refit_strip().bits))
    varied = jax.tree.map(np.asarray, refitted(bits, jnp.asarray(grid), straight, **options))
    return {(one.tobytes(), dirty.tobytes()): (one, dirty) for one, dirty in zip(*varied, strict=True)}


def fits(one, other, forth, back):
    """Whether two codes may be neighbours, the second on the side `forth` of the first."""
    if bool(one & forth) != bool(other & back):
        return False
    return not {one, other} <= set(KINDS["turn"]) and not (one & forth and {one, other} <= set(CROSSINGS))


def fillings(grid, dirty, codes):
    """All grids that differ from a grid in dirty tiles alone, and where no dirty tile disturbs a neighbour."""
    padded = np.pad(np.where(dirty, -1, grid), 1)
    cells = np.argwhere(padded == -1)

    def completed(index):
        if index == len(cells):
            yield padded[1:-1, 1:-1].astype(np.int8).tobytes()
            return
        row, column = cells[index]
        for code in codes:
            fixed = True
            for forth, back, down, right in NEIGHBOURS:
                before, after = padded[row - down, column - right], padded[row + down, column + right]
                fixed &= fits(before, code, forth, back) and (after == -1 or fits(code, after, forth, back))
            if fixed:
                padded[row, column] = code
                yield from completed(index + 1)
                padded[row, column] = -1

    return set(completed(0))


@pytest.mark.slow
@pytest.mark.parametrize("empty", [True, False])
@pytest.mark.parametrize("grid", [TWO_RINGS, SPIRAL], ids=["4x4", "4x5"])
@pytest.mark.parametrize("whole", [0.0, 1.0])
def test_each_valid_filling_of_a_strip_is_drawn(grid, empty, whole):
    """An obvious search lists the fillings of each strip that was drawn."""
    grid = np.array(repair(grid))
    codes = [code for code in range(16) if code.bit_count() > 1 or (empty and code == 0)]
    seen = {}
    for one, dirty in drawn(grid, empty=empty, whole=whole, count=60_000, seed=1, straight=0.1).values():
        seen.setdefault(dirty.tobytes(), (dirty, set()))[1].add(one.tobytes())
    ways = (grid.shape, grid.shape[::-1])
    strips = sum((lines - 2) * (1 if whole else length * (length + 1) // 2) for lines, length in ways)
    # A square of 3 x 3 tiles is a strip of rows and of columns.
    assert len(seen) == strips - (0 if whole else (grid.shape[0] - 2) * (grid.shape[1] - 2))
    for dirty, found in seen.values():
        expected = fillings(grid, dirty, codes) or {grid.tobytes()}
        assert found <= expected
        assert found == expected or len(expected) > 50
    assert max(len(found) for _, found in seen.values()) > 1


@pytest.mark.parametrize(
    "shape", [(5, 8), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((3, 3), (6, 6), (9, 4)))]
)
def test_no_strip_disturbs_its_neighbours(shape):
    """Of any grid without mismatches; where nothing fits, nothing changes."""
    rng = np.random.default_rng([3, *shape])
    for seed in range(12):
        before = np.array(repair(rng.integers(0, 16, shape).astype(np.int8), fill=seed % 2 == 0))
        for grid, dirty in drawn(before, empty=seed % 3 > 0, whole=0.3, count=40, seed=seed).values():
            np.testing.assert_array_equal(np.where(dirty, before, grid), before)
            if (grid == before).all():
                continue
            assert oracle(grid)["mismatches"] == oracle(grid)["boundary_violations"] == 0
            for forth, back, down, right in NEIGHBOURS:
                for row, column in product(range(shape[0] - down), range(shape[1] - right)):
                    if dirty[row, column] or dirty[row + down, column + right]:
                        assert fits(int(grid[row, column]), int(grid[row + down, column + right]), forth, back)


def test_another_filling_is_drawn_where_one_was_asked_for_and_there_is_one():
    bits = random_bits(jax.random.key(2), (400, refit_strip().bits))
    bits = bits.at[:, 0].set(bits[:, 0] | 2)
    varied, dirty = jax.tree.map(np.asarray, refitted(bits, jnp.asarray(repair(TWO_RINGS)), 0.5, empty=True, whole=1.0))
    changes = {}
    for one, strip in zip(varied, dirty, strict=True):
        changes.setdefault(strip.tobytes(), set()).add(bool((one != np.asarray(repair(TWO_RINGS))).any()))
    assert {True} in changes.values() and {True, False} not in changes.values()


def test_straight_strips_go_straight_on():
    """Links to the next column as to the one before: more often if they are asked for."""
    field = np.zeros((3, 12), np.int8)
    shares = []
    for straight in (0.0, 1.0):
        east = np.array([one & EAST > 0 for one, _ in drawn(field, count=300, straight=straight, whole=1.0).values()])
        shares.append((east[:, :, 1:] == east[:, :, :-1]).all(axis=1).mean())
    assert shares[0] < 0.7 and shares[0] + 0.15 < shares[1]


def test_grids_of_two_lines_do_not_change():
    grid = np.array(repair(np.array([[6, 5, 3], [12, 5, 9]], np.int8)))
    ((same, dirty),) = drawn(grid, empty=True, whole=0.5, count=50).values()
    np.testing.assert_array_equal(same, grid)
    assert not dirty.any()


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("dtype", [pytest.param(np.uint8, marks=pytest.mark.slow), np.int32])
@pytest.mark.parametrize("grid", [SPIRAL, SPIRAL[:2]])
def test_strips_of_any_whole_numbers_are_int8(grid, dtype):
    bits = random_bits(jax.random.key(0), (refit_strip().bits,))
    expected, varied = (refit_strip().apply(bits, jnp.asarray(grid, kind)).grid for kind in (jnp.int8, dtype))
    assert varied.dtype == jnp.int8
    np.testing.assert_array_equal(varied, expected)
