"""Records of options: frozen dataclasses that check each field when they are created.

A field is one line: its default and its check. The command line makes its options from the same
lines (`elitelanes_jax.cli.arguments`). `elitelanes_jax.network.pytrees` registers records that JAX
traces.
"""

import inspect
import os
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, field, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, Self, TypeVar, overload

import numpy as np

from elitelanes_jax._util.checks import (
    Check,
    check_named,
    instance,
    is_whole,
    path_exists,
)
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote, suggest
from elitelanes_jax._util.types import Numbers, Numeric, Untyped, UserValue

T = TypeVar("T")
R = TypeVar("R", bound="Record")

REQUIRED = MISSING
"""The default of a required field."""

_METAVARS_OF_FOLDERS = ("DIR", "FILE|DIR", "MAP")


class Option(NamedTuple):
    """What a field has beside its name, default and description.

    Attributes:
      check: checks the value.
      metavar: the name of the value in the command line's help; None if the field is no option of
        the command line.
      flag: the option's name on the command line, if it is not the field's.
      many: whether the option takes several values. "*" also accepts none; "once" refuses a
        repeated option, which otherwise overrides the first one.
      after: the name of an earlier field, whose value the check takes as a second argument.
    """

    check: Callable[..., UserValue]
    metavar: str | tuple[str, ...] | None = None
    flag: str | None = None
    many: bool | str = False
    after: str | None = None


def option(
    default: UserValue,
    check: Callable[..., T],
    metavar: str | tuple[str, ...] | None = None,
    **more: Untyped,
) -> T:
    """Declares a field of a record: its default, and the arguments of `Option`.

    A type checker sees the type of the checked value.
    """
    return _field(default, option=Option(check, metavar, **more))


def _field(default: UserValue, **metadata: UserValue) -> Untyped:
    # For a type checker a field has the type of its value.
    return field(default=default, metadata=metadata)


def nested(default: R) -> R:
    """Declares a field with another record."""
    return option(default, instance(type(default)))


def static(default: UserValue, check: Check[T]) -> T:
    """Declares a field for each of whose values `jax.jit` compiles a program."""
    return _field(default, option=Option(check), static=True)


@overload
def traced(default: T, check: Check) -> T | Numeric: ...


@overload
def traced(default: T, check: Check, each: Check) -> T | Numbers: ...


def traced(default: UserValue, check: Check, each: Check | None = None) -> Untyped:
    """Declares a field with a number or an array. One program serves all values.

    See `number_or_array` for `each`.
    """
    return option(default, number_or_array(check, each, whole=is_whole(default)))


def number_or_array(
    check: Check, each: Check | None = None, *, whole: bool = False
) -> Check[Numeric]:
    """Makes a check for a number, or an array of numbers that each pass the check.

    Within a transformation an array may be a tracer. Its numbers are not known, so only its dtype
    is checked.

    Args:
      check: checks what is no array.
      each: checks a number of an array, where `check` takes several numbers.
      whole: whether the numbers are whole.
    """
    kind, expected = (np.integer, "whole numbers") if whole else (np.number, "numbers")
    check_each = each or check

    def check_value(value: UserValue) -> Numeric:
        # Records of options that nobody traces must not wait for JAX. A value of JAX exists only
        # after JAX was loaded.
        jax: Untyped = sys.modules.get("jax")
        of_jax = jax is not None and isinstance(value, jax.Array)
        if not of_jax and not isinstance(value, np.ndarray):
            return check(value)
        array: Untyped = value
        numpy = jax.numpy if of_jax else np
        if not numpy.issubdtype(array.dtype, kind) or numpy.iscomplexobj(array):
            raise InputError("", expected, f"{array.dtype} {list(array.shape)}")
        if not (of_jax and isinstance(array, jax.core.Tracer)) and array.size:
            numbers = np.asarray(jax.device_get(array) if of_jax else array)
            check_each(_number(numbers.min()))
            check_each(_number(numbers.max()))
        return frozen_copy(array)

    return check_value


