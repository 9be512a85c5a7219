"""Extra features: kernels from a grid to a whole number, which a search computes only where they are asked for."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Int32
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray, Numeric, UserValue
from elitelanes_jax.network.town import measure_town
from elitelanes_jax.problem.features import FEATURES, LARGEST_FEATURE, TOWN_FEATURES, extra_names

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
        raise InputError(f"features: expected kernels by name, got {shorten(repr(features))}")
    for name, kernel in features.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise InputError(f"features: expected names of letters, digits and _, got {shorten(repr(name), 40)}")
        if name in (*FEATURES, *TOWN_FEATURES):
            raise InputError(f"features: expected names that no other feature has, got {name!r}")
        if not callable(kernel):
            raise InputError(f"features: expected {name} to be a function of a grid, got {shorten(repr(kernel))}")
        made = jax.eval_shape(kernel, jax.ShapeDtypeStruct(shape, jnp.int8))
        kind = getattr(made, "dtype", None)
        if kind is None or made.shape or not jnp.issubdtype(kind, jnp.integer):
            got = shorten(repr(made), 60) if kind is None else f"{kind} of shape {made.shape}"
            raise InputError(f"features: expected {name} to return an integer scalar, got {got}")
    return dict(features)


def measure_extras(
    grids: Int8[Array | np.ndarray, "P H W"], names: Sequence[str], kernels: Mapping[str, Kernel]
) -> Int32[Array, "P K"]:
    """Measures K extra features of grids; values of one's own are kept within 0 to `LARGEST_FEATURE`.

    Args:
      grids: to measure.
      names: of the features.
      kernels: by name, those of all features of one's own.
    """
    own = [name for name in names if name not in TOWN_FEATURES]
    units = np.eye(len(names), dtype=np.int32)

    def measure_one(grid: Array) -> Array:
        values = {name: jnp.clip(kernels[name](grid), 0, LARGEST_FEATURE).astype(jnp.int32) for name in own}
        if len(own) < len(names):
            values |= measure_town(grid, detour="mean_detour" in names)._asdict()
        return sum((values[name] * unit for name, unit in zip(names, units, strict=True)), jnp.int32(0))

    return jax.vmap(measure_one)(jnp.asarray(grids))


def measure_missing(
    features: Mapping[str, AnyArray], names: Iterable[str], grids: AnyArray, source: str = "where"
) -> dict[str, NDArray[np.int32]]:
    """Returns extra features by name: those that are there, and those of a town that are not, measured now.

    Args:
      features: int32 ``[...]`` by name, as a search measured them.
      names: of the features that are needed.
      grids: int8 ``[..., H, W]``.
      source: the start of the message.

    Raises:
      InputError: for a feature of one's own that is not there.
    """
    found = {name: np.asarray(values) for name, values in features.items()}
    missing = [name for name in extra_names(names) if name not in found]
    for name in missing:
        if name not in TOWN_FEATURES:
            raise InputError(f"{source}: expected features that the search has measured, got {name}")
    if missing:
        grids = np.asarray(grids)
        flat = grids.reshape(-1, *grids.shape[-2:])
        parts = [np.asarray(_measure(jnp.asarray(part), tuple(missing))) for part in _batches(flat)]
        values = np.concatenate(parts)[: len(flat)].reshape(*grids.shape[:-2], len(missing))
        found |= {name: values[..., place] for place, name in enumerate(missing)}
    return found


# Grids that are measured at once: few enough for the memory, and always as many, for one compilation.
_BATCH = 256


def _batches(grids: NDArray[np.int8]) -> Iterator[NDArray[np.int8]]:
    for first in range(0, max(len(grids), 1), _BATCH):
        part = grids[first : first + _BATCH]
        yield np.pad(part, [(0, _BATCH - len(part)), (0, 0), (0, 0)])


@partial(jax.jit, static_argnames="names")
def _measure(grids: Int8[Array, "P H W"], names: tuple[str, ...]) -> Int32[Array, "P K"]:
    return measure_extras(grids, names, {})
