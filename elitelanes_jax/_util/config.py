"""Records of an optimiser's settings, which are pytrees: numbers in them may be traced, and swept by `jax.vmap`."""

import sys
from collections.abc import Callable
from dataclasses import field, fields, replace
from typing import Self

import numpy as np

from elitelanes_jax._util.checks import Check, check_named
from elitelanes_jax._util.errors import InputError, short
from elitelanes_jax._util.types import UserValue


def static(default: UserValue, check: Check) -> UserValue:
    """Declares a field that `jax.jit` compiles for: another value is another program."""
    return field(default=default, metadata={"static": True, "check": check})


def swept(default: UserValue, check: Check) -> UserValue:
    """Declares a field with a number, or an array that stands for many: one program serves all values."""
    return field(default=default, metadata={"swept": True, "check": check})


def nested(make: "Callable[[], Config]") -> UserValue:
    """Declares a field with another record."""

    def check(value: UserValue) -> UserValue:
        if not isinstance(value, type(make())):
            raise InputError(f"expected {type(make()).__name__}, got {short(repr(value))}")
        return value

    return field(default_factory=make, metadata={"check": check})


class Config:
    """A frozen dataclass, registered by `jax.tree_util.register_dataclass`, that can check its fields."""

    def checked(self, name: str = "config") -> Self:
        """Returns the record with all fields checked; arrays of numbers pass, since their values may not be known.

        Args:
          name: of the record, for the message.

        Raises:
          InputError: for a setting out of its range.
        """
        values = {one.name: getattr(self, one.name) for one in fields(self)}  # type: ignore[arg-type]
        for one in fields(self):  # type: ignore[arg-type]
            path, value = f"{name}.{one.name}", values[one.name]
            if isinstance(value, Config):
                value = value.checked(path)
            if not (one.metadata.get("swept") and _is_array(value)):
                values[one.name] = check_named(path, one.metadata["check"], value)
        record = replace(self, **values)  # type: ignore[type-var]
        check_named(name, type(record).check_together, record)
        return record

    def check_together(self) -> None:
        """Checks what no field can tell alone; raises `InputError`."""


def _is_array(value: UserValue) -> bool:
    jax = sys.modules.get("jax")  # without JAX loaded there is no array of it
    return isinstance(value, np.ndarray) or bool(jax and isinstance(value, jax.Array))
