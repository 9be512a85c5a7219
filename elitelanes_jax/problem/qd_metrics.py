"""Metrics of an archive as a whole (Pugh, Soros and Stanley, "Quality diversity", 2016), in NumPy alone."""

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.types import AnyArray


def qd_score(fitness: AnyArray, valid: AnyArray, worst: float) -> NDArray[np.float64]:
    """Returns the sum over all elites of worst - fitness, if positive; float ``[...]``.

    `fitness` is ``[..., N]``, lower is better, and anything in niches that are not `valid`, bool ``[..., N]``.
    """
    return np.where(valid, np.maximum(worst - np.asarray(fitness, np.float64), 0), 0).sum(axis=-1)


def coverage(valid: AnyArray, feasible: AnyArray = None) -> NDArray[np.float64]:
    """Returns the filled share of the feasible niches, float ``[...]``.

    `valid`, bool ``[..., N]``, are the filled niches, `feasible`, bool ``[N]``, those that can be filled; by default
    all.
    """
    valid = np.atleast_1d(np.asarray(valid, bool))
    feasible = np.ones(valid.shape[-1], bool) if feasible is None else np.asarray(feasible, bool)
    return (valid & feasible).sum(axis=-1) / max(1, int(feasible.sum()))


def gaps(fitness: AnyArray, valid: AnyArray, best_known: AnyArray) -> NDArray[np.float64]:
    """Returns how much each elite's fitness exceeds the best known fitness of its niche, float ``[..., N]``.

    It is negative if the elite is better, and NaN in vacant niches.
    """
    return np.where(valid, np.asarray(fitness, np.float64) - np.asarray(best_known, np.float64), np.nan)
