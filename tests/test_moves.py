"""The moves on networks: each against its definition, written out tile by tile, and what holds of all."""

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from conftest import grids
from hypothesis import given
from hypothesis import strategies as st
from oracle import measure as oracle
from oracle import road_graph

from elitelanes_jax import InputError, mirror, repair, rotate
from elitelanes_jax.codes import CONNECTIONS
from elitelanes_jax.draws import random_words
from elitelanes_jax.moves import (
    Mix,
    clear_block,
    completed,
    lay_straight,
    mirror_block,
    mixed,
    slide_lines,
    toggle_corner,
    toggle_link,
    toggle_outline,
    toggle_street,
    transplant,
    twinned,
)

CYCLES = {"corner": toggle_corner(), "outline": toggle_outline()}
MOVES = CYCLES | {
    "link": toggle_link(),
    "street": toggle_street(),
    "straight": lay_straight(),
    "clear": clear_block(),
    "mirror": mirror_block(),
    "slide": slide_lines(),
    "transplant": transplant(),
    "displaced": transplant(displaced=True),
    "mixed": mixed(Mix(), fill=True),
    "twinned": twinned(0.5, mixed(Mix(), fill=True)),
}
SHAPES = [(6, 6), (4, 7)]

every_move = pytest.mark.parametrize("name", MOVES)


def network(shape, seed=0):
    codes = np.random.default_rng([seed, *shape]).integers(0, 16, shape).astype(np.int8)
    return np.asarray(repair(codes))


def many(move, grid, mate=None, count=3000, seed=0):
    words = random_words(jax.random.key(seed), (count, move.words))
    apply = jax.jit(jax.vmap(move.apply, (0, None, None)))
    return jax.tree.map(np.asarray, apply(words, jnp.asarray(grid), None if mate is None else jnp.asarray(mate)))


def edges(grid):
    return {frozenset(edge) for edge in road_graph(np.asarray(grid)).edges}


def different(varied):
    """Each distinct result once."""
    seen = {grid.tobytes() + dirty.tobytes(): (grid, dirty) for grid, dirty in zip(*varied, strict=True)}
    return list(seen.values())


@every_move
@given(grid=grids(), seed=st.integers(0, 2**32 - 1))
def test_what_is_not_dirty_is_as_it_was_and_all_can_be_repaired(name, grid, seed):
    move = MOVES[name]
    words = jnp.asarray(np.random.default_rng(seed).integers(0, 2**32, move.words, np.uint32))
    varied = move.apply(words, jnp.asarray(grid), jnp.asarray(grid[::-1].copy()))
    assert varied.grid.dtype == jnp.int8
    assert varied.dirty.dtype == bool
    assert varied.grid.shape == varied.dirty.shape == grid.shape
    np.testing.assert_array_equal(np.where(varied.dirty, grid, varied.grid), grid)
    assert 0 <= varied.grid.min() <= varied.grid.max() <= 15
    found = oracle(repair(*varied))
    assert found["mismatches"] == found["boundary_violations"] == 0


@every_move
def test_batches_and_compilation_change_nothing(name):
    move, grid, mate = MOVES[name], network((4, 7)), network((4, 7), 1)
    words = random_words(jax.random.key(5), (20, move.words))
    together = jax.jit(jax.vmap(move.apply, (0, None, None)))(words, grid, mate)
    for number in range(20):
        alone = move.apply(words[number], jnp.asarray(grid), jnp.asarray(mate))
        np.testing.assert_array_equal(together.grid[number], alone.grid)
        np.testing.assert_array_equal(together.dirty[number], alone.dirty)


@pytest.mark.parametrize("name", CYCLES)
@pytest.mark.parametrize("shape", SHAPES)
def test_loops_keep_the_parity_of_every_tile_and_undo_themselves(name, shape):
    grid = network(shape)
    for varied, dirty in different(many(CYCLES[name], grid)):
        found = oracle(varied)
        assert found["mismatches"] == found["boundary_violations"] == 0
        assert (CONNECTIONS[varied] % 2 == CONNECTIONS[grid] % 2).all()
        added = nx.Graph(tuple(edge) for edge in edges(grid) ^ edges(varied))
        assert nx.is_connected(added)
        assert {degree for _, degree in added.degree} == {2}, "one loop"
        assert set(added) == set(map(tuple, np.argwhere(dirty).tolist()))
        rows, columns = zip(*added, strict=True)
        height, width = max(rows) - min(rows), max(columns) - min(columns)
        assert len(added) == 2 * (height + width), "the outline of a rectangle"
        assert name == "outline" or height == width == 1


