"""Statistics of differences: Mann-Whitney's U with its effect size, Holm's correction, bootstrap intervals."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy import stats

__all__ = ["Comparison", "bootstrap_interval", "compare_all", "holm"]


class Comparison(NamedTuple):
    """A comparison of two samples.

    Attributes:
      effect: rank-biserial correlation, -1 to 1. It is 1 if every value of the first sample is larger than every value
        of the second.
      p: p-value of Mann-Whitney's U, two-sided, with Holm's correction for all pairs compared.
    """

    effect: float
    p: float


def compare_all(samples: Mapping[str, Sequence[float]]) -> dict[tuple[str, str], Comparison]:
    """Compares all pairs of samples, in their order."""
    pairs = list(combinations(samples, 2))
    tests = [stats.mannwhitneyu(samples[one], samples[other], alternative="two-sided") for one, other in pairs]
    sizes = [len(samples[one]) * len(samples[other]) for one, other in pairs]
    effects = [2 * float(test.statistic) / size - 1 for test, size in zip(tests, sizes, strict=True)]
    # SciPy returns nan for equal samples from 1.18 on.
    corrected = holm([float(np.nan_to_num(test.pvalue, nan=1.0)) for test in tests])
    return dict(zip(pairs, map(Comparison, effects, corrected), strict=True))


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrects p-values for the number of tests (Holm, 1979).

    The k-th lowest of m values is multiplied by m - k + 1. The result is at least the one before, and at most 1.
    """
    order = np.argsort(p_values, kind="stable")
    steps = np.asarray(p_values)[order] * np.arange(len(p_values), 0, -1)
    corrected = np.empty(len(p_values))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1)
    return corrected.tolist()


def bootstrap_interval(sample: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Returns the 95 % bootstrap interval of the mean (BCa, 9,999 resamples); of a constant sample its value twice."""
    if np.ptp(sample) == 0:
        return float(sample[0]), float(sample[0])
    found = stats.bootstrap((sample,), np.mean, n_resamples=9999, rng=np.random.default_rng(seed))
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
