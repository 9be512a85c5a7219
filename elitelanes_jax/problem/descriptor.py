"""The descriptor space: axes, each a feature in bins, whose cells are niches.

The space is that of the paper's section "Behavior Descriptors".
"""

import re
from collections.abc import Collection, Mapping, Sequence
from math import prod
from typing import NamedTuple

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    LARGEST,
    check_named,
    check_unique,
    is_whole,
    items_of,
    listed,
    split_settings,
)
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import transfers
from elitelanes_jax._util.types import ArrayT, Untyped, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.problem.features import check_feature, default_width, select_features

MOST_NICHES = 2**20
"""The largest number of niches, so that the archives of a single seed fit in memory."""


# A whole number from 1, with at most nine leading zeros and 19 digits.
_WHOLE = "0{0,9}[1-9][0-9]{0,18}"
_AXIS_TEXT = re.compile(f"([^:]*):({_WHOLE})(?::({_WHOLE}))?", re.DOTALL)


class Axis(NamedTuple):
    """One axis of the descriptor space: a feature in bins of equal width.

    The first and the last bin are open.

    Attributes:
      metric: the name of the feature.
      bins: the number of bins.
      width: the width of a bin, for a share or a ratio in thousandths; 0 for one by the grid's
        shape.
      start: the value at which the first bin starts, in the unit of `width`.
      target: the bin whose niches the tuned MAP-Elites seeks; niches in other bins are stepping
        stones. By default all are sought. Other methods and presets do not use it.
    """

    metric: str
    bins: int
    width: int = 0
    start: int = 0
    target: int | None = None


_PAPER_AXES = (
    Axis("cyclomatic", 25),
    Axis("components", 2, 1, start=1),
    Axis("dead_ends", 2, 1),
    Axis("adjacent_crossings", 2, 1),
    Axis("adjacent_turns", 2, 1),
)

_TUNED_AXES = (_PAPER_AXES[0], *(flag._replace(target=0) for flag in _PAPER_AXES[1:]))


@name_wrong_arguments
def paper_axes(shape: tuple[int, int]) -> tuple[Axis, ...]:
    """Returns the paper's space of 400 niches: 25 bins of the cyclomatic number and four flags.

    A flag's first bin is the favourable value. The paper does not give the width of its bins. A
    width of 2 at 12 x 12 that grows with the grid's area covers the values in the paper's archive.
    Raises `InputError` for a bad shape.
    """
    return complete_axes(None, "paper", check_shape(shape))


@name_wrong_arguments
def tuned_axes(shape: tuple[int, int]) -> tuple[Axis, ...]:
    """Returns the paper's space with narrower bins and with targets.

    The target of each flag is its favourable value. At 12 x 12 bins of the cyclomatic number have
    width 1: 0 to 23, and 24 or more.
    """
    return complete_axes(None, "tuned", check_shape(shape))


def complete_axes(
    axes: tuple[Axis, ...] | None, preset: str, shape: tuple[int, int]
) -> tuple[Axis, ...]:
    """Returns checked axes, by default the axes of a preset, with widths for a shape.

    Width 0 is replaced by the default width on grids of the shape.
    """
    if not axes:
        axes = _TUNED_AXES
        if preset not in ("tuned", "irregular"):
            width = max(1, round(2 * shape[0] * shape[1] / 144))
            axes = (_PAPER_AXES[0]._replace(width=width), *_PAPER_AXES[1:])
    completed = []
    for axis in axes:
        width = axis.width or default_width(axis.metric, axis.bins, shape)
        completed.append(axis._replace(width=width))
    return tuple(completed)


def parse_axes(axes: UserValue, features: Collection[str] | None = ()) -> tuple[Axis, ...]:
    """Reads axes from texts, mappings or records.

    Args:
      axes: the axes: for each axis ``NAME:BINS``, ``NAME:BINS:WIDTH``, a mapping of the fields of
        `Axis`, or an `Axis`; or for all axes one text with spaces between, or a mapping of names to
        bins or to pairs of bins and width. A single `Axis` is one axis.
      features: the names of the user's features; None accepts any name.

    Raises:
      InputError: for anything else, an unknown or repeated feature, a number out of range, no axis,
        or more than `MOST_NICHES` niches.
    """
    if isinstance(axes, str):
        axes = split_settings(axes)
    # An axis is a tuple itself, whose fields are no axes.
    if isinstance(axes, Axis):
        axes = [axes]
    try:
        if isinstance(axes, Mapping):
            axes = [_axis_of(name, bins) for name, bins in axes.items()]
        checked = tuple(_check_axis(axis, features) for axis in items_of(axes))
    except TypeError:
        got = quote(axes)
        raise InputError("axes", "axes such as 'straight_share:10'", got) from None
    if not checked:
        raise InputError("axes", "at least one axis", "none")
    check_unique("axes", "metric", [axis.metric for axis in checked])
    niches = prod(axis.bins for axis in checked)
    if niches > MOST_NICHES:
        raise InputError("axes", f"at most {MOST_NICHES:,} niches", f"{niches:,}")
    return checked


def resolve_axes(
    axes: UserValue, shape: tuple[int, int], features: Collection[str] | None = ()
) -> tuple[Axis, ...]:
    """Reads axes as `parse_axes` does, and fills in default widths on grids of a shape."""
    return complete_axes(parse_axes(axes, features), "paper", shape)


