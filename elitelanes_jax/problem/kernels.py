"""Kernels of the user: functions of one grid that return a feature or a fitness."""

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from hashlib import sha256
from inspect import Parameter, signature
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int8, Int32, Integer, Real
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import LARGEST, check_named, function_of
from elitelanes_jax._util.errors import InputError, quote, shorten, suggest
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, Pytree, Untyped, UserValue
from elitelanes_jax.network.metrics import unstack_metrics
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.network.town import measure_town
from elitelanes_jax.problem.features import (
    SHARES,
    TOWN_FEATURES,
    check_features,
    columns_for,
    with_shares,
)

if TYPE_CHECKING:
    from jax.extend import core

Kernel: TypeAlias = Callable[[Int8[Array, "H W"]], Integer[ArrayLike, ""]]
"""A feature of the user: one grid -> a whole number. Pure, for `jax.jit` and `jax.vmap`.

A grid whose value has a size of 2**30 or more is refused, see `road_problem`.
"""

Fitness: TypeAlias = Callable[..., Real[ArrayLike, ""]]
"""A fitness of the user: lower is better. Pure, for `jax.jit` and `jax.vmap`.

It takes any of these arguments, by name; one with a default keeps it:

- ``metrics``: the `Metrics` of the grid.
- ``features``: a dictionary of all features that the search measures, by name: metrics, shares,
  the user's, and the town features that axes, ranges or weights of the search name. Shares and
  ratios are in thousandths.
- ``grid``: int8 ``[H, W]``.
- ``usual``: int32, the weighted sum of features that is the fitness by default.

It returns an integer scalar, at most 2**29 in size, or a float scalar, converted to float32. A grid
with any other value, such as NaN, is refused, see `road_problem`.
"""

# The arguments that a fitness may have.
_ARGUMENTS = ("metrics", "features", "grid", "usual")
_RETURNS_SCALAR = "to return an integer or float scalar"
_RETURNS_INTEGER = "to return an integer scalar"


def check_kernels(features: UserValue, shape: tuple[int, int]) -> dict[str, Kernel]:
    """Checks that the user's features are functions that JAX can trace.

    On grids of a shape, each function returns an integer scalar.
    """
    if features is None:
        return {}
    if not isinstance(features, Mapping):
        raise InputError("features", "kernels by name", quote(features))
    check_features(features)
    for name, kernel in features.items():
        if not callable(kernel):
            raise InputError("features", f"{name} to be a function of a grid", quote(kernel))
        check_named(f"features: {name}", function_of("grid"), kernel)
        # JAX traces the kernel with a shape and a dtype alone, so nothing is computed.
        grid = jax.ShapeDtypeStruct(shape, jnp.int8)
        result = _trace_shapes("features", name, partial(_apply_kernel, name, kernel), grid)
        is_array = hasattr(result, "dtype")
        if not is_array or result.shape or not jnp.issubdtype(result.dtype, jnp.integer):
            raise InputError("features", f"{name} {_RETURNS_INTEGER}", _described(result))
    return dict(features)


def check_fitness(
    fitness: UserValue, shape: tuple[int, int], feature_names: Sequence[str]
) -> Fitness:
    """Checks that JAX can trace a fitness of the user to a scalar.

    The arguments of the fitness are among those that `Fitness` lists.
    """
    if not callable(fitness):
        expected = "a function of metrics, features, grid or usual"
        raise InputError("fitness", expected, quote(fitness))
    for argument in arguments_of(fitness):
        if argument not in _ARGUMENTS:
            names = ", ".join(_ARGUMENTS)
            raise InputError("fitness", f"arguments among {names}", repr(argument))
    height, width = shape
    grids = jax.ShapeDtypeStruct((1, height, width), jnp.int8)
    features = jax.ShapeDtypeStruct((1, len(feature_names)), jnp.int32)
    usual = jax.ShapeDtypeStruct((1,), jnp.int32)
    apply = partial(apply_fitness, fitness, feature_names)
    try:
        result = _trace_shapes("fitness", "it", apply, grids, features, usual)
    except KeyError as error:
        (name, *_) = error.args or ("",)
        known = (*feature_names, *SHARES)
        is_town = name in TOWN_FEATURES
        similar = suggest(name, (*known, *TOWN_FEATURES))
        hint = f"weights={{{name!r}: 0}} measures it" if is_town else similar
        # Any other key is that of a mapping of the user's.
        if name in known or not hint:
            raise
        raise InputError("fitness", "features that are measured", repr(name), hint) from error
    is_scalar = getattr(result, "shape", None) == (1,)
    if not is_scalar or not jnp.issubdtype(result.dtype, jnp.number) or result.dtype.kind == "c":
        raise InputError("fitness", f"it {_RETURNS_SCALAR}", _described(result, batch=1))
    return fitness


