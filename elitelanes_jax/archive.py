"""The archive of MAP-Elites: niches of a descriptor space, each with the best grid found for it.

Paper, section "Behavior Descriptors"; Mouret and Clune, "Illuminating search spaces by mapping elites", 2015.
"""

from math import prod
from typing import NamedTuple

import jax.numpy as jnp
from chex import Array

from elitelanes_jax.metrics import Metrics

__all__ = ["Archive", "Axis", "describe", "empty_archive", "insert", "niche_bins", "niche_of", "paper_axes"]

_VACANT = jnp.iinfo(jnp.int32).max


class Axis(NamedTuple):
    """One axis of the descriptor space: a metric in bins of equal width, the first and the last one open.

    metric: the name of an integer field of `Metrics`.
    bins: how many.
    width: of a bin, in the metric's unit.
    start: where the first bin starts.
    """

    metric: str
    bins: int
    width: int = 1
    start: int = 0


def paper_axes(shape: tuple[int, int]) -> tuple[Axis, ...]:
    """The paper's space of 400 niches: 25 bins of the cyclomatic number and four flags.

    A flag's first niche is the favourable value. The paper does not give the width of its bins; 2 at 12 x 12,
    growing with the grid's area, takes in what its archive holds.
    """
    width = max(1, round(2 * shape[0] * shape[1] / 144))
    return (
        Axis("cyclomatic", 25, width),
        Axis("components", 2, start=1),
        Axis("dead_ends", 2),
        Axis("adjacent_crossings", 2),
        Axis("adjacent_turns", 2),
    )


def describe(metrics: Metrics, axes: tuple[Axis, ...]) -> Array:
    """The descriptor of a grid, int32 ``[D]``: the plain values of the axes' metrics."""
    return jnp.stack([getattr(metrics, axis.metric) for axis in axes], axis=-1)


def niche_bins(descriptor: Array, axes: tuple[Axis, ...]) -> Array:
    """The bin on each axis, int32 ``[..., D]``, of descriptors ``[..., D]``."""
    bins, width, start = (jnp.array([getattr(axis, name) for axis in axes]) for name in ("bins", "width", "start"))
    return jnp.clip((descriptor - start) // width, 0, bins - 1)


def niche_of(descriptor: Array, axes: tuple[Axis, ...]) -> Array:
    """The index of the niche, int32 ``[...]``, of descriptors ``[..., D]``: the last axis runs fastest."""
    niche = jnp.zeros(descriptor.shape[:-1], jnp.int32)
    for number, axis in enumerate(axes):
        niche = niche * axis.bins + niche_bins(descriptor, axes)[..., number]
    return niche


class Archive(NamedTuple):
    """One place for each of N niches.

    grids: int8 ``[N, H, W]``.
    fitness: int32 ``[N]``; in a vacant niche the largest int32.
    descriptor: int32 ``[N, D]``.
    """

    grids: Array
    fitness: Array
    descriptor: Array

    @property
    def filled(self) -> Array:
        """Bool ``[N]``: which niches have an elite."""
        return self.fitness < _VACANT


def empty_archive(axes: tuple[Axis, ...], shape: tuple[int, int]) -> Archive:
    niches = prod(axis.bins for axis in axes)
    return Archive(
        grids=jnp.zeros((niches, *shape), jnp.int8),
        fitness=jnp.full(niches, _VACANT, jnp.int32),
        descriptor=jnp.zeros((niches, len(axes)), jnp.int32),
    )


def insert(archive: Archive, axes: tuple[Axis, ...], grids: Array, fitness: Array, descriptor: Array) -> Archive:
    """The archive after each grid has had its chance at its niche.

    The lower fitness takes the niche. Among equals the elite already there stays, then the first in the batch
    comes in: the result does not depend on the order in which a device writes.

    Args:
      archive: with N niches on `axes`.
      axes: of the descriptors.
      grids: int8 ``[P, H, W]``.
      fitness: int32 ``[P]``.
      descriptor: int32 ``[P, D]``.
    """
    niche = niche_of(descriptor, axes)
    batch, niches = jnp.arange(niche.size), archive.fitness.size
    lowest = archive.fitness.at[niche].min(fitness)
    contends = (fitness == lowest[niche]) & (fitness < archive.fitness[niche])
    first = jnp.full(niches, batch.size).at[niche].min(jnp.where(contends, batch, batch.size))
    # Winners write to their own niche, each the only one; the others to places beyond the end.
    place = jnp.where(first[niche] == batch, niche, niches + batch)

    def write(into: Array, values: Array) -> Array:
        return into.at[place].set(values, mode="drop", unique_indices=True)

    return Archive(write(archive.grids, grids), lowest, write(archive.descriptor, descriptor))