def compute_descriptor(
    features: ArrayT, feature_names: Sequence[str], axes: tuple[Axis, ...]
) -> ArrayT:
    """Returns the values of the axes' features, int32 ``[..., D]``.

    The features are ``[..., F]`` of NumPy or JAX.
    """
    return select_features(features, feature_names, [axis.metric for axis in axes])


@name_wrong_arguments
def niche_bins(descriptor: ArrayT, axes: tuple[Axis, ...]) -> ArrayT:
    """Returns the bin on each axis, int32 ``[..., D]``, of descriptors ``[..., D]``.

    The arrays are of NumPy or JAX. Raises `InputError` for no axes, another shape, or descriptors
    that are not whole numbers.
    """
    check_named("axes", listed(Axis), axes)
    if not axes:
        raise InputError("axes", "at least one", "none")
    for axis in axes:
        if axis.bins < 1 or axis.width < 1:
            got = f"{axis.bins} of width {axis.width}"
            raise InputError(
                f"axes {axis.metric!r}", "at least one bin, of a width of at least 1", got
            )
    if np.shape(descriptor)[-1:] != (len(axes),):
        raise InputError("descriptor", f"shape [..., {len(axes)}]", list(np.shape(descriptor)))
    values: Untyped = descriptor if hasattr(descriptor, "dtype") else np.asarray(descriptor)
    if values.dtype.kind not in "iu":
        raise InputError("descriptor", "whole numbers", values.dtype)
    # The arrays of axes get as many axes as the descriptor, see `xla.align`.
    aligned = (1,) * (np.ndim(values) - 1) + (-1,)
    last = np.array([axis.bins - 1 for axis in axes], np.uint32).reshape(aligned)
    width = np.array([axis.width for axis in axes], np.uint32).reshape(aligned)
    start = np.array([axis.start for axis in axes], np.int32).reshape(aligned)
    with transfers():
        largest = np.iinfo(np.int32).max
        if np.iinfo(values.dtype).max > largest:
            # A conversion of larger numbers would cut off their upper bits.
            values = values.clip(None, largest)
        # A difference of two int32, one of them negative, may not fit int32. It fits uint32.
        distance = (values.clip(start, None).astype(np.int32) - start).astype(np.uint32)
        return (distance // width).clip(None, last).astype(np.int32)


@name_wrong_arguments
def niche_index(descriptor: ArrayT, axes: tuple[Axis, ...]) -> ArrayT:
    """Returns the index of the niche, int32 ``[...]``, of descriptors ``[..., D]``.

    The last axis varies fastest.
    """
    bins = niche_bins(descriptor, axes)
    with transfers():
        niche = bins[..., 0]
        for index, axis in enumerate(axes[1:], start=1):
            niche = niche * axis.bins + bins[..., index]
    return niche


def _axis_of(name: Untyped, bins: Untyped) -> Axis:
    """Returns the axis of an entry of a mapping: the bins, or the bins and their width."""
    arguments = bins if isinstance(bins, tuple | list) else [bins]
    return Axis(name, *arguments)


def _parse_axis(text: str) -> Axis:
    parsed = _AXIS_TEXT.fullmatch(text)
    if parsed is None:
        expected = "NAME:BINS or NAME:BINS:WIDTH with whole numbers, 1 or more"
        raise InputError(f"axes {quote(text)}", expected)
    name, bins, width = parsed.groups()
    return Axis(name, int(bins), int(width or 0))


def _check_axis(value: UserValue, features: Collection[str] | None) -> Axis:
    axis = value
    if isinstance(value, str):
        axis = _parse_axis(value)
    elif isinstance(value, Mapping) and "metric" in value and set(value) <= set(Axis._fields):
        axis = Axis(**value)
    if not isinstance(axis, Axis):
        raise InputError("axes", "axes such as 'straight_share:10'", quote(value))
    source = f"axes {quote(value if isinstance(value, str) else axis.metric)}"
    check_feature(source, axis.metric, features)
    # JSON takes no numbers of NumPy.
    axis = Axis._make(map(_to_python, axis))
    _check_numbers(source, axis)
    return axis


def _to_python(value: Untyped) -> Untyped:
    """Returns a whole number as one of Python, and any other value unchanged."""
    if is_whole(value):
        return int(value)
    return value


def _check_numbers(source: str, axis: Axis) -> None:
    """Checks the numbers of an axis. Errors begin with `source`."""
    bins, width, start, target = axis.bins, axis.width, axis.start, axis.target
    # Comparisons come after this, because a field of a record may be of any type.
    are_whole = is_whole(bins) and is_whole(width) and is_whole(start)
    if not are_whole or bins < 1 or width < 0:
        numbers = {"bins": bins, "width": width, "start": start}
        got = ", ".join(f"{name} {quote(number)}" for name, number in numbers.items())
        expected = "whole numbers, at least one bin and no negative width"
        raise InputError(source, expected, got)
    largest = max(abs(bins), abs(width), abs(start))
    if largest > LARGEST:
        raise InputError(source, f"numbers of at most {LARGEST:,}", f"{largest:,}")
    if target is not None and not (is_whole(target) and 0 <= target < bins):
        got = quote(target)
        raise InputError(source, f"target to be a bin, 0 to {bins - 1}", got)
