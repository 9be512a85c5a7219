"""The scores of the benchmark.

They follow Mouret and Clune, "Illuminating search spaces by mapping elites", 2015, section 4.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, unmasked
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax.benchmark.tasks import Task
from elitelanes_jax.problem.archive import VACANT, coverage

_RESAMPLES = 10_000


class Scores(NamedTuple):
    """The scores of archives ``[...]``, floats in [0, 1].

    The nearness of an elite is its fitness divided by its niche's optimum, or 0 if the fitness is
    positive.

    Attributes:
      coverage: the share of feasible niches that are filled.
      reliability: the mean nearness over feasible niches, 0 in vacant ones.
      precision: the mean nearness over filled niches; NaN if none is.
      optimal: the share of feasible niches that are at their optimum.
    """

    coverage: NDArray[np.float64]
    reliability: NDArray[np.float64]
    precision: NDArray[np.float64]
    optimal: NDArray[np.float64]


@name_wrong_arguments
def compute_scores(task: Task, best: NDArray[np.float64]) -> Scores:
    """Computes the scores of archives on a task with F feasible niches.

    `best` is ``[..., F]`` with at least one more axis, the lowest fitness in each niche; infinite,
    or that of a vacant slot, if it is vacant. Raises `InputError` for another shape, anything but
    numbers, NaN, or a fitness below the proven optimum of its niche.
    """
    check_named("task", instance(Task), task)
    best = np.asarray(check_named("best", unmasked, best))
    if best.ndim < 2 or best.shape[-1] != len(task.optimum):
        raise InputError(
            "best", f"shape [..., {len(task.optimum)}] for {task.name}", list(best.shape)
        )
    if best.dtype.kind not in "iuf":
        raise InputError("best", "numbers, infinite in vacant niches", best.dtype)
    if np.isnan(best).any():
        raise InputError("best", "numbers, infinite in vacant niches", "nan")
    # A better fitness than the proven one is a mistake in the archive or in the proof.
    if (beyond := best < task.optimum).any():
        (*_, niche) = np.argwhere(beyond)[0]
        value, least = best[beyond][0], task.optimum[niche]
        raise InputError(
            "best", f"no fitness below the optimum, {least} in niche {niche}", f"{value:g}"
        )
    # A vacant niche has the fitness of a vacant slot, or an infinite one.
    filled = best < VACANT
    nearness = _nearness(task, best)
    total, count = nearness.sum(axis=-1), filled.sum(axis=-1)
    precision = np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)
    at_optimum = (filled & (best <= task.optimum)).mean(axis=-1)
    return Scores(np.asarray(coverage(filled)), total / filled.shape[-1], precision, at_optimum)


def _nearness(task: Task, best: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the nearness of each niche's best flawless network, 0 in vacant niches."""
    filled = best < VACANT
    # All optima are negative, so the quotient is 1 at the optimum and falls to 0.
    return np.where(filled, np.maximum(np.where(filled, best, 0) / task.optimum, 0), 0)


def grade(task: Task, best: NDArray[np.float64], flaws: NDArray[np.float64]) -> NDArray[np.float64]:
    """Computes the graded score ``[...]`` of archives, which `Submission.grade` defines.

    Args:
      task: the task, with F feasible niches.
      best: float ``[..., F]``, as in `compute_scores`.
      flaws: float ``[..., F]``, the smallest number of flaws of a grid in each niche; infinite if
        the niche is vacant.
    """
    flawless = best < VACANT
    # A flawless network has at least 1/2, and a flawed one at most 1/4. For infinite flaws the
    # second term is 0.
    return np.where(flawless, (1 + _nearness(task, best)) / 2, 1 / (2 + 2 * flaws)).mean(axis=-1)


@name_wrong_arguments
def confidence_interval(values: ArrayLike) -> tuple[float, float]:
    """Returns the 95 % percentile bootstrap interval of the mean over runs ``[R]``.

    Equal values give equal limits. Runs with NaN are ignored. If all runs are NaN, both limits are
    NaN. Raises `InputError` for another shape, for no runs, and for anything but finite numbers and
    NaN.
    """
    values = np.atleast_1d(np.asarray(check_named("values", unmasked, values)))
    if values.dtype.kind not in "biuf" or np.isinf(values).any():
        raise InputError("values", "finite scores or NaN", quote(values))
    values = values.astype(float)
    if values.ndim != 1 or not values.size:
        raise InputError(
            "values", "one score for each run, shape [R]", f"shape {list(values.shape)}"
        )
    known = values[~np.isnan(values)]
    if not len(known):
        return float("nan"), float("nan")
    # The seed is fixed, so that the same scores have the same interval everywhere.
    drawn = np.random.default_rng(0).integers(len(known), size=(_RESAMPLES, len(known)))
    low, high = np.quantile(known[drawn].mean(axis=1), [0.025, 0.975])
    return float(low), float(high)
