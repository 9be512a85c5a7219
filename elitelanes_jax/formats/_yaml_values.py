"""Numbers and tables among values that were read from YAML."""

from collections.abc import Mapping
from contextlib import suppress
from math import isfinite

from elitelanes_jax._util.errors import InputError, brief
from elitelanes_jax._util.types import Plain

NOTHING = (None, "", "~", "null", "Null", "NULL")
"""A missing value, and the texts that YAML reads as null. `yaml_tree` keeps scalars as texts."""

FALSE = ["false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF"]
"""What YAML 1.1 reads as false."""


def table_of(value: Plain, name: str) -> dict[str, Plain]:
    """Returns the table under a name.

    Raises an `InputError` that starts with the name if there is no table.
    """
    inner = value.get(name) if isinstance(value, dict) else None
    if not isinstance(inner, dict):
        raise InputError(name, "a table", brief(inner, 40))
    return inner


def real_of(values: Mapping[str, Plain], name: str, default: float | None = None) -> float:
    """Returns the number under a name.

    Raises:
      InputError: if there is no finite number; its subject is the name.
    """
    value = values.get(name, default)
    with suppress(ValueError):
        # `float` would also read "1_000", which is no number here. A list is not made a text,
        # because the text may be longer than the memory.
        if isinstance(value, str | int | float) and "_" not in str(value):
            number = float(value)
            if isfinite(number):
                return number
    raise InputError(name, "a number", brief(value, 40))


def whole_of(values: Mapping[str, Plain], name: str) -> int:
    """Returns the whole number under a name; raises as `real_of` does."""
    number = real_of(values, name)
    if not number.is_integer():
        raise InputError(name, "a whole number", f"{number:g}")
    return int(number)