def apply_fitness(
    fitness: Fitness,
    feature_names: Sequence[str],
    grids: Int8[Array, "P H W"],
    features: Int32[Array, "P F"],
    usual: Int32[Array, " P"],
) -> Real[Array, " P"]:
    """Applies a fitness of the user to grids.

    Returns float32 ``[P]``, or int32 ``[P]`` with size 2**30 for an integer out of range.
    """
    # The function gets only the arguments that it names.
    names = arguments_of(fitness)

    # The user's function takes a single grid. `jax.vmap` applies it to P grids.
    def apply_to_grid(grid: Array, row: Array, usual: Array) -> Array:
        feature_values, all_names = with_shares(row, feature_names)
        known = {
            "metrics": unstack_metrics(row, grid.size),
            "features": dict(zip(all_names, feature_values, strict=True)),
            "grid": grid,
            "usual": usual,
        }
        arguments = {name: known[name] for name in names}
        total = _as_array("fitness", f"it {_RETURNS_SCALAR}", fitness(**arguments))
        if jnp.issubdtype(total.dtype, jnp.floating):
            return total.astype(jnp.float32)
        if jnp.issubdtype(total.dtype, jnp.integer):
            return _clipped(total)
        # `check_fitness` refuses other types.
        return total

    return jax.vmap(apply_to_grid)(grids, features, usual)


def measure_features(
    grids: Int8[Array | np.ndarray, "P H W"], names: Sequence[str], kernels: Mapping[str, Kernel]
) -> Int32[Array, "P K"]:
    """Measures K features that are not metrics: town features and the user's.

    A value of the user's that is out of range gets the size 2**30.
    """
    user_names = [name for name in names if name not in TOWN_FEATURES]
    unit_vectors = np.eye(len(names), dtype=np.int32)

    def measure_grid(grid: Array) -> Array:
        values: dict[str, Array] = {}
        for name in user_names:
            values[name] = _clipped(_apply_kernel(name, kernels[name], grid))
        if len(user_names) < len(names):
            values |= measure_town(grid, detour="mean_detour" in names)._asdict()
        row: Array = jnp.int32(0)
        for name, unit_vector in zip(names, unit_vectors, strict=True):
            row = row + values[name] * unit_vector
        return row

    return jax.vmap(measure_grid)(jnp.asarray(grids))


@name_wrong_arguments
@runs_jax
def with_town_features(
    features: Mapping[str, ArrayOrRows],
    names: Iterable[str],
    grids: ArrayOrRows,
    source: str = "names",
) -> dict[str, NDArray[np.int32]]:
    """Returns features by name, and measures the town features among `names` that are missing.

    Args:
      features: int32 ``[...]`` by name, as a search measured them.
      names: the names of the features that are needed.
      grids: int8 ``[..., H, W]``.
      source: the start of the message.

    Raises:
      InputError: for a feature of the user that is missing.
    """
    measured = {name: np.asarray(values) for name, values in features.items()}
    missing = []
    for name in columns_for(names):
        if name in METRIC_NAMES or name in measured:
            continue
        if name not in TOWN_FEATURES:
            raise InputError(source, "features that the search has measured", name)
        missing.append(name)
    if missing:
        columns = _measure_in_batches(np.asarray(grids), tuple(missing))
        for index, name in enumerate(missing):
            measured[name] = columns[..., index]
    return measured


# The number of grids that are measured at once: they fit in memory, and one program serves all
# batches.
_BATCH = 256


def _measure_in_batches(grids: AnyArray, names: tuple[str, ...]) -> NDArray[np.int32]:
    """Measures town features of grids ``[..., H, W]``; returns int32 ``[..., K]``."""
    if grids.ndim < 2:
        raise InputError("grids", "[..., H, W]", f"shape {list(grids.shape)}")
    height, width = grids.shape[-2:]
    flat = grids.reshape(-1, height, width)
    # Empty grids fill up the last batch.
    padded = np.pad(flat, [(0, _BATCH - len(flat) % _BATCH), (0, 0), (0, 0)])
    batches = []
    for first in range(0, len(padded), _BATCH):
        batches.append(_measure(padded[first : first + _BATCH], names))
    rows = np.concatenate(batches)[: len(flat)]
    return rows.reshape(*grids.shape[:-2], len(names))


@partial(jax.jit, static_argnames="names")
def _measure(grids: Int8[Array, "P H W"], names: tuple[str, ...]) -> Int32[Array, "P K"]:
    return measure_features(grids, names, {})


