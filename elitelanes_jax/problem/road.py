"""The paper's problem: road networks of one size.

The module has all that distinguishes one such problem from another.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    LARGEST,
    check_named,
    check_unique,
    flag,
    instance,
    items_of,
    listed,
)
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Numeric, Untyped, UserValue
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import KINDS, ROAD_ALPHABET, check_alphabet
from elitelanes_jax.network.edges import check_array
from elitelanes_jax.network.metrics import measure, stack_metrics, unstack_metrics
from elitelanes_jax.network.records import METRIC_NAMES, Weights, check_weights
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.weighted_sum import fitness as weighted_sum
from elitelanes_jax.network.xla import align, materialize
from elitelanes_jax.problem.archive import vacant_fitness
from elitelanes_jax.problem.descriptor import Axis, paper_axes, resolve_axes, tuned_axes
from elitelanes_jax.problem.features import (
    LARGEST_FITNESS,
    SHARES,
    check_feature,
    columns_for,
    largest_addend,
)
from elitelanes_jax.problem.fixed_cells import FixedCells, check_fits, parse_fixed_cells
from elitelanes_jax.problem.kernels import (
    Fitness,
    Kernel,
    apply_fitness,
    arguments_of,
    check_fitness,
    check_kernels,
    measure_features,
)
from elitelanes_jax.problem.problem import Evaluation, Problem
from elitelanes_jax.problem.ranges import largest_penalty, parse_ranges, range_limits, range_penalty

# `jax.jit` compiles a program for each value of such a field.
_STATIC = {"static": True}

# The numbers of a problem are arrays, or their shapes and dtypes alone, by which programs are
# looked up.
_Numbers: TypeAlias = Untyped

# The axes that have a name.
_NAMED_AXES = {"paper": paper_axes, "tuned": tuned_axes}


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class RoadProblem:
    """All that makes one road problem, checked; a pytree.

    Programs are compiled for the static fields. The numbers, which may be traced, are weights,
    limits, feature_weights and initial.

    Attributes:
      shape: (height, width) of the grids.
      axes: the axes of the descriptor space.
      feature_names: the names of the F columns of features: the metrics, then all others that are
        measured.
      alphabet: the codes that new tiles are drawn from.
      fill: whether repair also fills.
      fix: cells that never change, or None.
      measured: the names of K features besides the metrics that may have a weight.
      kernels: the names and kernels of the user's features among `feature_names`.
      fitness: the fitness function of the user, or None.
      weights: the weights of the metrics in the fitness.
      limits: int32 ``[2, C]``, the least and the greatest value of each column of `with_shares`;
        None for no ranges.
      feature_weights: int ``[K]``, of the `measured` features in the fitness; None if all are 0.
      initial: int8 ``[N, H, W]``, grids that every run starts from, or None.
    """

    shape: tuple[int, int] = field(metadata=_STATIC)
    axes: tuple[Axis, ...] = field(metadata=_STATIC)
    feature_names: tuple[str, ...] = field(metadata=_STATIC)
    alphabet: tuple[int, ...] = field(default=ROAD_ALPHABET, metadata=_STATIC)
    fill: bool = field(default=False, metadata=_STATIC)
    fix: FixedCells | None = field(default=None, metadata=_STATIC)
    measured: tuple[str, ...] = field(default=(), metadata=_STATIC)
    kernels: tuple[tuple[str, Kernel], ...] = field(default=(), metadata=_STATIC)
    fitness: Fitness | None = field(default=None, metadata=_STATIC)
    weights: Weights = Weights()
    limits: Int32[_Numbers, "2 C"] | None = None
    feature_weights: Int[_Numbers, " K"] | None = None
    initial: Int8[_Numbers, "N H W"] | None = None


@name_wrong_arguments
def road_problem(
    shape: tuple[int, int] = (12, 12),
    axes: UserValue = "paper",
    *,
    alphabet: Iterable[int] | None = None,
    weights: Weights = Weights(),
    fill: bool = False,
    where: UserValue = (),
    limits: Int32[Array | np.ndarray, "2 C"] | None = None,
    measured: Iterable[str] = (),
    feature_weights: Int[ArrayLike, " K"] | None = None,
    features: Mapping[str, Kernel] = MappingProxyType({}),
    fitness: Fitness | None = None,
    fix: UserValue = None,
    initial: Int8[Array | np.ndarray, "N H W"] | None = None,
) -> Problem:
    """Makes the paper's problem: road networks of one size.

    A grid is refused if the user's fitness is out of range or not a number, or if a feature of the
    user has a size of 2**30 or more. It is also refused if the sizes of the weighted features add
    up to over 2**29. It has the fitness of a vacant slot and becomes no elite.

    Args:
      shape: (height, width), each at least 2.
      axes: axes of the descriptor space, such as ``"cyclomatic:8"`` or several `Axis`; "paper" for
        the paper's 400 niches, or "tuned" for these with narrower bins and with targets.
      alphabet: the codes to draw from, by default all tiles with two or more connections. A
        repaired grid may hold others: `dead_ends` and `coverage` count stubs and empty cells,
        `off_alphabet` any other code.
      weights: weights of the metrics in the fitness; may be traced.
      fill: whether repair also fills (see `elitelanes_jax.network.repair`).
      where: ranges of features, such as ``{"bridges": (0, 3)}``; the distance from them adds to the
        fitness.
      limits: the same as an array that may be traced: the least and the greatest value of each
        feature and then of each share that follows from them, from -2**30 to 2**30, which mean no
        limit; replaces `where`.
      measured: the names of K features to measure beside the metrics; features of axes and ranges
        may be omitted.
      feature_weights: int ``[K]``, weights of these features in the fitness, in the order of
        `measured`; may be traced. By default 0.
      features: the user's features by name: functions of one grid, int8 ``[H, W]``, that return a
        whole number. A name has letters, digits and _, and is not that of another feature.
      fitness: a fitness of the user, see `elitelanes_jax.evolve`, which replaces the weighted sum
        or uses it. The penalty of ranges is added.
      fix: cells that never change: rows of codes, with None for a free cell, or the path of a JSON
        file with them.
      initial: int8 ``[N, H, W]``, grids that every run starts from.

    Raises:
      InputError: for a bad shape, alphabet, axis, range, feature, kernel, fitness, cell or initial
        grid, limits of another shape, type or size, another number of weights than K, or weights
        with which a fitness might not fit int32. The values of traced weights and limits are not
        checked.
    """
    shape = check_shape(shape, new=True)
    check_named("weights", instance(Weights), weights)
    check_named("fill", flag, fill)
    if alphabet is None:
        alphabet = ROAD_ALPHABET
    else:
        alphabet = check_alphabet(alphabet)
    features = check_kernels(features, shape)
    if isinstance(axes, str) and axes in _NAMED_AXES:
        axes = _NAMED_AXES[axes](shape)
    else:
        axes = resolve_axes(axes, shape, features)
    ranges = parse_ranges(where, features)
    if fix is not None:
        fix = parse_fixed_cells(fix)
        check_fits(fix, shape)

    measured = _check_measured(measured, features)
    axis_names = [axis.metric for axis in axes]
    range_names = [item.name for item in ranges]
    # What axes and ranges name is measured too. Kernels that nothing names are left out.
    feature_names = columns_for(axis_names, measured, range_names)
    kernels = {name: kernel for name, kernel in features.items() if name in feature_names}

    limited = len(ranges)
    if limits is not None:
        limited = _count_limited(limits, feature_names)
    elif ranges:
        limits = range_limits(ranges, feature_names)
    if feature_weights is not None:
        feature_weights = _check_feature_weights(feature_weights, measured)
    # No sum of weighted metrics, features and penalties may exceed int32 on any grid.
    penalty = largest_penalty(limited, feature_names)
    _check_total(shape, weights, measured, feature_weights, penalty)
    if fitness is not None:
        check_fitness(fitness, shape, feature_names)
    road = RoadProblem(
        shape=shape,
        axes=axes,
        feature_names=feature_names,
        alphabet=alphabet,
        fill=fill,
        fix=fix,
        measured=measured,
        kernels=tuple(kernels.items()),
        fitness=fitness,
        weights=Weights._make(map(frozen_copy, weights)),
        limits=frozen_copy(limits),
        feature_weights=frozen_copy(feature_weights),
        initial=initial,
    )
    return make_problem(road)


def make_problem(road: RoadProblem) -> Problem:
    """Makes the functions of a road problem."""
    return Problem(
        shape=road.shape,
        evaluate=partial(_evaluate, road=road),
        feature_names=road.feature_names,
        axes=road.axes,
        alphabet=road.alphabet,
        repair=partial(_repair, road),
        penalties=partial(_penalties, road=road),
        initial=road.initial,
        fill=road.fill,
        fixed=None if road.fix is None else road.fix.fixed,
    )


def _repair(
    road: RoadProblem,
    grid: Int8[Array, "H W"],
    dirty: Bool[Array, "H W"] | None = None,
    raster: Numeric = False,
) -> Int8[Array, "H W"]:
    """Repairs a grid, and puts the fixed cells back."""
    fixed = None
    if road.fix is not None:
        fixed = road.fix.fixed
        grid = jnp.where(fixed, road.fix.grid, grid)
    return repair(grid, dirty, raster=raster, fill=road.fill, fixed=fixed)


@runs_jax
@partial(divide_batches, rows=0)
def _evaluate(grids: Int8[Array, "P H W"], *, road: RoadProblem) -> Evaluation:
    """Measures grids, and computes their fitness."""
    grids = check_array("grids", grids, ("P", *road.shape), jnp.int8)
    features = _measure(road, grids)
    total = _weigh(road, features, road.weights)
    if road.fitness is not None:
        total = apply_fitness(road.fitness, road.feature_names, grids, features, total)
    # The penalty is added after a value out of range is found, because the sum might not show it.
    refused = _refuse(road, features, total)
    total = materialize(total + _penalty(road, features).astype(total.dtype))
    if road.kernels or road.fitness is not None:
        vacant = jnp.asarray(vacant_fitness(total.dtype), total.dtype)
        total = jnp.where(refused, vacant, total)
    return Evaluation(total, features)


def _measure(road: RoadProblem, grids: Int8[Array, "P H W"]) -> Int32[Array, "P F"]:
    """Measures the metrics and the other features of grids."""
    # Stubs and empty cells are counted by other metrics, so `off_alphabet` need not count them.
    allowed_codes = road.alphabet + KINDS["end"] + KINDS["empty"]
    metrics = jax.vmap(lambda grid: measure(grid, allowed_codes))(grids)
    columns = materialize(stack_metrics(metrics))
    other_names = road.feature_names[len(METRIC_NAMES) :]
    if other_names:
        other_columns = measure_features(grids, other_names, dict(road.kernels))
        columns = jnp.concatenate([columns, materialize(other_columns)], axis=-1)
    return columns


def _weigh(
    road: RoadProblem, features: Int32[Array, "... F"], weights: Weights, *, rewards: bool = True
) -> Int32[Array, "..."]:
    """Returns the weighted sum of features.

    Without `rewards`, addends of `feature_weights` below 0 do not count.
    """
    height, width = road.shape
    total = weighted_sum(unstack_metrics(features, height * width), weights)
    if road.feature_weights is not None:
        values, feature_weights = align(features[..., _weighed_columns(road)], road.feature_weights)
        addends = jnp.multiply(values, feature_weights)
        if not rewards:
            addends = addends.clip(0)
        total += addends.sum(axis=-1, dtype=jnp.int32)
    return total


def _weighed_columns(road: RoadProblem) -> slice | Int[np.ndarray, " K"]:
    """Returns the columns of the `measured` features.

    If the columns are in order, they are a slice, so that XLA gathers nothing.
    """
    if road.measured == road.feature_names[len(METRIC_NAMES) :]:
        return slice(len(METRIC_NAMES), None)
    return _columns(road, road.measured)


def _columns(road: RoadProblem, names: Sequence[str]) -> Int[np.ndarray, " K"]:
    return np.array([road.feature_names.index(name) for name in names], int)


def _penalty(road: RoadProblem, features: Int32[Array, "... F"]) -> Int32[Array, "..."]:
    """Returns the penalty for the distance from the ranges."""
    if road.limits is None:
        return jnp.int32(0)
    return range_penalty(features, road.feature_names, road.limits, road.shape)


def _refuse(
    road: RoadProblem, features: Int32[Array, "P F"], total: Real[Array, " P"]
) -> Bool[Array, " P"]:
    """Returns which grids have a value of the user's that is out of range or not a number."""
    refused = jnp.zeros(total.shape, bool)
    names = [name for name, _ in road.kernels]
    if names:
        values = features[..., _columns(road, names)]
        refused |= (jnp.abs(values) >= LARGEST).any(axis=-1)
    if names and road.feature_weights is not None:
        weighed = [name for name in road.measured if name in names]
        indices = np.array([road.measured.index(name) for name in weighed], int)
        weights = jnp.asarray(road.feature_weights)[indices]
        refused |= _sum_exceeds(LARGEST_FITNESS, features[..., _columns(road, weighed)], weights)
    if road.fitness is None:
        return refused
    if total.dtype == jnp.float32:
        return refused | ~jnp.isfinite(total)
    return refused | (jnp.abs(total) > LARGEST_FITNESS)


