"""Populations, and the archive of MAP-Elites: a population with one slot for each niche.

Mouret and Clune, "Illuminating search spaces by mapping elites", 2015; paper, section "Behavior
Descriptors".
"""

from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int8, Int32, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, real, unmasked
from elitelanes_jax._util.errors import InputError, pluralize, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, Numeric
from elitelanes_jax.network.checks import is_traced
from elitelanes_jax.network.sharding import divide_batches

VACANT = np.iinfo(np.int32).max
"""The fitness of a vacant slot, if fitness is int32."""


class Population(NamedTuple):
    """Grids with their evaluation, in P slots.

    Attributes:
      grids: int8 ``[P, H, W]``.
      fitness: int32 or float32 ``[P]``, lower is better; infinity or the largest int32 in a
        vacant slot.
      features: int32 ``[P, F]``, in the order of `Problem.feature_names`.
    """

    grids: Int8[Array, "*S P H W"]
    fitness: Real[Array, "*S P"]
    features: Int32[Array, "*S P F"]

    @property
    def valid(self) -> Bool[Array, "*S P"]:
        """Bool ``[P]``: which slots are filled.

        The grid and the features of a vacant slot have no meaning.
        """
        return self.fitness < vacant_fitness(self.fitness.dtype)


@name_wrong_arguments
def vacant_fitness(dtype: np.dtype | type[np.generic]) -> float:
    """Returns the fitness of vacant slots and refused grids.

    It is infinity for floats, otherwise the largest int32.
    """
    return np.inf if jnp.issubdtype(dtype, jnp.floating) else VACANT


def finite_or_vacant(fitness: Real[Array, " P"]) -> Real[Array, " P"]:
    """Returns a fitness with that of vacant slots in place of what is not finite."""
    return (
        jnp.where(jnp.isfinite(fitness), fitness, vacant_fitness(fitness.dtype))
        if jnp.issubdtype(fitness.dtype, jnp.floating)
        else fitness
    )


@name_wrong_arguments
@runs_jax
@divide_batches
def insert(
    archive: Population,
    niche: Int32[Array, "*K P"],
    found: Population,
    *,
    accept_equal: bool = False,
) -> Population:
    """Offers each grid to its niche, which keeps the grid of lowest fitness.

    Among equal grids the elite stays, or else the first grid of the batch wins: the result does not
    depend on the order in which a device writes.

    Args:
      archive: one slot for each of N niches.
      niche: int32 ``[P]``, the index of each grid's niche; or ``[K, P]`` to offer each grid to K
        niches.
      found: the P grids. A fitness that is not finite is refused.
      accept_equal: whether the first in the batch replaces an elite of equal fitness.

    Raises:
      InputError: for other numbers of indices, grids and features than of fitnesses, another dtype
        of fitness or other shapes of grids and features than the archive's, or an index of no
        niche; the last not under `jax.jit`.
    """
    archive, found = Population(*map(jnp.asarray, archive)), Population(*map(jnp.asarray, found))
    _check_offer(archive, niche, found)
    niche = jnp.asarray(niche, jnp.int32)
    # Grids that are offered to K niches make K rounds, which contend together.
    rounds = niche.reshape(prod(niche.shape[:-1]), niche.shape[-1])
    niche, fitness = rounds.reshape(-1), finite_or_vacant(jnp.tile(found.fitness, len(rounds)))
    # A minimum is the same in any order of writing, so the scatter may write a niche many times.
    lowest = archive.fitness.at[niche].min(fitness)
    # A grid contends for its niche if no grid offered to the niche is better. Of those that
    # contend, the first one wins.
    contends = fitness == lowest[niche]
    if not accept_equal:
        contends &= fitness < archive.fitness[niche]
    # Grids that do not contend take an index beyond the batch, which wins nowhere.
    niches, batch = archive.fitness.size, jnp.arange(niche.size, dtype=jnp.int32)
    first = (
        jnp.full(niches, batch.size, jnp.int32)
        .at[niche]
        .min(jnp.where(contends, batch, batch.size))
    )
    # Each winner writes to its own niche. Losers write to slots beyond the end, which are dropped.
    # So no two grids write to one slot, and the order of writing does not matter.
    slots = jnp.where(first[niche] == batch, niche, niches + batch)

    def write(into: Array, values: Array) -> Array:
        # XLA would compute grids twice if they were concatenated with themselves.
        for slots_of_round in slots.reshape(rounds.shape):
            into = into.at[slots_of_round].set(
                jnp.asarray(values, into.dtype), mode="drop", unique_indices=True
            )
        return into

    return Population(
        write(archive.grids, found.grids), lowest, write(archive.features, found.features)
    )


