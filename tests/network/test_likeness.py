"""Maps are compared by their roads, wherever these are: against an oracle that lays one on the other cell by cell."""

import jax
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from hypothesis import given
from hypothesis import strategies as st
from oracle import difference as slow_difference
from refusals import refused

from elitelanes_jax import RoadMap, mirror, render, rotate
from elitelanes_jax.network import difference, gridlock_loop, likeness, plain_measure
from elitelanes_jax.network.likeness import RoadSet, group_alike, road_forms
from elitelanes_jax.network.symmetry import canonical_form

TOWN = np.array([[6, 5, 3, 0], [10, 0, 14, 3], [12, 5, 13, 9]], np.int8)


@st.composite
def moved(draw, grid):
    """Hypothesis: an image of a grid, with empty rows and columns around it."""
    image = rotate(mirror(grid) if draw(st.booleans()) else grid, draw(st.integers(0, 3)))
    sides = st.tuples(st.integers(0, 2), st.integers(0, 2))
    return np.pad(image, (draw(sides), draw(sides)))


@st.composite
def pairs(draw):
    """Hypothesis: small grids; half of the pairs are a grid and its image with up to two other codes."""
    one = draw(grids(ALL_SHAPES)) * draw(st.sampled_from([1, 1, 0]))
    other = draw(st.one_of(grids(ALL_SHAPES), moved(one)))
    for _ in range(draw(st.integers(0, 2))):
        row, column = draw(st.integers(0, len(other) - 1)), draw(st.integers(0, other.shape[1] - 1))
        other = np.array(other)
        other[row, column] = draw(st.integers(0, 15))
    return np.asarray(one, np.int8), np.asarray(other, np.int8)


@given(pairs(), st.sampled_from([0.05, 0.15, 0.5]))
def test_it_is_the_least_share_over_all_images_and_positions(pair, below):
    one, other = pair
    one, other = one[:3, :4], other[:3, :4]
    expected = slow_difference(one, other)
    assert difference(one, other) == difference(other, one) == expected
    assert (canonical_form(one, crop=True) == canonical_form(other, crop=True)) == (expected == 0)
    (limited,) = RoadSet([one]).differences(other, below)
    assert limited == (expected if expected < below else np.inf)


@given(st.data())
def test_neither_position_nor_image_counts(data):
    one = data.draw(grids())
    image = data.draw(moved(one))
    assert canonical_form(image, crop=True) == canonical_form(one, crop=True) and difference(image, one) == 0
    counts = [difference(grid, TOWN) * max(grid.size, TOWN.size) for grid in (one, image)]
    assert counts[0] == pytest.approx(counts[1])


def test_filled_grids_are_compared_cell_by_cell():
    one, other = np.random.default_rng(0).integers(1, 16, (2, 9, 9)).astype(np.int8)
    images = [rotate(flipped, turns) for flipped in (other, mirror(other)) for turns in range(4)]
    assert difference(one, other) == min((one != image).mean() for image in images)


@pytest.mark.parametrize("shape", [(4, 5), pytest.param((3, 7), marks=pytest.mark.slow)])
def test_it_is_a_kernel(shape):
    rng = np.random.default_rng(5)
    many, others = (
        np.where(rng.random((40, *sides)) < 0.6, rng.integers(0, 16, (40, *sides)), 0) for sides in ((4, 5), shape)
    )
    if shape == (4, 5):
        # Half of them are images with another code.
        others[::2] = np.roll(rotate(many[0], 2), 1, axis=0), *map(mirror, many[2::2])
        others[::2, 1, 2] ^= 4
    shares = jax.jit(jax.vmap(difference))(many, others)
    expected = [difference(grid, other) for grid, other in zip(many, others, strict=True)]
    assert shares.dtype == np.float32
    np.testing.assert_array_equal(shares, np.float32(expected))


@pytest.mark.parametrize("function", [canonical_form, gridlock_loop, plain_measure, render, RoadMap])
def test_functions_that_are_no_kernels_refuse_traced_codes(function):
    name = "codes" if function is gridlock_loop else "grid"
    with refused(name, "traced ones", hint="jax.jit"):
        jax.jit(function)(TOWN)


def test_a_set_of_many_sizes_gives_what_pairs_give():
    rng = np.random.default_rng(1)
    many = [np.pad(rng.integers(0, 16, rng.integers(2, 6, 2)), 1).astype(np.int8) for _ in range(12)]
    many += [np.roll(rotate(grid), 1, axis=0) for grid in many[:4]]
    roads = RoadSet(many)
    for grid in many[::4]:
        expected = np.array([difference(grid, other) for other in many])
        np.testing.assert_array_equal(roads.differences(grid, np.inf), expected)
        np.testing.assert_array_equal(roads.differences(grid, 0.4), np.where(expected < 0.4, expected, np.inf))
    assert road_forms(many) == [canonical_form(grid, crop=True) for grid in many]


def test_many_maps_are_compared_with_a_set_as_one_by_one(monkeypatch):
    """Few grids and few positions at once, so that several rounds are needed."""
    monkeypatch.setattr(likeness, "_COMPARED", 3)
    monkeypatch.setattr(likeness, "_TOGETHER", 5)
    rng = np.random.default_rng(3)
    many = [rng.integers(0, 16, (3, 4)).astype(np.int8) for _ in range(8)]
    many += [np.where(rng.random(grid.shape) < 0.2, 5, mirror(grid)).astype(np.int8) for grid in many]
    others = [rotate(grid) for grid in many[3:11]] + [TOWN]
    expected = np.array([[slow_difference(other, grid) for grid in many] for other in others])
    expected[expected >= 0.5] = np.inf
    assert 8 < np.isfinite(expected).sum() < expected.size // 2
    roads, compared = RoadSet(many), np.full(expected.shape, np.inf)
    pairs = roads.pairs(others, 0.5)
    compared[pairs.first, pairs.second] = pairs.difference
    assert len(pairs.first) == np.isfinite(expected).sum()
    np.testing.assert_array_equal(compared, expected)
    np.testing.assert_array_equal(roads.least_differences(others, 0.5), expected.min(axis=0))
    assert np.isinf(roads.least_differences([], 0.5)).all()


def test_a_large_map_differs_from_its_moved_copy_by_what_was_changed():
    rng = np.random.default_rng(2)
    grid = rng.integers(0, 16, (40, 30)).astype(np.int8)
    other = np.pad(mirror(grid), ((5, 0), (0, 3)))
    other[20:22, 10:14] = (other[20:22, 10:14] % 15) + 1
    assert difference(grid, other) == RoadSet([grid]).differences(other, 0.01)[0] == 8 / other.size


def test_a_chain_of_alike_maps_is_a_group():
    chain = [np.full((4, 5), 5, np.int8)]
    for cell in ((0, 0), (1, 1), (2, 2), (3, 3)):
        chain.append(np.array(chain[-1]))
        chain[-1][cell] = 15
    ends = chain[0], rotate(chain[4])
    assert difference(*ends) == 4 / 20
    assert len({*group_alike(chain).tolist()}) == 1
    assert len({*group_alike(ends).tolist()}) == 2
    other = np.full((4, 5), 10, np.int8)
    assert group_alike([other, TOWN, ends[0]], np.array([7, 4, 7])).tolist() in ([0, 1, 0], [1, 0, 1])


def test_bad_grids_are_refused():
    for compare in (canonical_form, lambda grid: difference(TOWN, grid)):
        with refused("grid", "16 at A1 ([0, 0])"):
            compare([[16]])
