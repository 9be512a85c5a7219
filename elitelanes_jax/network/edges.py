"""Checks of arrays at the edges of kernels, problems and optimisers.

They run while JAX traces, so a compiled call costs nothing more.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jax.tree_util import PyTreeDef
from jaxtyping import Array
from numpy.typing import DTypeLike

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray, Pytree


def check_array(
    name: str, array: AnyArray, shape: Sequence[int | str], *dtypes: DTypeLike
) -> Array:
    """Checks the shape and the dtype of an array; returns it as an array of JAX.

    Args:
      name: the name of the array in messages.
      array: the array of numbers to check.
      shape: the length of each axis, or a text that names an axis of any length.
      *dtypes: the dtypes that the array may have.

    Raises:
      InputError: for another shape or dtype.
    """
    # JAX makes 32 bits of 64, so the dtype in the message is read before.
    given_dtype = getattr(array, "dtype", None)
    array = jnp.asarray(array)
    is_shape = array.ndim == len(shape) and all(
        isinstance(expected, str) or expected == length
        for expected, length in zip(shape, array.shape, strict=True)
    )
    if not is_shape or array.dtype not in [jnp.dtype(dtype) for dtype in dtypes]:
        kinds = " or ".join(str(jnp.dtype(dtype)) for dtype in dtypes)
        expected = f"{kinds} [{', '.join(map(str, shape))}]"
        raise InputError(name, expected, f"{given_dtype or array.dtype} {list(array.shape)}")
    return array


def check_same_tree(name: str, before: Pytree, after: Pytree) -> None:
    """Checks that two pytrees have one structure, and leaves of the same shapes and dtypes.

    Raises:
      InputError: otherwise; the message names the leaves that differ.
    """
    structure: PyTreeDef = jax.tree.structure(before)
    is_same_structure = structure == jax.tree.structure(after)
    leaves = jax.tree.leaves(before), jax.tree.leaves(after)
    if is_same_structure and all(map(_have_one_kind, *leaves)):
        return
    # It finds the words for what differs, and takes a tenth of the time that JAX takes to load.
    import chex

    try:
        chex.assert_trees_all_equal_structs(before, after)
        chex.assert_trees_all_equal_comparator(_have_one_kind, _describe_kinds, before, after)
    except AssertionError as error:
        # The text before this names a function of chex, which tells the user nothing.
        words = str(error).partition(" failed: ")[2]
        raise InputError(name, "", shorten(words, 400)) from None


def _have_one_kind(before: AnyArray, after: AnyArray) -> bool:
    before, after = jnp.asarray(before), jnp.asarray(after)
    if before.shape != after.shape:
        return False
    # A Python number fits any dtype, because it takes the dtype of the array it meets.
    return before.weak_type or before.dtype == after.dtype


def _describe_kinds(before: AnyArray, after: AnyArray) -> str:
    before, after = jnp.asarray(before), jnp.asarray(after)
    return f"expected {before.dtype} {list(before.shape)}, got {after.dtype} {list(after.shape)}"
