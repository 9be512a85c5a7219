"""Packed cells against plain ones."""

import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.network.xla import PackedCells, in_all_cells


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (3, 5), (12, 12), (5, 33)], ids=str)
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
