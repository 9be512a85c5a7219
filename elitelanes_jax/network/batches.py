"""Batches of any size: on a processor, kernels work in blocks that fit its caches."""

import math
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax import lax

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, function, none_or, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree

R = TypeVar("R")

# The most numbers in the arguments of a block: 455 grids of 12 x 12, or one of 256 x 256. What our
# kernels compute from these numbers fits caches of 1 to 2 MB.
_NUMBERS = 2**16


@name_wrong_arguments
def vmap_in_blocks(kernel: Callable[..., R], *, block: int | None = None) -> Callable[..., R]:
    """Returns the batched form of a kernel, as `jax.vmap` does, for batches of any size.

    On a processor it computes one block after another, because the intermediate arrays of a whole
    batch do not fit its caches. The fitness of 262,144 grids of 12 x 12 tiles takes half of the
    time. On other devices the whole batch is computed at once. The results are those of `jax.vmap`,
    bit for bit, if the kernel's results do not depend on the size of a batch. Those of our kernels
    do not. A batch that is sharded over devices is divided by `jax.shard_map` first. A program that
    `jax.export` makes for any length computes the whole batch at once too.

    Args:
      kernel: a function of pytrees of arrays, such as `measure`, `repair`, or one of your own that
        calls them.
      block: the most elements in a block, 1 or more. By default as many as have 65,536 numbers in
        all, such as 455 grids of 12 x 12 tiles. That suits caches of 1 to 2 MB.

    Returns:
      A function of pytrees of arrays. The arrays and the results have a leading axis of equal
      length; the function raises `InputError` for other arguments.

    Raises:
      InputError: if the kernel is not a function, or the block is not a whole number of 1 or more.
    """
    check_named("kernel", function, kernel)
    block = check_named("block", none_or(whole(1)), block)

    def in_blocks(*args: Pytree) -> R:
        # `jax.export` may leave the length open, but `lax.map` divides it into blocks.
        if not isinstance(jax.tree.leaves(args)[0].shape[0], int):
            return jax.vmap(kernel)(*args)
        # `lax.map` loops over blocks, and applies `jax.vmap` within each block.
        most = block or max(_NUMBERS // _numbers_of_an_element(args), 1)
        result: R = lax.map(lambda elements: kernel(*elements), args, batch_size=most)
        return result

    @runs_jax
    @wraps(kernel)
    def batched(*args: Pytree) -> R:
        _check_lengths(args)
        result: R = lax.platform_dependent(*args, cpu=in_blocks, default=jax.vmap(kernel))
        return result

    return batched


def _check_lengths(args: Pytree) -> None:
    """Checks that all arrays have a first axis, of one length."""
    shapes = [list(jnp.shape(leaf)) for leaf in jax.tree.leaves(args)]
    lengths = {tuple(shape[:1]) for shape in shapes}
    if len(lengths) != 1 or () in lengths:
        got = f"shapes {', '.join(map(str, shapes))}" if shapes else "none"
        raise InputError("arguments", "arrays with a first axis of one length", got)


def _numbers_of_an_element(args: Pytree) -> int:
    shapes = [jnp.shape(leaf)[1:] for leaf in jax.tree.leaves(args)]
    return max(sum(map(math.prod, shapes)), 1)
