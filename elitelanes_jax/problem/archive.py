"""The archive of MAP-Elites: niches of a descriptor space, each with the best grid found for it.

Mouret and Clune, "Illuminating search spaces by mapping elites", 2015; paper, section "Behavior Descriptors".
"""

from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int8, Int32

from elitelanes_jax.network.counts import COUNT_NAMES
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, niche_index

VACANT = np.iinfo(np.int32).max
"""The fitness of a vacant niche."""


class Archive(NamedTuple):
    """One place for each of N niches.

    Attributes:
      grids: int8 ``[N, H, W]``.
      fitness: int32 ``[N]``; in a vacant niche the largest int32.
      counts: int32 ``[N, M]``, the metrics as `stack_counts` orders them.
    """

    grids: Int8[Array, "N H W"]
    fitness: Int32[Array, " N"]
    counts: Int32[Array, "N M"]

    @property
    def valid(self) -> Bool[Array, " N"]:
        """Bool ``[N]``: whether each niche has an elite."""
        return self.fitness < VACANT


def empty_archive(
    axes: tuple[Axis, ...], shape: tuple[int, int], *, copies: int = 1, columns: int = len(COUNT_NAMES)
) -> Archive:
    """Makes an archive with a place for each niche, with so many columns of counts; or several, one after another."""
    niches = copies * prod(axis.bins for axis in axes)
    return Archive(
        grids=jnp.zeros((niches, *shape), jnp.int8),
        fitness=jnp.full(niches, VACANT, jnp.int32),
        counts=jnp.zeros((niches, columns), jnp.int32),
    )


def insert(
    archive: Archive,
    axes: tuple[Axis, ...],
    grids: Int8[Array, "P H W"],
    fitness: Int32[Array, " P"],
    counts: Int32[Array, "P M"],
) -> Archive:
    """Offers each grid to its niche.

    The lower fitness takes the niche. Among equals the elite already there stays, then the first in the batch comes in:
    the result does not depend on the order in which a device writes.

    Args:
      archive: with N niches on `axes`.
      axes: of the descriptor space.
      grids: int8 ``[P, H, W]``.
      fitness: int32 ``[P]``.
      counts: int32 ``[P, M]``.
    """
    return insert_at(archive, niche_index(compute_descriptor(counts, axes), axes), grids, fitness, counts)


def insert_at(
    archive: Archive,
    niche: Int32[Array, "*K P"],
    grids: Int8[Array, "P H W"],
    fitness: Int32[Array, " P"],
    counts: Int32[Array, "P M"],
    *,
    accept_equal: bool = False,
) -> Archive:
    """Offers each grid to a given place of the archive, int32 ``[P]``, or to several, ``[K, P]``; else as `insert`.

    With `accept_equal` the first in the batch comes in among equals, whether or not an elite is there.
    """
    rounds, niches = niche.reshape(-1, len(grids)), archive.fitness.size
    niche, fitness = rounds.reshape(-1), jnp.tile(fitness, len(rounds))
    batch = jnp.arange(niche.size, dtype=jnp.int32)
    lowest = archive.fitness.at[niche].min(fitness)
    contends = fitness == lowest[niche]
    if not accept_equal:
        contends &= fitness < archive.fitness[niche]
    first = jnp.full(niches, batch.size, jnp.int32).at[niche].min(jnp.where(contends, batch, batch.size))
    # Winners write to their own niche, each the only one; the others to places beyond the end.
    place = jnp.where(first[niche] == batch, niche, niches + batch)

    def write(into: Array, values: Array) -> Array:
        # One round after another: XLA would compute grids that are concatenated with themselves twice.
        for round_ in place.reshape(rounds.shape):
            into = into.at[round_].set(values, mode="drop", unique_indices=True)
        return into

    return Archive(write(archive.grids, grids), lowest, write(archive.counts, counts))


def keep_best(archives: Archive) -> Archive:
    """Returns of several archives, in front of each other ``[K, ...]``, the best elite of each niche.

    Among equals that of the first archive stays.
    """
    first = jnp.argmin(archives.fitness, axis=0)

    def take(array: Array) -> Array:
        return jnp.take_along_axis(array, first.reshape(1, -1, *(1,) * (array.ndim - 2)), axis=0)[0]

    return jax.tree.map(take, archives)
