"""Copies of what a caller may change later."""

from collections.abc import Iterable
from functools import wraps
from typing import TypeVar, cast

import numpy as np

from elitelanes_jax._util.types import Untyped, UserValue

T = TypeVar("T")


def frozen_copy(value: T) -> T:
    """Returns an array of NumPy as a copy that cannot be written to; anything else unchanged.

    Arrays that are kept after a call are copied, because the caller may write to them later. An
    array that this function returned is not copied again.
    """
    if not isinstance(value, np.ndarray) or (value.base is None and not value.flags.writeable):
        return value
    # A masked array keeps its mask, so that a later check can refuse it.
    copy = np.array(value, subok=isinstance(value, np.ma.MaskedArray))
    copy.flags.writeable = False
    return cast(T, copy)


def keeps_copies(record: type[T]) -> type[T]:
    """Decorates a named tuple to keep copies of arrays, lists and dictionaries.

    Arrays are copied as `frozen_copy` does. Methods such as `_replace` make a tuple with copies,
    too. A named tuple that is a pytree of a compiled program needs no copies: what keeps it makes
    them.
    """
    # A class of `NamedTuple` cannot define these two methods itself.
    named_tuple: Untyped = record
    make = named_tuple.__new__

    @wraps(make)
    def new(cls: Untyped, *values: UserValue, **named: UserValue) -> Untyped:
        return tuple.__new__(cls, map(_copy_of, make(cls, *values, **named)))

    def of_values(cls: Untyped, values: Iterable[UserValue]) -> Untyped:
        return cls(*values)

    named_tuple.__new__ = staticmethod(new)
    named_tuple._make = classmethod(of_values)
    return record


def _copy_of(value: UserValue) -> UserValue:
    if isinstance(value, list):
        return [_copy_of(item) for item in value]
    if isinstance(value, dict):
        return {key: _copy_of(item) for key, item in value.items()}
    return frozen_copy(value)
