"""Measures of an archive as a whole (Pugh, Soros and Stanley, "Quality diversity", 2016; NumPy alone)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["coverage", "gaps", "qd_score"]


def qd_score(fitness: Any, filled: Any, worst: float) -> NDArray[np.float64]:
    """What all elites together are better than the worst fitness that counts, float ``[...]``.

    Args:
      fitness: ``[..., N]``, lower is better; anything in vacant niches.
      filled: bool ``[..., N]``.
      worst: the fitness of which an elite is worth nothing; what is worse is worth nothing too.
    """
    return np.where(filled, np.maximum(worst - np.asarray(fitness, np.float64), 0), 0).sum(axis=-1)


def coverage(filled: Any, feasible: Any = None) -> NDArray[np.float64]:
    """The share of the niches that are filled, float ``[...]``.

    Args:
      filled: bool ``[..., N]``.
      feasible: bool ``[N]``, the niches that can be filled, where that is known; by default all count.
    """
    filled = np.asarray(filled, bool)
    feasible = np.ones(filled.shape[-1], bool) if feasible is None else np.asarray(feasible, bool)
    return (filled & feasible).sum(axis=-1) / max(1, int(feasible.sum()))


def gaps(fitness: Any, filled: Any, best_known: Any) -> NDArray[np.float64]:
    """How far each niche's elite is from the best known for it, float ``[..., N]``: negative where it is better.

    Not a number in vacant niches.
    """
    return np.where(filled, np.asarray(fitness, np.float64) - np.asarray(best_known, np.float64), np.nan)
