"""Ranges: the values of a feature that a user allows, and the penalty of a network outside them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from fractions import Fraction
from math import ceil, floor
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int32

from elitelanes_jax._util.checks import LARGEST, check_unique, split_settings
from elitelanes_jax._util.errors import InputError, quote, shorten
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, ArrayT, Untyped, UserValue
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.problem.features import (
    FEATURES,
    SHARE_UNIT,
    SHARES,
    TOWN_FEATURES,
    check_feature,
    feature_unit,
    is_share,
    with_shares,
)

# The penalty of one unit of distance equals that of a dead end, so that the search does not
# exchange the two.
_STEEPNESS = 480


class Range(NamedTuple):
    """The values that a feature may have, both limits included.

    Attributes:
      name: the name of the feature.
      low: the lower limit, of a share as a part of 1; None for no limit.
      high: the upper limit, of a share as a part of 1; None for no limit.
    """

    name: str
    low: Fraction | None
    high: Fraction | None

    def __str__(self) -> str:
        """Returns the text that `parse_ranges` reads."""
        low = _format(self.low)
        high = _format(self.high)
        if self.low == self.high:
            return f"{self.name}={low}"
        return f"{self.name}={low}..{high}"


def parse_ranges(where: UserValue, features: Collection[str] | None = ()) -> tuple[Range, ...]:
    """Reads ranges from texts or a mapping.

    Texts are such as ``crossings=6..10``, ``bridges=0`` or ``straight_share=0.3..``.

    Args:
      where: texts, or one text with spaces between ranges; or a mapping of names to numbers, texts
        such as ``6..10``, or pairs of numbers with None for no limit; or several `Range` records.
      features: the names of the user's features; None accepts any name.

    Raises:
      InputError: for anything else, an unknown feature, limits in the wrong order, or a repeated
        feature.
    """
    if isinstance(where, str):
        where = split_settings(where)
    if isinstance(where, Mapping):
        ranges = [
            _range(f"where: {name}", name, limits, features) for name, limits in where.items()
        ]
    elif isinstance(where, Iterable):
        ranges = [_read_range(item, features) for item in where]
    else:
        raise InputError("where", "ranges such as ['crossings=6..10']", quote(where))
    check_unique("where", "feature", [item.name for item in ranges])
    return tuple(ranges)


def range_limits(where: Iterable[Range], feature_names: Sequence[str]) -> Int32[np.ndarray, "2 C"]:
    """Returns the lower and upper limits of all columns of `with_shares`, int32 ``[2, C]``.

    Limits of shares are in thousandths. As an array, ranges can be traced, so that other ranges
    need no compilation.
    """
    # Columns without a range get limits that no value exceeds.
    names = [*feature_names, *SHARES]
    lower = np.full(len(names), -LARGEST, np.int32)
    upper = np.full(len(names), LARGEST, np.int32)
    for name, low, high in where:
        column = names.index(name)
        unit = feature_unit(name)
        if low is not None:
            # Thousandths of shares are rounded down, so their limit is too.
            rounded = floor if name in SHARES else ceil
            lower[column] = min(rounded(low * unit), LARGEST)
        if high is not None:
            upper[column] = min(floor(high * unit), LARGEST)
    return np.stack([lower, upper])


def range_penalty(
    features: ArrayT, feature_names: Sequence[str], limits: AnyArray, shape: tuple[int, int]
) -> ArrayT:
    """Returns the penalty for the distance from the ranges.

    The penalty is 480 for each unit, and 0 for a network in all ranges. A unit is 1 of a whole
    number, the share of one cell, or the gain of one more tile in a long straight.

    Takes features int32 ``[..., F]`` of NumPy or JAX, and limits as `range_limits` returns them,
    which may be traced. Returns int32 ``[...]`` of the same library, at most `largest_penalty`.
    """
    features, names = with_shares(features, feature_names)
    factors, divisors = _factors_of_units(names, shape)
    # The arrays of columns get as many axes as the features, see `xla.align`.
    aligned = (1,) * (features.ndim - 1) + (-1,)
    factors = factors.reshape(aligned)
    divisors = divisors.reshape(aligned)
    limits = limits.reshape(2, *aligned)
    below = (limits[0] - features).clip(0, None)
    above = (features - limits[1]).clip(0, None)
    # Distances are limited, so that their products fit int32.
    distance = (below + above).clip(None, LARGEST // factors) * factors
    # The columns of each divisor are divided together, because processors divide by a constant many
    # times as fast as by numbers that differ between columns.
    units: Untyped = 0
    for constant in np.unique(divisors).tolist():
        has_divisor = (divisors == constant).astype(np.int32)
        units += has_divisor * ((distance + constant - 1) // constant)
    units = units.clip(None, _most_units(len(names)))
    return _STEEPNESS * units.sum(axis=-1, dtype=np.int32)


def _factors_of_units(
    names: Sequence[str], shape: tuple[int, int]
) -> tuple[Int32[np.ndarray, " C"], Int32[np.ndarray, " C"]]:
    """Returns the factor and the divisor by which a distance in each column becomes units."""
    factors = np.ones(len(names), np.int32)
    divisors = np.ones(len(names), np.int32)
    for column, name in enumerate(names):
        if name == "straight_score":
            # One more tile in a run of L straights adds 2 L + 1.
            divisors[column] = 2 * max(shape)
        elif name == "adjacent_crossing_score":
            # A linked pair of crossings scores at most 8.
            divisors[column] = 8
        elif feature_unit(name) != 1:
            # One cell is a share of 1 / cells, and a share is stored in thousandths.
            factors[column] = shape[0] * shape[1]
            divisors[column] = SHARE_UNIT
    return factors, divisors


def largest_penalty(ranges: int, feature_names: Sequence[str]) -> int:
    """Returns the most that `range_penalty` returns for a number of ranges."""
    return ranges * _STEEPNESS * _most_units(len(feature_names) + len(SHARES))


def _most_units(columns: int) -> int:
    """Returns the most units of distance in one column that count.

    With this limit, all columns together fit 32 bits.
    """
    return LARGEST // (_STEEPNESS * columns)


def satisfies(
    features: Mapping[str, ArrayOrRows], where: Iterable[Range]
) -> Bool[np.ndarray, "..."]:
    """Returns which networks are in all ranges, exactly.

    `features` has all metrics, and the other features with a range: whole numbers of one shape, by
    name.
    """
    inside = np.ones(np.shape(features[METRIC_NAMES[0]]), bool)
    for name, low, high in where:
        part, parts_of_whole = SHARES.get(name, (name, ()))
        # Products are compared instead of quotients, so nothing is rounded.
        value = np.asarray(features[part], np.int64)
        whole: int | np.ndarray = feature_unit(name)
        if parts_of_whole:
            # A share of nothing is 0.
            whole = np.maximum(sum(np.asarray(features[n], np.int64) for n in parts_of_whole), 1)
        if low is not None:
            inside &= value * low.denominator >= whole * low.numerator
        if high is not None:
            inside &= value * high.denominator <= whole * high.numerator
    return inside


def _read_range(item: UserValue, features: Collection[str] | None) -> Range:
    if isinstance(item, Range):
        return _range(f"where {str(item)!r}", item.name, (item.low, item.high), features)
    source = f"where {quote(item)}"
    name, _, limits = item.partition("=") if isinstance(item, str) else ("", "", "")
    if not limits.strip():
        raise InputError(source, "NAME=LOW..HIGH, such as crossings=6..10")
    return _range(source, name.strip(), limits.strip(), features)


def _range(
    source: str, name: UserValue, limits: UserValue, features: Collection[str] | None
) -> Range:
    feature = check_feature(source, name, features)
    if isinstance(limits, str) and ".." in limits:
        low_text, high_text = limits.split("..", 1)
        limits = (low_text.strip() or None, high_text.strip() or None)
    elif not isinstance(limits, tuple | list):
        limits = (limits, limits)
    if len(limits) != 2:
        raise InputError(source, "a number or two limits", quote(limits))
    low = _limit(source, feature, limits[0])
    high = _limit(source, feature, limits[1])
    if low is None and high is None:
        raise InputError(source, "at least one limit", "none")
    if low is not None and high is not None and low > high:
        got = f"{_format(low)} before {_format(high)}"
        raise InputError(source, "the lower limit first", got)
    return Range(feature, low, high)


def _limit(source: str, name: str, limit: UserValue) -> Fraction | None:
    """Returns a limit as an exact number; None for no limit."""
    if limit is None:
        return None
    # The text of a float has the digits that the user wrote: 0.3 is three tenths exactly.
    text = str(limit)
    try:
        # Python would read 1_000 as a number.
        if "_" in text:
            raise ValueError
        # An exponent is read by `float`, because Fraction("1e99999999") would fill the memory.
        number = Fraction(float(text) if "e" in text.lower() else text)
    except (ValueError, ZeroDivisionError, OverflowError):
        raise InputError(source, "a number", quote(limit)) from None
    is_users = name not in FEATURES and name not in TOWN_FEATURES
    least = -LARGEST if is_users else 0
    most = 1 if is_share(name) else LARGEST
    if not least <= number <= most:
        unit = " (a part of 1)" if is_share(name) else ""
        raise InputError(source, f"{least:,} to {most:,}{unit}", shorten(text))
    if feature_unit(name) == 1 and number.denominator != 1:
        raise InputError(source, "whole numbers", shorten(text))
    # The limit of the denominator makes 0.333333333 a third, and lets products fit 64 bits.
    return number.limit_denominator(10**6)


def _format(limit: Fraction | None) -> str:
    if limit is None:
        return ""
    if limit.denominator == 1:
        return str(limit)
    return str(float(limit))
