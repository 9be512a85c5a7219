"""Statistics of differences: Mann-Whitney's U with its effect size, Holm's correction, bootstrap intervals (SciPy)."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import stats

__all__ = ["Comparison", "bootstrap_interval", "compare_all", "holm"]


class Comparison(NamedTuple):
    """A comparison of two samples.

    Attributes:
      effect: rank-biserial correlation, -1 to 1: 1 where all of the first lie over all of the second.
      p: of Mann-Whitney's U, two-sided, with Holm's correction for all pairs compared.
    """

    effect: float
    p: float


def compare_all(samples: Mapping[str, Sequence[float]]) -> dict[tuple[str, str], Comparison]:
    """Compares all pairs of samples, in their order."""
    pairs = list(combinations(samples, 2))
    effects, chances = [], []
    for one, other in pairs:
        first, second = np.asarray(samples[one]), np.asarray(samples[other])
        result = stats.mannwhitneyu(first, second, alternative="two-sided")
        effects.append(2 * float(result.statistic) / (first.size * second.size) - 1)
        equal = np.ptp([*first, *second]) == 0  # SciPy has no p for them from 1.18 on
        chances.append(1.0 if equal else float(result.pvalue))
    corrected = holm(chances)
    return {pair: Comparison(*numbers) for pair, *numbers in zip(pairs, effects, corrected, strict=True)}


def holm(chances: Sequence[float]) -> list[float]:
    """Corrects p-values for their number (Holm, 1979).

    The k-th lowest of m is multiplied by m - k + 1; it is at least the one before, and at most 1.
    """
    order = np.argsort(chances, kind="stable")
    steps = np.asarray(chances)[order] * np.arange(len(chances), 0, -1)
    corrected = np.empty(len(chances))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return corrected.tolist()


def bootstrap_interval(sample: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Returns the 95 % interval of the mean, bias-corrected and accelerated; of a constant sample its value."""
    values = np.asarray(sample, float)
    if np.ptp(values) == 0:
        return float(values[0]), float(values[0])
    interval = stats.bootstrap(
        (values,), np.mean, n_resamples=9999, rng=np.random.default_rng(seed)
    ).confidence_interval
    return float(interval.low), float(interval.high)
