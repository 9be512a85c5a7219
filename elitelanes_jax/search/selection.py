"""Choosing maps among the elites of a run: valid, different, spread over the niches."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.plain_town import cut_to_roads
from elitelanes_jax.network.symmetry import canonical_form, mirror, rotate
from elitelanes_jax.problem.constraints import bounds_of, violation
from elitelanes_jax.problem.descriptor import Axis, niche_bins
from elitelanes_jax.problem.features import (
    FEATURES,
    compute_features,
    extra_names,
    feature_places,
    feature_unit,
    join_counts,
)
from elitelanes_jax.problem.flaws import find_flaws
from elitelanes_jax.problem.targets import Pursuit, Target
from elitelanes_jax.search.elites import MeasuredElites
from elitelanes_jax.search.spec import SearchSpec

_OUTSIDE = "outside the ranges"

LEAST_DIFFERENT = (0.15, 0.05, 0.0)
"""Shares of tiles in which a map should differ from others, the first if there are enough."""


class Choice(NamedTuple):
    """The chosen maps, and the reasons against all other elites.

    Attributes:
      maps: the chosen ones, sorted by niche, within one by fitness.
      found: the number of elites.
      rejected: the number of elites with a flaw, by reason.
      alike: the number of elites that were another one, or a known one, rotated or mirrored.
      nearest: where no map is in all ranges, the values of these features of the elite nearest to them: of those
        without a flaw, or of all where there is none; None without elites.
    """

    maps: list[RoadMap]
    found: int
    rejected: dict[str, int]
    alike: int
    nearest: dict[str, float] | None = None


def choose_maps(
    elites: MeasuredElites,
    spec: SearchSpec,
    axes: tuple[Axis, ...],
    count: int,
    seed: int = 0,
    *,
    known: Sequence[NDArray[np.int8]] = (),
    least: Sequence[float] = LEAST_DIFFERENT,
) -> Choice:
    """Chooses up to `count` maps of a run with an array of keys.

    A map is one component without dead end, boundary violation or mismatch; all its cells are tiles of the run's
    alphabet, but for empty ones where rules or given cells ask for them. It is in the ranges and keeps the rules of the
    run's specification, and is none of the maps that it is to be like. Of maps that are the same but for rotation and
    mirroring, the fittest is taken. Maps that hardly differ are taken only where there are too few others; among the
    others every niche gives one before any gives a second, and all seeds as equally many as can be. Where the
    specification has targets, maps are chosen one by one so that the energy distance between the features of all
    chosen ones and the targets is least. Niches in the axes' target bins come before all others.

    Args:
      elites: of a search, with a leading seed axis.
      spec: of the search.
      axes: of the descriptor.
      count: how many maps are wanted.
      seed: of the run, to be noted in the maps.
      known: grids ``[H, W]`` that were chosen before; others are to differ from them too.
      least: the share of its tiles in which a map differs from all chosen before, however they are rotated or mirrored,
        at least; where there are too few such maps, the next share holds.

    Raises:
      InputError: for the result of one key alone.
    """
    valid = np.asarray(elites.valid)
    if valid.ndim != 2:
        raise InputError("result: expected one of an array of keys, with the seeds in front, got one of a single key")
    fitness, grids, metrics = np.asarray(elites.fitness), np.asarray(elites.grids), elites.measures()
    useful, rejected = without_flaws(valid, metrics, spec)
    satisfied = elites.satisfies(spec.where)
    nearest = None
    if not (useful & satisfied).any():
        nearest = _nearest(metrics, useful if useful.any() else valid, (grids.shape[2], grids.shape[3]), spec)
    rejected[_OUTSIDE] = int((useful & ~satisfied).sum())
    useful &= satisfied

    given = [np.array(grid, np.int8) for grid in spec.like]
    known = [*known, *(grid for grid in given if sorted(grid.shape) == sorted(grids.shape[2:]))]
    kept = _distinct(grids, fitness, useful, known, given)
    descriptor = np.asarray(elites.descriptor)[tuple(kept.T)]
    bins = np.asarray(niche_bins(descriptor, axes))
    extent = np.array([max(1, axis.bins - 1) for axis in axes])
    # Niches outside the target bins were stepping stones for the search; they give maps where the others have too few.
    targeted = np.ones(len(kept), bool)
    for number, axis in enumerate(axes):
        if axis.target is not None:
            targeted &= bins[:, number] == axis.target
    targets = spec.targets
    pursuit = Pursuit(_target_features(metrics, kept, targets), targets) if targets else None
    chosen: list[int] = []
    for group in (np.flatnonzero(targeted), np.flatnonzero(~targeted)):
        before = [*known, *(grids[tuple(kept[number])] for number in chosen)]
        candidates, wanted = grids[tuple(kept[group].T)], count - len(chosen)
        if pursuit is None:
            part = _spread((bins / extent)[group], kept[group, 0], candidates, wanted, before, least)
        else:
            part = _pursue(pursuit, group, candidates, wanted, before, least)
        chosen += group[part].tolist()
    chosen.sort(key=lambda number: (*bins[number], number))
    maps = [
        RoadMap(
            codes=grids[tuple(kept[number])],
            metrics={name: _value(name, values[tuple(kept[number])].item()) for name, values in metrics.items()},
            fitness=int(fitness[tuple(kept[number])]),
            descriptor={axis.metric: int(v) for axis, v in zip(axes, descriptor[number], strict=True)},
            niche=bins[number].tolist(),
            seed=(seed, int(kept[number][0])),
        )
        for number in chosen
    ]
    reasons = {words: number for words, number in rejected.items() if number}
    return Choice(maps, int(valid.sum()), reasons, int(useful.sum()) - len(kept), nearest)


def describe_choice(choice: Choice, maps: int) -> str:
    """Describes a choice of so many maps: how many were found, and the reasons against the others."""
    rejected = [f"{number} {reason}" for reason, number in choice.rejected.items()]
    if choice.alike:
        rejected.append(f"{choice.alike} like another when rotated or mirrored")
    return f"found {len(choice.maps)} of {pluralize(maps, 'map')} among {pluralize(choice.found, 'elite')}" + (
        f" ({', '.join(rejected)})" if rejected else ""
    )


def describe_shortage(choice: Choice, maps: int, more: str, *, writable: bool = True) -> str:
    """Describes a choice with too few maps: the reasons against the others, and what finds more.

    Args:
      choice: the choice.
      maps: how many were wanted.
      more: words for what finds more.
      writable: whether the found ones could be written.
    """
    flawed = "" if _OUTSIDE in choice.rejected else ", with other flaws"
    return (
        describe_choice(choice, maps)
        + (f"; nearest found{flawed}: {_values(choice.nearest)}" if choice.nearest else "")
        + ("; --at-most writes those found" if writable and choice.maps else "")
        + f"; {more} find more"
    )


def without_flaws(
    valid: NDArray[np.bool_], metrics: dict[str, NDArray[np.generic]], spec: SearchSpec
) -> tuple[NDArray[np.bool_], Counter[str]]:
    """Returns which elites have no flaw, and the number of the others by reason.

    Args:
      valid: which places hold an elite, in whatever shape.
      metrics: by name, of the same shape.
      spec: of the search, whose rules and given cells say what a flaw is.
    """
    rejected: Counter[str] = Counter()
    useful = valid.copy()
    for name, right, words in find_flaws(spec.rules, filled=spec.fills and spec.fix is None):
        flawed = useful & (metrics[name] != right)
        rejected[words] += int(flawed.sum())
        useful &= ~flawed
    return useful, rejected


def _distinct(
    grids: NDArray[np.int8],
    fitness: NDArray[np.int32],
    useful: NDArray[np.bool_],
    known: Sequence[NDArray[np.int8]],
    given: Sequence[NDArray[np.int8]],
) -> NDArray[np.int_]:
    """Returns the (seed, place) of useful elites, fittest first, each unlike all before, all known and all given ones.

    Wherever a given map's roads lie in a larger grid, it is that map.
    """
    places = np.argwhere(useful)
    places = places[np.argsort(fitness[useful], kind="stable")]
    seen = {canonical_form(grid) for grid in known}
    roads = {canonical_form(cut_to_roads(grid)) for grid in given}
    distinct: dict[bytes, NDArray[np.int_]] = {}
    for place in places:
        grid = grids[tuple(place)]
        form = canonical_form(grid)
        if form not in seen and not (roads and canonical_form(cut_to_roads(grid)) in roads):
            distinct.setdefault(form, place)
    return np.array(list(distinct.values()), int).reshape(-1, 2)


def _values(features: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:g}" for name, value in features.items())


def remedy(choice: Choice, method: str, shape: tuple[int, int]) -> str:
    """Returns words for what finds more maps than a choice has, of a method's search for maps ``(height, width)``."""
    if choice.nearest:
        return "wider ranges, more seeds or evaluations"
    if method == "ea":  # its population becomes more alike with time
        return "more seeds"
    if max(choice.rejected, key=lambda reason: choice.rejected[reason], default="").endswith("the tile set lacks"):
        return "a tile set with more kinds of tiles, more seeds or evaluations"
    larger = "larger maps, " if min(shape) < 4 else ""
    return f"{larger}more seeds or evaluations"


