"""The moves on networks: each against its definition, written out tile by tile, and what holds of all."""

import re
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import networkx as nx
import numpy as np
import pytest
from oracle import measure as oracle
from oracle import road_graph
from refusals import refused

from elitelanes_jax.network import mirror, repair, rotate
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.codes import CONNECTIONS
from elitelanes_jax.optimizers import (
    Move,
    MoveWeights,
    make_move,
    random_move,
    refit_strip,
    with_fill,
    with_symmetric_copy,
)
from elitelanes_jax.optimizers._moves import KNOWN_MOVES
from elitelanes_jax.optimizers._mutations import Variation
from elitelanes_jax.optimizers._windows import valid_windows

CYCLES = {"corner": make_move("corner"), "outline": make_move("outline")}
# By the names of their weights.
MOVES = CYCLES | {
    "link": make_move("link"),
    "street": make_move("street"),
    "straight": make_move("straight"),
    "clear": make_move("clear"),
    "mirror": make_move("mirror"),
    "slide": make_move("slide"),
    "transplant": make_move("transplant"),
    "displaced": make_move("displaced"),
    "refit": make_move("refit", empty=False),
}
SHAPES = [(6, 6), (4, 7)]

NONE = dict.fromkeys((*KNOWN_MOVES, "fill_probability"), 0)


@jax.jit
@partial(jax.vmap, in_axes=(None, 0, 0, 0))
def moved(mix, bits, grid, mate):
    """A move of a mix, what it leaves after repair, and the same move with filling, and elsewhere too."""
    move = random_move(mix, fill=True)
    varied = move.apply(bits[:-1], grid, mate)
    filled = with_fill(1.0, move).apply(bits, grid, mate)
    both, never = (with_symmetric_copy(share, move).apply(bits, grid, mate) for share in (1.0, 0.0))
    return varied, repair(*varied), repair(*varied, fill=True), repair(*filled), both, never


def test_a_move_may_return_a_tuple():
    move = Move(1, lambda bits, grid, mate: (grid ^ 15, grid > 0))
    found = with_fill(0.0, move).apply(jnp.zeros(2, jnp.uint32), jnp.array([[6, 3], [12, 9]], jnp.int8))
    np.testing.assert_array_equal(found.grid, [[9, 12], [3, 6]])
    assert found.dirty.all()


def random_moves(shape, mix, count=60):
    """Random grids and mates of any codes, and what `moved` makes of them."""
    rng = np.random.default_rng([7, *shape])
    bits = rng.integers(0, 2**32, (count, random_move(mix, fill=True).bits + 1), np.uint32)
    before, mates = (rng.integers(0, 16, (count, *shape)).astype(np.int8) for _ in range(2))
    found = moved(mix, *map(jnp.asarray, (bits, before, mates)))
    return before, jax.tree.map(np.asarray, found)


def network(shape, seed=0):
    codes = np.random.default_rng([seed, *shape]).integers(0, 16, shape).astype(np.int8)
    return np.asarray(repair(codes))


def many(move, grid, mate=None, count=3000, seed=0):
    bits = random_bits(jax.random.key(seed), (count, move.bits))
    apply = jax.jit(jax.vmap(move.apply, (0, None, None)))
    return jax.tree.map(np.asarray, apply(bits, jnp.asarray(grid), None if mate is None else jnp.asarray(mate)))


def edges(grid):
    return {frozenset(edge) for edge in road_graph(np.asarray(grid)).edges}


def test_the_page_has_the_names_of_all_weights():
    page = (Path(__file__).parents[2] / "docs" / "moves.md").read_text(encoding="utf-8")
    names = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    assert names == [*KNOWN_MOVES, "refit_strip", "with_fill", "with_symmetric_copy"]
    assert re.findall(r"^ +(\w+): weight of ", MoveWeights.__doc__, re.MULTILINE) == list(KNOWN_MOVES)


