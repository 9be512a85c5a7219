"""Spreads the seeds of a search over all local devices.

The devices are the cores of the processor, GPUs, or cores of a TPU.
"""

from collections.abc import Sequence
from itertools import cycle, islice

import jax

from elitelanes_jax._util.checks import is_whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.threads import count_cores

# The most seeds that a processor's core advances together. What a step of more seeds reads and
# writes does not stay in its caches: with 4,096 seeds of the tuned MAP-Elites at 12 x 12, two cores
# take twice as long.
_MOST_ROWS = 32


def choose_devices(devices: int | Sequence[jax.Device] | None = None) -> list[jax.Device]:
    """Returns the devices for the parts of some work; a device may be repeated.

    By default these are all local devices, and for the processor its device once for each core that
    `use_cores` allows: JAX has one device for all cores, and runs a program for each thread that
    calls it.

    Raises:
      InputError: for anything else than devices, or their number from 1.
    """
    named = [*devices] if isinstance(devices, Sequence) else []
    if named and all(isinstance(device, jax.Device) for device in named):
        return named
    local = jax.local_devices()
    if devices is None:
        count = len(local)
        if local[0].platform == "cpu":
            count = max(count, count_cores())
    elif is_whole(devices) and devices > 0:
        count = devices
    else:
        expected = "JAX's devices, or their number, at least 1"
        raise InputError("devices", expected, quote(devices))
    # If there are fewer devices, they are repeated in their order.
    return list(islice(cycle(local), count))


def device_of_each_part(devices: Sequence[jax.Device], rows: int) -> list[jax.Device]:
    """Returns a device for each of the parts of equal size that rows are cut into.

    No part on a processor has more than `_MOST_ROWS` rows, so a device may have several parts.
    """
    devices = list(devices)
    if all(device.platform == "cpu" for device in devices):
        # Each device takes as many parts as it needs to keep each part small. Divisions round up.
        devices *= -(-rows // (_MOST_ROWS * len(devices)))
    # Parts of equal size may need fewer devices: 9 rows on 4 devices are 3 parts of 3 rows.
    size = -(-rows // len(devices))
    return devices[: -(-rows // size)]
