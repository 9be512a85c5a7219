"""Metrics against the oracle: all small grids, many random ones, and the shapes that are hard on labelling."""

from functools import partial
from math import prod

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export
from oracle import fitness as oracle_fitness
from oracle import measure as oracle
from refusals import refused

from elitelanes_jax import Metrics, fitness, measure, mirror, repair, rotate
from elitelanes_jax.network import measure_town, plain_measure
from elitelanes_jax.network._faces import _label, label_faces
from elitelanes_jax.network.metrics import stack_metrics, unstack_metrics
from elitelanes_jax.network.plain_metrics import count_tiles
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.network.xla import PaddedLayout
from experiments.search.corridors import serpentine, spiral


def slow(*shapes):
    return [pytest.param(shape, marks=pytest.mark.slow) for shape in shapes]


SHAPES = [(2, 2), (2, 9), (5, 7), (16, 17), (20, 65)]
SHAPES += slow((12, 12), (9, 2), (16, 16), (2, 3), (3, 2), (33, 17), (1, 9), (1, 65), (1, 1024), (65, 1))

measure_many = jax.jit(jax.vmap(measure))
repair_many = jax.jit(jax.vmap(repair))
repair_raster_many = jax.jit(jax.vmap(lambda grid: repair(grid, raster=True)))
mirror_many, rotate_many = jax.vmap(mirror), jax.vmap(rotate, in_axes=(0, None))
fill_many = jax.jit(jax.vmap(lambda grid: repair(grid, fill=True)))


def compare(grids):
    found = jax.device_get(measure_many(jnp.asarray(grids)))
    fitnesses = jax.device_get(jax.jit(fitness)(found))
    for name, counts in count_tiles(np.asarray(grids)).items():
        assert np.array_equal(counts, getattr(found, name)), name
    for index, grid in enumerate(grids):
        expected = oracle(grid)
        got = {name: getattr(found, name)[index] for name in Metrics._fields}
        assert got == expected, f"\n{grid}"
        assert plain_measure(grid) == expected, f"\n{grid}"
        assert fitnesses[index] == oracle_fitness(expected)


def kinds_of_grids(rng, count, shape):
    """Unrepaired, with long straights, sparse, repaired in several ways."""
    anything = rng.integers(0, 16, (count, *shape)).astype(np.int8)
    yield anything
    yield np.where(rng.random(anything.shape) < 0.9, 5, anything).astype(np.int8)
    yield np.where(rng.random(anything.shape) < rng.random((count, 1, 1)), anything, 0).astype(np.int8)
    yield np.array(repair_many(anything))
    yield np.array(repair_raster_many(anything))
    sparse = np.where(rng.random(anything.shape) < 0.6, anything, 0).astype(np.int8)
    yield np.array(repair_raster_many(sparse))
    if min(shape) > 1:
        yield np.array(fill_many(sparse))


