"""Choosing maps among what runs have found: valid, different, spread over the niches."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.archive import niche_bins
from elitelanes_jax.errors import InputError
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.search import Result
from elitelanes_jax.symmetry import canonical, mirror, rotate

__all__ = ["Choice", "choose_maps"]

# What makes a map useless: the metric, the one value that it should have, and words for when it has not. A map is
# counted with the first flaw that it has.
_FLAWS = (
    ("components", 1, "not in one piece"),
    ("dead_ends", 0, "with dead ends"),
    ("boundary_violations", 0, "with roads that leave the grid"),
    ("mismatches", 0, "with roads that do not meet"),
    ("off_alphabet", 0, "with tiles that the tile set lacks"),
    ("coverage", 1, "with empty cells"),
)

# In what share of its tiles a map should differ from all chosen before, however they are turned or mirrored; where
# there are too few such maps, the next will do.
_LEAST_DIFFERENT = (0.15, 0.05, 0.0)


class Choice(NamedTuple):
    """What was chosen, and what became of all the elites.

    Attributes:
      maps: the chosen ones, sorted by niche, within one by fitness.
      found: how many elites there were.
      rejected: how many of them were useless, by reason.
      alike: how many were another one turned or mirrored.
    """

    maps: list[RoadMap]
    found: int
    rejected: dict[str, int]
    alike: int


def choose_maps(result: Result, count: int, seed: int = 0) -> Choice:
    """Chooses up to `count` maps of a run with an array of keys.

    A map is one component without dead end, boundary violation or mismatch; all its cells are tiles of the run's
    alphabet. Of maps that are the same but for turning and mirroring, the fittest is taken. Maps that hardly differ are
    taken only where there are too few others; among the others every niche gives one before any gives a second, and all
    seeds as equally many as can be.

    Args:
      result: of `elitelanes_jax.evolve`, with a leading seed axis.
      count: how many maps are wanted.
      seed: of the run, to be noted in the maps.

    Raises:
      InputError: for the result of one key alone.
    """
    elites = result.elites
    fitness, valid = np.asarray(elites.fitness), np.asarray(elites.valid)
    if valid.ndim != 2:
        raise InputError("result: expected one of an array of keys, with the seeds in front, got one of a single key")
    metrics = {name: np.asarray(values) for name, values in elites.metrics._asdict().items()}
    rejected: Counter[str] = Counter()
    useful = valid.copy()
    for name, right, words in _FLAWS:
        flawed = useful & (metrics[name] != right)
        rejected[words] += int(flawed.sum())
        useful &= ~flawed

    places = np.argwhere(useful)
    places = places[np.argsort(fitness[useful], kind="stable")]
    grids = np.asarray(elites.grids)
    distinct: dict[bytes, NDArray[np.int_]] = {}
    for place in places:
        distinct.setdefault(canonical(grids[tuple(place)]), place)

    kept = np.array(list(distinct.values()), int).reshape(-1, 2)
    descriptor = np.asarray(elites.descriptor)[tuple(kept.T)]
    bins = np.asarray(niche_bins(descriptor, result.axes))
    extent = np.array([max(1, axis.bins - 1) for axis in result.axes])
    chosen = _spread(bins / extent, kept[:, 0], grids[tuple(kept.T)], count)
    chosen.sort(key=lambda number: (*bins[number], number))
    maps = [
        RoadMap(
            codes=grids[tuple(kept[number])],
            metrics={name: values[tuple(kept[number])].item() for name, values in metrics.items()},
            fitness=int(fitness[tuple(kept[number])]),
            descriptor={axis.metric: int(v) for axis, v in zip(result.axes, descriptor[number], strict=True)},
            niche=bins[number].tolist(),
            seed=(seed, int(kept[number][0])),
        )
        for number in chosen
    ]
    reasons = {words: number for words, number in rejected.items() if number}
    return Choice(maps, int(valid.sum()), reasons, len(places) - len(kept))


def _spread(points: NDArray[np.float64], seeds: NDArray[np.int_], grids: NDArray[np.int8], count: int) -> list[int]:
    """Up to `count` of the maps `grids` ``[M, H, W]`` at `points` ``[M, D]``, found by `seeds` ``[M]``, fittest first.

    Every point gives one before any gives a second. Where the round is the last and not all have a turn, the next is
    always the point farthest from those that had one. A point gives a map of the seed that has given fewest so far:
    what one seed has found is akin.
    """
    difference = np.ones(len(grids))  # from the nearest chosen map; under 0 for the chosen ones
    given: Counter[int] = Counter()
    chosen: list[int] = []
    for least in _LEAST_DIFFERENT:
        while len(chosen) < count and (difference >= least).any():
            waiting: dict[bytes, list[int]] = {}
            for number in np.flatnonzero(difference >= least).tolist():
                waiting.setdefault(points[number].tobytes(), []).append(number)
            lists = list(waiting.values())
            for place in _farthest(points[[numbers[0] for numbers in lists]], count - len(chosen)):
                different: list[int] = [number for number in lists[place] if difference[number] >= least]
                if not different:
                    continue
                number = min(different, key=lambda number: (given[int(seeds[number])], number))
                given[int(seeds[number])] += 1
                chosen.append(number)
                difference = np.minimum(difference, _difference(grids, grids[number]))
                difference[number] = -1
    return chosen


def _difference(grids: NDArray[np.int8], grid: NDArray[np.int8]) -> NDArray[np.float64]:
    """The share of tiles in which each of ``[M, H, W]`` differs from one map, turned or mirrored to be most alike."""
    images = [rotate(side, turns) for side in (grid, mirror(grid)) for turns in range(4)]
    return np.min([(grids != image).mean(axis=(1, 2)) for image in images if image.shape == grid.shape], axis=0)


def _farthest(points: NDArray[np.float64], count: int) -> list[int]:
    """Places of up to `count` points: the first, then always the one farthest from all before; of equals the first."""
    places: list[int] = []
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points))):
        places.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[places[-1]], axis=1))
        distance[places] = -1
    return places
