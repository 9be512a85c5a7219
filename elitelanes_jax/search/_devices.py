"""Spreads the seeds of a search over all local devices.

The devices are the cores of the processor, GPUs, or cores of a TPU.
"""

from collections.abc import Sequence
from itertools import cycle, islice
from operator import itemgetter
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.threads import count_cores
from elitelanes_jax._util.types import Pytree

# The most seeds that a processor's core advances together. What a step of more seeds reads and
# writes does not stay in its caches: with 4,096 seeds of the tuned MAP-Elites at 12 x 12, two cores
# take twice as long.
_MOST_ROWS = 32


class PartRows(NamedTuple):
    """How rows are cut into parts.

    Attributes:
      rows: the number of rows in each part.
      parts: the number of parts.
    """

    rows: int
    parts: int


def choose_devices(devices: int | Sequence[jax.Device] | None = None) -> list[jax.Device]:
    """Returns the devices for the parts of some work; a device may be repeated.

    By default these are all local devices, and for the processor its device once for each core that
    `use_cores` allows: JAX has one device for all cores, and runs a program for each thread that
    calls it.

    Raises:
      InputError: for anything else than devices, or their number from 1.
    """
    local = jax.local_devices()
    if devices is None:
        count = len(local)
        if local[0].platform == "cpu":
            count = max(count, count_cores())
        return _take_in_turn(local, count)
    if isinstance(devices, Sequence):
        if devices and all(isinstance(device, jax.Device) for device in devices):
            return list(devices)
    elif is_whole(devices) and devices > 0:
        return _take_in_turn(local, devices)
    raise InputError(
        "devices: expected JAX's devices, or their number, at least 1, "
        f"got {shorten(repr(devices))}"
    )


def _take_in_turn(devices: Sequence[jax.Device], count: int) -> list[jax.Device]:
    """Returns `count` devices. If there are fewer, they are repeated in their order."""
    return list(islice(cycle(devices), count))


def device_of_each_part(devices: Sequence[jax.Device], rows: int) -> list[jax.Device]:
    """Returns a device for each part that `cut` makes of rows; there may be fewer parts.

    No part on a processor has more than `_MOST_ROWS` rows, so a device may have several parts.
    """
    on_processor = all(device.platform == "cpu" for device in devices)
    if not on_processor:
        return list(devices)
    # Each device takes as many parts as it needs to keep each part small. The division rounds up.
    rounds = -(-rows // (_MOST_ROWS * len(devices)))
    return list(devices) * rounds


def part_rows(rows: int, devices: Sequence[jax.Device]) -> PartRows:
    """Returns how `cut` cuts rows into parts. `rows` is the number of all rows."""
    # Both divisions round up. Parts of this size may need fewer devices: 9 rows on 4 devices are 3
    # parts of 3 rows.
    size = -(-rows // len(devices))
    return PartRows(size, parts=-(-rows // size))


def cut(tree: Pytree, devices: Sequence[jax.Device]) -> list[Pytree]:
    """Cuts arrays ``[S, ...]`` into parts with equally many rows, and puts each part on its device.

    If the rows do not divide evenly, the last parts repeat the last row. All parts have one size,
    so one program serves them, and a part with repeated rows takes no longer than the first part.
    There may be fewer parts than devices.
    """
    rows = len(jax.tree.leaves(tree)[0])
    size, count = part_rows(rows, devices)
    if count == 1:
        return [_put(tree, devices[0])]
    # The indices of the rows of all parts. Those beyond the end are the last row's.
    indices = np.minimum(np.arange(count * size), rows - 1).reshape(count, size)
    tree = jax.tree.map(_to_numpy, tree)
    parts = []
    for indices_of_part, device in zip(indices, devices[:count], strict=True):
        part = jax.tree.map(itemgetter(indices_of_part), tree)
        parts.append(_put(part, device))
    return parts


def _to_numpy(array: Pytree) -> Pytree:
    """Returns an array of NumPy, whose indexing compiles nothing.

    An array of keys stays one of JAX, because NumPy has no such arrays.
    """
    if _is_key(array):
        return array
    return np.asarray(array)


def join(parts: Sequence[Pytree], rows: int) -> Pytree:
    """Joins the parts that `cut` made to arrays ``[rows, ...]``, for the default device."""
    # A single part on the default device needs no copy: it has no repeated rows.
    if len(parts) == 1 and _is_on_default_device(parts[0]):
        return parts[0]
    return jax.tree.map(lambda *arrays: _concatenate(arrays)[:rows], *parts)


def _is_on_default_device(tree: Pytree) -> bool:
    """Returns whether all arrays are JAX's, and on the default device."""
    default_device = jax.local_devices()[0]
    # A leaf that is no array, such as a number, has no device.
    devices = [getattr(array, "device", default_device) for array in jax.tree.leaves(tree)]
    return all(device == default_device for device in devices)


def _concatenate(arrays: Sequence[Pytree]) -> Pytree:
    """Joins arrays in NumPy, or arrays of keys on the default device."""
    if not _is_key(arrays[0]):
        return np.concatenate(arrays)
    default_device = jax.local_devices()[0]
    return jnp.concatenate([jax.device_put(array, default_device) for array in arrays])


def _is_key(array: Pytree) -> bool:
    return jnp.issubdtype(array.dtype, jax.dtypes.prng_key)


def _put(tree: Pytree, device: jax.Device) -> Pytree:
    """Puts arrays on a device.

    Arrays for the default device are not bound to it: JAX would compile again for those.
    """
    if device == jax.local_devices()[0]:
        return tree
    return jax.device_put(tree, device)