def _check_offer(archive: Population, niche: Int32[Array, "*K P"], found: Population) -> None:
    """Raises what `insert` raises for what is offered to an archive."""
    if np.shape(niche)[-1:] != found.fitness.shape:
        raise InputError(
            "niche", f"{len(found.fitness)} indices, one for each grid", list(np.shape(niche))
        )
    # The dtype is read before JAX converts the indices, because JAX makes 32 bits of 64.
    dtype = niche.dtype if isinstance(niche, jax.Array) else np.asarray(niche).dtype
    if dtype.kind not in "iu":
        raise InputError("niche", "whole numbers", dtype)
    if not isinstance(niche, jax.core.Tracer) and np.size(niche):
        lowest, highest, niches = int(np.min(niche)), int(np.max(niche)), archive.fitness.size
        if not 0 <= lowest <= highest < niches:
            raise InputError("niche", f"indices 0 to {niches - 1}", f"{lowest} to {highest}")
    if found.fitness.dtype != archive.fitness.dtype:
        raise InputError(
            "found", f"a fitness of {archive.fitness.dtype}, as in the archive", found.fitness.dtype
        )
    for part in ("grids", "features"):
        expected, got = list(getattr(archive, part).shape[1:]), list(getattr(found, part).shape[1:])
        if got != expected:
            raise InputError("found", f"{part} of shape {expected} each, as in the archive", got)
        # A single grid would be broadcast to all slots.
        for name, population in (("archive", archive), ("found", found)):
            slots, rows = population.fitness.size, len(getattr(population, part))
            if rows != slots:
                raise InputError(name, f"{part} of {pluralize(slots, 'slot')}, as of fitness", rows)


@name_wrong_arguments
def qd_score(fitness: ArrayOrRows, valid: ArrayOrRows, worst: Numeric) -> AnyArray:
    """Returns the sum over all elites of worst - fitness, if positive; float64 ``[...]``.

    `fitness` is ``[..., N]``, lower is better, and anything in niches that are not `valid`, bool
    ``[..., N]``. The larger `worst` is, the more the score only counts elites: with the default
    weights take 0, which a map without faults does not exceed. NumPy computes the score. Under
    `jax.jit` and `jax.vmap` it is float32, and its values are not checked. Source: Pugh, Soros and
    Stanley, "Quality diversity", 2016.

    Raises `InputError` for `valid` of another dtype, a `worst` that is not finite, and a fitness of
    NaN or minus infinity in a valid niche.
    """
    filled = _check_niches("valid", valid)
    if any(map(is_traced, (fitness, valid, worst))):
        losses = jnp.asarray(fitness).astype(jnp.float32)
        traced_gains = jnp.maximum(jnp.asarray(worst, jnp.float32) - losses, 0)
        return jnp.where(filled, traced_gains, 0).sum(axis=-1)
    worst = check_named("worst", real(-np.inf), worst)
    check_named("fitness", unmasked, fitness)
    # An infinite fitness is worse than `worst`, and adds nothing.
    gains = np.maximum(worst - np.asarray(fitness, np.float64), 0)
    if not (np.isfinite(gains) | ~filled).all():
        raise InputError("fitness", "numbers in valid niches", "NaN or minus infinity")
    return np.where(filled, gains, 0).sum(axis=-1)


@name_wrong_arguments
def coverage(valid: ArrayOrRows, feasible: ArrayOrRows | None = None) -> AnyArray:
    """Returns the filled share of the feasible niches, float64 ``[...]``.

    `valid`, bool ``[..., N]``, are the filled niches, `feasible`, bool ``[N]``, those that can be
    filled; by default all. NumPy computes the share. Under `jax.jit` and `jax.vmap` it is float32.
    Raises `InputError` for niches of another dtype, and for feasible niches of another number.
    """
    filled = _check_niches("valid", valid)
    if not filled.ndim:
        filled = filled.reshape(1)
    if feasible is None:
        feasible = np.ones(filled.shape[-1], bool)
    else:
        feasible = _check_niches("feasible", feasible)
    if feasible.shape != filled.shape[-1:]:
        raise InputError("feasible", f"bool [{filled.shape[-1]}]", f"shape {list(feasible.shape)}")
    if is_traced(filled) or is_traced(feasible):
        # JAX may be told to refuse arrays of other ranks, and types that differ.
        both = jnp.asarray(filled) & jnp.broadcast_to(feasible, filled.shape)
        count = jnp.maximum(jnp.asarray(feasible).sum(dtype=jnp.int32), 1)
        return both.sum(axis=-1, dtype=jnp.int32).astype(jnp.float32) / count.astype(jnp.float32)
    return (filled & feasible).sum(axis=-1) / max(1, int(feasible.sum()))


def _check_niches(name: str, niches: ArrayOrRows) -> AnyArray:
    """Checks an array that is True for some of the niches."""
    array = niches if is_traced(niches) else np.asarray(check_named(name, unmasked, niches))
    # An empty list has the dtype of floats.
    if array.dtype != bool and array.size:
        raise InputError(name, "an array of bool", quote(niches))
    return array.astype(bool)