def _nearest(
    metrics: dict[str, NDArray[np.generic]], among: NDArray[np.bool_], shape: tuple[int, int], spec: SearchSpec
) -> dict[str, float] | None:
    """Returns the constrained features of the elite that violates the ranges least; among equals of the first."""
    if not among.any():
        return None
    extras = extra_names(item.name for item in spec.where)
    features = compute_features(join_counts(metrics, extras)[among])
    place = int(np.argmin(violation(features, bounds_of(spec.where, extras), shape, extras)))
    values = dict(zip((*FEATURES, *extras), features[place].tolist(), strict=True))
    return {item.name: values[item.name] / feature_unit(item.name) for item in spec.where}


def _value(name: str, number: float) -> float:
    """Returns a metric as it is, an extra feature in its own unit."""
    return number / feature_unit(name) if name not in FEATURES and feature_unit(name) != 1 else number


def _target_features(
    metrics: dict[str, NDArray[np.generic]], kept: NDArray[np.int_], targets: Sequence[Target]
) -> NDArray[np.float64]:
    """Returns the features of kept maps for which there are targets, in their order and units."""
    names = [target.name for target in targets]
    extras = extra_names(names)
    features = compute_features(join_counts({name: values[tuple(kept.T)] for name, values in metrics.items()}, extras))
    return features[:, feature_places(names)] / np.array([feature_unit(name) for name in names])


