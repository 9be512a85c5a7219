"""Emitters: the niche that a chain pursues for a cycle, and the penalised fitness by which it does so.

A chain that pursues one niche is an improvement emitter, one that goes towards the end of an axis a random direction
emitter (Fontaine et al., "Covariance matrix adaptation for the rapid illumination of behavior space", 2020), both with
annealing in place of a distribution that adapts.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int32, Real, UInt32

from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.problem.descriptor import Axis

# The fitness that stands for a vacant niche: above all others, and with a penalty within int32.
_FAR = 2**29


class Niches(NamedTuple):
    """The niches of a descriptor space, in the order of `niche_index`; static.

    Attributes:
      bins: of each of D axes.
      places: int32 ``[N, D]``, the bin of each niche on each axis.
      free: bool ``[D]``, the axes without a target bin.
      targets: int32 ``[D]``, the target bin of the other axes.
      wanted: bool ``[N]``, the niches in all target bins.
    """

    bins: tuple[int, ...]
    places: Int32[np.ndarray, "N D"]
    free: Bool[np.ndarray, " D"]
    targets: Int32[np.ndarray, " D"]
    wanted: Bool[np.ndarray, " N"]

    @staticmethod
    def of(axes: tuple[Axis, ...]) -> "Niches":
        """Returns the niches of a space."""
        bins = tuple(axis.bins for axis in axes)
        places = np.indices(bins).reshape(len(bins), -1).T.astype(np.int32)
        free = np.array([axis.target is None for axis in axes])
        targets = np.array([axis.target or 0 for axis in axes], np.int32)
        return Niches(bins, places, free, targets, (free | (places == targets)).all(axis=1))


def penalise_distance(
    fitness: Int32[Array, "..."],
    place: Int32[ArrayLike, "... D"],
    target: Int32[ArrayLike, "... D"],
    penalty: Int32[ArrayLike, "..."],
) -> Int32[Array, "..."]:
    """Adds a penalty for each bin between a grid's niche and a target niche to its fitness.

    Args:
      fitness: int32 ``[...]``.
      place: int32 ``[..., D]``, the bins of the grid's niche.
      target: int32 ``[..., D]``, the bins of the target niche.
      penalty: int32, of all axes or of each, ``[D]``.
    """
    return fitness + (jnp.abs(place - jnp.asarray(target)) * penalty).sum(axis=-1, dtype=jnp.int32)


def nearest_elite(
    fitness: Int32[Array, "*P N"],
    places: Int32[ArrayLike, "*P N D"],
    target: Int32[Array, "*P D"],
    penalty: Int32[ArrayLike, ""],
) -> Int32[Array, "*P"]:
    """Returns which of N niches has the elite of the lowest penalised fitness; vacant ones come after all elites."""
    penalised = penalise_distance(jnp.minimum(fitness, _FAR), places, target[..., None, :], penalty)
    return penalised.argmin(axis=-1).astype(jnp.int32)


def reachable(niches: Niches, valid: Bool[Array, " N"]) -> Bool[Array, " N"]:
    """Returns the wanted niches that are vacant and within reach.

    A niche is within reach if, on the free axes, it or one beside it is filled, whatever the bins on the other axes.
    """
    others = tuple(np.flatnonzero(~niches.free).tolist())
    seen = valid.reshape(niches.bins).any(axis=others, keepdims=True)
    near = seen | _beside(seen, niches.free)
    return jnp.broadcast_to(near, niches.bins).reshape(-1) & niches.wanted & ~valid


def draw_target(
    niches: Niches, bits: UInt32[Array, " 2"], valid: Bool[Array, " N"], frontier: Real[ArrayLike, ""]
) -> Int32[Array, " D"]:
    """Draws a niche to pursue: with probability `frontier` a reachable vacant one, if there is any, else a filled one.

    Args:
      niches: of the archive.
      bits: uint32 ``[2]``, random bits.
      valid: bool ``[N]``, the filled niches.
      frontier: a probability.

    Returns:
      int32 ``[D]``, the bins of a wanted niche.
    """
    near, kept = reachable(niches, valid), valid & niches.wanted
    # Before any wanted niche is filled, a filled one beside the target bins stands for the wanted one in its column.
    kept = jnp.where(kept.any(), kept, jnp.where(valid.any(), valid, niches.wanted))
    vacant = bernoulli(bits[0], frontier) & near.any()
    chosen = draw_valid(bits[1], jnp.where(vacant, near, kept))
    return jnp.where(niches.free, jnp.asarray(niches.places)[chosen], niches.targets)


def draw_direction(niches: Niches, bits: UInt32[Array, ""], valid: Bool[Array, " N"]) -> Int32[Array, " D"]:
    """Draws a reachable vacant niche, and goes past it to the ends of the axes: away from most of the filled niches.

    Args:
      niches: of the archive.
      bits: uint32, random bits.
      valid: bool ``[N]``, the filled niches, with a reachable vacant one among the others.

    Returns:
      int32 ``[D]``, on each free axis the first bin or the last one.
    """
    place = jnp.asarray(niches.places)[draw_valid(bits, reachable(niches, valid))]
    filled = (valid & niches.wanted)[:, None]
    upwards = (jnp.sign(place - niches.places) * filled).sum(axis=0, dtype=jnp.int32) > 0
    last = np.array(niches.bins, np.int32) - 1
    return jnp.where(niches.free, jnp.where(upwards, last, 0), niches.targets)


def draw_valid(bits: UInt32[Array, "..."], valid: Bool[Array, " N"]) -> Int32[Array, "..."]:
    """Draws a place that is True, each equally likely; the last place where none is."""
    rank = jnp.cumsum(valid, dtype=jnp.int32)
    drawn = randint(bits, jnp.maximum(rank[-1], 1))
    return jnp.minimum(jnp.searchsorted(rank, drawn, side="right"), valid.size - 1).astype(jnp.int32)


def _beside(valid: Bool[Array, "..."], axes: Bool[np.ndarray, " D"]) -> Bool[Array, "..."]:
    """Returns the places that have a neighbour along one of the given axes."""
    near = jnp.zeros_like(valid)
    for axis in np.flatnonzero(axes).tolist():
        ends = [(0, 0)] * valid.ndim
        for end, start in (((1, 0), 0), ((0, 1), 1)):
            ends[axis] = end
            near |= jax.lax.slice_in_dim(jnp.pad(valid, ends), start, start + valid.shape[axis], axis=axis)
    return near
