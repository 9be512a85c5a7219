"""Records that are pytrees of JAX: their numbers may be traced, and mapped by `jax.vmap`."""

from collections.abc import Iterable
from dataclasses import field, fields
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import Check, frozen_copy, is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Option, Record, option
from elitelanes_jax._util.types import Numeric, UserValue

R = TypeVar("R", bound=Record)


def static(default: UserValue, check: Check) -> UserValue:
    """Declares a field for each of whose values `jax.jit` compiles a program."""
    return field(default=default, metadata={"option": Option(check), "static": True})


def traced(default: UserValue, check: Check, each: Check | None = None) -> UserValue:
    """Declares a field with a number or an array. One program serves all values.

    See `number_or_array` for `each`.
    """
    return option(default, number_or_array(check, each, whole=is_whole(default)))


def number_or_array(check: Check, each: Check | None = None, *, whole: bool = False) -> Check:
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

    def check_value(value: UserValue) -> UserValue:
        if not isinstance(value, jax.Array | np.ndarray):
            return check(value)
        if not jnp.issubdtype(value.dtype, kind) or jnp.iscomplexobj(value):
            raise InputError(f"expected {expected}, got {value.dtype} {list(value.shape)}")
        if not isinstance(value, jax.core.Tracer) and value.size:
            numbers = np.asarray(jax.device_get(value))
            check_each(_number(numbers.min()))
            check_each(_number(numbers.max()))
        return frozen_copy(value)

    return check_value


def _number(number: Numeric) -> int | float:
    """Returns a number of NumPy as one of Python, a float as its shortest text says it.

    So 0.1 of float32, which is 0.100000001, does not exceed a limit of 0.1.
    """
    return int(number) if isinstance(number, np.integer) else float(str(number))


def pytree(kind: type[R]) -> type[R]:
    """Registers a record as a pytree.

    Its static fields belong to the structure, and all others are children.
    `jax.tree_util.register_dataclass` would call the constructor, which checks the fields. But
    transformations make records of tracers, axes and None.
    """
    structure = [item.name for item in fields(kind) if item.metadata.get("static")]  # type: ignore[arg-type]
    children = [name for name in kind.options() if name not in structure]

    def flatten(record: R) -> tuple[list[UserValue], tuple[UserValue, ...]]:
        values = [getattr(record, name) for name in children]
        values_of_structure = tuple(getattr(record, name) for name in structure)
        return values, values_of_structure

    def flatten_with_keys(record: R) -> tuple[list[UserValue], tuple[UserValue, ...]]:
        values, values_of_structure = flatten(record)
        # The keys name the fields in paths, such as those of error messages.
        keys = map(jax.tree_util.GetAttrKey, children)
        return list(zip(keys, values, strict=True)), values_of_structure

    # The record is made without its constructor, see above.
    def unflatten(values_of_structure: tuple[UserValue, ...], values: Iterable[UserValue]) -> R:
        record = object.__new__(kind)
        # The record is frozen, so its fields are set in its dictionary.
        fields_of_record = vars(record)
        fields_of_record.update(zip(structure, values_of_structure, strict=True))
        fields_of_record.update(zip(children, values, strict=True))
        return record

    jax.tree_util.register_pytree_with_keys(kind, flatten_with_keys, unflatten, flatten)
    return kind
