"""Independent rows of arrays side by side on all local devices: the cores of the processor, GPUs, TPU cores."""

from collections.abc import Callable, Sequence
from functools import lru_cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.threads import count_cores, side_by_side
from elitelanes_jax._util.types import AnyArray, Pytree

# Rows of a call: with fewer the calls cost more than the rows, with more the memory grows and the time does not fall.
_ROWS_A_CALL = 4096


def spread(
    function: Callable[..., Pytree], *arrays: AnyArray, devices: int | Sequence[jax.Device] | None = None
) -> Pytree:
    """Applies a function of one row to all rows of large arrays, side by side on all devices.

    It is ``jax.jit(jax.vmap(function))(*arrays)``, bit for bit, in calls of some thousand rows: so the memory that it
    takes beside its result does not grow with the number of rows. Such as ``spread(measure, grids)``.

    Args:
      function: of arrays without their first axis, to a tree of arrays; compiled once for as long as it is there.
      *arrays: ``[N, ...]`` each, of NumPy or JAX.
      devices: as in `evolve`; by default all local ones.

    Returns:
      A tree of NumPy arrays ``[N, ...]``.

    Raises:
      InputError: for no arrays, arrays without rows, or with different numbers of them.
    """
    rows = {np.shape(array)[:1] for array in arrays}
    if len(rows) != 1 or rows & {(), (0,)}:
        shapes = ", ".join(str(np.shape(array)) for array in arrays) or "none"
        raise InputError(f"arrays: expected some with the same number of rows, at least 1, got {shapes}")
    (count,), chosen = rows.pop(), choose_devices(devices)
    size = min(_ROWS_A_CALL, -(-count // len(chosen)))  # of all calls: the last one begins earlier where rows run out
    firsts = [min(number * size, count - size) for number in range(-(-count // size))]
    run = _batched(function)

    def run_share(number: int, device: jax.Device) -> list[Pytree]:
        parts = (
            [_put(np.asarray(array[first : first + size]), device) for array in arrays] for first in shares[number]
        )
        return [jax.tree.map(np.asarray, run(*part)) for part in parts]

    shares = [firsts[number :: len(chosen)] for number in range(min(len(chosen), len(firsts)))]
    found = side_by_side([partial(run_share, *share) for share in enumerate(chosen[: len(shares)])])
    by_call = [found[number % len(shares)][number // len(shares)] for number in range(len(firsts))]
    kept = [slice(number * size - first, None) for number, first in enumerate(firsts)]
    return jax.tree.map(
        lambda *parts: np.concatenate([part[rows] for part, rows in zip(parts, kept, strict=True)]), *by_call
    )


@lru_cache(maxsize=32)
def _batched(function: Callable[..., Pytree]) -> Callable[..., Pytree]:
    return jax.jit(jax.vmap(function))


def choose_devices(devices: int | Sequence[jax.Device] | None = None) -> list[jax.Device]:
    """Returns the devices that work is spread over, one for each part of it.

    JAX's device for the processor stands for all its cores, and runs as many programs at once as threads ask it to. So
    it is there once for each core.

    Args:
      devices: the devices, any of them more than once, or their number; by default all local ones, and of the cores as
        many as `use_cores` says.

    Raises:
      InputError: for a number under 1, or anything else that is no devices.
    """
    local = jax.local_devices()
    if devices is None:
        return _repeated(local, max(count_cores(), len(local)) if local[0].platform == "cpu" else len(local))
    if isinstance(devices, Sequence) and devices and all(isinstance(device, jax.Device) for device in devices):
        return list(devices)
    if not isinstance(devices, Sequence) and is_whole(devices) and devices > 0:
        return _repeated(local, devices)
    raise InputError(f"devices: expected JAX's devices, or their number, at least 1, got {devices!r}")


def _repeated(devices: Sequence[jax.Device], count: int) -> list[jax.Device]:
    return [devices[number % len(devices)] for number in range(count)]


def cut(tree: Pytree, devices: Sequence[jax.Device]) -> list[Pytree]:
    """Cuts arrays with rows in front into parts of equal size, and puts each part on its device.

    One program serves parts of one size: the last ones repeat the last row where the rows do not divide. This takes no
    longer than the first part does.

    Args:
      tree: of arrays ``[S, ...]``.
      devices: for the parts; there may be fewer parts than devices.

    Returns:
      The parts, trees of arrays ``[size, ...]``.
    """
    rows = len(jax.tree.leaves(tree)[0])
    size = -(-rows // len(devices))
    count = -(-rows // size)
    if count == 1:
        return [_put(tree, devices[0])]
    places = np.minimum(np.arange(count * size), rows - 1).reshape(count, size)
    # NumPy has nothing to compile for this, but does not know keys.
    tree = jax.tree.map(lambda array: array if _is_key(array) else np.asarray(array), tree)
    return [
        _put(jax.tree.map(lambda array, place=place: array[place], tree), device)
        for place, device in zip(places, devices, strict=False)
    ]


def join(parts: Sequence[Pytree], rows: int) -> Pytree:
    """Puts parts of `cut` together again, arrays ``[rows, ...]``."""
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
    """Puts arrays on a device, bound to it but for the default: for bound arrays JAX would compile again."""
    return tree if device == jax.local_devices()[0] else jax.device_put(tree, device)
