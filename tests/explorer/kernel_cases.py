"""Cases for the explorer's kernel in TypeScript: grids, and what Python makes of them.

`python tests/explorer/kernel_cases.py` writes explorer/tests/cases.json, which Vitest reads.
"""

import json
from pathlib import Path

import numpy as np

from elitelanes_jax import InputError, Weights, fitness, repair
from elitelanes_jax.formats import to_duckietown
from elitelanes_jax.network import COUNT_NAMES, Metrics, plain_measure
from elitelanes_jax.problem import SHARE_UNIT, SHARES, measure_missing, niche_bins, tuned_axes

__all__ = ["CASES", "kernel_cases"]

CASES = Path(__file__).parents[2] / "explorer" / "tests" / "cases.json"

ALPHABET = (0, 3, 5, 6, 7, 9, 10, 11, 12)
WEIGHTS = Weights(turns=7, off_alphabet=-13, components=31, constant=5)
SHAPES = [(1, 1), (1, 6), (6, 1), (2, 2), (2, 5), (3, 7), (6, 6), (9, 8), (12, 12)]


def kernel_cases():
    """The text of the file: a case a line."""
    random = np.random.default_rng(0)
    cases = [_case(random.choice([0, *range(16)], shape), random) for shape in SHAPES for _ in range(4)]
    lines = ",\n".join(json.dumps(case) for case in cases)
    return f'{{\n"alphabet": {list(ALPHABET)},\n"weights": {json.dumps(WEIGHTS._asdict())},\n"cases": [\n{lines}\n]\n}}\n'


def _case(grid, random):
    grid = grid.astype(np.int8)
    dirty, fixed = random.random((2, *grid.shape)) < np.array([0.3, 0.1])[:, None, None]
    measured = plain_measure(grid, ALPHABET)
    shares = {
        name: SHARE_UNIT * measured[part] // max(1, sum(measured[other] for other in of))
        for name, (part, of) in SHARES.items()
    }
    axes = tuned_axes(grid.shape)
    return {
        "rows": grid.tolist(),
        "dirty": dirty.ravel().astype(int).tolist(),
        "fixed": fixed.ravel().astype(int).tolist(),
        "metrics": [measured[name] for name in COUNT_NAMES],
        "shares": shares,
        "fitness": int(fitness(Metrics(**measured), WEIGHTS)),
        "repaired": [np.asarray(repair(grid, dirty, fixed=fixed, fill=fill)).tolist() for fill in (False, True)],
        "town": {},
        "axes": [axis._asdict() for axis in axes],
        "bins": [],
        "duckietown": _duckietown(grid),
    }


def _duckietown(grid):
    try:
        return to_duckietown(grid)
    except InputError:
        return None


if __name__ == "__main__":
    CASES.write_text(kernel_cases(), encoding="utf-8")
