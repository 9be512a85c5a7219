"""Checks of shapes and grids, for arrays of NumPy and JAX, without importing JAX."""

import sys
from collections.abc import Mapping, Set
from pathlib import PurePath
from typing import TypeGuard

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import describe_cell, describe_size
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import AnyArray, Untyped, UserValue

LONGEST_SIDE = 1024
"""The longest side of a grid, in tiles: the sums of squares in its metrics then fit 32 bits."""

NO_SHAPES = (Mapping, Set, bytes, bytearray)
"""Types that are no shape, even if they have two whole numbers.

The keys of a mapping are no sides, a set has no order, and the numbers of bytes are characters.
"""


@name_wrong_arguments
def check_shape(shape: UserValue, *, new: bool = False) -> tuple[int, int]:
    """Checks a grid's shape; returns (height, width) as two ints.

    Args:
      shape: the shape to check.
      new: whether it is the shape of maps to create. A map one tile wide has no loop, so their
        sides are at least 2.

    Raises:
      InputError: unless it is two whole numbers from 1, or from 2 for new maps, to `LONGEST_SIDE`.
    """
    try:
        sides: Untyped = shape
        height, width = sides
        are_whole = int(height) == height and int(width) == width
    except (TypeError, ValueError, OverflowError, np.ma.MaskError):
        are_whole = False
    if not are_whole or isinstance(shape, NO_SHAPES):
        got = quote(shape)
        raise InputError("shape", "(height, width), two whole numbers", got)
    height, width = int(height), int(width)
    least, purpose = (2, " for new maps") if new else (1, "")
    if min(height, width) < least or max(height, width) > LONGEST_SIDE:
        raise InputError(
            "shape",
            f"sides from {least} to {LONGEST_SIDE}{purpose}",
            describe_size((height, width)),
        )
    return height, width


def check_sides(rows: list[list[UserValue]]) -> None:
    """Checks that the number of rows, and the length of each, is at most `LONGEST_SIDE`."""
    width = max(map(len, rows), default=0)
    if max(len(rows), width) > LONGEST_SIDE:
        raise InputError("shape", f"sides up to {LONGEST_SIDE}", f"{len(rows)} x {width}")


def check_grid(grid: UserValue, subject: str = "grid") -> AnyArray:
    """Checks a grid and returns it as an int8 array ``[H, W]``.

    The result is an array of JAX if the grid is one, otherwise an array of NumPy. Errors call the
    grid by `subject`, the name of the caller's argument.

    Under `jax.jit` and `jax.vmap` codes are unknown and not checked. Kernels read the four lowest
    bits of a code, therefore 31 and -1 count as 15.

    Raises:
      InputError: if it is not two-dimensional, has a side under 1 or over `LONGEST_SIDE`, holds
        anything but integers, or a code outside 0..15.
    """
    jax = sys.modules.get("jax")
    if hasattr(grid, "codes"):
        name = type(grid).__name__
        raise InputError(subject, "rows of tile codes", f"a {name}", "give its codes")
    if isinstance(grid, str | PurePath):
        raise InputError(
            subject, "rows of tile codes", repr(str(grid)), "read_map reads the map of a file"
        )
    try:
        array = grid if jax and isinstance(grid, jax.Array) else _array_of(grid)
    except ValueError:
        raise InputError(subject, "rows of one length", "rows of several") from None
    # `np.asarray` drops the mask, and the cells under it may have any codes.
    if np.ma.is_masked(grid):
        raise InputError(
            subject,
            "a tile code in each cell",
            "a masked array",
            f"{subject}.filled(0) empties such cells",
        )
    if not array.ndim:
        raise InputError(subject, "rows of tile codes", quote(grid))
    if array.ndim != 2:
        hint = "give one grid, or batch a kernel with jax.vmap" if array.ndim == 3 else ""
        raise InputError(subject, "two dimensions (rows, columns)", f"shape {array.shape}", hint)
    check_shape(array.shape)
    if array.dtype.kind not in "iu":
        raise InputError(subject, "integer tile codes", array.dtype)
    if not is_traced(array):
        codes = np.asarray(array)
        if codes.min() < 0 or codes.max() > 15:
            row, column = np.argwhere((codes < 0) | (codes > 15))[0]
            raise InputError(
                subject,
                "tile codes 0 to 15",
                f"{codes[row, column]} at {describe_cell(row, column)}",
            )
    return array.astype(np.int8)


def _array_of(grid: UserValue) -> AnyArray:
    """Returns rows as an array of NumPy, or of JAX if `jax.jit` traces each number of them."""
    jax = sys.modules.get("jax")
    try:
        return np.asarray(grid)
    except TypeError:
        if jax is None or not isinstance(grid, list | tuple):
            raise
        return jax.numpy.stack([jax.numpy.stack(row) for row in grid])


def known_grid(grid: UserValue, subject: str = "grid") -> Int8[np.ndarray, "H W"]:
    """Checks a grid as `check_grid` does, and returns it as an array of NumPy.

    Raises `InputError` for traced codes too, which have no value.
    """
    if is_traced(grid):
        raise InputError(
            subject,
            "known tile codes",
            "traced ones",
            "call this function outside of jax.jit and jax.vmap",
        )
    return np.asarray(check_grid(grid, subject))


def is_traced(grid: UserValue) -> TypeGuard[AnyArray]:
    """Returns whether a grid is an array of unknown codes, within `jax.jit` or `jax.vmap`."""
    # If nobody has imported JAX, the grid is no array of JAX.
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(grid, jax.core.Tracer)
