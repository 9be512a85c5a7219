"""Independent rows of arrays side by side on all local devices: the cores of the processor, GPUs, TPU cores."""

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Thread
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.cores import count_cores, use_cores
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import Pytree

__all__ = ["choose_devices", "cut", "join", "side_by_side", "use_cores"]

T = TypeVar("T")


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


def side_by_side(calls: Sequence[Callable[[], T]]) -> list[T]:
    """Calls functions at once, in a thread each; returns what they return, in order.

    An error in one of them, or an interruption, is raised when all have ended. The wait is at a simple queue, which an
    interruption leaves intact.
    """
    if len(calls) == 1:
        return [calls[0]()]
    ended: SimpleQueue[tuple[int, Pytree, BaseException | None]] = SimpleQueue()

    def call(number: int) -> None:
        try:
            ended.put((number, calls[number](), None))
        except BaseException as error:
            ended.put((number, None, error))

    threads = [Thread(target=call, args=(number,), daemon=True) for number in range(len(calls))]
    found: dict[int, T] = {}
    try:
        for thread in threads:
            thread.start()
        for _ in threads:
            number, value, error = ended.get()
            if error is not None:
                raise error
            found[number] = value
    finally:
        for thread in threads:
            if thread.is_alive():
                thread.join()
    return [found[number] for number in range(len(calls))]


def _is_key(array: Pytree) -> bool:
    return jnp.issubdtype(array.dtype, jax.dtypes.prng_key)


def _put(tree: Pytree, device: jax.Device) -> Pytree:
    """Puts arrays on a device, bound to it but for the default: for bound arrays JAX would compile again."""
    return tree if device == jax.local_devices()[0] else jax.device_put(tree, device)
