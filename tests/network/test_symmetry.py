"""Turning and mirroring: the road graph stays the same."""

from itertools import product

import jax
import networkx as nx
import numpy as np
import pytest
from conftest import ALL_SHAPES, grids
from hypothesis import given
from oracle import road_graph

from elitelanes_jax.network.codes import rotate_codes
from elitelanes_jax.network.symmetry import canonical_form, canonical_forms, mirror, rotate


@given(grids(ALL_SHAPES))
def test_cells_and_codes_go_together(grid):
    width = grid.shape[1]
    quarter, flipped = rotate(grid), mirror(grid)
    for row, column in np.ndindex(grid.shape):
        assert quarter[width - 1 - column, row] == rotate_codes(int(grid[row, column]))
    moved = {(row, column): (width - 1 - column, row) for row, column in road_graph(grid)}
    assert nx.utils.graphs_equal(nx.relabel_nodes(road_graph(grid), moved), road_graph(quarter))
    moved = {(row, column): (row, width - 1 - column) for row, column in road_graph(grid)}
    assert nx.utils.graphs_equal(nx.relabel_nodes(road_graph(grid), moved), road_graph(flipped))


@given(grids(ALL_SHAPES))
def test_group(grid):
    np.testing.assert_array_equal(rotate(rotate(grid)), rotate(grid, 2))
    np.testing.assert_array_equal(rotate(grid, 4), grid)
    np.testing.assert_array_equal(rotate(rotate(grid, -1)), grid)
    np.testing.assert_array_equal(mirror(mirror(grid)), grid)
    np.testing.assert_array_equal(mirror(rotate(grid)), rotate(mirror(grid), -1))


@given(grids(ALL_SHAPES))
def test_canonical_form_is_that_of_every_image(grid):
    form = canonical_form(grid)
    for turns in range(4):
        assert canonical_form(rotate(grid, turns)) == canonical_form(rotate(mirror(grid), turns)) == form


@pytest.mark.parametrize("shape", [(0, 3, 4), (7, 3, 4), (4, 5, 5), (6, 1, 2)], ids=str)
def test_canonical_forms_of_many_grids_are_those_of_each(shape, monkeypatch):
    monkeypatch.setattr("elitelanes_jax.network.symmetry._TOGETHER", 3)
    codes = np.random.default_rng(2).integers(0, 16, shape).astype(np.int8)
    assert list(canonical_forms(codes)) == [canonical_form(grid) for grid in codes]


@pytest.mark.parametrize("alphabet", [(0, 3, 5, 6, 9, 10, 12), (1, 2, 4, 8, 15), (0, 7, 11, 13, 14)], ids=str)
def test_canonical_forms_tell_all_small_grids_apart(any_types, alphabet):
    """Burnside's lemma: how many 2 x 2 grids of some codes there are but for turning and mirroring."""
    codes = np.array(list(product(alphabet, repeat=4))).reshape(-1, 2, 2)
    images = [rotate, lambda grid: rotate(grid, 2), lambda grid: rotate(grid, 3)]
    images += [lambda grid, turns=turns: rotate(mirror(grid), turns) for turns in range(4)]
    many = [np.array(jax.vmap(image)(codes.astype(np.int8))) for image in images]
    fixed = len(codes) + sum((image == codes).all(axis=(1, 2)).sum() for image in many)
    assert len({canonical_form(grid) for grid in codes}) == fixed // 8


def test_grids_of_other_shapes_have_other_forms():
    forms = {shape: canonical_form(np.zeros(shape, int)) for shape in ((1, 4), (4, 1), (2, 2))}
    assert forms[1, 4] == forms[4, 1] != forms[2, 2]


def test_under_jit_and_vmap():
    codes = np.random.default_rng(1).integers(0, 16, (5, 3, 4)).astype(np.int8)
    for image in (rotate, mirror):
        np.testing.assert_array_equal(jax.jit(jax.vmap(image))(codes), [image(grid) for grid in codes])
