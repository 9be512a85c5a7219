"""Targets: features of example maps, among whose values those of chosen maps are spread."""

from collections.abc import Collection, Iterable, Mapping
from math import isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import LARGEST, check_unique
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.problem.features import check_feature, is_share


class Target(NamedTuple):
    """A feature of all example maps.

    Attributes:
      name: of the feature, a metric or a share.
      values: of each map, of a share as a part of 1.
    """

    name: str
    values: tuple[float, ...]


def parse_targets(targets: UserValue, own: Collection[str] = ()) -> tuple[Target, ...]:
    """Reads targets from a mapping of features to the values that example maps have, or from pairs of them.

    Args:
      targets: the features, each with one value for each map, in the same order.
      own: names of features of one's own.

    Raises:
      InputError: for anything else, an unknown feature, one given twice, a value out of range, or features with other
        numbers of values.
    """
    pairs = targets.items() if isinstance(targets, Mapping) else targets
    if isinstance(pairs, str) or not isinstance(pairs, Iterable):
        raise InputError(f"targets: expected features with their values, got {shorten(repr(targets))}")
    read = tuple(_target(pair, own) for pair in pairs)
    check_unique("targets", "feature", [target.name for target in read])
    if len({len(target.values) for target in read}) > 1:
        counts = ", ".join(f"{target.name} {len(target.values)}" for target in read)
        raise InputError(f"targets: expected as many values of each feature, got {counts}")
    return read


class Pursuit:
    """A choice, one by one, of maps whose features are spread as those of the targets.

    The next map is the one that leaves the least energy distance (Székely and Rizzo, 2013) between the chosen maps and
    the targets: support points (Mak and Joseph, 2018), greedily. A feature is measured in standard deviations of its
    targets; of the candidates, where all targets are equal.

    Args:
      features: float ``[M, D]``, of the candidates, in the units of the targets.
      targets: D of them, with T values each.
    """

    def __init__(self, features: NDArray[np.float64], targets: Iterable[Target]) -> None:
        wanted = np.array([target.values for target in targets]).T
        scale = np.where(wanted.std(axis=0) > 0, wanted.std(axis=0), features.std(axis=0) if len(features) else 0)
        scale = np.where(scale > 0, scale, 1)
        self._points = features / scale
        self._to_wanted = sum(self._distances(point) for point in wanted / scale) / len(wanted)
        self._to_chosen = np.zeros(len(features))
        self._count = 0

    def losses(self) -> NDArray[np.float64]:
        """Returns by how much each candidate would leave the distance larger than another, up to a common term."""
        return np.round(self._to_wanted - self._to_chosen / (self._count + 1), 9)

    def choose(self, number: int) -> None:
        """Takes a candidate."""
        self._to_chosen += self._distances(self._points[number])
        self._count += 1

    def _distances(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.linalg.norm(self._points - point, axis=1)


def _target(pair: UserValue, own: Collection[str]) -> Target:
    try:
        name, values = pair
        values = [*values]
    except (TypeError, ValueError):
        raise InputError(f"targets: expected a feature with its values, got {shorten(repr(pair))}") from None
    check_feature("targets", name, own)
    most = 1 if is_share(name) else LARGEST
    for value in values:
        if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
            raise InputError(f"targets: {name}: expected numbers, got {shorten(repr(value))}")
        if not 0 <= value <= most:
            raise InputError(f"targets: {name}: expected 0 to {most:,}, got {shorten(repr(value))}")
    if not values:
        raise InputError(f"targets: {name}: expected at least one value, got none")
    return Target(str(name), tuple(map(float, values)))
