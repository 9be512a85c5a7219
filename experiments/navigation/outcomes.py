"""The finished runs of `navigation.py`, and the statistics that compare them."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from experiments.navigation.tasks import CONDITIONS, TASKS, Figures, Judged
from experiments.paper.statistics import bootstrap_interval

__all__ = [
    "ALIKE",
    "FEATURES",
    "Difference",
    "Places",
    "Runs",
    "correlation",
    "correlations",
    "difference",
    "over_seeds",
    "read_places",
    "read_runs",
    "success_by_niche",
]

ALIKE = ("seen", "held out")
"""The tests on unseen maps of MAP-Elites."""

FEATURES = ("cyclomatic", "straight_share", "mean_detour", "repetition", "ambiguity")
"""Features of maps that failures are compared with."""

Runs: TypeAlias = dict[tuple[str, str, int], dict[str, Judged]]
"""What `judge` says of each test, by task, condition and seed."""

Places: TypeAlias = dict[int, dict[str, dict[str, list[float]]]]
"""What `find_places` says of each test, by seed."""


class Difference(NamedTuple):
    """A mean over seeds, as of differences between runs of the same seed, with its 95 % bootstrap interval.

    The interval is NaN under three seeds.
    """

    mean: float
    low: float
    high: float
    seeds: int


def read_runs(out: Path) -> Runs:
    """Reads the finished runs of a folder: what `judge` says of each test, by task, condition and seed."""
    runs: Runs = {}
    for name in TASKS:
        for condition in CONDITIONS:
            for file in sorted((out / "runs").glob(f"{name}-{condition}-*.json")):
                seed = file.stem.removeprefix(f"{name}-{condition}-")
                if seed.isdigit():
                    runs[name, condition, int(seed)] = json.loads(file.read_text(encoding="utf-8"))
    return runs


def difference(
    runs: Runs, task: str, one: tuple[str, str], other: tuple[str, str], figure: Figures = "success"
) -> Difference:
    """Compares two (condition, test), over the seeds that both have."""
    pairs = [
        (found[one[1]][figure], runs[task, other[0], seed][other[1]][figure])
        for (name, condition, seed), found in sorted(runs.items())
        if (name, condition) == (task, one[0]) and one[1] in found and other[1] in runs.get((task, other[0], seed), {})
    ]
    return over_seeds([first - second for first, second in pairs])


def over_seeds(values: Sequence[float]) -> Difference:
    """Averages a figure of each seed."""
    mean = float(np.mean(values)) if len(values) else float("nan")
    low, high = bootstrap_interval(values) if len(values) > 2 else (float("nan"), float("nan"))
    return Difference(mean, low, high, len(values))


def correlation(failure: ArrayLike, feature: ArrayLike) -> float:
    """Returns Spearman's rank correlation; NaN where one of them is constant."""
    if np.ptp(failure) == 0 or np.ptp(feature) == 0:
        return float("nan")
    return float(stats.spearmanr(failure, feature).statistic)


def read_places(out: Path) -> Places:
    """Reads what `find_places` says of each test, by seed."""
    files = {int(file.stem.removeprefix("where-")): file for file in (out / "runs").glob("where-*.json")}
    return {seed: json.loads(file.read_text(encoding="utf-8")) for seed, file in sorted(files.items())}


def correlations(runs: Runs, places: Places, task: str, condition: str, feature: str) -> list[float]:
    """Correlates a driver's failures with a feature over all unseen maps of MAP-Elites; one number for each seed."""
    values = []
    for (name, trained, seed), found in sorted(runs.items()):
        if (name, trained) == (task, condition) and seed in places:
            failure = 1 - np.concatenate([found[test]["by_map"] for test in ALIKE])
            values.append(correlation(failure, np.concatenate([places[seed][test][feature] for test in ALIKE])))
    return [value for value in values if np.isfinite(value)]


def success_by_niche(runs: Runs, out: Path, task: str, condition: str) -> tuple[NDArray[np.float64], NDArray[np.int_]]:
    """Averages the success on maps of each niche, trained on or held out, over all seeds.

    Returns:
      Means ``[10, 10]``, NaN in niches without a map, and the numbers of maps.
    """
    total, count = np.zeros((10, 10)), np.zeros((10, 10), int)
    for (name, trained, seed), found in runs.items():
        if (name, trained) == (task, condition):
            niches = json.loads((out / "maps" / f"{seed}.json").read_text(encoding="utf-8"))["niches"]
            for test in ALIKE:
                for (loops, straights), success in zip(niches[test], found[test]["by_map"], strict=True):
                    total[loops, straights] += success
                    count[loops, straights] += 1
    return np.where(count > 0, total / np.maximum(count, 1), np.nan), count
