"""A problem: the grids that an optimiser may make, and how they are evaluated."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import prod
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int, Int8, Int32, Key, Real
from numpy.typing import DTypeLike

from elitelanes_jax._util.checks import (
    LARGEST,
    check_named,
    check_unique,
    flag,
    function,
    function_of,
    instance,
    listed,
    none_or,
)
from elitelanes_jax._util.errors import InputError, shorten, suggest
from elitelanes_jax._util.types import AnyArray, Numeric, UserValue
from elitelanes_jax.network.bits import random_grids
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import KINDS, ROAD_ALPHABET, check_alphabet
from elitelanes_jax.network.fitness import fitness as weighted_sum
from elitelanes_jax.network.metrics import measure, stack_metrics, unstack_metrics
from elitelanes_jax.network.records import METRIC_NAMES, Weights, check_weights
from elitelanes_jax.network.repairing import repair
from elitelanes_jax.network.xla import materialize
from elitelanes_jax.problem.archive import VACANT, Population, vacant_fitness
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, niche_index, paper_axes, resolve_axes
from elitelanes_jax.problem.features import LARGEST_FITNESS, SHARES, check_feature, columns_for, largest_addend
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
from elitelanes_jax.problem.ranges import largest_penalty, parse_ranges, range_limits, range_penalty


class Evaluation(NamedTuple):
    """The evaluation of P grids.

    Attributes:
      fitness: int32 or float32 ``[P]``, lower is better.
      features: int32 ``[P, F]``, in the order of `Problem.feature_names`.
    """

    fitness: Real[Array, " P"]
    features: Int32[Array, "P F"]


@dataclass(frozen=True, eq=False)
class Problem:
    """The grids of a search, their evaluation and their niches. `road_problem` makes the paper's problem.

    Your own problem needs only the first two fields.

    Attributes:
      shape: (height, width) of the grids, each at least 2.
      evaluate: grids int8 ``[P, H, W]`` -> `Evaluation`; pure. Integers of a fitness are less than 2**29 in size. A
        float fitness that is not finite is refused: its grid becomes no elite.
      feature_names: the names of the F columns of features.
      axes: axes of the descriptor space; MAP-Elites needs at least one.
      alphabet: the codes, among 0 to 15, that new tiles are drawn from.
      repair: (grid, dirty, raster) -> grid, applied to every new grid; the last two are optional, and `raster` is given
        by name. See `elitelanes_jax.network.repair`. By default a code outside the alphabet becomes one of its K codes,
        the one at index code mod K.
      penalties: features int32 ``[..., F]`` -> int32 ``[...]``, the part of the fitness that no reward lowers; by
        default 0. The tuned MAP-Elites with `require_feasible`, as in its preset `irregular`, counts a niche as vacant
        until this is 0 there.
      initial: int8 ``[N, H, W]``, grids that every run starts from, or None.
      fill: whether `repair` leaves nothing to fill, so that moves need not. Otherwise moves may apply the repair of
        roads.
      fixed: bool ``[H, W]``, the cells that `repair` never changes, or None.
    """

    shape: tuple[int, int]
    evaluate: Callable[[Int8[Array, "P H W"]], Evaluation]
    feature_names: tuple[str, ...] = ()
    axes: tuple[Axis, ...] = ()
    alphabet: tuple[int, ...] = tuple(range(16))
    repair: Callable[..., Int8[Array, "H W"]] = None  # type: ignore[assignment]  # set when it is made
    penalties: Callable[[Int32[Array, "... F"]], Int32[Array, "..."]] = None  # type: ignore[assignment]
    initial: Int8[Array | np.ndarray, "N H W"] | None = None
    fill: bool = True
    fixed: Bool[np.ndarray, "H W"] | None = None

    def __post_init__(self) -> None:
        """Checks the fields and sets the defaults.

        Raises:
          InputError: for a bad shape or alphabet, an axis whose feature is no column, a repair without these arguments,
            fixed cells of another shape, or initial grids of another shape or with other codes.
        """
        shape, alphabet = check_shape(self.shape, new=True), check_alphabet(self.alphabet)
        names = tuple(check_named("feature_names", listed(str), self.feature_names))
        check_unique("feature_names", "name", names)
        for part in ("evaluate", "repair", "penalties"):
            check_named(part, function if part == "evaluate" else none_or(function), getattr(self, part))
        for check in (function_of("grid", "dirty", raster=False), function_of("grid", raster=False)):
            check_named("repair", none_or(check), self.repair)
        check_named("initial", none_or(_check_initial), self.initial, shape)
        if self.fixed is not None and np.shape(self.fixed) != shape:
            raise InputError(f"fixed: expected bool [{shape[0]}, {shape[1]}], got {shorten(repr(self.fixed))}")
        axes = resolve_axes(self.axes, shape, None) if not isinstance(self.axes, tuple | list) or self.axes else ()
        known = {*names, *(share for share, (part, whole) in SHARES.items() if {part, *whole} <= set(names))}
        for axis in axes:
            if axis.metric not in known:
                hint = suggest(axis.metric, known)
                raise InputError(f"axes: expected features of the problem, {', '.join(names)}, got {axis.metric}{hint}")
        for field, value in (("shape", shape), ("alphabet", alphabet), ("axes", axes), ("feature_names", names)):
            object.__setattr__(self, field, value)
        if self.repair is None:
            object.__setattr__(self, "repair", partial(_to_alphabet, alphabet))
        if self.penalties is None:
            object.__setattr__(self, "penalties", lambda features: jnp.zeros(features.shape[:-1], jnp.int32))

    @property
    def niches(self) -> int:
        """The number of niches.

        Raises:
          InputError: if there are no axes.
        """
        if not self.axes:
            raise InputError("axes: expected a problem with at least one axis, got none")
        return prod(axis.bins for axis in self.axes)

    def empty_archive(self, dtype: DTypeLike = jnp.int32, *, copies: int = 1) -> Population:
        """Returns a number of archives of vacant slots, end to end, for a fitness of a dtype.

        Raises:
          InputError: for a dtype that does not hold the fitness of vacant slots, or if there are no axes.
        """
        slots, kind = copies * self.niches, jnp.dtype(dtype)
        whole = jnp.issubdtype(kind, jnp.integer) and jnp.iinfo(kind).max >= VACANT
        if not (whole or jnp.issubdtype(kind, jnp.floating)):
            raise InputError(f"dtype: expected that of a fitness, int32 or float32, got {kind}")
        return Population(
            grids=jnp.zeros((slots, *self.shape), jnp.int8),
            fitness=jnp.full(slots, vacant_fitness(kind), kind),
            features=jnp.zeros((slots, len(self.feature_names)), jnp.int32),
        )

    def random(self, key: Key[Array, ""], count: int) -> Int8[Array, "count H W"]:
        """Returns repaired grids for a run to start from: the initial ones, then random ones; the key is consumed.

        Raises:
          InputError: for more initial grids than `count`.
        """
        grids = self.random_unrepaired(key, count)
        return jax.vmap(lambda grid, raster: self.repair(grid, raster=raster))(grids, self.drawn(count))

    def random_unrepaired(self, key: Key[Array, ""], count: int) -> Int8[Array, "count H W"]:
        """Returns the grids of `random` before their repair; those that are `drawn` are repaired in raster order."""
        grids = random_grids(key, count, self.shape, alphabet=self.alphabet)
        if self.initial is None:
            return grids
        given = len(self.initial)
        if given > count:
            raise InputError(f"initial: expected at most {count} grids, the number a run starts from, got {given}")
        return grids.at[:given].set(jnp.asarray(self.initial, jnp.int8))

    def drawn(self, count: int) -> Bool[np.ndarray, " count"]:
        """Returns which of the grids that a run starts from are random ones. The initial ones come first."""
        return np.arange(count) >= (0 if self.initial is None else len(self.initial))

    def repair_raster(self, grid: Int8[Array, "H W"]) -> Int8[Array, "H W"]:
        """Repairs a grid whose tiles are all new: each tile decides over those after it, row by row."""
        return self.repair(grid, raster=True)

    def descriptor(self, features: Int32[Array, "... F"]) -> Int32[Array, "... D"]:
        if np.shape(features)[-1:] != (len(self.feature_names),):
            raise InputError(f"features: expected shape [..., {len(self.feature_names)}], got {[*np.shape(features)]}")
        return compute_descriptor(features, self.feature_names, self.axes)

    def niche(self, features: Int32[Array, "... F"]) -> Int32[Array, "..."]:
        return niche_index(self.descriptor(features), self.axes)


def _check_initial(initial: UserValue, shape: tuple[int, int]) -> None:
    """Checks grids to start from; the codes of traced ones are unknown."""
    expected = f"whole numbers of shape [N, {shape[0]}, {shape[1]}]"
    try:
        array = initial if hasattr(initial, "dtype") else jnp.asarray(initial)
    except (TypeError, ValueError):
        raise InputError(f"expected {expected}, got {shorten(repr(initial))}") from None
    if not array.size:
        return
    if array.ndim != 3 or array.shape[1:] != shape or not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(f"expected {expected}, got {array.dtype} {[*array.shape]}")
    codes = np.arange(0) if isinstance(array, jax.core.Tracer) else np.asarray(array)
    if codes.size and not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError(f"expected tile codes 0 to 15, got {codes.min()} to {codes.max()}")


def _to_alphabet(
    alphabet: tuple[int, ...],
    grid: Int8[Array, "H W"],
    dirty: Bool[Array, "H W"] | None = None,
    raster: Bool[ArrayLike, ""] = False,
) -> Int8[Array, "H W"]:
    codes = [code if code in alphabet else alphabet[code % len(alphabet)] for code in range(16)]
    return grid if codes == list(range(16)) else jnp.array(codes, jnp.int8)[grid]


def road_problem(
    shape: tuple[int, int] = (12, 12),
    axes: UserValue = None,
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

    A grid is refused if a feature or the fitness of the user is out of range or not a number (see `Kernel` and
    `Fitness`), or if the sizes of the weighted features add up to over 2**29. It has the fitness of a vacant slot and
    becomes no elite.

    Args:
      shape: (height, width), each at least 2.
      axes: axes of the descriptor space, such as ``"cyclomatic:8"`` or several `Axis`; by default `paper_axes`.
      alphabet: the codes to draw from, by default all tiles with two or more connections. A repaired grid may hold
        others: `dead_ends` and `coverage` count stubs and empty cells, `off_alphabet` any other code.
      weights: weights of the metrics in the fitness; may be traced.
      fill: whether repair also fills (see `elitelanes_jax.network.repair`).
      where: ranges of features, such as ``{"bridges": (0, 3)}``; the distance from them adds to the fitness.
      limits: the same as an array that may be traced: the least and the greatest value of each feature and then of each
        share that follows from them; replaces `where`.
      measured: the names of K features to measure beside the metrics; features of axes and ranges may be omitted.
      feature_weights: int ``[K]``, weights of these features in the fitness, in the order of `measured`; may be traced.
        By default 0.
      features: kernels of the user's features, by name: letters, digits and _, and no name of another feature.
      fitness: a fitness of the user, which replaces the weighted sum or uses it. The penalty of ranges is added.
      fix: cells that never change: rows of codes, with None for a free cell, or the path of a JSON file with them.
      initial: int8 ``[N, H, W]``, grids that every run starts from.

    Raises:
      InputError: for a bad shape, alphabet, axis, range, feature, kernel, fitness, cell or initial grid, another number
        of weights than K, or weights with which a fitness might not fit int32, if they are not traced.
    """
    shape = check_shape(shape, new=True)
    check_named("weights", instance(Weights), weights)
    check_named("fill", flag, fill)
    alphabet = ROAD_ALPHABET if alphabet is None else check_alphabet(alphabet)
    features = check_kernels(features, shape)
    axes = paper_axes(shape) if axes is None else resolve_axes(axes, shape, features)
    ranges, fix = parse_ranges(where, features), None if fix is None else parse_fixed_cells(fix)
    if fix is not None:
        check_fits(fix, shape)
    measured = measured if isinstance(measured, str) else tuple(measured)
    measured = tuple(check_feature("measured", one, features) for one in check_named("measured", listed(str), measured))
    feature_names = columns_for((axis.metric for axis in axes), measured, (item.name for item in ranges))
    if ranges and limits is None:
        limits = range_limits(ranges, feature_names)
    factors = None if feature_weights is None else _check_feature_weights(feature_weights, measured)
    _check_total(shape, weights, measured, factors, largest_penalty(len(ranges), feature_names))
    if fitness is not None:
        check_fitness(fitness, shape, feature_names)
    return make_road_problem(
        shape,
        axes,
        feature_names,
        alphabet=alphabet,
        weights=weights,
        fill=fill,
        limits=limits,
        measured=measured,
        feature_weights=factors,
        features=features,
        fitness=fitness,
        fix=fix,
        initial=initial,
    )


