"""Worst cases for labelling: grids with one corridor of corner points that winds through the whole grid."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

__all__ = ["serpentine", "spiral"]

NORTH, EAST, SOUTH, WEST = 8, 4, 2, 1  # the bits of a tile's code

Corner = tuple[int, int]


def serpentine(shape: tuple[int, int]) -> NDArray[np.int8]:
    """Makes a single corridor of corners that runs to and fro through the whole grid."""
    height, width = shape[0] - 1, shape[1] - 1
    path: list[Corner] = []
    for row in range(0, height, 2):
        columns = range(width) if row % 4 == 0 else range(width - 1, -1, -1)
        path += [(row, column) for column in columns]
        if row + 2 < height:
            path.append((row + 1, path[-1][1]))
    return _corridor(path, shape)


def spiral(shape: tuple[int, int]) -> NDArray[np.int8]:
    """Makes a single corridor of corners that winds inwards."""
    height, width = shape[0] - 1, shape[1] - 1
    steps, heading = [(0, 1), (1, 0), (0, -1), (-1, 0)], 0
    path, seen = [(0, 0)], {(0, 0)}
    turned = 0
    while turned < 2:
        (down, right), (row, column) = steps[heading % 4], path[-1]
        ahead, beyond = (row + down, column + right), (row + 2 * down, column + 2 * right)
        inside = 0 <= ahead[0] < height and 0 <= ahead[1] < width
        if inside and ahead not in seen and beyond not in seen:
            path.append(ahead)
            seen.add(ahead)
            turned = 0
        else:
            heading += 1
            turned += 1
    return _corridor(path, shape)


def _corridor(path: Sequence[Corner], shape: tuple[int, int]) -> NDArray[np.int8]:
    """Makes a grid with all links except those that separate successive corners of a path."""
    grid = np.zeros(shape, np.int8)
    grid[:, :-1] |= EAST
    grid[:, 1:] |= WEST
    grid[:-1] |= SOUTH
    grid[1:] |= NORTH
    for (row, column), (next_row, next_column) in pairwise(path):
        if row == next_row:  # a step to the east or west crosses the link south of the tile between both corners
            between = max(column, next_column)
            grid[row, between] &= ~SOUTH
            grid[row + 1, between] &= ~NORTH
        else:
            between = max(row, next_row)
            grid[between, column] &= ~EAST
            grid[between, column + 1] &= ~WEST
    return grid
