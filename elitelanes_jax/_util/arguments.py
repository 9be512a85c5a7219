"""Names the wrong argument of a public function.

A function that fails for an argument of another type would raise an error from deep within. Its
decorator compares the arguments with the annotations after such an error, so that calls that
succeed cost nothing and may be given whatever works. Flags are compared before the call, because
every value has a truth: with ``force="no"`` a function would replace a folder.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sized
from functools import wraps
from inspect import BoundArguments, Parameter, signature
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.checks import is_real, is_whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import Untyped, UserValue

P = ParamSpec("P")
R = TypeVar("R")

_WORDS: dict[UserValue, str] = {
    int: "a whole number",
    float: "a number",
    np.number: "a number",
    bool: "True or False",
}
_WORDS |= {str: "a text", Path: "a path", NoneType: "None", Callable: "a function"}
_WORDS |= {Any: "no key", object: "no key"}

# From NumPy 2.5 on `NDArray` is a type alias.
_ARRAYS = (Annotated, np.ndarray, get_origin(NDArray[np.int8]))

# The errors that arguments of another type cause.
_CAUSED = (ArithmeticError, AttributeError, LookupError, SystemError, TypeError, ValueError)


class WrongArgumentError(InputError):
    """An argument of a public function that has another type than its annotation."""


def name_wrong_arguments(function: Callable[P, R]) -> Callable[P, R]:
    """Decorates a public function to raise a `WrongArgumentError` for an argument of another type.

    The error names the argument. Public functions call each other. The outermost one with a wrong
    argument names it, because this is the one that the user has called.
    """

    @wraps(function)
    def named(*args: P.args, **kwargs: P.kwargs) -> R:
        # Flags are given by name, so a call without names has none to check.
        if kwargs:
            _check_flags(function, kwargs)
        try:
            return function(*args, **kwargs)
        except WrongArgumentError as inner:
            # An inner public function refused an argument of its own. If it came from a wrong
            # argument of this function, the user needs this function's name for it.
            wrong = _find_wrong(function, args, kwargs, inner)
            if wrong is None:
                raise
            raise wrong from inner.__cause__
        except InputError:
            # The message names the argument already.
            raise
        except Exception as error:
            wrong = None
            if isinstance(error, _CAUSED) or type(error).__module__ == "cv2":
                wrong = _find_wrong(function, args, kwargs, error)
            if wrong is None:
                raise
            raise wrong from error

    return named


def _check_flags(function: Callable[..., UserValue], options: Mapping[str, UserValue]) -> None:
    """Raises `WrongArgumentError` for a flag that is neither True nor False."""
    annotations = function.__annotations__
    for name, value in options.items():
        if annotations.get(name) is bool and not isinstance(value, bool | np.bool_):
            raise _wrong_type(name, bool, value)


def _wrong_type(name: str, annotation: Untyped, value: UserValue) -> WrongArgumentError:
    return WrongArgumentError(name, _describe(annotation), quote(value))


def _find_wrong(
    function: Callable[..., UserValue], args: Untyped, kwargs: Untyped, error: Exception
) -> WrongArgumentError | None:
    """Returns the error for the arguments that caused another error, or None.

    None means that the error may have another cause.
    """
    try:
        bound = signature(function).bind(*args, **kwargs)
    except TypeError:
        # The arguments are for other parameters, as Python's message says.
        return None
    for parameter, value in _arguments(bound):
        # A default may have another type than its annotation, for example None.
        if value is not parameter.default and not _fits(value, parameter.annotation):
            return _wrong_type(parameter.name, parameter.annotation, value)
    # Each argument fits alone. What is left to name are arrays whose shapes do not fit each other.
    values = bound.arguments
    if "broadcast" not in str(error) or any(map(callable, values.values())):
        return None
    arrays = {
        name: value
        for name, value in values.items()
        if hasattr(value, "shape") or isinstance(value, list)
    }
    # A single array can only clash with an array from within.
    if len(arrays) < 2:
        return None
    shapes = ", ".join(str(list(np.shape(array))) for array in arrays.values())
    return WrongArgumentError(", ".join(arrays), "shapes that fit", shapes)


def _arguments(bound: BoundArguments) -> Iterator[tuple[Parameter, UserValue]]:
    """Yields each argument with its parameter; a parameter such as ``*maps`` has several."""
    for name, value in bound.arguments.items():
        parameter = bound.signature.parameters[name]
        if parameter.kind == Parameter.VAR_POSITIONAL:
            yield from ((parameter, item) for item in value)
        elif parameter.kind == Parameter.VAR_KEYWORD:
            yield from ((parameter, item) for item in value.values())
        else:
            yield parameter, value


def _fits(value: UserValue, annotation: Untyped, batch: bool = False) -> bool:
    """Returns whether an annotation can mean a value; an unknown annotation means any value.

    In a batch, arrays may have more axes than their annotation says.
    """
    origin, parts = get_origin(annotation), get_args(annotation)
    if annotation == ArrayLike or hasattr(annotation, "dims") or origin in _ARRAYS:
        return _is_array(value, annotation, batch)
    if origin in (Union, UnionType):
        return any(_fits(value, part, batch) for part in parts)
    if origin is Literal:
        return any(type(value) is type(part) and value == part for part in parts)
    if _is_iterable(origin):
        return _is_list_of(value, origin, parts)
    kind = origin or annotation
    # An array without axes is a number, also a traced one.
    if kind in (int, float, bool) and hasattr(value, "dtype"):
        return getattr(value, "ndim", 0) == 0 and _is_array(value, kind)
    # Larger numbers overflow in NumPy and JAX.
    if kind is int:
        return is_whole(value) and abs(value) < 2**63
    if kind in (float, np.number):
        return is_real(value) and abs(value) < 2**63
    if kind in (Any, object):
        return not _is_key(value)
    if kind is Parameter.empty or not isinstance(kind, type):
        return True
    if not isinstance(value, kind):
        return False
    # The fields of a named tuple are those of a batch if functions that `jax.vmap` maps take it.
    fields = getattr(kind, "__annotations__", {}) if issubclass(kind, tuple) else {}
    return all(_fits(getattr(value, name), of, batch=True) for name, of in fields.items())


def _is_iterable(origin: Untyped) -> bool:
    return (
        isinstance(origin, type)
        and issubclass(origin, Iterable)
        and not issubclass(origin, Mapping)
    )


def _is_list_of(value: UserValue, origin: Untyped, parts: tuple[Untyped, ...]) -> bool:
    """Returns whether a value has several items of the annotation's type.

    An example of the annotation is ``list[int]``.
    """
    if not isinstance(value, Iterable) or isinstance(value, str | bytes | Mapping):
        return False
    if getattr(value, "ndim", 1) == 0:
        return False
    if not isinstance(value, Sized):
        # The items of a generator are gone once they are seen.
        return True
    has_fixed_length = origin is tuple and ... not in parts
    if has_fixed_length:
        has_length = len(value) == len(parts)
        return has_length and all(_fits(*pair) for pair in zip(value, parts, strict=True))
    return all(_fits(item, parts[0]) for item in value)


def _is_key(value: UserValue) -> bool:
    return str(getattr(value, "dtype", "")).startswith("key<")


def _is_array(value: Untyped, annotation: Untyped, batch: bool = False) -> bool:
    """Returns whether a value is an array of numbers or can be one.

    The annotation may say how many axes the array has.
    """
    # A map stands for its codes.
    value = getattr(value, "codes", value)
    dtypes = getattr(annotation, "dtypes", ())
    if "prng_key" in dtypes:
        return _is_key_array(value, annotation, batch)
    try:
        array = value if hasattr(value, "dtype") else np.asarray(value)
    except ValueError:
        # The value is a list of lists of several lengths.
        return False
    takes_whole = bool(dtypes) and all("int" in dtype for dtype in dtypes)
    # V stands for the float types of JAX that NumPy does not know.
    kinds = "biuV" if takes_whole else "biufV"
    if _is_key(array) or array.dtype.kind not in kinds:
        return False
    if not array.size and array is not value:
        # An empty list has no numbers, and an empty array has a dtype.
        return False
    return _has_axes(annotation, array.ndim, batch)


def _is_key_array(value: Untyped, annotation: Untyped, batch: bool) -> bool:
    """Returns whether a value is a key of JAX, or a vector of the old style."""
    if _is_key(value):
        return _has_axes(annotation, value.ndim, batch)
    is_old_style = getattr(value, "dtype", None) == np.uint32
    return is_old_style and _has_axes(annotation, value.ndim - 1, batch)


def _has_axes(annotation: Untyped, axes: int, batch: bool) -> bool:
    """Returns whether the annotation of an array allows a number of axes.

    An annotation without axes allows any number.
    """
    dims = getattr(annotation, "dims", None)
    if not isinstance(dims, tuple):
        return True
    if annotation.index_variadic is not None:
        return len(dims) - 1 <= axes
    return len(dims) == axes or (batch and len(dims) <= axes)


def _describe(annotation: Untyped) -> str:
    """Returns the words for an annotation in a message."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if annotation == ArrayLike or origin in _ARRAYS:
        return "an array of numbers"
    # Parts of a union may have the same words, such as `ArrayLike` and `NDArray`.
    if origin in (Union, UnionType):
        return " or ".join(_distinct_words(parts))
    # A key of JAX has dtypes like an array, so it is asked for first.
    if "prng_key" in getattr(annotation, "dtypes", ()):
        return "a jax.random.key"
    if hasattr(annotation, "dims"):
        dtype = annotation.__name__.partition("[")[0].lower()
        return f"{dtype} [{', '.join(annotation.dim_str.split())}]"
    if origin is Literal:
        return f"one of {', '.join(map(str, parts))}"
    if isinstance(origin, type) and issubclass(origin, Mapping):
        return "values by name"
    if _is_iterable(origin):
        words = " and ".join(_distinct_words(part for part in parts if part is not ...))
        return f"a list, each item {words}"
    kind = origin or annotation
    return _WORDS.get(kind) or str(getattr(kind, "__name__", kind))


def _distinct_words(annotations: Iterable[UserValue]) -> list[str]:
    """Returns the words for annotations, each once, in order."""
    return list(dict.fromkeys(map(_describe, annotations)))
