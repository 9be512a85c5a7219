"""Grids of tile codes: what counts as one, and random ones.

A grid is an int8 array ``[H, W]`` of codes 0..15, row 0 in the north, H and W at least 2.
"""

from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from chex import Array, PRNGKey

from elitelanes_jax.codes import ROAD_ALPHABET, alphabet_of
from elitelanes_jax.draws import below, random_words

__all__ = ["check_grid", "check_shape", "random_grids"]

# Sums of squares over a grid must fit int32: 2 * side * area < 2**31.
_MOST_CELLS = 2**20
_LONGEST_SIDE = 1024


def check_shape(shape: Any) -> tuple[int, int]:
    """A grid's (height, width) as two ints.

    Raises:
      ValueError: if it is anything but two whole numbers from 2 to 1024.
    """
    try:
        height, width = (int(side) for side in shape if int(side) == side)
    except (TypeError, ValueError):
        raise ValueError(f"shape: expected (height, width), two whole numbers, got {shape!r}") from None
    if min(height, width) < 2 or max(height, width) > _LONGEST_SIDE:
        raise ValueError(f"shape: expected sides from 2 to {_LONGEST_SIDE}, got {height} x {width}")
    return height, width


def check_grid(grid: Any) -> Array:
    """A grid as an int8 array.

    Codes are looked at only where they are known: under `jax.jit` and `jax.vmap` they are not.

    Raises:
      ValueError: if it is not two-dimensional, has a side under 2 or over 1024, holds anything but integers,
        or a code outside 0..15.
    """
    array = grid if isinstance(grid, jax.Array) else np.asarray(grid)
    if array.ndim != 2:
        raise ValueError(f"grid: expected two dimensions (rows, columns), got shape {array.shape}")
    check_shape(array.shape)
    if not jnp.issubdtype(array.dtype, jnp.integer):
        raise ValueError(f"grid: expected integer tile codes, got {array.dtype}")
    if not isinstance(array, jax.core.Tracer):
        codes = np.asarray(array)
        if codes.min() < 0 or codes.max() > 15:
            row, column = np.argwhere((codes < 0) | (codes > 15))[0]
            raise ValueError(
                f"grid: expected tile codes 0 to 15, got {codes[row, column]} at row {row}, column {column}"
            )
    return array.astype(np.int8)


def random_grids(
    key: PRNGKey, count: int, shape: tuple[int, int] = (12, 12), *, alphabet: Iterable[int] = ROAD_ALPHABET
) -> Array:
    """Grids with every tile drawn uniformly from an alphabet, neighbours unasked: `repair` makes them fit.

    Args:
      key: consumed. Grid i depends on the key and i alone, not on `count`.
      count: how many, at least 0.
      shape: (height, width), each at least 2.
      alphabet: the tile codes to draw from.

    Returns:
      int8 ``[count, height, width]``.
    """
    height, width = check_shape(shape)
    codes = jnp.asarray(alphabet_of(alphabet), jnp.int8)
    words = random_words(key, (count, height, width))
    return codes[below(words, codes.size)]