def _spread(
    points: NDArray[np.float64],
    seeds: NDArray[np.int_],
    grids: NDArray[np.int8],
    count: int,
    before: Sequence[NDArray[np.int8]],
    shares: Sequence[float],
) -> list[int]:
    """Chooses up to `count` of the maps `grids` ``[M, H, W]`` at `points` ``[M, D]``, found by `seeds` ``[M]``.

    Maps come fittest first. Every point gives one before any gives a second. Where the round is the last and not all
    have a turn, the next is always the point farthest from those that had one. A point gives a map of the seed that has
    given fewest so far, as maps of one seed are related. Each differs from those before and from each other in the
    first of the shares of its tiles, then in the next.
    """
    difference = _least_difference(grids, before)  # under 0 for the chosen ones
    given: Counter[int] = Counter()
    chosen: list[int] = []
    for least in shares:
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


def _pursue(
    pursuit: Pursuit,
    group: NDArray[np.int_],
    grids: NDArray[np.int8],
    count: int,
    before: Sequence[NDArray[np.int8]],
    shares: Sequence[float],
) -> list[int]:
    """Chooses up to `count` of a group's maps `grids` ``[M, H, W]``, as the pursuit goes; of equals the first.

    Each differs from those before and from each other in the first of the shares of its tiles, then in the next.
    """
    difference = _least_difference(grids, before)
    chosen: list[int] = []
    for least in shares:
        while len(chosen) < count and (difference >= least).any():
            number = int(np.argmin(np.where(difference >= least, pursuit.losses()[group], np.inf)))
            pursuit.choose(int(group[number]))
            chosen.append(number)
            difference = np.minimum(difference, _difference(grids, grids[number]))
            difference[number] = -1
    return chosen


def _least_difference(grids: NDArray[np.int8], before: Sequence[NDArray[np.int8]]) -> NDArray[np.float64]:
    """Returns the difference of each map from the nearest of those before; 1 where there is none."""
    difference = np.ones(len(grids))
    for grid in before if len(grids) else ():
        difference = np.minimum(difference, _difference(grids, grid))
    return difference


def _difference(grids: NDArray[np.int8], grid: NDArray[np.int8]) -> NDArray[np.float64]:
    """Returns the share of tiles in which each of ``[M, H, W]`` differs from the most similar image of a map."""
    images = [rotate(side, turns) for side in (grid, mirror(grid)) for turns in range(4)]
    return np.min([(grids != image).mean(axis=(1, 2)) for image in images if image.shape == grid.shape], axis=0)


def _farthest(points: NDArray[np.float64], count: int) -> list[int]:
    """Returns up to `count` places: the first, then always the one farthest from all before; of equals the first."""
    places: list[int] = []
    distance = np.full(len(points), np.inf)
    for _ in range(min(count, len(points))):
        places.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[places[-1]], axis=1))
        distance[places] = -1
    return places