@pytest.mark.parametrize(
    ("shape", "share"),
    [((2, 2), 32), ((1, 1), 1), ((1, 3), 4)]
    + [pytest.param(shape, 1, marks=pytest.mark.slow) for shape in ((2, 2), (1, 2), (1, 3), (1, 4))],
    ids=str,
)
def test_every_small_grid(shape, share):
    """Compares one grid of each class under rotation and mirroring with the oracle, and all others with that one.

    The oracle is slow. With a `share` of n, it measures the grids of each n-th class.
    """
    numbers, values = np.arange(16 ** prod(shape)), 16 ** np.arange(prod(shape))[::-1]
    grids = (numbers[:, None] // values % 16).reshape(-1, *shape).astype(np.int8)
    sides = grids, mirror_many(grids)
    images = [np.asarray(rotate_many(side, turns)) for side in sides for turns in range(4)]
    first = np.min([image.reshape(len(grids), -1) @ values for image in images if image.shape == grids.shape], axis=0)
    compare(grids[first == numbers][::share])
    found, turned = measure_many(grids), measure_many(rotate_many(grids, 1))
    for name in Metrics._fields:
        for other in (found, turned):
            np.testing.assert_array_equal(getattr(other, name), getattr(found, name)[first], err_msg=name)


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_random_grids(shape):
    rng = np.random.default_rng(shape)
    for grids in kinds_of_grids(rng, max(2, 700 // prod(shape)), shape):
        compare(grids)


@pytest.mark.slow
def test_a_hundred_thousand_random_grids():
    rng = np.random.default_rng(2026)
    shares = {(2, 2): 500, (2, 9): 2500, (9, 2): 2500, (5, 7): 4000, (7, 8): 3500, (12, 12): 3500, (33, 17): 300}
    compared = 0
    for shape, count in shares.items():
        for grids in kinds_of_grids(rng, count, shape):
            compare(grids)
            compared += len(grids)
    assert compared >= 100_000


@pytest.mark.parametrize("shape", [(12, 12), (17, 17), *slow((64, 64), (16, 16), (40, 90))], ids=str)
def test_long_corridors(shape):
    """One slow grid among quick ones, every way round: labels have to travel its whole length, also upwards.

    One grid has crossings alone, so that the largest score of a tile meets the bits of its sum.
    """
    rng = np.random.default_rng(5)
    slow = [serpentine(shape), spiral(shape)]
    mirrored = [np.where(grid & 4, 1, 0) | np.where(grid & 1, 4, 0) | grid & 10 for grid in slow]
    slow += [grid[:, ::-1].astype(np.int8) for grid in mirrored]
    quick = np.array(repair_many(rng.integers(0, 16, (3, *shape)).astype(np.int8)))
    crossings = np.full((1, *shape), 15, np.int8)
    compare(np.concatenate([np.stack(slow), quick, crossings]))


# A label is one byte up to 254 inner corners, two up to 65,534 corners, then four.
@pytest.mark.parametrize("shape", [(2, 255), (2, 256), (254, 256), *slow((253, 255), (254, 255))], ids=str)
def test_where_labels_get_wider(shape):
    """A long corridor above, faces of all kinds below."""
    grid, below = serpentine(shape), shape[0] // 2 + 1
    grid[below:] = np.random.default_rng(shape).integers(0, 16, grid[below:].shape)
    compare(grid[None])


@pytest.mark.parametrize("shape", [(17, 17), *slow((5, 7), (2, 2), (12, 12), (20, 65), (64, 64), (2, 254))], ids=str)
def test_the_way_of_gpus_finds_the_same_labels(shape):
    layout = PaddedLayout(*shape)
    pad = jax.jit(jax.vmap(layout.pad))
    beside, end_to_end = (jax.jit(partial(_label, layout=layout, beside=beside)) for beside in (True, False))
    grids = [*kinds_of_grids(np.random.default_rng(prod(shape)), 40, shape)]
    if min(shape) >= 5:
        grids.append(np.stack([spiral(shape), serpentine(shape)]))
    for some in grids:
        padded = pad(some)
        labels = beside(padded)
        np.testing.assert_array_equal(labels, end_to_end(padded), strict=True)
        np.testing.assert_array_equal(beside(padded[:1]), labels[:1], strict=True)
    across = jax.vmap(partial(label_faces, layout), in_axes=1, out_axes=1)(padded.T)
    np.testing.assert_array_equal(across, labels.T, strict=True)
    assert beside(padded[:0]).shape == end_to_end(padded[:0]).shape == (0, padded.shape[1])
    traced = jax.jit(jax.vmap(partial(label_faces, layout))).trace(padded)
    forms = [traced.lower(lowering_platforms=(platform,)).as_text() for platform in ("cuda", "cpu")]
    assert ["stablehlo.transpose" in form for form in forms] == [True, False]


def test_a_ring_by_hand():
    ring = np.array([[6, 5, 3], [10, 0, 10], [12, 5, 9]])
    metrics = measure(ring)
    assert metrics.components == metrics.cyclomatic == 1
    assert metrics.tiles == metrics.edges == 8
    assert metrics.bridges == metrics.dead_ends == metrics.crossings == metrics.adjacent_turns == 0
    assert metrics.straight_score == 4
    assert metrics.coverage == np.float32(8 / 9)
    assert fitness(metrics) == -2 - 8


def test_rows_of_traced_numbers_are_a_grid():
    assert jax.jit(measure)([[6, 3], [12, 9]]).turns == 4
    with refused("grid", "rows of several"):
        jax.jit(measure)([[6, 3], [12]])


@pytest.mark.parametrize("shape", [(5, 7), *slow((20, 20))], ids=str)
def test_alone_in_a_batch_under_jit_and_nested_vmap(shape):
    grids = np.random.default_rng(8).integers(0, 16, (2, 3, *shape)).astype(np.int8)
    nested = jax.vmap(jax.vmap(measure))(grids)
    compiled = jax.jit(jax.vmap(jax.vmap(measure)))(grids)
    last = jax.jit(jax.vmap(measure, in_axes=-1))(np.moveaxis(grids[0], 0, -1))
    for outer, inner in np.ndindex(2, 3):
        alone = measure(grids[outer, inner])
        for name in Metrics._fields:
            value = getattr(alone, name)
            assert value == getattr(nested, name)[outer, inner] == getattr(compiled, name)[outer, inner]
            assert outer or value == getattr(last, name)[inner]


@pytest.mark.parametrize("shape", [(6, 7), *slow((18, 18))], ids=str)  # labels of 8 and of 16 bits
def test_kernels_for_a_batch_of_any_size(shape):
    (size,) = export.symbolic_shape("size")
    kernels = jax.jit(jax.vmap(lambda grid: (measure(grid), measure_town(grid))))
    exported = export.export(kernels)(jax.ShapeDtypeStruct((size, *shape), jnp.int8))
    grids = np.random.default_rng(0).integers(0, 16, (5, *shape), np.int8)
    jax.tree.map(np.testing.assert_array_equal, exported.call(grids), kernels(grids))


@pytest.mark.parametrize("length", [64, 65])
def test_the_longest_straights_of_small_and_of_wide_counters(length):
    assert measure(np.full((1, length), 5)).straight_score == length**2


def test_types_and_shapes():
    types = {name: array.dtype for name, array in measure(np.zeros((3, 3), np.int32))._asdict().items()}
    assert types.pop("coverage") == jnp.float32
    assert set(types.values()) == {jnp.dtype("int32")}


def test_metrics_side_by_side_and_back():
    grids = np.random.default_rng(2).integers(0, 16, (2, 3, 7, 9)).astype(np.int8)
    metrics = jax.vmap(jax.vmap(measure))(grids)
    counts = stack_metrics(metrics)
    assert counts.shape == (2, 3, len(METRIC_NAMES))
    assert counts.dtype == jnp.int32
    for back in (unstack_metrics(counts, 63), jax.jit(unstack_metrics, static_argnums=1)(counts, 63)):
        for name in Metrics._fields:
            np.testing.assert_array_equal(getattr(back, name), getattr(metrics, name), err_msg=name)


def test_codes_outside_the_alphabet_are_counted():
    grids = np.random.default_rng(3).integers(0, 16, (20, 4, 5)).astype(np.int8)
    for alphabet in ([3, 5, 10], range(16), [0], [15, 15, 7]):
        counted = jax.vmap(lambda grid, alphabet=alphabet: measure(grid, alphabet).off_alphabet)(grids)
        np.testing.assert_array_equal(counted, [oracle(grid, alphabet)["off_alphabet"] for grid in grids])


@pytest.mark.parametrize(
    ("grid", "subject", "got", "expected"),
    [
        ([[0, 16], [0, 0]], "grid", "16 at B1 ([0, 1])", ""),
        ([[0, 0], [-1, 0]], "grid", "-1 at A2 ([1, 0])", ""),
        ([[0.0, 1.0], [2.0, 3.0]], "grid", "float64", ""),
        ([[True, False], [True, False]], "grid", "bool", ""),
        (np.zeros((2, 2), "m8[s]"), "grid", "timedelta64[s]", ""),
        (np.ma.masked_equal([[6, 3], [12, 9]], 3), "grid", "a masked array", ""),
        ([[], []], "shape", "2 x 0", "sides"),
        ([1, 2, 3], "grid", "shape (3,)", ""),
        (
            np.zeros((2, 3, 3), np.int8),
            "grid",
            "shape (2, 3, 3)",
            "",
        ),
        ("road", "grid", "'road'", ""),
    ],
)
def test_what_is_no_grid_is_refused(grid, subject, got, expected):
    for kernel in (measure, repair):
        with refused(subject, got, expected):
            kernel(grid)
    with refused("alphabet", "16"):
        measure([[0, 0], [0, 0]], alphabet=[3, 16])
    with refused("alphabet", "none"):
        measure([[0, 0], [0, 0]], alphabet=[])
