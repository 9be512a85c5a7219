"""Names for types that several rooms share.

Four names are `Any` to a type checker, each with the reason: `OptionValue`, `Whole`, `Pytree` and
`Untyped`.
"""

from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence

    import jax
    import numpy as np
    from numpy.typing import ArrayLike

UserValue: TypeAlias = object
"""A user's value, from Python, the command line or a file. The function that takes it checks it."""

OptionValue: TypeAlias = Any
"""The checked value of an option or a field. Its type depends on a name, which is a variable."""

Plain: TypeAlias = object
"""A value of JSON, YAML or TOML. The function that reads it checks its type.

A table of known fields has a `TypedDict` instead.
"""

# A type checker sees the types of JAX. At run time they are left out, so that the command line
# starts without JAX, and `name_wrong_arguments` reads the words of the annotation.
if TYPE_CHECKING:
    AnyArray: TypeAlias = np.ndarray | jax.Array
    ArrayOrRows: TypeAlias = ArrayLike | jax.Array
    ArrayT = TypeVar("ArrayT", np.ndarray, jax.Array, np.ndarray | jax.Array)
    Numeric: TypeAlias = float | np.number | np.bool_ | np.ndarray | jax.Array
    Numbers: TypeAlias = Sequence[Numeric] | np.ndarray | jax.Array
    WholeT = TypeVar("WholeT", int, np.ndarray, jax.Array, np.ndarray | jax.Array)
else:
    AnyArray = Annotated[Any, "an array"]
    """An array of NumPy or JAX."""

    ArrayOrRows = AnyArray
    """An array of NumPy or JAX, or rows of numbers."""

    ArrayT = AnyArray
    """An array of NumPy or JAX. A function of it returns an array of the same library."""

    Numeric = Annotated[Any, "a number"]
    """A number, an array of numbers, or a tracer of `jax.jit` or `jax.vmap`."""

    Numbers = Annotated[Any, "numbers"]
    """Several numbers, such as a colour: a sequence of `Numeric`, or an array."""

    WholeT = TypeVar("WholeT")
    """A whole number, or an integer array of NumPy or JAX: the same for arguments and result."""

Whole: TypeAlias = Annotated[Any, "a number"]
"""A field of a `NamedTuple`: a whole number, or an integer array of NumPy or JAX.

All fields of a record have the same type. Beartype supports no generic named tuple that says so.
"""

Pytree: TypeAlias = Any
"""A pytree of arrays, such as a state or an observation.

Only the optimiser or environment knows its structure, and each has its own. They are named tuples,
and beartype supports no generic named tuple, so their states have no type variable.
"""

Tree = TypeVar("Tree")
"""A pytree of arrays. A function of it returns a pytree of the same structure."""

Untyped: TypeAlias = Any
"""What has no types: a module, object or keyword arguments of a library, or an annotation."""