def make_road_problem(
    shape: tuple[int, int],
    axes: tuple[Axis, ...],
    feature_names: tuple[str, ...],
    *,
    alphabet: tuple[int, ...],
    weights: Weights,
    fill: bool,
    limits: Int32[Array | np.ndarray, "2 C"] | None,
    measured: tuple[str, ...],
    feature_weights: Int[Array | np.ndarray, " K"] | None,
    features: Mapping[str, Kernel],
    fitness: Fitness | None,
    fix: FixedCells | None,
    initial: Int8[Array | np.ndarray, "N H W"] | None,
) -> Problem:
    """Makes the problem of `road_problem` from its checked arguments; `feature_names` are all that are measured."""
    others = feature_names[len(METRIC_NAMES) :]
    users = np.array([feature_names.index(name) for name in others if name in features], int)
    # The column of each weight; where they are in order, a slice, so that XLA gathers nothing.
    weighed = np.array([feature_names.index(name) for name in measured if feature_weights is not None], int)
    columns_weighed = np.s_[len(METRIC_NAMES) :] if measured == others else weighed
    own = np.array([place for place, name in enumerate(measured) if name in features], int)
    allowed = (*alphabet, *KINDS["end"], *KINDS["empty"])
    fixed = None if fix is None else fix.fixed

    def repair_grid(grid: Array, dirty: Array | None = None, raster: Numeric = False) -> Array:
        if fix is not None:
            grid = jnp.where(fix.fixed, fix.grid, grid)
        return repair(grid, dirty, raster=raster, fill=fill, fixed=fixed)

    def weigh(features: Array, weights: Weights, least: int | None = None) -> Array:
        total = weighted_sum(unstack_metrics(features, shape[0] * shape[1]), weights)
        if feature_weights is not None:
            addends = features[..., columns_weighed] * feature_weights
            total += addends.clip(least).sum(axis=-1, dtype=jnp.int32)
        return total

    def outside(features: Array) -> Array:
        return jnp.int32(0) if limits is None else range_penalty(features, feature_names, limits, shape)

    def refuse(features: Array, total: Array) -> Array:
        refused = jnp.zeros(total.shape, bool)
        if users.size:
            refused |= (jnp.abs(features[..., users]) >= LARGEST).any(axis=-1)
        if users.size and feature_weights is not None:
            refused |= _sum_exceeds(LARGEST_FITNESS, features[..., weighed[own]], jnp.asarray(feature_weights)[own])
        if fitness is not None and total.dtype == jnp.float32:
            refused |= ~jnp.isfinite(total)
        elif fitness is not None:
            refused |= jnp.abs(total) > LARGEST_FITNESS
        return refused

    def evaluate(grids: Array) -> Evaluation:
        grids = jnp.asarray(grids)
        if grids.shape[1:] != shape or grids.dtype != jnp.int8:
            raise InputError(f"grids: expected int8 [P, {shape[0]}, {shape[1]}], got {grids.dtype} {grids.shape}")
        metrics = jax.vmap(lambda grid: measure(grid, allowed))(grids)
        columns = materialize(stack_metrics(metrics))
        if others:
            columns = jnp.concatenate([columns, materialize(measure_features(grids, others, features))], axis=-1)
        total = weigh(columns, weights)
        if fitness is not None:
            total = apply_fitness(fitness, feature_names, grids, columns, total)
        refused, total = refuse(columns, total), materialize(total + outside(columns))
        if users.size or fitness is not None:
            total = jnp.where(refused, jnp.asarray(vacant_fitness(total.dtype), total.dtype), total)
        return Evaluation(total, columns)

    def penalties(features: Array) -> Array:
        if fitness is not None and "usual" not in arguments_of(fitness):
            return outside(features) + jnp.zeros(features.shape[:-1], jnp.int32)
        alone = Weights(*(jnp.maximum(weight, 0) for weight in weights))._replace(constant=0)
        return weigh(features, alone, least=0) + outside(features)

    return Problem(
        shape, evaluate, feature_names, axes, alphabet, repair_grid, penalties, initial, fill=fill, fixed=fixed
    )