def one_number(check: Check) -> Check[Numeric]:
    """Makes a check for a number, or an array without axes, as `number_or_array` does."""
    check_number = number_or_array(check)

    def check_value(value: UserValue) -> Numeric:
        if getattr(value, "ndim", 0):
            raise InputError("", "one number", f"shape {list(getattr(value, 'shape', ()))}")
        return check_number(value)

    return check_value


def _number(number: np.number) -> int | float:
    """Returns a number of NumPy as one of Python, a float as its shortest text says it.

    So 0.1 of float32, which is 0.100000001, does not exceed a limit of 0.1.
    """
    return int(number) if isinstance(number, np.integer) else float(str(number))


class Record:
    """The base of frozen dataclasses that check their fields.

    The fields are declared by `option`, `nested`, `static` and `traced`.
    """

    def __post_init__(self) -> None:
        """Checks each field, then all together.

        The message of an `InputError` starts with the field's name.
        """
        self._keep_inputs(vars(self))
        for name, option in self.options().items():
            earlier = () if option.after is None else (getattr(self, option.after),)
            checked = check_named(name, option.check, getattr(self, name), *earlier)
            # The dataclass is frozen, and the checked value may differ from the given one: a text
            # becomes a number.
            object.__setattr__(self, name, checked)
        self.check_together()

    def check_together(self) -> None:
        """Checks fields against each other; raises `InputError`."""

    @classmethod
    def options(cls) -> dict[str, Option]:
        """Returns the `Option` of each field, by name."""
        return {item.name: item.metadata["option"] for item in fields(cls) if item.metadata}  # type: ignore[arg-type]

    def values(self) -> dict[str, UserValue]:
        """Returns the values of the fields, by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}  # type: ignore[arg-type]

    @property
    def inputs(self) -> tuple[str, ...]:
        """Returns the files and folders that the options named, and those of nested records."""
        named: tuple[str, ...] = vars(self).get("_inputs", ())
        return named

    def _keep_inputs(self, values: Mapping[str, UserValue], *more: str) -> Self:
        inputs = (*more, *inputs_among(values, self.options()))
        if inputs:
            # The inputs are no field, so that records with equal options are equal and hash alike.
            vars(self)["_inputs"] = inputs
        return self

    def replace(self, **values: UserValue) -> Self:
        """Returns the record with new values in some fields.

        Raises:
          InputError: for an unknown name or a wrong value.
        """
        check_names(values, self.options())
        return replace(self, **values)._keep_inputs(values, *self.inputs) if values else self  # type: ignore[type-var]


def inputs_among(
    values: Mapping[str, UserValue], options: Mapping[str, Option] = MappingProxyType({})
) -> Iterator[str]:
    """Yields the files and folders that options name.

    A word of a text, such as "signs objects.toml", may also name one. A text names a folder only
    where the option's metavar says so: in ``--style town --out town`` it is a word. A `Path` is
    always one.
    """
    for name, value in values.items():
        takes_folders = name in options and options[name].metavar in _METAVARS_OF_FOLDERS
        # Both are False for a text that is too long for a path.
        is_input = os.path.exists if takes_folders else os.path.isfile
        for item in value if isinstance(value, list | tuple) else [value]:
            if isinstance(item, Record):
                yield from item.inputs
            elif isinstance(item, Path) and path_exists(item):
                yield str(item)
            elif isinstance(item, str):
                yield from filter(is_input, dict.fromkeys([item, *item.split()]))


def check_names(names: Iterable[str], known: Iterable[str]) -> None:
    """Checks that all names are known; the subject of the error is the first unknown name."""
    known = list(known)
    for name in names:
        if name not in known:
            raise InputError(name, f"one of {', '.join(known)}", quote(name), suggest(name, known))


def descriptions(kind: type) -> dict[str, str]:
    """Returns the descriptions of a record's fields, by name.

    They come from its docstring and the docstrings of its bases. Python's option -OO leaves out
    docstrings; then all are empty.
    """
    texts: dict[str, str] = {}
    # A class overrides the descriptions of its bases.
    for base in reversed(kind.__mro__):
        attributes = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")[2]
        texts |= dict(re.findall(r"^  (\w+): (.*(?:\n    .*)*)", attributes, re.MULTILINE))
    return defaultdict(str, {name: " ".join(text.split()) for name, text in texts.items()})
