"""Names for types that a checker cannot see, each with the reason; there is no other `Any` in the package."""

from typing import Any, TypeAlias

UserValue: TypeAlias = Any
"""A user's value, from Python, the command line or a file: whoever takes it checks it, and refuses what is wrong."""

Plain: TypeAlias = Any
"""A value of JSON, YAML or TOML: whoever reads it looks what it is."""

AnyArray: TypeAlias = Any
"""An array of NumPy or of JAX, or rows of numbers: a function of it works on each, and returns the same kind."""

Numeric: TypeAlias = Any
"""A number, or an array that stands for many: `jax.jit` and `jax.vmap` put tracers in its place."""

Pytree: TypeAlias = Any
"""A tree of arrays whose form is not ours to know: the state of an optimiser or of an environment, an observation."""

Untyped: TypeAlias = Any
"""A module, an object or keywords of a library that has no types, or is not installed with ours."""
