"""Measures kernels, searches and environments on the processor, and beside it on the GPU or TPU that JAX finds.

    python -m experiments.search.devices [--quick] [--repetitions N]

Rates are medians by the clock, with 12 x 12 tiles and after compiling. Every repetition has new grids or keys. On the
processor a search uses all cores, and other work one call.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import jax
import numpy as np

from experiments.common import Parser, Pytree, leave, run, table, whole
from experiments.navigation.speed import SHAPE, measured, steps_of
from experiments.search.speed import CORES, evaluate, fresh_grids, time_a_search, timed

_MAPS = 10_000  # of the environments
_STEPS = 32  # of the environments and the camera, in one call

Rate = Callable[[], float]
"""Does some work once; returns its units of work a second."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("devices", __doc__)
    parser.add_argument("--quick", action="store_true", help="the smallest batches alone, to see that it runs")
    parser.add_argument("--repetitions", type=whole(1), default=5, metavar="N", help="of each timing; default 5")
    options = parser.parse_args(arguments)
    return run("devices", lambda: _measure(options.repetitions, options.quick))


def _measure(repetitions: int, quick: bool) -> None:
    devices = list(dict.fromkeys([jax.devices("cpu")[0], jax.local_devices()[0]]))
    print(f"JAX {jax.__version__}, {', '.join(device.device_kind for device in devices)}, {len(CORES)} cores\n")
    rows = []
    for parts in zip(*[_rates(device, quick) for device in devices], strict=True):
        rates = [np.median([rate() for _ in range(repetitions + 1)][1:]) for _, rate in parts]
        memory = (devices[-1].memory_stats() or {}).get("peak_bytes_in_use")
        most = "" if memory is None else f"{memory / 1e6:,.0f}"
        rows.append([parts[0][0], *(f"{rate:,.0f}" for rate in rates), f"{rates[-1] / rates[0]:.2f}", most])
        print("; ".join(rows[-1]), flush=True)  # a row when it is known
    head = ["a second", *(device.platform for device in devices), "times the processor's", "MB so far, at most"]
    print(f"\n{table(head, rows)}")


def _rates(device: jax.Device, quick: bool) -> Iterator[tuple[str, Rate]]:
    """Yields what is measured on a device: a name and its rate."""
    kernel = jax.jit(jax.vmap(evaluate))
    for batch in (512,) if quick else (512, 4096, 32_768, 262_144):
        yield f"evaluations, batch {batch:,}", partial(_evaluation, kernel, device, batch)
    for method in ("ea", "map-elites"):
        for seeds in (16,) if quick else (16, 64, 256, 1024, 4096):
            yield f"evaluations of the tuned {method}, {seeds:,} seeds", partial(_search, device, method, seeds, quick)
    for batch in (16,) if quick else (1024, 16_384):
        keys = jax.random.split(jax.random.key(2), batch)
        with jax.default_device(device):
            made = [
                (name, jax.jit(steps_of(step, batch, _STEPS)), jax.jit(begin)(keys))
                for name, begin, step in measured(32 if quick else _MAPS, batch)
            ]
        for name, program, state in made:
            yield f"{name}, {batch:,} at once", partial(_environment, program, device, batch, state)


def _evaluation(kernel: Callable[[jax.Array], Pytree], device: jax.Device, batch: int) -> float:
    grids = jax.block_until_ready(jax.device_put(fresh_grids(batch, SHAPE), device))
    return batch / timed(lambda: jax.block_until_ready(kernel(grids)))


def _search(device: jax.Device, method: str, seeds: int, quick: bool) -> float:
    generations = 8 if quick else max(8, 2**16 // (32 * seeds))
    devices = (device,) * (len(CORES) if device.platform == "cpu" else 1)
    return 1e6 / time_a_search(method, devices, seeds, generations)


_keys = iter(range(2**32))


def _environment(program: Callable[..., Pytree], device: jax.Device, batch: int, state: Pytree) -> float:
    with jax.default_device(device):
        key = jax.random.key(next(_keys))
        return batch * _STEPS / timed(lambda: jax.block_until_ready(program(key, state)))


if __name__ == "__main__":
    leave(main())