def different(varied):
    """Each distinct result once."""
    seen = {grid.tobytes() + dirty.tobytes(): (grid, dirty) for grid, dirty in zip(*varied, strict=True)}
    return list(seen.values())


@pytest.mark.parametrize(
    "shape", [(3, 4), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((2, 2), (2, 5), (6, 6)))]
)
def test_of_any_grid_by_any_move(shape):
    """What is not dirty stays, all can be repaired, filling fills, and the opposite place changes too if it is to."""
    for mix in (MoveWeights(refit=12), *(MoveWeights(**NONE | {name: 1}) for name in MOVES)):
        before, (varied, settled, filled, filling, both, never) = random_moves(shape, mix)
        assert varied.grid.dtype == np.int8
        assert varied.dirty.dtype == bool
        np.testing.assert_array_equal(np.where(varied.dirty, before, varied.grid), before)
        assert 0 <= varied.grid.min() <= varied.grid.max() <= 15
        for grid in settled[::5]:
            found = oracle(grid)
            assert found["mismatches"] == found["boundary_violations"] == 0
        np.testing.assert_array_equal(filling, filled)
        np.testing.assert_array_equal(never.grid, varied.grid)
        np.testing.assert_array_equal(never.dirty, varied.dirty)
        for plain, dirty, *found in zip(*varied, *both, strict=True):
            np.testing.assert_array_equal(found, at_the_opposite_place_too(plain, dirty))


def at_the_opposite_place_too(plain, dirty):
    """A grid after a move and the same change rotated by half a turn, and what is dirty; the first of two decides."""
    image, copied = rotate(plain, 2), dirty[::-1, ::-1]
    indices = np.arange(plain.size).reshape(plain.shape)
    first = dirty & (indices <= indices[::-1, ::-1])
    return np.where(copied & ~first, image, plain), dirty | copied


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
    assert len(different(many(make_move("corner"), network((4, 5))))) == 3 * 4
    assert len(different(many(make_move("outline"), network((4, 5)), count=5000))) == 6 * 10


def test_a_link_is_made_or_cut_and_each_comes_equally_often():
    grid = network((4, 5))
    results, counts = np.unique(many(make_move("link"), grid, count=6200).grid, axis=0, return_counts=True)
    changes = [edges(grid) ^ edges(result) for result in results]
    assert all(len(change) == 1 for change in changes)
    counts = dict(zip(map(frozenset, changes), counts.tolist(), strict=True))
    assert len(counts) == 4 * 4 + 3 * 5
    assert max(abs(count - 200) for count in counts.values()) < 5 * np.sqrt(200)


def test_a_street_is_a_stretch_of_a_line():
    grid = network((4, 5))
    for varied, _ in different(many(make_move("street"), grid)):
        change = sorted(sorted(edge) for edge in edges(grid) ^ edges(varied))
        if change:
            street = nx.Graph(change)
            rows, columns = ({place[axis] for place in street} for axis in (0, 1))
            assert min(len(rows), len(columns)) == 1
            assert nx.is_connected(street)


def test_straights_lie_along_a_line():
    grid = np.full((5, 6), 15, np.int8)
    seen = different(many(make_move("straight"), grid))
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