def test_every_corner_and_every_outline_comes():
    assert len(different(many(toggle_corner(), network((4, 5))))) == 3 * 4
    assert len(different(many(toggle_outline(), network((4, 5)), count=20_000))) == 6 * 10


def test_a_link_is_made_or_cut_and_each_comes_equally_often():
    grid = network((4, 5))
    varied = many(toggle_link(), grid, count=31_000)
    counts = {}
    for result in varied.grid:
        change = edges(grid) ^ edges(result)
        assert len(change) == 1
        counts[next(iter(change))] = counts.get(next(iter(change)), 0) + 1
    assert len(counts) == 4 * 4 + 3 * 5
    assert max(abs(count - 1000) for count in counts.values()) < 5 * np.sqrt(1000)


def test_a_street_is_a_stretch_of_a_line():
    grid = network((4, 5))
    for varied, _ in different(many(toggle_street(), grid)):
        change = sorted(sorted(edge) for edge in edges(grid) ^ edges(varied))
        if change:
            street = nx.Graph(change)
            rows, columns = ({place[axis] for place in street} for axis in (0, 1))
            assert min(len(rows), len(columns)) == 1
            assert nx.is_connected(street)


def test_straights_lie_along_a_line():
    grid = np.full((5, 6), 15, np.int8)
    seen = different(many(lay_straight(), grid))
    assert len(seen) == 5 * 21 + 6 * 15
    for varied, dirty in seen:
        rows, columns = np.argwhere(dirty).T
        code = set(varied[dirty].tolist())
        assert (code == {5} and len(set(rows)) == 1) or (code == {10} and len(set(columns)) == 1)


