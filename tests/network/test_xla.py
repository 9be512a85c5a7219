"""Layouts and forms for XLA change no value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.network.xla import PackedCells, in_all_cells, lookup, materialize


@pytest.mark.parametrize("dtype", [np.int8, np.int32, np.uint32])
def test_the_array_stays_as_it_is(dtype):
    limits = np.iinfo(dtype)
    array = np.array([[limits.max, 0, 5], [limits.min, 1, limits.max]], dtype)
    given = jnp.asarray(array)
    for function in (materialize, jax.jit(materialize), jax.vmap(jax.vmap(materialize))):
        for part in (given, given[:0]):
            result = function(part)
            assert result.dtype == dtype
            np.testing.assert_array_equal(result, array[: len(part)])


@pytest.mark.parametrize(("platform", "loops"), [("cpu", 1), ("cuda", 0), ("rocm", 0), ("tpu", 0)])
def test_only_the_processor_needs_a_loop_to_store_an_array(platform, loops):
    traced = jax.jit(jax.vmap(materialize)).trace(jax.ShapeDtypeStruct((2, 3), jnp.int8))
    assert traced.lower(lowering_platforms=(platform,)).as_text().count("stablehlo.while") == loops


def test_values_are_looked_up_in_each_vector_of_a_batch():
    rng = np.random.default_rng(0)
    values = jnp.asarray(rng.integers(-9, 9, (2, 3, 7)), jnp.int8)
    indices = jnp.asarray(rng.integers(0, 7, (2, 3, 4, 5)))
    expected = np.take_along_axis(np.asarray(values)[..., None, :], np.asarray(indices), axis=-1)
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(lookup)))(values, indices), expected)
    shared = jax.vmap(lookup, (None, 0))(values[0, 0], indices[0])
    np.testing.assert_array_equal(shared, values[0, 0][indices[0]])


@pytest.mark.parametrize(
    "shape",
    [(1, 1), (3, 5), (5, 33), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((1, 9), (12, 12)))],
    ids=str,
)
def test_cells_are_packed_and_their_neighbours_are_shifts(shape):
    """Also of two grids end to end, which do not see each other."""
    cells = PackedCells(*shape)
    grids = np.random.default_rng(shape).integers(0, 16, (2, *shape))
    words = jnp.concatenate([cells.pack(grid) for grid in grids])
    for first, grid in zip((0, cells.words), grids, strict=True):
        wide = np.pad(grid.reshape(-1), cells.width)
        for steps in (1, cells.width):
            for shift, start in ((cells.following, cells.width + steps), (cells.preceding, cells.width - steps)):
                seen = cells.unpack(shift(words, steps)[first : first + cells.words])
                np.testing.assert_array_equal(seen, wide[start : start + grid.size].reshape(shape))


def test_a_word_has_eight_cells():
    np.testing.assert_array_equal(PackedCells(2, 4).pack(np.full((2, 4), 6))[0], in_all_cells(6))