@pytest.mark.parametrize("empty", [True, False])
def test_a_window_gets_each_other_valid_window_with_the_same_links_out(empty):
    """Two rings, the one in a corner of the other: their window has other valid ones, the rest does not change."""
    grid = np.array(repair(np.array([[6, 5, 5, 3], [10, 6, 5, 11], [10, 10, 0, 10], [12, 13, 5, 9]], np.int8)))
    windows = valid_windows(3, 3, empty=empty)
    expected = set()
    for north, west in np.ndindex(2, 2):
        tiles = grid[north : north + 3, west : west + 3]
        rows = (tiles << 4 * np.arange(3)).sum(axis=1)
        sides = np.concatenate([tiles[0] & 8, tiles[2] & 2, tiles[:, 0] & 1, tiles[:, 2] & 4]) > 0
        border = int((sides << np.arange(12)).sum())
        for window in windows.rows[windows.first[border] : windows.first[border + 1]]:
            result = grid.copy()
            result[north : north + 3, west : west + 3] = window[:, None] >> 4 * np.arange(3) & 15
            if not (window == rows).all():
                expected.add(result.tobytes())
    seen = different(many(make_move("refit", empty=empty), grid, count=4000))
    assert {varied.tobytes() for varied, _ in seen} - {grid.tobytes()} == expected
    changed = {dirty.tobytes() for varied, dirty in seen if (varied != grid).any()}
    assert not changed & {dirty.tobytes() for varied, dirty in seen if (varied == grid).all()}
    assert all(dirty.sum() == 9 and block_of(dirty) for _, dirty in seen)
    for varied, _ in seen:
        assert oracle(varied)["mismatches"] == 0


def test_the_tile_at_the_centre_is_the_one_that_the_move_made():
    centre = np.pad([[True]], 1)
    stub = Move(0, lambda bits, grid, mate=None: Variation(jnp.where(centre, 8, grid).astype(jnp.int8), centre))
    grid, bits = jnp.zeros((3, 3), jnp.int8), jnp.zeros(1, jnp.uint32)
    varied = with_symmetric_copy(1.0, stub).apply(bits, grid)
    np.testing.assert_array_equal(varied.grid, 8 * centre)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_block_is_emptied(shape):
    seen = different(many(make_move("clear"), network(shape), count=40_000))
    for varied, dirty in seen:
        assert not varied[block_of(dirty)].any()
    height, width = shape
    assert len(seen) == height * (height + 1) * width * (width + 1) // 4


@pytest.mark.parametrize("shape", SHAPES)
def test_a_block_is_mirrored_in_its_place(shape):
    grid = network(shape)
    for varied, dirty in different(many(make_move("mirror"), grid)):
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
    for varied, dirty in different(many(make_move("slide"), grid)):
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
    for varied, dirty in different(many(make_move("displaced" if displaced else "transplant"), grid, mate)):
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


@pytest.mark.slow
def test_a_mix_of_one_move_is_that_move():
    """Shares are numbers like any other: one program serves all mixes."""
    grid, mate = jnp.asarray(network((5, 5))), jnp.asarray(network((5, 5), 1))
    bits = random_bits(jax.random.key(1), (200, random_move(MoveWeights(), fill=True).bits))

    @jax.jit
    def varied(mix):
        return jax.vmap(random_move(mix, fill=True).apply, (0, None, None))(bits, grid, mate).grid

    for name, move in MOVES.items():
        alone = jax.jit(jax.vmap(move.apply, (0, None, None)))(bits, grid, mate).grid
        np.testing.assert_array_equal(varied(MoveWeights(**NONE | {name: 7})), alone)
        assert (np.asarray(alone) != np.asarray(grid)).any(), name


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize(
    "move",
    [
        make_move("corner"),
        refit_strip(),
        with_fill(0.5, make_move("link")),
        with_symmetric_copy(0.5, make_move("link")),
    ],
)
def test_a_move_takes_its_own_number_of_bits(move):
    grid = network((5, 5))
    for bits in (jnp.zeros(move.bits - 1, jnp.uint32), jnp.zeros(move.bits, jnp.int32)):
        with refused("bits", f"{bits.dtype} [{bits.size}]", expected=f"uint32 [{move.bits}]"):
            move.apply(bits, grid)


@pytest.mark.usefixtures("any_types")
def test_a_mate_has_the_shape_of_the_grid():
    move = make_move("transplant")
    with refused("mate", "int8 [4, 4]"):
        move.apply(jnp.zeros(move.bits, jnp.uint32), network((5, 5)), network((4, 4)))
