"""Emitters: the goals of chains, and the penalised fitness that leads to them.

A goal is the niche that a chain pursues for one cycle. A chain with a goal is an improvement
emitter that anneals instead of adapting a distribution (Fontaine et al., "Covariance matrix
adaptation for the rapid illumination of behavior space", 2020).
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int32, Real, UInt32

from elitelanes_jax.network.bits import bernoulli, randint
from elitelanes_jax.problem.descriptor import Axis

# This number replaces the whole-numbered fitness of a vacant niche. It is larger than any other
# such fitness, and its sums with a penalty fit int32.
_FAR = 2**29


class Niches(NamedTuple):
    """The niches of a descriptor space, in the order of `Problem.niche`; static.

    Attributes:
      shape: the number of bins of each of D axes.
      bins: int32 ``[N, D]``, the bin of each niche on each axis.
      free: bool ``[D]``, the axes without a target bin.
      targets: int32 ``[D]``, the target bin of each other axis.
      targeted: bool ``[N]``, the niches that are in all target bins.
    """

    shape: tuple[int, ...]
    bins: Int32[np.ndarray, "N D"]
    free: Bool[np.ndarray, " D"]
    targets: Int32[np.ndarray, " D"]
    targeted: Bool[np.ndarray, " N"]

    @staticmethod
    def of(axes: tuple[Axis, ...]) -> "Niches":
        shape = tuple(axis.bins for axis in axes)
        bins = np.indices(shape).reshape(len(shape), -1).T.astype(np.int32)
        free = np.array([axis.target is None for axis in axes])
        # An axis without a target gets target 0, which `free` hides.
        targets = np.array([axis.target or 0 for axis in axes], np.int32)
        return Niches(shape, bins, free, targets, (free | (bins == targets)).all(axis=1))


def penalise_distance(
    fitness: Real[Array, "..."],
    bins: Int32[ArrayLike, "... D"],
    goal: Int32[ArrayLike, "... D"],
    penalty: Int32[ArrayLike, "..."],
) -> Real[Array, "..."]:
    """Adds a penalty to a fitness for each bin between a grid's niche and the goal.

    The penalty may differ between axes.
    """
    total = (jnp.abs(bins - jnp.asarray(goal)) * penalty).sum(axis=-1, dtype=jnp.int32)
    return fitness + total.astype(fitness.dtype)


def nearest_elite(
    fitness: Real[Array, "*P N"],
    bins: Int32[ArrayLike, "*P N D"],
    goal: Int32[Array, "*P D"],
    penalty: Int32[ArrayLike, "..."],
) -> Int32[Array, "*P"]:
    """Returns the index of the elite with the lowest penalised fitness.

    Vacant niches rank after all elites.
    """
    if not jnp.issubdtype(fitness.dtype, jnp.floating):
        # A float fitness may be larger than this number, and is infinite in vacant niches.
        fitness = jnp.minimum(fitness, _FAR)
    penalised = penalise_distance(fitness, bins, goal[..., None, :], penalty)
    return penalised.argmin(axis=-1).astype(jnp.int32)


def reachable(niches: Niches, filled: Bool[Array, " N"]) -> Bool[Array, " N"]:
    """Returns which vacant niches in all target bins are within reach.

    A niche is within reach if it or a neighbour on a free axis is filled, whatever the bins on the
    other axes.
    """
    # An axis with a target is reduced to one bin, so any of its bins counts.
    others = tuple(np.flatnonzero(~niches.free).tolist())
    seen = filled.reshape(niches.shape).any(axis=others, keepdims=True)
    near = seen | _neighbours(seen, niches.free)
    return jnp.broadcast_to(near, niches.shape).reshape(-1) & niches.targeted & ~filled


def draw_goal(
    niches: Niches,
    bits: UInt32[Array, " 2"],
    filled: Bool[Array, " N"],
    vacant_probability: Real[ArrayLike, ""],
) -> Int32[Array, " D"]:
    """Draws the bins of a goal that is in all target bins.

    With probability `vacant_probability` the goal is a vacant niche, if one is reachable. Otherwise
    the goal is a filled niche.
    """
    near = reachable(niches, filled)
    candidates = filled & niches.targeted
    # Until a niche in all target bins is filled, any filled niche gives the bins on the free axes.
    if_none = jnp.where(filled.any(), filled, niches.targeted)
    candidates = jnp.where(candidates.any(), candidates, if_none)
    is_vacant = bernoulli(bits[0], vacant_probability) & near.any()
    chosen = draw_true(bits[1], jnp.where(is_vacant, near, candidates))
    return jnp.where(niches.free, jnp.asarray(niches.bins)[chosen], niches.targets)


def draw_true(bits: UInt32[Array, "..."], flags: Bool[Array, " N"]) -> Int32[Array, "..."]:
    """Draws an index whose flag is True, each equally likely; the last index if no flag is True."""
    # A rank among the True flags is drawn, and a binary search finds its index.
    rank = jnp.cumsum(flags, dtype=jnp.int32)
    drawn = randint(bits, jnp.maximum(rank[-1], 1))
    return jnp.minimum(jnp.searchsorted(rank, drawn, side="right"), flags.size - 1).astype(
        jnp.int32
    )


def _neighbours(flags: Bool[Array, "..."], axes: Bool[np.ndarray, " D"]) -> Bool[Array, "..."]:
    """Returns where a neighbour along one of the chosen axes is True."""
    # Along each axis the flags are shifted by one in both directions, with False beyond the ends.
    near = jnp.zeros_like(flags)
    for axis in np.flatnonzero(axes).tolist():
        ends = [(0, 0)] * flags.ndim
        for end, start in (((1, 0), 0), ((0, 1), 1)):
            ends[axis] = end
            near |= jax.lax.slice_in_dim(
                jnp.pad(flags, ends), start, start + flags.shape[axis], axis=axis
            )
    return near
