"""The archive of MAP-Elites: niches of a descriptor space, each with the best grid found for it.

Paper, section "Behavior Descriptors"; Mouret and Clune, "Illuminating search spaces by mapping elites", 2015.
"""

from math import prod
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from chex import Array

from elitelanes_jax.checks import LARGEST, check_once
from elitelanes_jax.errors import InputError
from elitelanes_jax.features import FEATURES, check_feature, features_of, usual_width
from elitelanes_jax.metrics import COUNTED

__all__ = [
    "MOST_NICHES",
    "VACANT",
    "Archive",
    "Axis",
    "check_axes",
    "describe",
    "empty_archive",
    "insert",
    "insert_at",
    "niche_bins",
    "niche_of",
    "paper_axes",
    "read_axis",
    "tuned_axes",
]

VACANT = np.iinfo(np.int32).max
"""The fitness of a vacant niche."""

MOST_NICHES = 2**20
"""With more, the archives of a single seed would not fit in memory."""


class Axis(NamedTuple):
    """One axis of the descriptor space: a feature in bins of equal width, the first and the last one open.

    Attributes:
      metric: the name of a feature: a whole number in `Metrics`, or a share.
      bins: how many.
      width: of a bin, in the metric's unit, thousandths for a share.
      start: where the first bin starts.
      aim: the bin whose niches are wanted, where the others serve as steps; by default all are.
    """

    metric: str
    bins: int
    width: int = 1
    start: int = 0
    aim: int | None = None


def paper_axes(shape: tuple[int, int]) -> tuple[Axis, ...]:
    """The paper's space of 400 niches: 25 bins of the cyclomatic number and four flags.

    A flag's first niche is the favourable value. The paper does not give the width of its bins; 2 at 12 x 12, growing
    with the grid's area, takes in what its archive holds.
    """
    width = max(1, round(2 * shape[0] * shape[1] / 144))
    return (
        Axis("cyclomatic", 25, width),
        Axis("components", 2, start=1),
        Axis("dead_ends", 2),
        Axis("adjacent_crossings", 2),
        Axis("adjacent_turns", 2),
    )


def tuned_axes(shape: tuple[int, int]) -> tuple[Axis, ...]:
    """The paper's space with bins of the cyclomatic number one wide at 12 x 12: 0 to 23, and 24 or more.

    Wanted are the niches where all four flags are favourable.
    """
    cyclomatic, *flags = paper_axes(shape)
    width = usual_width("cyclomatic", cyclomatic.bins, shape)
    return (cyclomatic._replace(width=width), *(flag._replace(aim=0) for flag in flags))


def read_axis(text: str, shape: tuple[int, int]) -> Axis:
    """An axis from ``feature:bins`` or ``feature:bins:width``; by default as wide as suits grids of the shape.

    Raises:
      InputError: if the text is no axis.
    """
    name, *numbers = text.split(":")
    check_feature(f"axis {text!r}", name)
    if not 1 <= len(numbers) <= 2 or not all(
        number.isascii() and number.isdigit() and int(number) for number in numbers
    ):
        raise InputError(f"axis {text!r}: expected NAME:BINS or NAME:BINS:WIDTH with whole numbers, 1 or more")
    bins = int(numbers[0])
    return Axis(name, bins, int(numbers[1]) if len(numbers) == 2 else usual_width(name, bins, shape))


def check_axes(axes: Any) -> tuple[Axis, ...]:
    """The axes as a tuple.

    Raises:
      InputError: if there is none, or one that is no `Axis`, of an unknown metric or one that another has, without bins
        or width.
    """
    try:
        axes = tuple(axes)
    except TypeError:
        raise InputError(f"axes: expected records of type Axis, got {axes!r}") from None
    if not axes:
        raise InputError("axes: expected at least one axis, got none")
    for axis in axes:
        if not isinstance(axis, Axis):
            raise InputError(f"axes: expected records of type Axis, got {axis!r}")
        check_feature("axes", axis.metric)
        numbers = (axis.bins, axis.width, axis.start)
        if not all(isinstance(number, int) for number in numbers) or min(axis.bins, axis.width) < 1:
            raise InputError(f"axes: expected whole numbers, at least one bin and a width of 1 or more, got {axis}")
        if max(map(abs, numbers)) > LARGEST:
            raise InputError(f"axes: expected numbers of at most {LARGEST:,}, got {axis}")
        if axis.aim is not None and not (isinstance(axis.aim, int) and 0 <= axis.aim < axis.bins):
            raise InputError(f"axes: expected aim to be a bin, 0 to {axis.bins - 1}, got {axis}")
    check_once("axes", "metric", [axis.metric for axis in axes])
    niches = prod(axis.bins for axis in axes)
    if niches > MOST_NICHES:
        raise InputError(f"axes: expected at most {MOST_NICHES:,} niches, got {niches:,}")
    return axes


