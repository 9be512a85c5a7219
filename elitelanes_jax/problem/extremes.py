"""The range of each feature on maps of 12 x 12 tiles, and maps that show its ends."""

from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.plain_metrics import plain_measure
from elitelanes_jax.problem.features import FEATURES, SHARES
from elitelanes_jax.problem.flaws import find_flaws
from elitelanes_jax.problem.limits import Limits, find_limits

EXTREMES = Path(__file__).with_name("extremes.txt")
"""The maps, one a line, as ``docs/metrics.py`` found them: rows of codes, a hexadecimal digit a tile."""


def features_of(grid: NDArray[np.int8]) -> dict[str, float]:
    """Returns all features of one grid ``[H, W]`` by name, in the order of `FEATURES`, shares as parts of 1."""
    metrics = plain_measure(grid)
    shares = {name: metrics[part] / max(1, sum(metrics[other] for other in of)) for name, (part, of) in SHARES.items()}
    return {name: (metrics | shares)[name] for name in FEATURES}


@cache
def _measured() -> list[tuple[NDArray[np.int8], dict[str, float]]]:
    grids = [
        np.array([[int(code, 16) for code in row] for row in line.split()], np.int8)
        for line in EXTREMES.read_text(encoding="ascii").splitlines()
    ]
    return [(grid, features_of(grid)) for grid in grids]


def feature_range(name: str) -> tuple[float, float]:
    """Returns the lowest and the highest value of a feature that searches for it found at 12 x 12.

    The maps are as `generate` writes them by default: in one piece, without dead ends and empty cells.

    Args:
      name: of the feature.
    """
    values = [features[name] for _, features in _measured()]
    return min(values), max(values)


@cache
def _limits() -> Limits:
    return find_limits((12, 12), certain={name: value for name, value, _ in find_flaws(None, filled=True)})


def feature_limits(name: str) -> tuple[Fraction, Fraction]:
    """Returns values that no such map is below, or above: where they are those of `feature_range`, these are proven.

    Args:
      name: of the feature.
    """
    return _limits().of(name)


def extreme_maps(name: str) -> tuple[NDArray[np.int8], NDArray[np.int8]]:
    """Returns a map int8 ``[12, 12]`` with the lowest and one with the highest value of a feature."""
    low, high = feature_range(name)
    return tuple(next(grid for grid, features in _measured() if features[name] == end) for end in (low, high))  # type: ignore[return-value]
