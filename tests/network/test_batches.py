"""Batches in blocks have the results of `jax.vmap`, bit for bit."""

import chex
import jax
import jax.numpy as jnp
import pytest
from jax import export
from refusals import refused

from elitelanes_jax import measure, random_grids
from elitelanes_jax.network import vmap_in_blocks

GRIDS = random_grids(jax.random.key(4), 23, (3, 4))


@pytest.mark.parametrize("block", [1, 7, 23, 24])
def test_blocks_of_any_size_give_the_same_bits(block):
    expected = jax.jit(jax.vmap(measure))(GRIDS)
    chex.assert_trees_all_equal(jax.jit(vmap_in_blocks(measure, block=block))(GRIDS), expected)


def test_pytrees_and_further_axes_are_batched():
    def kernel(pair, weight):
        return {"sum": pair[0] + pair[1] * weight, "weight": weight}

    first, second = jnp.arange(30).reshape(2, 5, 3), jnp.arange(30).reshape(2, 5, 3) * 7
    weights = jnp.arange(10).reshape(2, 5)
    got = jax.vmap(vmap_in_blocks(kernel, block=2))((first, second), weights)
    chex.assert_trees_all_equal(got, {"sum": first + second * weights[..., None], "weight": weights})


def test_a_program_for_any_length_has_the_same_bits():
    (count,) = export.symbolic_shape("count")
    kernel = jax.jit(vmap_in_blocks(measure))
    exported = export.export(kernel)(jax.ShapeDtypeStruct((count, 3, 4), jnp.int8))
    chex.assert_trees_all_equal(exported.call(GRIDS), kernel(GRIDS))


def test_only_a_processor_works_in_blocks():
    """The program of a GPU is that of `jax.vmap`: without a loop over blocks."""
    kernel = vmap_in_blocks(lambda grid: grid.sum(dtype=jnp.int32), block=7)
    for platform, loops in (("cpu", 1), ("cuda", 0)):
        text = jax.jit(kernel).trace(GRIDS).lower(lowering_platforms=(platform,)).as_text()
        assert text.count("stablehlo.while") == loops


@pytest.mark.parametrize(("shape", "loops"), [((400, 12, 12), 0), ((500, 12, 12), 1), ((2, 256, 256), 1)])
def test_a_block_has_65536_numbers_by_default(shape, loops):
    grids = jax.ShapeDtypeStruct(shape, jnp.int8)
    kernel = vmap_in_blocks(lambda grid: grid.sum(dtype=jnp.int32))
    text = jax.jit(kernel).trace(grids).lower(lowering_platforms=("cpu",)).as_text()
    assert text.count("stablehlo.while") == loops


@pytest.mark.usefixtures("any_types")
@pytest.mark.parametrize("block", [0, 2.5, "many"])
def test_a_wrong_block_is_named(block):
    with refused("block", repr(block)):
        vmap_in_blocks(measure, block=block)