def _check_feature_weights(weights: UserValue, measured: Sequence[str]) -> AnyArray:
    """Checks the weights of the measured features; returns them as an array."""
    array = weights if hasattr(weights, "dtype") else np.asarray(weights)
    check_unique("measured", "name", measured)
    if array.shape != (len(measured),):
        got = f"shape {[*array.shape]}"
        raise InputError(f"feature_weights: expected {len(measured)} numbers, one for each of measured, got {got}")
    if array.size and not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError(f"feature_weights: expected whole numbers, got {array.dtype}")
    for name in measured:
        if name in SHARES:
            raise InputError(f"measured: expected features that may be weighed, got the share {name}")
    return array


def _check_total(
    shape: tuple[int, int], weights: Weights, measured: Sequence[str], feature_weights: AnyArray | None, penalty: int
) -> None:
    """Checks that a fitness with these weights and a penalty fits int32; traced weights are unknown."""
    if any(isinstance(one, jax.core.Tracer) for one in (*weights, feature_weights)):
        return
    others = {} if feature_weights is None else dict(zip(measured, np.asarray(feature_weights).tolist(), strict=True))
    weights = check_weights(weights, shape)
    both = {name: getattr(weights, name) + weight for name, weight in others.items() if name in METRIC_NAMES}
    check_weights(weights._replace(**both), shape, penalty + largest_addend(others.items(), shape))


def _sum_exceeds(most: int, values: Int32[Array, "... K"], weights: Int32[Array, " K"]) -> Bool[Array, "..."]:
    """Returns whether the sizes of weighted values add up to over `most`, at most 2**29; exact, in 32 bits."""
    sizes = jnp.abs(weights).astype(jnp.uint32)
    # A larger value gives an addend that exceeds `most` too.
    least = most // jnp.maximum(sizes, 1) + 1
    addends = jnp.minimum(jnp.abs(values).astype(jnp.uint32), least) * sizes
    total = jnp.zeros(values.shape[:-1], jnp.uint32)
    for column in range(weights.size):
        total = jnp.minimum(total + addends[..., column], most + 1)
    return total > most
