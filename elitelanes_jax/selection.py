"""Choosing maps among what runs have found: valid, all different, spread over the niches."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.archive import niche_bins
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.search import Result
from elitelanes_jax.symmetry import canonical

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


class Choice(NamedTuple):
    """What was chosen, and what became of all the elites.

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
    alphabet.
    Of maps that are the same but for turning and mirroring, the fittest is taken. Then every niche gives one map
    before any gives a second, and all seeds as equally many as can be.

    Args:
      result: of `elitelanes_jax.evolve`, with a leading seed axis.
      count: how many maps are wanted.
      seed: of the run, to be noted in the maps.
    """
    elites = result.elites
    metrics = {name: np.asarray(values) for name, values in elites.metrics._asdict().items()}
    fitness, valid = np.asarray(elites.fitness), np.asarray(elites.valid)
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
    chosen = _spread(bins / extent, kept[:, 0], count)
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


def _spread(points: NDArray[np.float64], seeds: NDArray[np.int_], count: int) -> list[int]:
    """Up to `count` of maps at `points` ``[M, D]``, found by `seeds` ``[M]``, sorted by fitness.

    Every point gives one before any gives a second. Where the round is the last and not all have a turn, the next is
    always the point farthest from those that had one. A point gives a map of the seed that has given fewest so far:
    what one seed has found is akin.
    """
    waiting: dict[bytes, list[int]] = {}
    for number, point in enumerate(points):
        waiting.setdefault(point.tobytes(), []).append(number)
    given: Counter[int] = Counter()
    chosen: list[int] = []
    while len(chosen) < count and waiting:
        lists = list(waiting.values())
        for place in _farthest(points[[numbers[0] for numbers in lists]], count - len(chosen)):
            number = min(lists[place], key=lambda number: (given[int(seeds[number])], number))
            lists[place].remove(number)
            given[int(seeds[number])] += 1
            chosen.append(number)
        waiting = {point: numbers for point, numbers in waiting.items() if numbers}
    return chosen


def _farthest(points: NDArray[np.float64], count: int) -> list[int]:
    """Places of up to `count` points: the first, then always the one farthest from all before; of equals the first."""
    places: list[int] = []
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points))):
        places.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[places[-1]], axis=1))
        distance[places] = -1
    return places