def describe(counts: Array, axes: tuple[Axis, ...]) -> Array:
    """The descriptor int32 ``[..., D]`` of grids with these `counts_of` metrics: the plain values of the axes' own."""
    return features_of(counts)[..., np.array([FEATURES.index(axis.metric) for axis in axes])]


def niche_bins(descriptor: Any, axes: tuple[Axis, ...]) -> Any:
    """The bin on each axis, int32 ``[..., D]``, of descriptors ``[..., D]``: of JAX or NumPy, as they are."""
    bins, width, start = (
        np.array([getattr(axis, name) for axis in axes], np.int32) for name in ("bins", "width", "start")
    )
    return ((descriptor - start) // width).clip(0, bins - 1)


def niche_of(descriptor: Any, axes: tuple[Axis, ...]) -> Any:
    """The index of the niche, int32 ``[...]``, of descriptors ``[..., D]``: the last axis runs fastest."""
    bins = niche_bins(descriptor, axes)
    niche = bins[..., 0]
    for number, axis in enumerate(axes[1:], start=1):
        niche = niche * axis.bins + bins[..., number]
    return niche


class Archive(NamedTuple):
    """One place for each of N niches.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``; in a vacant niche the largest int32.
      counts: int32 ``[N, M]``, the `counts_of` metrics.
    """

    grids: Array
    fitness: Array
    counts: Array

    @property
    def filled(self) -> Array:
        """Bool ``[N]``: which niches have an elite."""
        return self.fitness < VACANT


def empty_archive(axes: tuple[Axis, ...], shape: tuple[int, int], *, times: int = 1) -> Archive:
    """One with a place for each niche; or so many archives, one after another."""
    niches = times * prod(axis.bins for axis in axes)
    return Archive(
        grids=jnp.zeros((niches, *shape), jnp.int8),
        fitness=jnp.full(niches, VACANT, jnp.int32),
        counts=jnp.zeros((niches, len(COUNTED)), jnp.int32),
    )


def insert(archive: Archive, axes: tuple[Axis, ...], grids: Array, fitness: Array, counts: Array) -> Archive:
    """The archive after each grid has had its chance at its niche.

    The lower fitness takes the niche. Among equals the elite already there stays, then the first in the batch comes in:
    the result does not depend on the order in which a device writes.

    Args:
      archive: with N niches on `axes`.
      axes: of the descriptor space.
      grids: int8 ``[P, H, W]``.
      fitness: int32 ``[P]``.
      counts: int32 ``[P, M]``.
    """
    return insert_at(archive, niche_of(describe(counts, axes), axes), grids, fitness, counts)


def insert_at(archive: Archive, niche: Array, grids: Array, fitness: Array, counts: Array) -> Archive:
    """As `insert`, each grid at a given place of the archive, int32 ``[P]``, or at several, ``[K, P]``."""
    times, niches = niche.reshape(-1, len(grids)), archive.fitness.size
    niche, fitness = times.reshape(-1), jnp.tile(fitness, len(times))
    batch = jnp.arange(niche.size, dtype=jnp.int32)
    lowest = archive.fitness.at[niche].min(fitness)
    contends = (fitness == lowest[niche]) & (fitness < archive.fitness[niche])
    first = jnp.full(niches, batch.size, jnp.int32).at[niche].min(jnp.where(contends, batch, batch.size))
    # Winners write to their own niche, each the only one; the others to places beyond the end.
    place = jnp.where(first[niche] == batch, niche, niches + batch)

    def write(into: Array, values: Array) -> Array:
        # One time after another: of grids that were joined to themselves each would be computed twice.
        for time in place.reshape(times.shape):
            into = into.at[time].set(values, mode="drop", unique_indices=True)
        return into

    return Archive(write(archive.grids, grids), lowest, write(archive.counts, counts))
