"""Names for types that a checker cannot see, each with the reason.

The package has no other `Any`.
"""

from typing import Annotated, Any, TypeAlias

UserValue: TypeAlias = object
"""A user's value, from Python, the command line or a file. The function that takes it checks it."""

OptionValue: TypeAlias = Any
"""The checked value of an option or a field. Its type depends on a name, which is a variable."""

Plain: TypeAlias = object
"""A value of JSON, YAML or TOML. The function that reads it checks its type.

A table of known fields has a `TypedDict` instead.
"""

AnyArray: TypeAlias = Annotated[Any, "an array"]
"""An array of NumPy or JAX, or rows of numbers.

A function of it returns an array of the same library.
"""

Numeric: TypeAlias = Annotated[Any, "a number"]
"""A number, an array of numbers, or a tracer of `jax.jit` or `jax.vmap`."""

Pytree: TypeAlias = Any
"""A pytree of arrays, such as a state or an observation.

Only the optimiser or environment knows its structure.
"""

Untyped: TypeAlias = Any
"""What has no types: a module, object or keyword arguments of a library, or an annotation."""
