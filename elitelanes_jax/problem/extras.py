"""Extra features: kernels from a grid to a whole number, which a search computes only where they are asked for."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32

from elitelanes_jax._util.errors import InputError, short
from elitelanes_jax._util.types import Numeric, UserValue
from elitelanes_jax.problem.features import FEATURES, LARGEST_FEATURE

__all__ = ["Kernel", "check_kernels", "measure_extras"]

Kernel: TypeAlias = Callable[[Int8[Array, "H W"]], Numeric]
"""From one grid to an integer scalar; pure, for `jax.jit` and `jax.vmap`."""


def check_kernels(features: UserValue, shape: tuple[int, int]) -> dict[str, Kernel]:
    """Checks features of one's own.

    Args:
      features: kernels by name; None for none.
      shape: (height, width) of the grids that they take.

    Raises:
      InputError: for anything but kernels by name, the name of another feature, or a kernel whose result is no integer
        scalar.
    """
    if features is None:
        return {}
    if not isinstance(features, Mapping):
        raise InputError(f"features: expected kernels by name, got {short(repr(features))}")
    for name, kernel in features.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"features: expected names of letters, digits and _, got {short(repr(name), 40)}")
        if name in FEATURES:
            raise InputError(f"features: expected names that no other feature has, got {name!r}")
        if not callable(kernel):
            raise InputError(f"features: expected {name} to be a function of a grid, got {short(repr(kernel))}")
        made = jax.eval_shape(kernel, jax.ShapeDtypeStruct(shape, jnp.int8))
        kind = getattr(made, "dtype", None)
        if kind is None or made.shape or not jnp.issubdtype(kind, jnp.integer):
            got = short(repr(made), 60) if kind is None else f"{kind} of shape {made.shape}"
            raise InputError(f"features: expected {name} to return an integer scalar, got {got}")
    return dict(features)


def measure_extras(
    grids: Int8[Array, "P H W"], names: Sequence[str], kernels: Mapping[str, Kernel]
) -> Int32[Array, "P K"]:
    """Measures K extra features of grids; values are kept within 0 to `LARGEST_FEATURE`.

    Args:
      grids: to measure.
      names: of the features.
      kernels: by name, those of all features of one's own.
    """

    def measure_one(grid: Array) -> Array:
        values = jnp.stack([jnp.clip(kernels[name](grid), 0, LARGEST_FEATURE).astype(jnp.int32) for name in names])
        return (values[:, None] * np.eye(len(names), dtype=np.int32)).sum(axis=0, dtype=jnp.int32)

    return jax.vmap(measure_one)(grids)
