"""Bootstrap intervals of means."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

__all__ = ["bootstrap_interval"]


def bootstrap_interval(sample: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """Returns the 95 % bootstrap interval of the mean (BCa, 9,999 resamples); of a constant sample its value twice."""
    if np.ptp(sample) == 0:
        return float(sample[0]), float(sample[0])
    found = stats.bootstrap((sample,), np.mean, n_resamples=9999, rng=np.random.default_rng(seed))
    return float(found.confidence_interval.low), float(found.confidence_interval.high)
