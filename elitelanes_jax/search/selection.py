"""Chooses maps among the elites of a search: valid, different, and spread over the niches."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, TypeAlias

import jax
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.likeness import ALIKE, RoadSet, road_forms
from elitelanes_jax.problem.descriptor import niche_bins
from elitelanes_jax.problem.features import FEATURES, columns_for, feature_unit, select_features
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import satisfies
from elitelanes_jax.problem.rules import map_constraints
from elitelanes_jax.problem.targets import ExampleValues, SupportPoints
from elitelanes_jax.search.elites import MeasuredElites
from elitelanes_jax.search.resolve import Search

_OUTSIDE = "outside the ranges"

MIN_DIFFERENCE = (ALIKE, 0.05, 0.0)
"""The least `difference` of two maps. The first share applies until there are no more such maps, then the next one."""

_Grids: TypeAlias = NDArray[np.int8]
_Round: TypeAlias = Callable[[NDArray[np.float64], float, int], Iterator[int]]
"""Takes the maps' differences from all chosen maps, the least difference and the largest number of maps, and yields the
indices of the next maps to choose. The differences change after each map."""


class Choice(NamedTuple):
    """The chosen maps, and why the other elites were not chosen."""

    maps: list[RoadMap]  # the chosen maps, sorted by niche, and within a niche by fitness
    found: int  # the number of elites
    rejected: dict[str, int]  # the number of elites that violate a constraint, by reason
    alike: int  # the number of elites with the same roads as another elite or an excluded map

    def describe_shortage(self, wanted: int, hint: str, *, writable: bool = True) -> str:
        """Returns how many of the `wanted` maps were found, the reasons against the other elites, and what finds more.

        That is `hint`, and `at_most` if some can be written.
        """
        reasons = [f"{count} {reason}" for reason, count in self.rejected.items()]
        if self.alike:
            reasons.append(f"{self.alike} like another when moved, rotated or mirrored")
        found = f"found {len(self.maps)} of {pluralize(wanted, 'map')} among {pluralize(self.found, 'elite')}"
        against = f" ({', '.join(reasons)})" if reasons else ""
        at_most = "; at_most=True writes those found" if writable and self.maps else ""
        return f"{found}{against}{at_most}; {hint} find more"

    def hint(self, method: str, shape: tuple[int, int]) -> str:
        """Returns what finds more maps ``(height, width)`` with a method."""
        if _OUTSIDE in self.rejected:
            return "wider ranges, more seeds or evaluations"
        if method == "ea":  # its population becomes more alike with time
            return "more seeds"
        if max(self.rejected, key=lambda reason: self.rejected[reason], default="").endswith("the tile set lacks"):
            return "a tile set with more kinds of tiles, more seeds or evaluations"
        return f"{'larger maps, ' if min(shape) < 4 else ''}more seeds or evaluations"


def choose_maps(
    elites: MeasuredElites,
    search: Search,
    count: int,
    seed: int = 0,
    *,
    exclude: Sequence[_Grids] = (),
    min_difference: Sequence[float] = MIN_DIFFERENCE,
) -> Choice:
    """Chooses up to `count` maps of a search.

    A map is one component without dead ends, boundary violations or mismatches. All its cells are tiles of the search's
    alphabet, or empty where rules, fixed cells or an inventory allow it. It is in the ranges of the search,
    keeps its rules, and has not the roads of an example map in `like`. Of maps whose roads are the same when moved,
    rotated or mirrored, the fittest is chosen. With an inventory, the metrics of a map also say how many tiles of each
    kind it leaves.

    Every niche gives one map before any niche gives a second, and the seeds give equally many maps if possible. If the
    specification has targets, maps are instead chosen one by one, so that the energy distance between the features of
    the chosen maps and the targets is smallest. Niches in the axes' target bins come before all others.

    Args:
      elites: of a search.
      search: that found them.
      count: the number of maps.
      seed: of the run; it is noted in the maps.
      exclude: grids, of any size, whose roads no chosen map may have; the chosen maps should differ from them too.
      min_difference: the least `difference` of each map from all others. If there are too few such maps, the next share
        applies.

    """
    settings, axes = search.settings, search.axes
    if elites.valid.ndim == 1:
        elites = jax.tree.map(lambda array: array[None], elites)
    valid = np.asarray(elites.valid)
    shape = (elites.grids.shape[-2], elites.grids.shape[-1])
    grids, fitness = np.asarray(elites.grids).reshape(-1, *shape), np.asarray(elites.fitness).ravel()
    metrics = {name: values.ravel() for name, values in elites.by_name().items()}
    useful, rejected = without_flaws(valid.ravel(), metrics, search)
    satisfied = satisfies(metrics, search.ranges)
    rejected[_OUTSIDE] = int((useful & ~satisfied).sum())
    useful &= satisfied

    exclude = [*exclude, *(np.array(grid, np.int8) for grid in settings.like)]
    kept = _distinct(grids, fitness, useful, exclude)
    descriptor = np.asarray(elites.descriptor).reshape(-1, len(axes))[kept]
    seeds, bins = kept // valid.shape[1], np.asarray(niche_bins(descriptor, axes))
    points = bins / [max(1, axis.bins - 1) for axis in axes]
    # Niches outside the target bins were stepping stones. They give maps only if the others have too few.
    target = np.array([-1 if axis.target is None else axis.target for axis in axes])
    on_target = ((bins == target) | (target < 0)).all(axis=1)
    pursuit = (
        SupportPoints(_target_features(metrics, kept, settings.targets), settings.targets) if settings.targets else None
    )
    chosen: list[int] = []
    for group in (np.flatnonzero(on_target), np.flatnonzero(~on_target)):
        order = _follow(pursuit, group) if pursuit else _spread(points[group], seeds[group])
        before = [*exclude, *grids[kept[chosen]]]
        chosen += group[_choose(order, grids[kept[group]], count - len(chosen), before, min_difference)].tolist()
    maps = [
        RoadMap(
            codes=grids[kept[index]],
            metrics={name: _value(name, values[kept[index]].item()) for name, values in metrics.items()}
            | {
                f"{COUNTED[kind]}_left": count - metrics[COUNTED[kind]][kept[index]].item()
                for kind, count in settings.inventory or ()
            },
            fitness=fitness[kept[index]].item(),
            descriptor={axis.metric: int(value) for axis, value in zip(axes, descriptor[index], strict=True)},
            niche=bins[index].tolist(),
            seed=(seed, int(seeds[index])),
        )
        for index in sorted(chosen, key=lambda index: (*bins[index], index))
    ]
    reasons = {words: number for words, number in rejected.items() if number}
    return Choice(maps, int(valid.sum()), reasons, int(useful.sum()) - len(kept))


@name_wrong_arguments
def without_flaws(
    valid: NDArray[np.bool_], metrics: dict[str, NDArray[np.generic]], search: Search
) -> tuple[NDArray[np.bool_], Counter[str]]:
    """Returns which elites violate no constraint of the search, and the number of the others by reason.

    Args:
      valid: bool of any shape, which slots are filled.
      metrics: arrays of the same shape, by name.
      search: with rules and fixed cells.
    """
    rejected: Counter[str] = Counter()
    useful = valid.copy()
    for name, right, words in map_constraints(search.settings.rules, filled=search.fills_all_cells):
        if name not in metrics:
            raise InputError(f"metrics: expected {name}, got {', '.join(metrics) or 'none'}")
        flawed = useful & (metrics[name] != right)
        rejected[words] += int(flawed.sum())
        useful &= ~flawed
    return useful, rejected


def _distinct(
    grids: _Grids, fitness: NDArray[np.int32], useful: NDArray[np.bool_], exclude: Sequence[_Grids]
) -> NDArray[np.int_]:
    """Returns the indices of useful elites, fittest first, without copies of each other and of excluded maps."""
    excluded = set(road_forms(exclude))
    distinct: dict[bytes, int] = {}
    order = np.flatnonzero(useful)[np.argsort(fitness[useful], kind="stable")]
    for index, form in zip(order.tolist(), road_forms(grids[order]), strict=True):
        if form not in excluded:
            distinct.setdefault(form, index)
    return np.array([*distinct.values()], int)


def _value(name: str, number: float) -> float:
    """Returns the number of a metric, which is not scaled, and of other features in units of 1."""
    return number / feature_unit(name) if name not in FEATURES and feature_unit(name) != 1 else number


def _target_features(
    metrics: dict[str, NDArray[np.generic]], kept: NDArray[np.int_], targets: Sequence[ExampleValues]
) -> NDArray[np.float64]:
    """Returns the features that have targets, of the kept elites, in the order and units of the targets."""
    names = [target.name for target in targets]
    columns = columns_for(names)
    features = np.stack([metrics[name][kept] for name in columns], axis=-1).astype(np.int32)
    return select_features(features, columns, names) / np.array([feature_unit(name) for name in names])


def _choose(order: _Round, grids: _Grids, count: int, before: Sequence[_Grids], shares: Sequence[float]) -> list[int]:
    """Chooses up to `count` of the maps `grids` ``[M, H, W]`` in rounds, and returns their indices.

    Each differs from the maps before and from each other in the first share of its tiles, then in the next share.
    """
    roads, largest = RoadSet(grids), max(shares)
    difference = np.full(len(grids), np.inf)  # from the most similar chosen map; under 0 for the chosen maps
    for grid in before if count > 0 else ():
        np.minimum(difference, roads.differences(grid, largest), out=difference)
    chosen: list[int] = []
    for share in shares:
        while len(chosen) < count and (difference >= share).any():
            for index in order(difference, share, count - len(chosen)):
                chosen.append(index)
                np.minimum(difference, roads.differences(grids[index], largest), out=difference)
                difference[index] = -1
    return chosen


def _spread(points: NDArray[np.float64], seeds: NDArray[np.int_]) -> _Round:
    """Orders maps, fittest first, at `points` ``[M, D]``, found by `seeds` ``[M]``: a round yields a map of each point.

    If a round has fewer maps than points, the next point is always the farthest from those before. A point yields a map
    of the seed that has given the fewest so far, because maps of one seed are related.
    """
    given: Counter[int] = Counter()

    def order(difference: NDArray[np.float64], share: float, count: int) -> Iterator[int]:
        waiting: dict[bytes, list[int]] = {}
        for index in np.flatnonzero(difference >= share).tolist():
            waiting.setdefault(points[index].tobytes(), []).append(index)
        lists = list(waiting.values())
        for point in _farthest(points[[indices[0] for indices in lists]], count):
            if different := [index for index in lists[point] if difference[index] >= share]:
                index = min(different, key=lambda index: (given[int(seeds[index])], index))
                given[int(seeds[index])] += 1
                yield index

    return order


def _follow(pursuit: SupportPoints, group: NDArray[np.int_]) -> _Round:
    """Orders the maps of a group by the targets; among equal ones the first comes first."""

    def order(difference: NDArray[np.float64], share: float, _: int) -> Iterator[int]:
        index = int(np.argmin(np.where(difference >= share, pursuit.losses()[group], np.inf)))
        pursuit.choose(int(group[index]))
        yield index

    return order


def _farthest(points: NDArray[np.float64], count: int) -> list[int]:
    """Returns up to `count` indices: 0, then always the point farthest from all before; among equal ones the first."""
    indices: list[int] = []
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points))):
        indices.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[indices[-1]], axis=1))
        distance[indices] = -1
    return indices