@runs_jax
@partial(divide_batches, rows=0)
def _penalties(features: Int32[Array, "... F"], *, road: RoadProblem) -> Int32[Array, "..."]:
    """Returns the part of the fitness that no reward lowers, see `Problem`."""
    outside = _penalty(road, features)
    if road.fitness is not None and "usual" not in arguments_of(road.fitness):
        # The weights have no part in this fitness.
        return outside + jnp.zeros(features.shape[:-1], jnp.int32)
    # Weights below 0 are rewards.
    punishing_weights = Weights._make([jnp.maximum(weight, 0) for weight in road.weights])
    punishing_weights = punishing_weights._replace(constant=0)
    return _weigh(road, features, punishing_weights, rewards=False) + outside


def _check_measured(names: UserValue, features: Mapping[str, Kernel]) -> tuple[str, ...]:
    """Checks the names of features to measure."""
    if not isinstance(names, str):
        names = tuple(items_of(names))
    checked = []
    for name in check_named("measured", listed(str), names):
        checked.append(check_feature("measured", name, features))
    return tuple(checked)


def _check_feature_weights(weights: Untyped, measured: Sequence[str]) -> AnyArray:
    """Checks the weights of the measured features; returns them as an array."""
    array = weights if hasattr(weights, "dtype") else np.asarray(weights)
    check_unique("measured", "name", measured)
    if array.shape != (len(measured),):
        got = f"shape {[*array.shape]}"
        raise InputError(
            "feature_weights", f"{len(measured)} numbers, one for each of measured", got
        )
    if array.size and not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError("feature_weights", "whole numbers", array.dtype)
    for name in measured:
        if name in SHARES:
            raise InputError("measured", "features that may be weighed", f"the share {name}")
    return array


