"""Turning and mirroring a grid: places and codes together, so that roads stay roads.

NumPy arrays give NumPy arrays, those of JAX give those of JAX.
"""

from typing import Any

import numpy as np

from elitelanes_jax.checks import check_grid
from elitelanes_jax.codes import EAST, NORTH, SOUTH, WEST, turned

__all__ = ["canonical", "mirror", "rotate"]


def rotate(grid: Any, quarter_turns: int = 1) -> Any:
    """The grid turned counter-clockwise by quarter turns, as `numpy.rot90` turns.

    Args:
      grid: integer codes ``[H, W]``.
      quarter_turns: any whole number; negative ones turn clockwise.

    Returns:
      int8 ``[H, W]`` after an even number of turns, ``[W, H]`` after an odd one.
    """
    grid = check_grid(grid)
    for _ in range(quarter_turns % 4):
        grid = turned(grid).T[::-1]
    return grid


def mirror(grid: Any) -> Any:
    """The grid mirrored east to west, as `numpy.fliplr` mirrors.

    Args:
      grid: integer codes ``[H, W]``.

    Returns:
      int8 ``[H, W]``.
    """
    grid = check_grid(grid)
    kept, east, west = grid & (NORTH | SOUTH), grid & EAST, grid & WEST
    return (kept | east // (EAST // WEST) | west * (EAST // WEST))[:, ::-1]


def canonical(grid: Any) -> bytes:
    """The same bytes for a grid and all its rotations and mirror images, other bytes for any other grid."""
    grid = np.asarray(grid, np.int8)
    images = [rotate(side, turns) for side in (grid, mirror(grid)) for turns in range(4)]
    return min(bytes([image.shape[0] >> 8, image.shape[0] & 255]) + image.tobytes() for image in images)