def block_of(dirty):
    """The rectangle of the dirty tiles: all tiles in it are dirty."""
    rows, columns = np.argwhere(dirty).T
    block = (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    assert dirty[block].all()
    assert dirty.sum() == dirty[block].size
    return block


@pytest.mark.parametrize("shape", SHAPES)
def test_a_block_is_emptied(shape):
    seen = different(many(clear_block(), network(shape), count=40_000))
    for varied, dirty in seen:
        assert not varied[block_of(dirty)].any()
    height, width = shape
    assert len(seen) == height * (height + 1) * width * (width + 1) // 4


@pytest.mark.parametrize("shape", SHAPES)
def test_a_block_is_mirrored_in_its_place(shape):
    grid = network(shape)
    for varied, dirty in different(many(mirror_block(), grid)):
        block = block_of(dirty)
        images = mirrored_block(grid[block]), mirrored_block(grid[block].T, swap=True).T
        assert any((varied[block] == image).all() for image in images)


def mirrored_block(block, swap=False):
    """East to west; with `swap` the block is one of rows and columns exchanged, and so are the directions."""
    first, second = (8, 2) if swap else (4, 1)
    both = first | second
    exchanged = (block & ~both) | np.where(block & first, second, 0) | np.where(block & second, first, 0)
    return exchanged[:, ::-1]


@pytest.mark.parametrize("shape", SHAPES)
def test_lines_slide_by_one(shape):
    grid = network(shape)
    for varied, dirty in different(many(slide_lines(), grid)):
        block = block_of(dirty)
        whole_rows = block[1] == slice(0, shape[1])
        whole_columns = block[0] == slice(0, shape[0])
        assert whole_rows or whole_columns
        results = [np.roll(grid[block], step, axis) for axis in (0, 1) for step in (1, -1)]
        assert any((varied[block] == result).all() for result in results)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("displaced", [False, True])
def test_a_block_of_the_mate_is_set_in(shape, displaced):
    grid, mate = network(shape), network(shape, 1)
    turns = range(4) if shape[0] == shape[1] else (0, 2)
    images = [np.asarray(rotate(side, turn)) for side in (mate, mirror(mate)) for turn in turns]
    used = set()
    for varied, dirty in different(many(transplant(displaced=displaced), grid, mate)):
        block = block_of(dirty)
        height, width = varied[block].shape
        sources = [
            (number, row, column)
            for number, image in enumerate(images)
            for row in range(shape[0] - height + 1)
            for column in range(shape[1] - width + 1)
            if (image[row : row + height, column : column + width] == varied[block]).all()
        ]
        here = (block[0].start, block[1].start)
        fits = [source for source in sources if source[1:] == here]
        if displaced:
            fits = [source for source in sources if source[1] == here[0] or source[2] == here[1]]
        assert fits
        if height * width > 8:
            used |= {number for number, *_ in fits}
    assert used == set(range(len(images)))


def test_without_a_mate_the_block_is_the_grids_own():
    grid = network((5, 5))
    alone, own = many(transplant(), grid), many(transplant(), grid, grid)
    np.testing.assert_array_equal(alone.grid, own.grid)


@given(grids(), st.integers(0, 2**32 - 1))
def test_what_is_completed_is_what_filling_makes(grid, seed):
    move = completed(1.0, toggle_corner())
    words = np.random.default_rng(seed).integers(0, 2**32, move.words, np.uint32)
    plain = toggle_corner().apply(jnp.asarray(words[:-1]), jnp.asarray(grid))
    varied = move.apply(jnp.asarray(words), jnp.asarray(grid))
    np.testing.assert_array_equal(repair(*varied), repair(*plain, fill=True))


@given(grids(), st.integers(0, 2**32 - 1))
def test_what_is_twinned_is_made_in_the_place_opposite_too(grid, seed):
    move = mixed(Mix(), fill=True)
    words = np.random.default_rng(seed).integers(0, 2**32, move.words + 1, np.uint32)
    plain, dirty = jax.tree.map(np.asarray, move.apply(jnp.asarray(words[:-1]), jnp.asarray(grid)))
    turned, expected = np.asarray(rotate(plain, 2)), plain.copy()
    for number, place in enumerate(np.ndindex(grid.shape)):
        opposite = tuple(side - 1 - at for side, at in zip(grid.shape, place, strict=True))
        second = number > grid.size - 1 - number
        if dirty[opposite] and (second or not dirty[place]):
            expected[place] = turned[place]
    varied = twinned(1.0, move).apply(jnp.asarray(words), jnp.asarray(grid))
    np.testing.assert_array_equal(varied.grid, expected)
    np.testing.assert_array_equal(varied.dirty, dirty | dirty[::-1, ::-1])
    never = twinned(0.0, move).apply(jnp.asarray(words), jnp.asarray(grid))
    np.testing.assert_array_equal(never.grid, plain)
    np.testing.assert_array_equal(never.dirty, dirty)


@pytest.mark.parametrize("shape", SHAPES)
def test_twins_keep_the_symmetry_of_half_a_turn(shape):
    half = network(shape)
    top = np.arange(half.size).reshape(shape) < half.size // 2
    grid = np.where(top, half, rotate(half, 2))
    varied = many(twinned(1.0, mixed(Mix(), fill=True)), grid, count=300)
    for result, dirty in different(varied):
        np.testing.assert_array_equal(result, rotate(result, 2))
        np.testing.assert_array_equal(dirty, dirty[::-1, ::-1])
    assert (varied.grid != grid).any()


def test_moves_come_in_proportion_to_their_shares():
    grid = np.full((5, 5), 15, np.int8)
    none = Mix(*(0 for _ in Mix._fields))
    varied = many(mixed(none._replace(clear=3, straight=1), fill=True), grid, count=20_000)
    cleared = ((varied.grid == 0) == varied.dirty).all(axis=(1, 2))
    assert cleared.mean() == pytest.approx(0.75, abs=0.02)


def test_a_mix_of_one_move_is_that_move():
    grid, mate = network((5, 5)), network((5, 5), 1)
    alone = Mix(*(0 for _ in Mix._fields))
    for name in Mix._fields[:-1]:
        results = many(mixed(alone._replace(**{name: 7}), fill=True), grid, mate, 200)
        assert (results.grid != grid).any(), name
    cut = many(mixed(alone._replace(link=1), fill=True), grid, count=50)
    assert all(len(edges(result) ^ edges(grid)) == 1 for result in cut.grid)


def test_a_mix_is_checked():
    for wrong, message in (
        (Mix(link=-1), "moves: expected link to be a whole number, 1 or more, got -1"),
        (Mix(completed=2), "moves: expected completed to be a number, 0 to 1, got 2"),
        (Mix(*(0 for _ in Mix._fields)), "moves: expected a share over 0 for at least one move, got none"),
    ):
        with pytest.raises(InputError, match=message):
            wrong.checked()
