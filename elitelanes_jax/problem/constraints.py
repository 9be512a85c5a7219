"""Constraints on a network: ranges of features, and how far a network violates them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import LARGEST, check_unique, split_settings
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray, Numeric, UserValue
from elitelanes_jax.network.counts import COUNT_NAMES
from elitelanes_jax.problem.features import FEATURES, SHARE_UNIT, SHARES, check_feature, feature_unit, is_share

# The fitness that a unit of distance from a range adds: as much as a dead end, so that no flaw is traded for it.
_STEEPNESS = 480


class Range(NamedTuple):
    """A feature between two limits, both included.

    Attributes:
      name: of the feature, a metric or a share.
      low: the lower limit, of a share as a part of 1; None for no limit.
      high: the upper limit, of a share as a part of 1; None for no limit.
    """

    name: str
    low: Fraction | None
    high: Fraction | None

    def __str__(self) -> str:
        """Returns the text that `parse_ranges` reads."""
        low, high = ("" if limit is None else _format(limit) for limit in self[1:])
        return f"{self.name}={low}" if self.low == self.high else f"{self.name}={low}..{high}"


class Bounds(NamedTuple):
    """Limits of all features, as arrays, so that other constraints need no second compilation.

    Attributes:
      low: int32 ``[F + K]``, in the order of `compute_features`, shares in thousandths.
      high: int32 ``[F + K]``, in the same order and units.
    """

    low: Numeric
    high: Numeric


def parse_ranges(where: UserValue, own: Collection[str] | None = ()) -> tuple[Range, ...]:
    """Reads ranges from texts such as ``crossings=6..10``, ``bridges=0``, ``straight_share=0.3..``, or a mapping.

    Args:
      where: texts, or one with spaces between; or a mapping of names to numbers, texts such as ``6..10``, or pairs of
        numbers, None for no limit; or `Range` records.
      own: names of features of one's own; None lets any name pass.

    Raises:
      InputError: for anything else, an unknown feature, limits in the wrong order, or one feature given twice.
    """
    if isinstance(where, str):
        where = split_settings(where)
    elif isinstance(where, Range):
        where = [where]
    if isinstance(where, Mapping):
        given = [_range(f"where: {name}", name, limits, own) for name, limits in where.items()]
    elif isinstance(where, Iterable):
        given = [
            _range("where", item.name, item[1:], own) if isinstance(item, Range) else _parse(item, own)
            for item in where
        ]
    else:
        raise InputError(f"where: expected ranges such as ['crossings=6..10'], got {where!r}")
    check_unique("where", "feature", [item.name for item in given])
    return tuple(given)


def bounds_of(where: Iterable[Range], extras: Sequence[str] = ()) -> Bounds:
    """Returns the limits as arrays; features without a range have no limits.

    Args:
      where: the ranges.
      extras: the names of the extra features, K of them, in the order of their columns.
    """
    names = (*FEATURES, *extras)
    low, high = np.full(len(names), -LARGEST, np.int32), np.full(len(names), LARGEST, np.int32)
    for item in where:
        place, unit = names.index(item.name), feature_unit(item.name)
        if item.low is not None:
            low[place] = ceil(item.low * unit)
        if item.high is not None:
            high[place] = floor(item.high * unit)
    return Bounds(low, high)


def violation(features: AnyArray, bounds: Bounds, shape: tuple[int, int], extras: Sequence[str] = ()) -> AnyArray:
    """Computes what the distance from the bounds adds to the fitness: 0 where all are met.

    A unit of distance is one of a count, the share of one cell, or the gain of one more tile in a long straight.

    Args:
      features: int32 ``[..., F + K]``, of NumPy or JAX.
      bounds: to be met.
      shape: (height, width) of the grids.
      extras: the names of the extra features, K of them, in the order of their columns.

    Returns:
      int32 ``[...]``, of the same library.
    """
    names = (*FEATURES, *extras)
    units = {name: (shape[0] * shape[1], SHARE_UNIT) for name in names if feature_unit(name) != 1}
    units |= {"straight_score": (1, 2 * max(shape)), "adjacent_crossing_score": (1, 8)}
    factor, divisor = np.array([units.get(name, (1, 1)) for name in names], np.int32).T
    distance = (bounds.low - features).clip(0, None) + (features - bounds.high).clip(0, None)
    distance = distance.clip(None, LARGEST // factor)
    steps = ((distance * factor + divisor - 1) // divisor).clip(None, LARGEST // (_STEEPNESS * len(names)))
    return _STEEPNESS * steps.sum(axis=-1, dtype=np.int32)


def satisfies(metrics: Mapping[str, AnyArray], where: Iterable[Range]) -> NDArray[np.bool_]:
    """Tells which networks satisfy all ranges, exactly.

    Args:
      metrics: the metrics by name, and the extra features, whole numbers of one shape.
      where: the ranges.

    Returns:
      bool, of the shape of the metrics.
    """
    good = np.ones(np.shape(metrics[COUNT_NAMES[0]]), bool)
    for item in where:
        part, whole = SHARES.get(item.name, (item.name, ()))
        value = np.asarray(metrics[part], np.int64)
        total: AnyArray = (
            sum(np.asarray(metrics[name], np.int64) for name in whole) if whole else feature_unit(item.name)
        )
        for limit, sign in ((item.low, 1), (item.high, -1)):
            if limit is not None:
                good &= sign * (value * limit.denominator - total * limit.numerator) >= 0
    return good


def _parse(text: UserValue, own: Collection[str] | None) -> Range:
    source = f"where {text!r}"
    name, equals, limits = text.partition("=") if isinstance(text, str) else ("", "", "")
    if not equals:
        raise InputError(f"{source}: expected NAME=LOW..HIGH, such as crossings=6..10")
    return _range(source, name.strip(), limits.strip(), own)


def _range(source: str, name: UserValue, limits: UserValue, own: Collection[str] | None) -> Range:
    check_feature(source, name, own)
    if isinstance(limits, str) and ".." in limits:
        limits = [limit.strip() or None for limit in limits.split("..", 1)]
    pair = limits if isinstance(limits, tuple | list) else (limits, limits)
    if len(pair) != 2:
        raise InputError(f"{source}: expected a number or two limits, got {shorten(repr(limits))}")
    if all(limit is None for limit in pair):
        raise InputError(f"{source}: expected at least one limit, got none")
    low, high = (None if limit is None else _limit(source, name, limit) for limit in pair)
    if low is not None and high is not None and low > high:
        raise InputError(f"{source}: expected the lower limit first, got {_format(low)} before {_format(high)}")
    return Range(name, low, high)


def _limit(source: str, name: str, limit: UserValue) -> Fraction:
    text = str(limit)
    try:
        # As a fraction 1e99999999 would fill the memory.
        number = Fraction(float(text) if "e" in text.lower() else text)
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(f"{source}: expected a number, got {shorten(repr(limit))}") from None
    most = 1 if is_share(name) else LARGEST
    if not 0 <= number <= most:
        unit = " (a part of 1)" if is_share(name) else ""
        raise InputError(f"{source}: expected 0 to {most:,}{unit}, got {shorten(text)}")
    if feature_unit(name) == 1 and number.denominator != 1:
        raise InputError(f"{source}: expected whole numbers, got {shorten(text)}")
    # The third that 0.333333333 stands for; small denominators keep sums within 64 bits.
    return number.limit_denominator(10**6)


def _format(limit: Fraction) -> str:
    return str(limit if limit.denominator == 1 else float(limit))
