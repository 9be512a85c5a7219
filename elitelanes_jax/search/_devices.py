"""Rows of arrays side by side on all local devices: the cores of the processor, GPUs, TPU cores."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax._util.types import AnyArray, Pytree

# Rows of one call on a device. With fewer rows the calls cost more than the rows; with more rows the memory grows, and
# the time does not fall.
_ROWS_A_CALL = 4096


def spread(
    function: Callable[..., Pytree], *arrays: AnyArray, devices: int | Sequence[jax.Device] | None = None
) -> Pytree:
    """Applies a function of one row to all rows of large arrays, side by side on all devices.

    The result is that of ``jax.jit(jax.vmap(function))(*arrays)``, bit for bit. Each call takes some thousand rows, so
    the memory for intermediate results does not grow with the number of rows. Example: ``spread(measure, grids)``.

    Args:
      function: takes arrays without their first axis, and returns a tree of arrays. It is compiled once, for as long as
        the function object exists.
      *arrays: ``[N, ...]`` each, of NumPy or JAX.
      devices: as in `evolve`; defaults to all local devices.

    Returns:
      A tree of NumPy arrays ``[N, ...]``.

    Raises:
      InputError: for no arrays, arrays without rows, or arrays with different numbers of rows.
    """
    rows = {np.shape(array)[:1] for array in arrays}
    if len(rows) != 1 or rows & {(), (0,)}:
        shapes = ", ".join(str(np.shape(array)) for array in arrays) or "none"
        raise InputError(f"arrays: expected some with the same number of rows, at least 1, got {shapes}")
    (count,), chosen = rows.pop(), choose_devices(devices)
    size = min(count, _ROWS_A_CALL * len(chosen))
    run = _batched(function)

    def run_part(part: Pytree) -> Pytree:
        return jax.tree.map(np.asarray, run(*part))

    found = []
    for first in range(0, count, size):
        start = min(first, count - size)  # the last call has as many rows as the others, for the same program
        parts = cut([np.asarray(array[start : start + size]) for array in arrays], chosen)
        batch = join(side_by_side([partial(run_part, part) for part in parts]), size)
        found.append(jax.tree.map(lambda array, known=first - start: array[known:], batch))
    return jax.tree.map(lambda *parts: np.concatenate(parts), *found)


@lru_cache(maxsize=32)
def _batched(function: Callable[..., Pytree]) -> Callable[..., Pytree]:
    return jax.jit(jax.vmap(function))


def choose_devices(devices: int | Sequence[jax.Device] | None = None) -> list[jax.Device]:
    """Returns the devices that share some work, one for each part of it.

    JAX's device for the processor stands for all cores, and runs as many programs at once as there are threads that
    call it. So the list has it once per core.

    Args:
      devices: the devices, which may be repeated, or their number. Defaults to all local devices, and to as many cores
        as `use_cores` allows.

    Raises:
      InputError: for a number under 1, or anything else that is not devices.
    """
    local = jax.local_devices()
    if devices is None:
        devices = max(count_cores(), len(local)) if local[0].platform == "cpu" else len(local)
    if isinstance(devices, Sequence) and devices and all(isinstance(device, jax.Device) for device in devices):
        return list(devices)
    if not isinstance(devices, Sequence) and is_whole(devices) and devices > 0:
        return [local[index % len(local)] for index in range(devices)]
    raise InputError(f"devices: expected JAX's devices, or their number, at least 1, got {devices!r}")


def part_rows(rows: int, devices: Sequence[jax.Device]) -> tuple[int, int]:
    """Returns the rows of each part that `cut` makes of so many rows, and the number of parts."""
    size = -(-rows // len(devices))
    return size, -(-rows // size)


def cut(tree: Pytree, devices: Sequence[jax.Device]) -> list[Pytree]:
    """Cuts arrays into parts with equally many rows, and puts each part on its device.

    If the rows do not divide evenly, the last parts repeat the last row. All parts have one size, so one program serves
    them, and a part with repeated rows takes no longer than the first part.

    Args:
      tree: arrays ``[S, ...]``.
      devices: for the parts; there may be fewer parts than devices.

    Returns:
      The parts, trees of arrays ``[size, ...]``.
    """
    rows = len(jax.tree.leaves(tree)[0])
    size, count = part_rows(rows, devices)
    if count == 1:
        return [_put(tree, devices[0])]
    indices = np.minimum(np.arange(count * size), rows - 1).reshape(count, size)
    # NumPy compiles nothing for this, but has no arrays of keys.
    tree = jax.tree.map(lambda array: array if _is_key(array) else np.asarray(array), tree)
    return [
        _put(jax.tree.map(lambda array, part=part: array[part], tree), device)
        for part, device in zip(indices, devices, strict=False)
    ]


def join(parts: Sequence[Pytree], rows: int) -> Pytree:
    """Joins the parts that `cut` has made, to arrays ``[rows, ...]``."""
    if len(parts) == 1:
        return parts[0]

    def joined(*arrays: Pytree) -> Pytree:
        if _is_key(arrays[0]):
            return jnp.concatenate([_put(array, jax.local_devices()[0]) for array in arrays])[:rows]
        return np.concatenate(arrays)[:rows]

    return jax.tree.map(joined, *parts)


def _is_key(array: Pytree) -> bool:
    return jnp.issubdtype(array.dtype, jax.dtypes.prng_key)


def _put(tree: Pytree, device: jax.Device) -> Pytree:
    """Puts arrays on a device. It binds no arrays to the default device: JAX would compile again for bound ones."""
    return tree if device == jax.local_devices()[0] else jax.device_put(tree, device)
