"""A problem: the grids that an optimiser may make, and how they are evaluated."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Int8, Int32, Key, Real
from numpy.typing import DTypeLike

from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    flag,
    function,
    function_of,
    listed,
    none_or,
    whole,
)
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.network.bits import random_grids
from elitelanes_jax.network.checks import check_shape
from elitelanes_jax.network.codes import check_alphabet
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.problem.archive import VACANT, Population, vacant_fitness
from elitelanes_jax.problem.descriptor import Axis, compute_descriptor, niche_index, resolve_axes
from elitelanes_jax.problem.features import SHARES


class Evaluation(NamedTuple):
    """The evaluation of P grids.

    Attributes:
      fitness: int32 or float32 ``[P]``, lower is better.
      features: int32 ``[P, F]``, in the order of `Problem.feature_names`; without features
        an array ``[P, 0]``.
    """

    fitness: Real[Array, " P"]
    features: Int32[Array, "P F"]


@dataclass(frozen=True, eq=False)
class Problem:
    """The grids of a search, their evaluation and their niches.

    `road_problem` makes the paper's problem. Your own problem needs only the first two fields.

    Attributes:
      shape: (height, width) of the grids, each at least 2.
      evaluate: grids int8 ``[P, H, W]`` -> `Evaluation`; pure. Integers of a fitness are less than
        2**29 in size. A float fitness that is not finite is refused: its grid becomes no elite.
      feature_names: the names of the F columns of features.
      axes: axes of the descriptor space; MAP-Elites needs at least one.
      alphabet: the codes, among 0 to 15, that new tiles are drawn from.
      repair: a function of ``(grid, dirty=None, raster=False)`` that returns a grid, applied to
        every new grid. It takes all three arguments, also if it uses the grid alone; see
        `elitelanes_jax.network.repair`. By default a code outside the alphabet becomes one of its K
        codes, the one at index code mod K.
      penalties: features int32 ``[..., F]`` -> int32 ``[...]``, the part of the fitness that no
        reward lowers; by default 0. The tuned MAP-Elites with `require_feasible`, as in its preset
        `irregular`, counts a niche as vacant until this is 0 there.
      initial: int8 ``[N, H, W]``, grids that every run starts from, or None.
      fill: whether `repair` leaves nothing to fill, so that moves need not. Otherwise moves may
        apply the repair of roads.
      fixed: bool ``[H, W]``, the cells that `repair` never changes, or None.
    """

    shape: tuple[int, int]
    evaluate: Callable[[Int8[Array, "P H W"]], Evaluation]
    feature_names: tuple[str, ...] = ()
    axes: tuple[Axis, ...] = ()
    alphabet: tuple[int, ...] = tuple(range(16))
    # `__post_init__` replaces None in these two fields.
    repair: Callable[..., Int8[Array, "H W"]] = None  # type: ignore[assignment]
    penalties: Callable[[Int32[Array, "... F"]], Int32[Array, "..."]] = None  # type: ignore[assignment]
    initial: Int8[Array | np.ndarray, "N H W"] | None = None
    fill: bool = True
    fixed: Bool[np.ndarray, "H W"] | None = None

    def __post_init__(self) -> None:
        """Checks the fields and sets the defaults.

        Raises:
          InputError: for a bad shape or alphabet, an axis whose feature is no column, a repair
            without these arguments, fixed cells of another shape or type, or initial grids of
            another shape or with other codes.
        """
        shape = check_shape(self.shape, new=True)
        alphabet = check_alphabet(self.alphabet)
        names = tuple(check_named("feature_names", listed(str), self.feature_names))
        check_unique("feature_names", "name", names)
        check_named("evaluate", function, self.evaluate)
        # A repair is called with and without a dirty mask.
        check_named("repair", none_or(function_of("grid", "dirty", raster=False)), self.repair)
        check_named("repair", none_or(function_of("grid", raster=False)), self.repair)
        check_named("penalties", none_or(function), self.penalties)
        check_named("initial", none_or(_check_initial), self.initial, shape)
        check_named("fill", flag, self.fill)
        check_named("fixed", none_or(_check_fixed), self.fixed, shape)
        # The features may have any names, so axes are checked against these names instead of the
        # known features.
        axes: tuple[Axis, ...] = ()
        if not _is_empty(self.axes):
            axes = resolve_axes(self.axes, shape, None)
            _check_axes_are_features(axes, names)

        fields: dict[str, UserValue] = {
            "initial": _copy_of(self.initial),
            "fixed": _copy_of(self.fixed),
            "shape": shape,
            "alphabet": alphabet,
            "axes": axes,
            "feature_names": names,
        }
        if self.repair is None:
            fields["repair"] = partial(_to_alphabet, alphabet)
        if self.penalties is None:
            fields["penalties"] = _no_penalties
        # The class is frozen, so its own fields cannot be assigned.
        for name, value in fields.items():
            object.__setattr__(self, name, value)

    @property
    def niches(self) -> int:
        """The number of niches.

        Raises:
          InputError: if there are no axes.
        """
        if not self.axes:
            raise InputError("axes", "a problem with at least one axis", "none")
        return prod(axis.bins for axis in self.axes)

    @runs_jax
    def empty_archive(self, dtype: DTypeLike = jnp.int32, *, copies: int = 1) -> Population:
        """Returns a number of archives of vacant slots, end to end, for a fitness of a dtype.

        Raises:
          InputError: for a dtype that does not hold the fitness of vacant slots, or if there are no
            axes.
        """
        slots = copies * self.niches
        fitness_dtype = jnp.dtype(dtype)
        is_float = jnp.issubdtype(fitness_dtype, jnp.floating)
        is_integer = jnp.issubdtype(fitness_dtype, jnp.integer)
        holds_vacant = is_float or (is_integer and jnp.iinfo(fitness_dtype).max >= VACANT)
        if not holds_vacant:
            expected = "that of a fitness, int32 or float32"
            raise InputError("dtype", expected, fitness_dtype)
        height, width = self.shape
        return Population(
            grids=jnp.zeros((slots, height, width), jnp.int8),
            fitness=jnp.full(slots, vacant_fitness(fitness_dtype), fitness_dtype),
            features=jnp.zeros((slots, len(self.feature_names)), jnp.int32),
        )

    def random(self, key: Key[Array, ""], count: int) -> Int8[Array, "count H W"]:
        """Returns repaired grids for a run to start from.

        The initial grids come first, then random ones. The key is consumed.

        Raises:
          InputError: for a count that is not a whole number from 0 on, or less than the initial
            grids.
        """
        count = check_named("count", whole(0), count)

        @runs_jax
        @divide_batches
        def draw(key: Array) -> Array:
            grids = self.random_unrepaired(key, count)
            return jax.vmap(lambda grid, raster: self.repair(grid, raster=raster))(
                grids, self.drawn(count)
            )

        return draw(key)

    def random_unrepaired(self, key: Key[Array, ""], count: int) -> Int8[Array, "count H W"]:
        """Returns the grids of `random` before their repair.

        Grids that are `drawn` are repaired in raster order.
        """
        grids = random_grids(key, count, self.shape, alphabet=self.alphabet)
        if self.initial is None:
            return grids
        initial_count = len(self.initial)
        if initial_count > count:
            expected = f"at most {count} grids, the number a run starts from"
            raise InputError("initial", expected, initial_count)
        return grids.at[:initial_count].set(jnp.asarray(self.initial, jnp.int8))

    def drawn(self, count: int) -> Bool[np.ndarray, " count"]:
        """Returns which of the grids that a run starts from are random ones.

        The initial ones come first.
        """
        initial_count = 0
        if self.initial is not None:
            initial_count = len(self.initial)
        return np.arange(count) >= initial_count

    def repair_raster(self, grid: Int8[Array, "H W"]) -> Int8[Array, "H W"]:
        """Repairs a grid whose tiles are all new.

        Each tile decides over those after it, row by row.
        """
        return self.repair(grid, raster=True)

    @runs_jax
    def descriptor(self, features: Int32[Array, "... F"]) -> Int32[Array, "... D"]:
        columns = len(self.feature_names)
        if np.shape(features)[-1:] != (columns,):
            got = list(np.shape(features))
            raise InputError("features", f"shape [..., {columns}]", got)
        return compute_descriptor(features, self.feature_names, self.axes)

    @runs_jax
    def niche(self, features: Int32[Array, "... F"]) -> Int32[Array, "..."]:
        return niche_index(self.descriptor(features), self.axes)


def _is_empty(axes: UserValue) -> bool:
    """Returns whether there are no axes.

    An empty text or mapping is left to `resolve_axes`, which refuses it.
    """
    return isinstance(axes, tuple | list) and not axes


def _check_axes_are_features(axes: tuple[Axis, ...], names: tuple[str, ...]) -> None:
    """Checks that the metric of each axis is a feature of the problem.

    It is a column of the features, or a share that follows from the columns.
    """
    known = set(names)
    for share, (part, total) in SHARES.items():
        if part in names and set(total) <= set(names):
            known.add(share)
    for axis in axes:
        if axis.metric not in known:
            hint = suggest(axis.metric, known)
            expected = f"features of the problem, {', '.join(names)}"
            raise InputError("axes", expected, axis.metric, hint)


def _copy_of(array: UserValue) -> UserValue:
    """Returns an array, or rows of numbers, as a copy; an array of JAX or None unchanged."""
    return array if array is None or isinstance(array, jax.Array) else frozen_copy(np.array(array))


def _no_penalties(features: Int32[Array, "... F"]) -> Int32[Array, "..."]:
    return jnp.zeros(features.shape[:-1], jnp.int32)


def _check_fixed(fixed: Untyped, shape: tuple[int, int]) -> None:
    expected = f"bool [{shape[0]}, {shape[1]}]"
    try:
        array = fixed if hasattr(fixed, "dtype") else np.asarray(fixed)
    except ValueError:
        # The rows have several lengths.
        raise InputError("", expected, quote(fixed)) from None
    if array.dtype != np.bool_ or array.shape != shape:
        raise InputError("", expected, quote(fixed))


def _check_initial(initial: Untyped, shape: tuple[int, int]) -> None:
    """Checks grids to start from; the codes of traced ones are unknown."""
    expected = f"whole numbers of shape [N, {shape[0]}, {shape[1]}]"
    try:
        array = initial if hasattr(initial, "dtype") else jnp.asarray(initial)
    except (OverflowError, TypeError, ValueError):
        raise InputError("", expected, quote(initial)) from None
    has_shape = array.ndim == 3 and array.shape[1:] == shape
    if not has_shape or not jnp.issubdtype(array.dtype, jnp.integer):
        raise InputError("", expected, f"{array.dtype} {list(array.shape)}")
    if isinstance(array, jax.core.Tracer):
        return
    codes = np.asarray(array)
    if codes.size and not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError("", "tile codes 0 to 15", f"{codes.min()} to {codes.max()}")


def _to_alphabet(
    alphabet: tuple[int, ...],
    grid: Int8[Array, "H W"],
    dirty: Bool[Array, "H W"] | None = None,
    raster: Bool[ArrayLike, ""] = False,
) -> Int8[Array, "H W"]:
    """Replaces each code outside the alphabet by one of its K codes.

    Code c becomes the one at index c mod K.
    """
    # The four lowest bits of a traced code are read.
    grid = grid & 15
    if set(alphabet) == set(range(16)):
        return grid
    code_by_code = list(range(16))
    for code in range(16):
        if code not in alphabet:
            code_by_code[code] = alphabet[code % len(alphabet)]
    return jnp.array(code_by_code, jnp.int8)[grid]
