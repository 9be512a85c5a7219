"""The problem that optimisers solve: the grids that may be made, and their fitness."""

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Key

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Numeric, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import KINDS, ROAD_ALPHABET, check_alphabet
from elitelanes_jax.network.counts import COUNT_NAMES
from elitelanes_jax.network.fitness import fitness, penalty_weights
from elitelanes_jax.network.grids import random_grids
from elitelanes_jax.network.materialize import materialize
from elitelanes_jax.network.metrics import measure, stack_counts, unstack_counts
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.weights import Weights
from elitelanes_jax.problem.constraints import Bounds, violation
from elitelanes_jax.problem.descriptor import Axis, paper_axes, resolve_axes
from elitelanes_jax.problem.extras import Kernel, measure_extras
from elitelanes_jax.problem.features import compute_features, extra_names
from elitelanes_jax.problem.template import Template


class Evaluation(NamedTuple):
    """The evaluation of a population.

    Attributes:
      fitness: int32 ``[P]``, lower is better.
      counts: int32 ``[P, M]``, the metrics as `stack_counts` orders them, then the problem's extra features.
    """

    fitness: Int32[Array, " P"]
    counts: Int32[Array, "P M"]


class Problem(NamedTuple):
    """All that an optimiser knows of road networks: how to draw, repair and evaluate grids.

    Attributes:
      shape: (height, width).
      alphabet: the codes that new tiles are drawn from.
      axes: of the descriptor space.
      fill: whether repair fills.
      fixed: bool ``[H, W]``, the cells that are given and stay; None where none is.
      random: (key, count) -> int8 ``[count, H, W]``, repaired: what a search begins with.
      repair: (grid, dirty, raster) -> grid, as `repair`.
      repair_raster: grid -> grid, repairs one of which all tiles are new: each decides over those after it, row by row.
      evaluate: int8 ``[P, H, W]`` -> `Evaluation`.
      penalties: int32 ``[P, M]``, counts -> int32 ``[P]``, the fitness without rewards.
      extras: the names of the extra features, in the order of their columns: those of the axes first.
      given: how many of the first random grids are given ones.
    """

    shape: tuple[int, int]
    alphabet: tuple[int, ...]
    axes: tuple[Axis, ...]
    fill: bool
    fixed: Bool[np.ndarray, "H W"] | None
    random: Callable[[Key[Array, ""], int], Int8[Array, "count H W"]]
    repair: Callable[..., Int8[Array, "H W"]]
    repair_raster: Callable[[Int8[Array, "H W"]], Int8[Array, "H W"]]
    evaluate: Callable[[Int8[Array, "P H W"]], Evaluation]
    penalties: Callable[[Int32[Array, "P M"]], Int32[Array, " P"]]
    extras: tuple[str, ...] = ()
    given: int = 0

    @property
    def columns(self) -> int:
        """The number of columns of counts."""
        return len(COUNT_NAMES) + len(self.extras)


def road_problem(
    shape: tuple[int, int] = (12, 12),
    axes: UserValue = None,
    *,
    alphabet: Iterable[int] | None = None,
    weights: Weights = Weights(),
    fill: bool = False,
    bounds: Bounds | None = None,
    extras: Iterable[str] = (),
    extra_weights: Int[ArrayLike, " K"] | None = None,
    features: Mapping[str, Kernel] = MappingProxyType({}),
    fix: Template | None = None,
    initial: Int8[Array | np.ndarray, "N H W"] | None = None,
) -> Problem:
    """Makes the paper's problem: road networks of a given size.

    Args:
      shape: (height, width), each at least 2.
      axes: of the descriptor space, as `resolve_axes` takes them; by default `paper_axes`.
      alphabet: the codes to draw from, by default all tiles with two or more connections. A repaired grid may hold
        others: `dead_ends` and `coverage` count stubs and empty cells, `off_alphabet` any other code.
      weights: of the fitness; its numbers may be traced.
      fill: whether repair also fills (see `repair`).
      bounds: limits of features, with K extra ones; their violation adds to the fitness. Its numbers may be traced.
      extras: the names of the K extra features that are measured; those of the axes, which come first, may be left out.
      extra_weights: int ``[K]``, what a unit of each adds to the fitness; by default nothing.
      features: kernels of one's own, by the name of their feature.
      fix: cells that are given.
      initial: int8 ``[N, H, W]``, repaired grids that stand first among the random ones.

    Raises:
      InputError: for a bad shape, alphabet or axis; of `Problem.random`, for more initial grids than it is to return.
    """
    shape = check_shape(shape, new=True)
    alphabet = ROAD_ALPHABET if alphabet is None else check_alphabet(alphabet)
    axes = paper_axes(shape) if axes is None else resolve_axes(axes, shape, features)
    extras = extra_names((axis.metric for axis in axes), extras)
    allowed = (*alphabet, *KINDS["end"], *KINDS["empty"])
    fixed = None if fix is None else fix.fixed

    def repair_grid(grid: Array, dirty: Array | None = None, raster: Numeric = False) -> Array:
        if fix is not None:
            grid = jnp.where(fix.fixed, fix.grid, grid)
        return repair(grid, dirty, raster=raster, fill=fill, fixed=fixed)

    def repair_raster(grid: Array) -> Array:
        return repair_grid(grid, raster=True)

    def random(key: Array, count: int) -> Array:
        grids = jax.vmap(repair_raster)(random_grids(key, count, shape, alphabet=alphabet))
        if initial is None:
            return grids
        if len(initial) > count:
            raise InputError(
                f"initial: expected at most {count} grids, as many as there are at first, got {len(initial)}"
            )
        return grids.at[: len(initial)].set(jax.vmap(repair_grid)(jnp.asarray(initial)))

    def violations(counts: Array) -> Array:
        return jnp.int32(0) if bounds is None else violation(compute_features(counts), bounds, shape, extras)

    def weigh(counts: Array, weights: Weights, extra: Numeric) -> Array:
        total = fitness(unstack_counts(counts, shape[0] * shape[1]), weights) + violations(counts)
        if extra is not None:
            total += (counts[..., len(COUNT_NAMES) :] * extra).sum(axis=-1, dtype=jnp.int32)
        return total

    def evaluate(grids: Array) -> Evaluation:
        chex.assert_shape(grids, (None, *shape))
        chex.assert_type(grids, jnp.int8)
        metrics = jax.vmap(lambda grid: measure(grid, allowed))(grids)
        counts = materialize(stack_counts(metrics))
        if extras:
            counts = jnp.concatenate([counts, materialize(measure_extras(grids, extras, features))], axis=-1)
        return Evaluation(materialize(weigh(counts, weights, extra_weights)), counts)

    def penalties(counts: Array) -> Array:
        return weigh(counts, penalty_weights(weights), None if extra_weights is None else jnp.maximum(extra_weights, 0))

    given = 0 if initial is None else len(initial)
    return Problem(
        shape, alphabet, axes, fill, fixed, random, repair_grid, repair_raster, evaluate, penalties, extras, given
    )
