"""Records that are pytrees of JAX: their numbers may be traced, and mapped by `jax.vmap`."""

from collections.abc import Iterable
from dataclasses import fields
from typing import TypeVar

import jax

from elitelanes_jax._util.records import Record
from elitelanes_jax._util.types import Untyped, UserValue

R = TypeVar("R", bound=Record)


def pytree(kind: type[R]) -> type[R]:
    """Registers a record as a pytree.

    Its static fields belong to the structure, and all others are children.
    `jax.tree_util.register_dataclass` would call the constructor, which checks the fields. But
    transformations make records of tracers, axes and None.
    """
    structure = [item.name for item in fields(kind) if item.metadata.get("static")]  # type: ignore[arg-type]
    children = [name for name in kind.options() if name not in structure]

    def flatten(record: R) -> tuple[list[Untyped], tuple[Untyped, ...]]:
        values = [getattr(record, name) for name in children]
        values_of_structure = tuple(getattr(record, name) for name in structure)
        return values, values_of_structure

    def flatten_with_keys(record: R) -> tuple[list[Untyped], tuple[Untyped, ...]]:
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