def _apply_kernel(name: str, kernel: Kernel, grid: Int8[Array, "H W"]) -> Untyped:
    return _as_array("features", f"{name} {_RETURNS_INTEGER}", kernel(grid))


def _as_array(subject: str, expected: str, value: UserValue) -> Untyped:
    """Returns a user's value as an array.

    Whole numbers of NumPy stay as they are, because JAX would cut off upper bits.
    """
    if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "iu":
        return value
    try:
        return jnp.asarray(value)
    except (TypeError, ValueError, OverflowError):
        raise InputError(subject, expected, quote(value, 60)) from None


def _clipped(value: Integer[Array | np.ndarray | np.generic, ""]) -> Int32[Array, ""]:
    """Limits a whole number to a size of 2**30; a dtype may not hold the limits themselves."""
    limits = jnp.iinfo(value.dtype)
    least = max(limits.min, -LARGEST)
    most = min(limits.max, LARGEST)
    return jnp.asarray(value.clip(least, most).astype(np.int32))


def arguments_of(fitness: Fitness) -> tuple[str, ...]:
    """Returns the names of the arguments that a fitness of the user takes."""
    try:
        parameters = signature(fitness).parameters.values()
        if any(parameter.kind is Parameter.POSITIONAL_ONLY for parameter in parameters):
            raise TypeError("positional only")
    except (TypeError, ValueError):
        raise InputError("fitness", "a function with named arguments", quote(fitness)) from None
    return tuple(parameter.name for parameter in parameters if parameter.default is Parameter.empty)


def _trace_shapes(
    subject: str, name: str, function: Callable[..., Pytree], *arguments: jax.ShapeDtypeStruct
) -> Pytree:
    """Returns the shapes and dtypes that a user's function returns.

    Errors of JAX become an `InputError`.
    """
    try:
        return jax.eval_shape(function, *arguments)
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        expected = f"{name} to be a function that JAX can trace"
        raise InputError(subject, expected, shorten(str(error), 160)) from None


def _described(result: Pytree, batch: int = 0) -> str:
    """Returns the dtype and shape of a result without its first `batch` axes.

    For a result that is no array, returns its text.
    """
    if not hasattr(result, "dtype"):
        return quote(result, 60)
    return f"{result.dtype} of shape {result.shape[batch:]}"


class Digest(NamedTuple):
    """What a function computes: equal digits for the same operations and constants."""

    digits: str
    uses_floats: bool


def digest(function: Callable[..., Pytree], *arguments: Pytree) -> Digest:
    """Returns a digest of what a function computes.

    Its 16 hexadecimal digits are equal in all processes for functions with the same jaxpr
    and constants. Calls out of JAX, such as callbacks, do not count. The arguments may be given by
    their shapes and dtypes.
    """
    # The lambda is a new function each time, because JAX does not trace the same function twice.
    closed = jax.make_jaxpr(lambda *inputs: function(*inputs))(*arguments)
    # NumPy would abbreviate long arrays in the text, and addresses differ between processes.
    with np.printoptions(threshold=sys.maxsize):
        text = re.sub(r"\bat 0x[0-9a-f]+", "", str(closed))
    content = sha256(text.encode())
    for constant in _constants(closed):
        content.update(constant)
    return Digest(content.hexdigest()[:16], _has_floats(closed))


def _has_floats(closed: "core.ClosedJaxpr") -> bool:
    """Returns whether results of a jaxpr come from floats.

    Shares of metrics do, but few fitnesses use them.
    """
    # From the last equation to the first, this follows the variables that results depend on.
    needed = {*map(id, closed.jaxpr.outvars)}
    for equation in reversed(closed.jaxpr.eqns):
        if needed.isdisjoint(map(id, equation.outvars)):
            continue
        if re.search(r":(b?f|c)\d\w*\[", str(equation)):
            return True
        needed.update(map(id, equation.invars))
    return False


def _constants(closed: "core.ClosedJaxpr") -> Iterator[bytes]:
    """Yields the constants of a jaxpr and of its inner jaxprs.

    The text of a jaxpr has only their shapes.
    """
    # This import is here, because most searches have no functions of the user.
    from jax.extend import core

    for constant in closed.consts:
        data = constant
        if jnp.issubdtype(jnp.result_type(constant), jax.dtypes.prng_key):
            data = jax.random.key_data(constant)
        yield np.asarray(data).tobytes()
    for equation in closed.jaxpr.eqns:
        for inner in jax.tree.leaves(equation.params):
            if isinstance(inner, core.ClosedJaxpr):
                yield from _constants(inner)
            elif isinstance(inner, core.Jaxpr):
                yield from _constants(core.ClosedJaxpr(inner, ()))
