"""Example values: features of example maps. The chosen maps should have the same distribution."""

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from elitelanes_jax._util.checks import LARGEST, check_named, check_unique, items_of, real
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.problem.features import check_feature, is_share


class ExampleValues(NamedTuple):
    """The values of one feature on all example maps.

    Attributes:
      name: the name of the feature.
      values: one value for each map, of a share as a part of 1.
    """

    name: str
    values: tuple[float, ...]


def parse_targets(targets: UserValue, features: Collection[str] = ()) -> tuple[ExampleValues, ...]:
    """Reads example values from a mapping of features to values, or from pairs of them.

    Each feature has one value per example map, in the same order. Raises `InputError` for anything
    else, an unknown or repeated feature, a value out of range, or features with different numbers
    of values.
    """
    pairs = targets.items() if isinstance(targets, Mapping) else targets
    if isinstance(pairs, str) or not isinstance(pairs, Iterable):
        raise InputError("targets", "features with their values", quote(targets))
    read = tuple(_example_values(pair, features) for pair in pairs)
    check_unique("targets", "feature", [item.name for item in read])
    if read and any(len(item.values) != len(read[0].values) for item in read):
        counts = ", ".join(f"{item.name} {len(item.values)}" for item in read)
        raise InputError("targets", "the same number of values of each feature", counts)
    return read


class SupportPoints:
    """Chooses maps one by one, so that their features are distributed like example values.

    The next map is the one that minimises the energy distance (Székely and Rizzo, 2013) between the
    chosen maps and the examples: greedy support points (Mak and Joseph, 2018). A feature is
    measured in standard deviations of its example values; if those are all equal, in standard
    deviations of the candidates.

    Args:
      features: float ``[M, D]``, of the candidates, in the units of the examples.
      examples: the values of D features on T example maps.
    """

    def __init__(
        self, features: Float[np.ndarray, "M D"], examples: Iterable[ExampleValues]
    ) -> None:
        values = np.array([item.values for item in examples]).T
        # A feature without any spread, in the examples and in the candidates, keeps its own unit.
        scale = _spread(values)
        if len(features):
            scale = np.where(scale > 0, scale, _spread(features))
        scale = np.where(scale > 0, scale, 1)
        self._points = features / scale
        total = np.zeros(len(features))
        for point in values / scale:
            total += self._distances(point)
        # These are the mean distance of each candidate to the examples, and its total distance to
        # the chosen maps.
        self._to_examples = total / len(values)
        self._to_chosen = np.zeros(len(features))
        self._count = 0

    def losses(self) -> Float[np.ndarray, " M"]:
        """Returns the energy distance after choosing each candidate, up to a constant."""
        # If n maps are chosen, a candidate adds 2 / (n + 1) times this to the energy distance.
        # Rounding makes equal candidates tie, also if the last bits of their sums differ.
        return np.round(self._to_examples - self._to_chosen / (self._count + 1), 9)

    def choose(self, index: int) -> None:
        """Chooses a candidate."""
        self._to_chosen += self._distances(self._points[index])
        self._count += 1

    def _distances(self, point: Float[np.ndarray, " D"]) -> Float[np.ndarray, " M"]:
        return np.linalg.norm(self._points - point, axis=1)


def _spread(values: Float[np.ndarray, "N D"]) -> Float[np.ndarray, " D"]:
    """Returns the standard deviation of each column; 0 if its values are equal."""
    # The mean of three times 0.1 is not 0.1, so the deviation of equal values may be 1e-17.
    return np.where(np.ptp(values, axis=0) > 0, values.std(axis=0), 0)


def _example_values(pair: UserValue, features: Collection[str]) -> ExampleValues:
    try:
        first, second = items_of(pair)
        values = list(items_of(second))
    except (TypeError, ValueError):
        raise InputError("targets", "a feature with its values", quote(pair)) from None
    name = check_feature("targets", first, features)
    least = -LARGEST if name in features else 0
    most = 1 if is_share(name) else LARGEST
    check = real(least, most)
    read = tuple(check_named(f"targets: {name}", check, value) for value in values)
    if not read:
        raise InputError(f"targets: {name}", "at least one value", "none")
    return ExampleValues(name, read)
