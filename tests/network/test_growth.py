"""Towns that grow: without a flaw on any size, as the oracle of NetworkX measures them."""

from functools import partial

import jax
import numpy as np
import pytest
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax.network.growth import _draw, grow_town
from elitelanes_jax.network.plain_metrics import plain_measure

NONE = ("dead_ends", "mismatches", "boundary_violations", "bridges")


def grown(shape, count):
    grow = jax.jit(jax.vmap(partial(grow_town, shape=shape)), compiler_options={"xla_backend_optimization_level": 0})
    return np.asarray(grow(jax.random.split(jax.random.key(0), count)))


@pytest.mark.parametrize(
    "shape", [(3, 3), (9, 14), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((3, 27), (24, 24)))]
)
def test_towns_have_no_flaw(shape, any_types):
    towns = grown(shape, 60)
    for town in towns:
        measured, rules = oracle(town), plain_measure(town)
        assert not any(measured[name] for name in NONE) and measured["components"] == 1
        assert rules["crowded_crossings"] == rules["unlinked_neighbours"] == 0
        assert town.any(axis=1).all() and town.any(axis=0).all()
    if max(shape) > 9:
        # Across three rows there are one to three streets, and no room for bends.
        assert len({town.tobytes() for town in towns}) > (40 if min(shape) == 3 else 50)
        assert max(plain_measure(town)["crossings"] for town in towns) >= 2
        assert max(plain_measure(town)["turns"] for town in towns) > (3 if min(shape) == 3 else 8)
        again = np.asarray(grow_town(jax.random.split(jax.random.key(0), 60)[3], shape))
        np.testing.assert_array_equal(again, towns[3])


def test_each_possible_cell_is_drawn_in_its_turn():
    rng = np.random.default_rng(0)
    for share in (0, 0.03, 0.5, 1):
        where = rng.random((200, 7, 7)) < share
        bits = rng.integers(2**32, size=200, dtype=np.uint32)
        found = jax.vmap(_draw)(bits, where)
        for mask, word, (some, row, column) in zip(where, bits, zip(*map(np.asarray, found), strict=True), strict=True):
            cells = np.argwhere(mask)
            assert some == (len(cells) > 0)
            assert not some or [row, column] == cells[int(word) * len(cells) >> 32].tolist()


def test_a_ring_needs_three_tiles():
    with refused("shape", "(2, 5)", expected="at least 3"):
        grow_town(jax.random.key(0), (2, 5))
