"""What counts as a grid, a shape, a setting. Needs NumPy alone: JAX is asked only about arrays that come from it."""

import sys
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np

from elitelanes_jax.errors import InputError

__all__ = ["LARGEST", "LONGEST_SIDE", "check_count", "check_grid", "check_once", "check_real", "check_shape", "is_real"]

LARGEST = 2**30
"""The largest number asked for: what two of them differ by fits 32 bits."""

LONGEST_SIDE = 1024
"""The longest side of a grid, in tiles: the sums of squares in its metrics then fit 32 bits."""


def check_shape(shape: Any) -> tuple[int, int]:
    """A grid's (height, width) as two ints.

    Raises:
      InputError: if it is anything but two whole numbers from 2 to `LONGEST_SIDE`.
    """
    try:
        height, width = (int(side) for side in shape if int(side) == side)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"shape: expected (height, width), two whole numbers, got {shape!r}") from None
    if min(height, width) < 2 or max(height, width) > LONGEST_SIDE:
        raise InputError(f"shape: expected sides from 2 to {LONGEST_SIDE}, got {height} x {width}")
    return height, width


def check_count(record: str, name: str, value: Any) -> None:
    """Raises InputError unless a setting of a record is a whole number, 1 or more."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
        raise InputError(f"{record}: expected {name} to be a whole number, 1 or more, got {value!r}")


def check_real(record: str, name: str, value: Any, least: float, most: float) -> Any:
    """A setting of a record as a float; if it is an array, of JAX or NumPy, as it is: it may be swept.

    Raises:
      InputError: if it is no number, or one out of its range.
    """
    jax = sys.modules.get("jax")
    if isinstance(value, np.ndarray) or (jax and isinstance(value, jax.Array)):
        return value
    if not isinstance(value, int | float | np.number) or not least <= value <= most:
        raise InputError(f"{record}: expected {name} to be a number, {least} to {most}, got {value!r}")
    return float(value)


def is_real(value: Any) -> bool:
    """Whether a value is a number of Python or NumPy, whole or with a fraction: no bool, no array."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def check_once(record: str, kind: str, names: Iterable[str]) -> None:
    """Checks that no name comes twice.

    Raises:
      InputError: if one does.
    """
    name, times = max(Counter(names).items(), key=lambda item: item[1], default=("", 0))
    if times > 1:
        raise InputError(f"{record}: expected each {kind} once, got {name} {times} times")


def check_grid(grid: Any) -> Any:
    """A grid as an int8 array: of JAX if it is one of JAX, else of NumPy.

    Codes are looked at only where they are known. Under `jax.jit` and `jax.vmap` they are not, and a code outside
    0..15 gives meaningless results there.

    Raises:
      InputError: if it is not two-dimensional, has a side under 2 or over `LONGEST_SIDE`, holds anything but
        integers, or a code outside 0..15.
    """
    jax = sys.modules.get("jax")
    try:
        array = grid if jax and isinstance(grid, jax.Array) else np.asarray(grid)
    except ValueError:
        raise InputError("grid: expected rows of one length, got rows of several") from None
    if array.ndim != 2:
        raise InputError(f"grid: expected two dimensions (rows, columns), got shape {array.shape}")
    check_shape(array.shape)
    if not np.issubdtype(array.dtype, np.integer):
        raise InputError(f"grid: expected integer tile codes, got {array.dtype}")
    if not (jax and isinstance(array, jax.core.Tracer)):
        codes = np.asarray(array)
        if codes.min() < 0 or codes.max() > 15:
            row, column = np.argwhere((codes < 0) | (codes > 15))[0]
            raise InputError(
                f"grid: expected tile codes 0 to 15, got {codes[row, column]} at row {row}, column {column}"
            )
    return array.astype(np.int8)
