"""Sparse networks: outlines of rectangles, one over another."""

import numpy as np


def sparse_towns(count, side, least=1):
    """Makes grids ``[count, side, side]`` without dead ends, of `least` to five rectangles each."""
    rng = np.random.default_rng(0)
    made = np.zeros((count, side, side), np.int8)
    for grid in made:
        for _ in range(rng.integers(least, 6)):
            rows, columns = np.sort(rng.choice(side, 2, replace=False)), np.sort(rng.choice(side, 2, replace=False))
            for row in rows:
                grid[row, columns[0] : columns[1]] |= 4
                grid[row, columns[0] + 1 : columns[1] + 1] |= 1
            for column in columns:
                grid[rows[0] : rows[1], column] |= 2
                grid[rows[0] + 1 : rows[1] + 1, column] |= 8
    return made
