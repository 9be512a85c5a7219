"""What a user asks of a map: ranges of features, and how far a map is from them."""

from collections.abc import Iterable, Mapping
from fractions import Fraction
from math import ceil, floor
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from chex import Array
from numpy.typing import NDArray

from elitelanes_jax.checks import LARGEST, check_once
from elitelanes_jax.errors import InputError, short
from elitelanes_jax.features import FEATURES, SHARES, WHOLE, check_feature
from elitelanes_jax.metrics import COUNTED

__all__ = ["Range", "Ranges", "meets", "ranges_of", "read_ranges", "shortfall"]

# What a unit of distance from a range adds to the fitness: as much as a dead end, so that no flaw is traded for it.
_STEEPNESS = 480


class Range(NamedTuple):
    """A feature between two limits, both included.

    Attributes:
      name: of the feature, a metric or a share.
      low: the least, a share as a part of 1; None where there is no limit.
      high: the most, likewise.
    """

    name: str
    low: Fraction | None
    high: Fraction | None

    def __str__(self) -> str:
        low, high = ("" if limit is None else _text(limit) for limit in self[1:])
        return f"{self.name}={low}" if self.low == self.high else f"{self.name}={low}..{high}"


class Ranges(NamedTuple):
    """Limits of all features, as arrays, so that another request needs no second compilation.

    Attributes:
      low: int32 ``[F]``, in the order of `FEATURES`, shares in thousandths.
      high: likewise.
    """

    low: Array
    high: Array


def read_ranges(where: Any) -> tuple[Range, ...]:
    """Ranges from texts such as ``crossings=6..10``, ``bridges=0``, ``straight_share=0.3..``, or from a mapping.

    Args:
      where: texts; or a mapping of names to numbers or to pairs of them, None for no limit; or `Range` records.

    Raises:
      InputError: for what is no range, an unknown feature, limits in the wrong order, or one feature given twice.
    """
    if isinstance(where, Mapping):
        given = [_range(f"where: {name}", name, limits) for name, limits in where.items()]
    elif isinstance(where, Iterable) and not isinstance(where, str):
        given = [_range("where", item.name, item[1:]) if isinstance(item, Range) else _read(item) for item in where]
    else:
        raise InputError(f"where: expected ranges such as ['crossings=6..10'], got {where!r}")
    check_once("where", "feature", [item.name for item in given])
    return tuple(given)


def ranges_of(where: Iterable[Range]) -> Ranges:
    """The limits as arrays; features that are not named have none."""
    low, high = np.full(len(FEATURES), -LARGEST, np.int32), np.full(len(FEATURES), LARGEST, np.int32)
    for item in where:
        place, unit = FEATURES.index(item.name), WHOLE if item.name in SHARES else 1
        if item.low is not None:
            low[place] = ceil(item.low * unit)
        if item.high is not None:
            high[place] = floor(item.high * unit)
    return Ranges(low, high)


def shortfall(features: Array, ranges: Ranges, shape: tuple[int, int]) -> Array:
    """What the distance from the ranges adds to the fitness, int32 ``[...]``: 0 where all are met.

    A unit is one of a count, the share of a cell, or what one tile more in a long straight is worth.

    Args:
      features: int32 ``[..., F]``.
      ranges: to be met.
      shape: (height, width) of the grids.
    """
    units = dict.fromkeys(SHARES, (shape[0] * shape[1], WHOLE))
    units |= {"straight_score": (1, 2 * max(shape)), "adjacent_crossing_score": (1, 8)}
    times, over = np.array([units.get(name, (1, 1)) for name in FEATURES], np.int32).T
    distance = jnp.maximum(ranges.low - features, 0) + jnp.maximum(features - ranges.high, 0)
    distance = jnp.minimum(distance, LARGEST // times)
    steps = jnp.minimum((distance * times + over - 1) // over, LARGEST // (_STEEPNESS * len(FEATURES)))
    return _STEEPNESS * steps.sum(axis=-1, dtype=jnp.int32)


def meets(metrics: Mapping[str, Any], where: Iterable[Range]) -> NDArray[np.bool_]:
    """Where networks meet all ranges, exactly: bool, of the shape of the metrics.

    Args:
      metrics: the metrics by name, whole numbers of one shape.
      where: the ranges.
    """
    good = np.ones(np.shape(metrics[COUNTED[0]]), bool)
    for item in where:
        part, whole = SHARES.get(item.name, (item.name, ()))
        value = np.asarray(metrics[part], np.int64)
        total = sum((np.asarray(metrics[name], np.int64) for name in whole), np.int64(0)) if whole else np.int64(1)
        for limit, sign in ((item.low, 1), (item.high, -1)):
            if limit is not None:
                good &= sign * (value * limit.denominator - total * limit.numerator) >= 0
    return good


def _read(text: Any) -> Range:
    where = f"where {text!r}"
    name, equals, limits = text.partition("=") if isinstance(text, str) else ("", "", "")
    if not equals:
        raise InputError(f"{where}: expected NAME=LOW..HIGH, such as crossings=6..10")
    low, dots, high = limits.partition("..")
    return _range(where, name.strip(), (low.strip() or None, high.strip() or None) if dots else low.strip())


def _range(where: str, name: Any, limits: Any) -> Range:
    check_feature(where, name)
    pair = limits if isinstance(limits, tuple | list) else (limits, limits)
    if len(pair) != 2:
        raise InputError(f"{where}: expected a number or two limits, got {short(repr(limits))}")
    if all(limit is None for limit in pair):
        raise InputError(f"{where}: expected at least one limit, got none")
    low, high = (None if limit is None else _limit(where, name, limit) for limit in pair)
    if low is not None and high is not None and low > high:
        raise InputError(f"{where}: expected the lower limit first, got {_text(low)} before {_text(high)}")
    return Range(name, low, high)


def _limit(where: str, name: str, limit: Any) -> Fraction:
    text = str(limit)
    try:
        # As a fraction 1e99999999 would fill the memory.
        number = Fraction(float(text) if "e" in text.lower() else text)
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(f"{where}: expected a number, got {short(repr(limit))}") from None
    most = 1 if name in SHARES else LARGEST
    if not 0 <= number <= most:
        unit = " (a part of 1)" if name in SHARES else ""
        raise InputError(f"{where}: expected 0 to {most:,}{unit}, got {short(text)}")
    if name not in SHARES and number.denominator != 1:
        raise InputError(f"{where}: expected whole numbers, got {short(text)}")
    return number.limit_denominator(10**6)  # the third that 0.333333333 stands for; it keeps sums within 64 bits


def _text(limit: Fraction) -> str:
    return str(limit) if limit.denominator == 1 else f"{float(limit):g}"
