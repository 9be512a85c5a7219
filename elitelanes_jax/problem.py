"""What is searched for: the grids that may be made, and what they are worth."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
from chex import Array, PRNGKey

from elitelanes_jax.archive import Axis
from elitelanes_jax.checks import check_shape
from elitelanes_jax.codes import KINDS, ROAD_ALPHABET, alphabet_of
from elitelanes_jax.errors import InputError
from elitelanes_jax.features import features_of
from elitelanes_jax.grids import random_grids
from elitelanes_jax.metrics import counts_of, measure, metrics_of
from elitelanes_jax.objective import Weights, fitness, penalties
from elitelanes_jax.repairs import raster_rank, repair
from elitelanes_jax.requests import Ranges, shortfall
from elitelanes_jax.templates import Template

__all__ = ["Evaluation", "Problem", "road_problem"]


class Evaluation(NamedTuple):
    """What an optimiser learns of a population.

    Attributes:
      fitness: int32 ``[P]``, lower is better.
      counts: int32 ``[P, M]``, the `counts_of` metrics.
    """

    fitness: Array
    counts: Array


class Problem(NamedTuple):
    """All that an optimiser knows of road networks: what to draw, how to mend it, what it is worth.

    Attributes:
      shape: (height, width).
      alphabet: the codes that new tiles are drawn from.
      axes: of the descriptor space.
      fill: whether repair fills.
      kept: bool ``[H, W]``, the cells that are given and stay; None where none is.
      random: (key, count) -> int8 ``[count, H, W]``, repaired: what a search begins with.
      repair: (grid, dirty) -> grid, all ``[H, W]``.
      settle: grid -> grid, repairs one of which all tiles are new: each dictates to those after it, row by row.
      evaluate: int8 ``[P, H, W]`` -> `Evaluation`.
      flaws: int32 ``[P, M]``, the `counts_of` metrics -> int32 ``[P]``, the fitness without what rewards.
    """

    shape: tuple[int, int]
    alphabet: tuple[int, ...]
    axes: tuple[Axis, ...]
    fill: bool
    kept: Array | None
    random: Callable[[PRNGKey, int], Array]
    repair: Callable[[Array, Array], Array]
    settle: Callable[[Array], Array]
    evaluate: Callable[[Array], Evaluation]
    flaws: Callable[[Array], Array]


def road_problem(
    shape: tuple[int, int],
    axes: tuple[Axis, ...],
    *,
    alphabet: Iterable[int] | None = None,
    weights: Weights = Weights(),  # noqa: B008
    fill: bool = False,
    where: Ranges | None = None,
    fix: Template | None = None,
    initial: Array | None = None,
) -> Problem:
    """The paper's problem: road networks of a given size.

    Args:
      shape: (height, width), each at least 2.
      axes: of the descriptor space.
      alphabet: the codes to draw from, by default all tiles with two or more connections. A repaired grid may hold
        others: stubs and empty cells are what `dead_ends` and `coverage` count, any other code is counted by
        `off_alphabet`.
      weights: of the fitness; its numbers may be traced.
      fill: whether repair also fills (see `repair`).
      where: ranges to steer into: what a grid lacks adds to its fitness. Its numbers may be traced.
      fix: cells that are given.
      initial: int8 ``[N, H, W]``, grids that stand first among the random ones, repaired.

    Raises:
      InputError: for a bad shape or alphabet; of `random`, for more initial grids than it is asked for.
    """
    shape = check_shape(shape)
    alphabet = ROAD_ALPHABET if alphabet is None else alphabet_of(alphabet)
    allowed = (*alphabet, *KINDS["stub"], *KINDS["empty"])

    kept = None if fix is None else fix.kept

    def mend(grid: Array, dirty: Array) -> Array:
        if fix is not None:
            grid = jnp.where(fix.kept, fix.grid, grid)
        return repair(grid, dirty, fill=fill, kept=kept)

    def settle(grid: Array) -> Array:
        return mend(grid, jnp.asarray(raster_rank(shape)))

    def random(key: PRNGKey, count: int) -> Array:
        grids = jax.vmap(settle)(random_grids(key, count, shape, alphabet=alphabet))
        if initial is None:
            return grids
        if len(initial) > count:
            raise InputError(
                f"initial: expected at most {count} grids, as many as there are at first, got {len(initial)}"
            )
        return grids.at[: len(initial)].set(jax.vmap(mend, in_axes=(0, None))(initial, jnp.zeros(shape, bool)))

    def off(counts: Array) -> Array:
        return jnp.int32(0) if where is None else shortfall(features_of(counts), where, shape)

    def evaluate(grids: Array) -> Evaluation:
        chex.assert_shape(grids, (None, *shape))
        chex.assert_type(grids, jnp.int8)
        metrics = jax.vmap(lambda grid: measure(grid, allowed))(grids)
        counts = counts_of(metrics)
        return Evaluation(fitness(metrics, weights) + off(counts), counts)

    def flaws(counts: Array) -> Array:
        return fitness(metrics_of(counts, shape[0] * shape[1]), penalties(weights)) + off(counts)

    return Problem(shape, alphabet, axes, fill, kept, random, mend, settle, evaluate, flaws)