def _count_limited(limits: AnyArray, feature_names: Sequence[str]) -> int:
    """Checks limits of columns; returns how many columns they limit, 0 if the limits are traced."""
    if not hasattr(limits, "dtype") or not jnp.issubdtype(limits.dtype, jnp.integer):
        got = getattr(limits, "dtype", quote(limits))
        raise InputError("limits", "an array of whole numbers", got)
    shape = (2, len(feature_names) + len(SHARES))
    if np.shape(limits) != shape:
        expected, got = list(shape), list(np.shape(limits))
        raise InputError("limits", f"shape {expected}", got)
    if isinstance(limits, jax.core.Tracer):
        return 0
    lower, upper = np.asarray(limits)
    least = min(lower.min(), upper.min())
    most = max(lower.max(), upper.max())
    if least < -LARGEST or most > LARGEST:
        # The difference of a feature and its limit must fit int32.
        expected_values = f"{-LARGEST:,} to {LARGEST:,}"
        raise InputError("limits", expected_values, f"{least:,} to {most:,}")
    is_limited = (lower > -LARGEST) | (upper < LARGEST)
    return int(np.count_nonzero(is_limited))


def _check_total(
    shape: tuple[int, int],
    weights: Weights,
    measured: Sequence[str],
    feature_weights: AnyArray | None,
    penalty: int,
) -> None:
    """Checks that a fitness with these weights and a penalty fits int32.

    Traced weights are unknown, and are not checked.
    """
    if isinstance(feature_weights, jax.core.Tracer):
        return
    if any(isinstance(weight, jax.core.Tracer) for weight in weights):
        return
    weight_by_feature: dict[str, int] = {}
    if feature_weights is not None:
        numbers = np.asarray(feature_weights).tolist()
        weight_by_feature = dict(zip(measured, numbers, strict=True))
    weights = check_weights(weights, shape)
    # A metric may have a weight of both kinds, which add up.
    sums = {}
    for name, weight in weight_by_feature.items():
        if name in METRIC_NAMES:
            sums[name] = getattr(weights, name) + weight
    other_addends = penalty + largest_addend(weight_by_feature.items(), shape)
    check_weights(weights._replace(**sums), shape, other_addends)


def _sum_exceeds(
    most: int, values: Int32[Array, "... K"], weights: Int32[Array, " K"]
) -> Bool[Array, "..."]:
    """Returns whether the sizes of weighted values add up to over `most`.

    The limit `most` is at most 2**29. The result is exact, although it is computed in 32 bits.
    """
    values, weights = align(values, weights)
    sizes = jnp.abs(weights).astype(jnp.uint32)
    # Each value is limited to the least one whose addend exceeds `most`. So addends fit 32 bits.
    least = most // jnp.maximum(sizes, 1) + 1
    addends = jnp.minimum(jnp.abs(values).astype(jnp.uint32), least) * sizes
    total = jnp.zeros(values.shape[:-1], jnp.uint32)
    for column in range(weights.size):
        total = jnp.minimum(total + addends[..., column], most + 1)
    return total > most
