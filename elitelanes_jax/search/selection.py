"""Chooses maps among the elites of a search: valid, different, and spread over the niches."""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.likeness import ALIKE, RoadSet, road_forms
from elitelanes_jax.problem.descriptor import niche_bins
from elitelanes_jax.problem.features import FEATURES, columns_for, feature_unit, select_features
from elitelanes_jax.problem.inventory import COUNTED
from elitelanes_jax.problem.ranges import Range, satisfies
from elitelanes_jax.problem.rules import OFF_ALPHABET, map_constraints
from elitelanes_jax.problem.targets import ExampleValues, SupportPoints
from elitelanes_jax.search.records import MeasuredElites
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.search.style import CROSSING

_OUTSIDE = "outside the ranges"
_UNFIXED = "with other codes in fixed cells"

MIN_DIFFERENCE = (ALIKE, 0.05, 0.0)
"""The least `difference` of two maps.

The first share applies until there are no more such maps, then the next one.
"""

_Grids: TypeAlias = NDArray[np.int8]
_Round: TypeAlias = Callable[[NDArray[np.float64], float], Iterator[int]]
"""Yields the indices of the next maps to choose.

It takes the maps' differences from all chosen maps, and the least difference. The differences
change after each map.
"""


class Choice(NamedTuple):
    """The chosen maps, and why the other elites were not chosen.

    Attributes:
      maps: the chosen maps, sorted by niche, and within a niche by fitness.
      found: the number of elites.
      rejected: the number of elites that violate a constraint, by reason.
      alike: the number of elites with the same roads as another elite or an excluded map.
      narrowest: of the ranges that elites are outside of, the one that rejects most.
    """

    maps: list[RoadMap]
    found: int
    rejected: dict[str, int]
    alike: int
    narrowest: Range | None = None

    def describe_shortage(self, wanted: int, hint: str, *, writable: bool = True) -> str:
        """Returns how many of the `wanted` maps were found, and why not more.

        The text has the reasons against the other elites, and `hint`, which finds more. It names
        `at_most` if some maps can be written.
        """
        reasons = [f"{count} {reason}" for reason, count in self.rejected.items()]
        if self.alike:
            reasons.append(f"{self.alike} like another when moved, rotated or mirrored")
        text = (
            f"found {len(self.maps)} of {pluralize(wanted, 'map')} "
            f"among {pluralize(self.found, 'elite')}"
        )
        if reasons:
            text += f" ({', '.join(reasons)})"
        if writable and self.maps:
            text += "; at_most=True writes those found"
        return f"{text}; {hint} find more"

    def hint(self, search: Search) -> str:
        """Returns what finds more maps with a search."""
        if self.narrowest is not None:
            return f"{_wider(self.narrowest, search)}, more seeds or evaluations"
        if search.settings.method == "ea":
            # The population becomes more alike with time.
            return "more seeds"
        most_frequent = max(self.rejected, key=lambda reason: self.rejected[reason], default="")
        if most_frequent == OFF_ALPHABET.violated:
            return "more codes in the alphabet or the tile set, more seeds or evaluations"
        if min(search.shape) < 4:
            return "larger maps, more seeds or evaluations"
        return "more seeds or evaluations"


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

    A map is one component without dead ends, boundary violations or mismatches. All its cells are
    tiles of the search's alphabet, or empty where rules, fixed cells or an inventory allow it. It
    is in the ranges of the search, keeps its rules, and has not the roads of an example map in
    `like`. Of maps whose roads are the same when moved, rotated or mirrored, the fittest is chosen.
    With an inventory, the metrics of a map also say how many tiles of each kind it leaves.

    Every niche gives one map before any niche gives a second, and the seeds give equally many maps
    if possible. If the specification has targets, maps are instead chosen one by one. Each makes
    the energy distance between the features of the chosen maps and the targets smallest. Niches in
    the axes' target bins come before all others.

    Args:
      elites: the elites of a search, with an axis of seeds.
      search: the search that found the elites.
      count: the number of maps.
      seed: the seed of the run; it is noted in the maps.
      exclude: grids, of any size, whose roads no chosen map may have; the chosen maps should differ
        from them too.
      min_difference: the least `difference` of each map from all others. If there are too few such
        maps, the next share applies.
    """
    valid = np.asarray(elites.valid)
    metrics = {name: values.ravel() for name, values in elites.by_name().items()}
    # The fitness only steers towards the constraints. An elite may violate them, so each elite is
    # checked exactly.
    unflawed, rejected = without_flaws(valid, elites, search)
    useful = unflawed.ravel()
    outside = useful & ~satisfies(metrics, search.ranges)
    rejected[_OUTSIDE] = int(outside.sum())
    narrowest = _narrowest(search.ranges, outside, metrics)
    useful &= ~outside

    # A search for maps like examples may find the examples themselves.
    examples = [np.array(grid, np.int8) for grid in search.settings.like]
    exclude = [*exclude, *examples]
    grids = np.asarray(elites.grids).reshape(-1, *elites.grids.shape[-2:])
    fitness = np.asarray(elites.fitness).ravel()
    distinct = _distinct(grids, fitness, useful, exclude)
    candidates = _Candidates.take(elites, distinct, metrics, search)

    pursuit = None
    targets = search.settings.targets
    if targets:
        pursuit = SupportPoints(_target_features(candidates.metrics, targets), targets)
    # Both groups share the counts, so that all chosen maps together are balanced between seeds.
    maps_of_seed: Counter[int] = Counter()
    chosen: list[int] = []
    # Niches outside the target bins were stepping stones. They give maps only if the others have
    # too few.
    for group in (np.flatnonzero(candidates.on_target), np.flatnonzero(~candidates.on_target)):
        order = (
            _follow(pursuit, group)
            if pursuit
            else _spread(candidates.points[group], candidates.seeds[group], maps_of_seed)
        )
        # Maps of the second group have to differ from those of the first.
        before = [*exclude, *candidates.grids[chosen]]
        indices = _choose(
            order, candidates.grids[group], count - len(chosen), before, min_difference
        )
        chosen += group[indices].tolist()
    # Candidates are the fittest first, so within a niche the index sorts by fitness.
    chosen.sort(key=lambda index: (*candidates.bins[index], index))

    reasons = {words: number for words, number in rejected.items() if number}
    return Choice(
        maps=[candidates.road_map(index, search, seed) for index in chosen],
        found=int(valid.sum()),
        rejected=reasons,
        alike=int(useful.sum()) - len(distinct),
        narrowest=narrowest,
    )


def _wider(narrowest: Range, search: Search) -> str:
    """Returns what allows more values of a feature than its range in a search."""
    # The user may not know of the ranges that a style or an inventory asks for.
    if narrowest == CROSSING and search.settings.style == "town":
        return "where crossings=0.., which allows rings"
    limits = {COUNTED[kind]: count for kind, count in search.settings.inventory or ()}
    if narrowest.high is None or limits.get(narrowest.name) != narrowest.high:
        return f"a wider range than {narrowest}"
    more = f"more {narrowest.name} in the inventory"
    if narrowest.low is None:
        return more
    return f"{more}, a wider range than {narrowest._replace(high=None)}"


def _narrowest(
    ranges: Sequence[Range], outside: NDArray[np.bool_], metrics: dict[str, NDArray[np.generic]]
) -> Range | None:
    """Returns the range that most elites outside the ranges are outside of; None without any."""
    if not outside.any():
        return None
    return max(ranges, key=lambda item: int((outside & ~satisfies(metrics, [item])).sum()))


class _Candidates(NamedTuple):
    """M elites among which maps are chosen, the fittest first.

    Attributes:
      grids: the codes ``[M, H, W]``.
      fitness: the fitness ``[M]``.
      metrics: the metrics by name, each ``[M]``.
      descriptor: the values on the D axes, ``[M, D]``.
      bins: the bins of the niche, ``[M, D]``.
      points: the niche in units of each axis, ``[M, D]``, 0 to 1.
      on_target: whether the niche is in all target bins, ``[M]``.
      seeds: the number in the run of the seed that found each elite, ``[M]``.
    """

    grids: _Grids
    fitness: NDArray[np.int32]
    metrics: dict[str, NDArray[np.generic]]
    descriptor: NDArray[np.int32]
    bins: NDArray[np.int_]
    points: NDArray[np.float64]
    on_target: NDArray[np.bool_]
    seeds: NDArray[np.int_]

    @staticmethod
    def take(
        elites: MeasuredElites,
        indices: NDArray[np.int_],
        metrics: dict[str, NDArray[np.generic]],
        search: Search,
    ) -> "_Candidates":
        """Takes some of the elites ``[S, slots]``, by their flat indices.

        `metrics` are those of all elites, flat.
        """
        axes = search.axes
        descriptor = np.asarray(elites.descriptor).reshape(-1, len(axes))[indices]
        bins = np.asarray(niche_bins(descriptor, axes))
        # No bin is -1, which stands for an axis without a target.
        targets = np.array([-1 if axis.target is None else axis.target for axis in axes])
        return _Candidates(
            grids=np.asarray(elites.grids).reshape(-1, *elites.grids.shape[-2:])[indices],
            fitness=np.asarray(elites.fitness).ravel()[indices],
            metrics={name: values[indices] for name, values in metrics.items()},
            descriptor=descriptor,
            bins=bins,
            points=bins / [max(1, axis.bins - 1) for axis in axes],
            on_target=((bins == targets) | (targets < 0)).all(axis=1),
            seeds=indices // elites.valid.shape[1],
        )

    def road_map(self, index: int, search: Search, seed: int) -> RoadMap:
        """Returns a candidate as a map, with its metrics.

        For an inventory, the map also says how many tiles of each kind it leaves.
        """
        metrics = {
            name: _value(name, values[index].item()) for name, values in self.metrics.items()
        }
        for kind, count in search.settings.inventory or ():
            used = self.metrics[COUNTED[kind]][index].item()
            metrics[f"{COUNTED[kind]}_left"] = count - used
        descriptor = zip(search.axes, self.descriptor[index], strict=True)
        return RoadMap(
            codes=self.grids[index],
            metrics=metrics,
            fitness=self.fitness[index].item(),
            descriptor={axis.metric: int(value) for axis, value in descriptor},
            niche=self.bins[index].tolist(),
            seed=(seed, int(self.seeds[index])),
        )


@name_wrong_arguments
def without_flaws(
    valid: NDArray[np.bool_], elites: MeasuredElites, search: Search
) -> tuple[NDArray[np.bool_], Counter[str]]:
    """Returns which elites violate no constraint of the search.

    Also returns the number of the other elites by reason.

    Args:
      valid: bool ``[*S, N]``, which elites to look at.
      elites: the elites ``[*S, N]``, of this search or of others with maps of its size.
      search: the search, with its rules and fixed cells.
    """
    rejected: Counter[str] = Counter()
    useful, metrics = valid.copy(), elites.by_name()
    flaws = []
    for name, right, words in map_constraints(search.settings.rules, filled=search.fills_all_cells):
        if name not in metrics:
            raise InputError("metrics", name, ", ".join(metrics) or "none")
        flaws.append((words, metrics[name] != right))
    fix = search.settings.fix
    if fix is not None:
        # The search keeps its fixed cells. Elites of another search may have other codes there.
        others = fix.fixed & (np.asarray(elites.grids) != fix.grid)
        flaws.append((_UNFIXED, others.any(axis=(-2, -1))))
    # An elite with several flaws counts once, so that the numbers add up.
    for words, flawed in flaws:
        rejected[words] += int((useful & flawed).sum())
        useful &= ~flawed
    return useful, rejected


def _distinct(
    grids: _Grids, fitness: NDArray[np.int32], useful: NDArray[np.bool_], exclude: Sequence[_Grids]
) -> NDArray[np.int_]:
    """Returns the indices of useful elites, fittest first, without copies.

    An elite with the roads of an earlier one, or of an excluded map, is a copy.
    """
    excluded = set(road_forms(exclude))
    distinct: dict[bytes, int] = {}
    # The sort is stable, so among equally fit elites the first seed and slot come first.
    order = np.flatnonzero(useful)[np.argsort(fitness[useful], kind="stable")]
    for index, form in zip(order.tolist(), road_forms(grids[order]), strict=True):
        if form not in excluded:
            distinct.setdefault(form, index)
    return np.array([*distinct.values()], int)


def _value(name: str, number: float) -> float:
    """Returns the number of a metric, which is not scaled, and of other features in units of 1."""
    is_scaled = name not in FEATURES and feature_unit(name) != 1
    return number / feature_unit(name) if is_scaled else number


def _target_features(
    metrics: dict[str, NDArray[np.generic]], targets: Sequence[ExampleValues]
) -> NDArray[np.float64]:
    """Returns the features that have targets, in the order and units of the targets."""
    names = [target.name for target in targets]
    columns = columns_for(names)
    features = np.stack([metrics[name] for name in columns], axis=-1).astype(np.int32)
    return select_features(features, columns, names) / np.array(
        [feature_unit(name) for name in names]
    )


def _choose(
    order: _Round, grids: _Grids, count: int, before: Sequence[_Grids], shares: Sequence[float]
) -> list[int]:
    """Chooses up to `count` of the maps `grids` ``[M, H, W]`` in rounds, and returns their indices.

    Each differs from the maps before and from each other in the first share of its tiles, then in
    the next share.
    """
    roads, largest = RoadSet(grids), max(shares)
    chosen: list[int] = []
    if count <= 0:
        return chosen
    # The difference of each map from the most similar map that is chosen or excluded. Chosen maps
    # get -1, so that no share chooses them again.
    difference = roads.least_differences(before, largest)
    for share in shares:
        while len(chosen) < count and (difference >= share).any():
            # The order reads the differences after each map, so they are updated in place.
            for index in islice(order(difference, share), count - len(chosen)):
                chosen.append(index)
                np.minimum(difference, roads.differences(grids[index], largest), out=difference)
                difference[index] = -1
    return chosen


def _spread(
    points: NDArray[np.float64], seeds: NDArray[np.int_], maps_of_seed: Counter[int]
) -> _Round:
    """Returns rounds that spread the chosen maps over their niches and seeds.

    Each niche is a point in the space of the axes. A round visits each point once, and yields one
    of its maps. It begins with the point of the fittest map. The next point is always the one that
    is farthest from all points before it.

    A point yields a map of the seed with the fewest maps so far, because maps of one seed are
    related. Of several such maps it yields the fittest.

    Args:
      points: the point of each map, ``[M, D]``; the fittest map is first.
      seeds: the seed that found each map, ``[M]``.
      maps_of_seed: the number of maps that each seed has yielded; the rounds update it.
    """

    def order(difference: NDArray[np.float64], share: float) -> Iterator[int]:
        waiting: dict[bytes, list[int]] = {}
        for index in np.flatnonzero(difference >= share).tolist():
            waiting.setdefault(points[index].tobytes(), []).append(index)
        # Maps are the fittest first, so the first map of a list stands for its point.
        lists = list(waiting.values())
        first = [indices[0] for indices in lists]
        for point in _farthest(points[first]):
            different = [index for index in lists[point] if difference[index] >= share]
            # A point whose maps are like those chosen in this round yields none. The next point
            # takes its turn, before any point yields a second map.
            if different:
                index = min(different, key=lambda index: (maps_of_seed[int(seeds[index])], index))
                maps_of_seed[int(seeds[index])] += 1
                yield index

    return order


def _follow(pursuit: SupportPoints, group: NDArray[np.int_]) -> _Round:
    """Orders the maps of a group by the targets; among equal ones the first comes first."""

    def order(difference: NDArray[np.float64], share: float) -> Iterator[int]:
        # Each map changes the losses of all others, so a round yields a single map.
        index = int(np.argmin(np.where(difference >= share, pursuit.losses()[group], np.inf)))
        pursuit.choose(int(group[index]))
        yield index

    return order


def _farthest(points: NDArray[np.float64]) -> Iterator[int]:
    """Yields all indices: 0, then always the point farthest from all before.

    Among equally far points the first comes first.
    """
    indices: list[int] = []
    distance = np.full(len(points), np.inf)
    for _ in range(len(points)):
        indices.append(int(np.argmax(distance)))
        yield indices[-1]
        distance = np.minimum(distance, np.linalg.norm(points - points[indices[-1]], axis=1))
        # Every distance is greater than -1, so no point is yielded twice.
        distance[indices] = -1
