"""Names the wrong argument of a public function.

A function that fails for an argument of another type would raise an error from deep within. Its decorator compares the
arguments with the annotations after such an error, so that calls that succeed cost nothing and may be given whatever
works.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import wraps
from inspect import Parameter, signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.checks import is_real, is_whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import UserValue

P = ParamSpec("P")
R = TypeVar("R")

_WORDS: dict[UserValue, str] = {int: "a whole number", float: "a number", np.number: "a number", bool: "True or False"}
_WORDS |= {str: "a text", Path: "a path", NoneType: "None", Callable: "a function", Any: "no key"}

_ARRAYS = (Annotated, np.ndarray, get_origin(NDArray[np.int8]))  # from NumPy 2.5 on `NDArray` is a type alias

# The errors that arguments of another type cause.
_CAUSED = (ArithmeticError, AttributeError, LookupError, SystemError, TypeError, ValueError)


def name_wrong_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a public function: an argument of another type causes an `InputError` that names it."""

    @wraps(function)
    def named(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return function(*args, **kwargs)
        except InputError:
            raise
        except Exception as error:
            caused = isinstance(error, _CAUSED) or type(error).__module__ == "cv2"
            if not caused or (message := _find_wrong(function, args, kwargs, error)) is None:
                raise
            raise InputError(message) from error

    return named


def _find_wrong(function: Callable[..., UserValue], args: UserValue, kwargs: UserValue, error: Exception) -> str | None:
    """Returns a message about the arguments that caused an error; None if it may have another cause."""
    parameters = signature(function)
    try:
        given = parameters.bind(*args, **kwargs).arguments
    except TypeError:  # other parameters; Python's message says so
        return None
    for name, value in given.items():
        kind = parameters.parameters[name]
        several = kind.kind in (kind.VAR_POSITIONAL, kind.VAR_KEYWORD)
        for one in (value.values() if isinstance(value, dict) else value) if several else [value]:
            if one is not kind.default and not _fits(one, kind.annotation):
                return f"{name}: expected {_describe(kind.annotation)}, got {shorten(repr(one))}"
    if "broadcast" not in str(error) or any(map(callable, given.values())):
        return None
    arrays = [name for name, value in given.items() if hasattr(value, "shape") or isinstance(value, list)]
    shapes = ", ".join(str(list(np.shape(given[name]))) for name in arrays)
    return f"{', '.join(arrays)}: expected shapes that fit, got {shapes}" if len(arrays) > 1 else None


def _fits(value: UserValue, kind: UserValue, batch: bool = False) -> bool:
    """Returns whether an annotation can mean a value; an unknown annotation means any value.

    In a batch, arrays may have more axes than their annotation says.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if kind == ArrayLike or hasattr(kind, "dims") or origin in _ARRAYS:
        return _is_array(value, kind, batch)
    if origin in (Union, UnionType):
        return any(_fits(value, part, batch) for part in parts)
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if isinstance(origin, type) and issubclass(origin, Iterable) and not issubclass(origin, Mapping):
        if not isinstance(value, Iterable) or isinstance(value, str | bytes | Mapping) or not getattr(value, "ndim", 1):
            return False
        if not hasattr(value, "__len__"):
            return True
        fixed = origin is tuple and ... not in parts
        return (not fixed or len(value) == len(parts)) and all(_fits(one, parts[0]) for one in value)
    kind = origin or kind
    if kind in (int, float, bool) and hasattr(value, "dtype"):
        return value.ndim == 0 and _is_array(value, kind)
    if kind in (int, float, np.number):
        return is_real(value) and (kind is not int or is_whole(value)) and abs(value) < 2**63
    if kind is Any:
        return not _is_key(value)
    if kind is Parameter.empty or not isinstance(kind, type):
        return True
    fields = getattr(kind, "__annotations__", {}) if issubclass(kind, tuple) else {}
    return isinstance(value, kind) and all(_fits(getattr(value, name), of, True) for name, of in fields.items())


def _is_key(value: UserValue) -> bool:
    return str(getattr(value, "dtype", "")).startswith("key<")


def _is_array(value: UserValue, kind: UserValue, batch: bool = False) -> bool:
    """Returns whether a value is an array of numbers or can be one; the annotation may say how many axes."""
    value, kinds = getattr(value, "codes", value), getattr(kind, "dtypes", ())
    if "prng_key" in kinds:
        old = getattr(value, "dtype", None) == np.uint32  # a key of the old style is a vector
        return (_is_key(value) or old) and _has_axes(kind, value.ndim - old, batch)
    try:
        array = value if hasattr(value, "dtype") else np.asarray(value)
    except ValueError:  # lists of several lengths
        return False
    kinds = "biuV" if all("int" in one for one in kinds or ("any",)) else "biufV"
    if _is_key(array) or array.dtype.kind not in kinds or (not array.size and array is not value):
        return False
    return not isinstance(getattr(kind, "dims", None), tuple) or _has_axes(kind, array.ndim, batch)


def _has_axes(kind: UserValue, axes: int, batch: bool) -> bool:
    """Returns whether the annotation of an array means a number of axes."""
    if kind.index_variadic is not None:
        return len(kind.dims) - 1 <= axes
    return len(kind.dims) == axes or (batch and len(kind.dims) <= axes)


def _describe(kind: UserValue) -> str:
    """Returns the words for an annotation in a message."""
    origin, parts = get_origin(kind), get_args(kind)
    if kind == ArrayLike or origin in _ARRAYS:
        return "an array of numbers"
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(map(_describe, parts)))
    if "prng_key" in getattr(kind, "dtypes", ()):
        return "a jax.random.key"
    if hasattr(kind, "dims"):
        return f"{kind.__name__.partition('[')[0].lower()} [{', '.join(kind.dim_str.split())}]"
    if origin is Literal:
        return f"one of {', '.join(map(str, parts))}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "values by name"
    if isinstance(origin, type) and issubclass(origin, Iterable):
        return f"a list of {' and '.join(dict.fromkeys(_describe(part) for part in parts if part is not ...))}"
    return _WORDS.get(origin or kind) or str(getattr(kind, "__name__", kind))
