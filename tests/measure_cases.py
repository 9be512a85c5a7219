"""Small grids with their metrics, measured by the oracle: JAX, NumPy and the explorer's TypeScript read the same file.

`python tests/measure_cases.py` writes the file. A line is a case: the codes of a grid as hexadecimal digits, its
rows apart by slashes, and its metrics in the order of `names`. `off_alphabet` counts the codes outside `alphabet`.
"""

import json
from pathlib import Path

import numpy as np
from oracle import OPPOSITE, STEPS, fill, measure, raster_rank, repair

__all__ = ["CASES", "grid_of", "measure_cases"]

CASES = Path(__file__).with_name("measure_cases.json")
ALPHABET = (0, 3, 5, 6, 7, 9, 10, 11, 12)
SHAPES = [(1, 7), (7, 1), (2, 3), (5, 4), (8, 9), (12, 12)]  # few, because each is compiled


def measure_cases():
    """Returns the text of the file."""
    random = np.random.default_rng(54)
    # The labels of faces travel farthest between the turns of a spiral.
    grids = [np.full((1, 1), code) for code in (0, 5, 15)] + [_spiral(8, 9), _spiral(12, 12)]
    for shape in SHAPES:
        grids += [grid for _ in range(7) for grid in _kinds_of_grids(random, shape)]
    names = list(measure(grids[0]))
    cases = [[_text_of(grid), [_plain(value) for value in measure(grid, ALPHABET).values()]] for grid in grids]
    lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
    heads = [f'"alphabet": {json.dumps(ALPHABET)}', f'"names": {json.dumps(names)}']
    return "{\n" + ",\n".join([*heads, f'"cases": [\n{lines}\n]']) + "\n}\n"


def grid_of(text):
    """Returns the grid of a case, int8 ``[H, W]``."""
    return np.array([[int(digit, 16) for digit in row] for row in text.split("/")], np.int8)


def _text_of(grid):
    return "/".join("".join(f"{code:x}" for code in row) for row in grid.tolist())


def _plain(value):
    return float(value) if isinstance(value, np.floating) else int(value)


def _spiral(height, width):
    """A road from the north-west corner to the middle, two rows apart from itself."""
    grid = np.zeros((height, width), int)
    cell, side = (0, 0), 4
    right_of = {8: 4, 4: 2, 2: 1, 1: 8}

    def is_free(row, column):
        return 0 <= row < height and 0 <= column < width and not grid[row, column]

    for _ in range(height * width):
        row, column = cell
        down, right = STEPS[side]
        ahead, beyond = (row + down, column + right), (row + 2 * down, column + 2 * right)
        is_road_beyond = 0 <= beyond[0] < height and 0 <= beyond[1] < width and grid[beyond]
        if not is_free(*ahead) or is_road_beyond:
            side = right_of[side]
            continue
        grid[cell] |= side
        grid[ahead] |= OPPOSITE[side]
        cell = ahead
    return grid


def _kinds_of_grids(random, shape):
    """Any codes, long straights, sparse, repaired, and repaired and filled."""
    anything = random.integers(0, 16, shape)
    yield anything
    yield np.where(random.random(shape) < 0.8, random.choice([5, 10]), anything)
    yield np.where(random.random(shape) < random.random(), anything, 0)
    repaired = repair(anything, raster_rank(shape))
    yield repaired
    if min(shape) > 1:
        yield fill(repaired, np.zeros(shape, bool))


if __name__ == "__main__":
    CASES.write_text(measure_cases(), encoding="utf-8")
