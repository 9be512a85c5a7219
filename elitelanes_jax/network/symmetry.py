"""Rotates and mirrors grids: cells and codes together, so that links are preserved.

A NumPy array gives a NumPy array, an array of JAX an array of JAX.
"""

import numpy as np

from elitelanes_jax._util.checks import LARGEST, check_named, whole
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST, WEST, exchange_sides, rotate_codes


def rotate(grid: AnyArray, quarter_turns: int = 1) -> AnyArray:
    """Rotates a grid of codes ``[H, W]`` counter-clockwise by quarter turns, as `numpy.rot90` does.

    Any whole number of turns is valid; negative ones rotate clockwise. Returns int8 ``[H, W]`` or ``[W, H]``. Raises
    `InputError` for a bad grid (see `check_grid`).
    """
    grid = check_grid(grid)
    for _ in range(check_named("quarter_turns", whole(-LARGEST, LARGEST), quarter_turns) % 4):
        grid = _turned(grid)
    return grid


def mirror(grid: AnyArray) -> AnyArray:
    """Mirrors a grid of codes ``[H, W]`` east to west, as `numpy.fliplr` does; returns int8 ``[H, W]``.

    Raises `InputError` for a bad grid (see `check_grid`).
    """
    return exchange_sides(check_grid(grid), EAST, WEST)[:, ::-1]


def canonical_form(grid: AnyArray) -> bytes:
    """Returns bytes that are equal for a grid and its rotations and mirror images, and differ for other grids.

    Raises `InputError` for a bad grid (see `check_grid`).
    """
    images = images_of(np.asarray(check_grid(grid), np.int8))
    return min(bytes([image.shape[0] >> 8, image.shape[0] & 255]) + image.tobytes() for image in images)


def images_of(grid: AnyArray) -> list[AnyArray]:
    """Returns the eight rotations and mirror images of a checked grid, the grid itself first."""
    images = []
    for image in (grid, mirror(grid)):
        for _ in range(4):
            images.append(image)
            image = _turned(image)
    return images


def _turned(grid: AnyArray) -> AnyArray:
    return rotate_codes(grid).T[::-1]
