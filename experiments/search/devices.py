"""Measures kernels, searches and environments on the processor, and beside it on the GPU or TPU that JAX finds.

    python -m experiments.search.devices [--quick] [--repetitions N]

Rates are medians by the clock, with 12 x 12 tiles and after compiling. Every repetition has new grids or keys. The
processor is measured first, in a process of its own. On the processor a search uses all cores, and other work is one
call.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import jax
import numpy as np

from experiments.common import Parser, Pytree, leave, run, table, whole
from experiments.navigation.speed import SHAPE, measured, steps_of
from experiments.search.speed import CORES, evaluate, fresh_grids, time_a_search, timed

_MAPS = 10_000  # of the environments
_STEPS, _FRAMES = 32, 4  # of the environments and of the camera, in one call

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
    with ProcessPoolExecutor(1, get_context("spawn"), _use_the_processor) as pool:
        found = [pool.submit(_medians, repetitions, quick).result()]
    devices, device = [f"{len(CORES)} cores"], jax.local_devices()[0]
    if device.platform != "cpu":
        found.append(_medians(repetitions, quick))
        devices.append(device.device_kind)
    rows = []
    for parts in zip(*found, strict=True):
        rates, most = [rate for _, rate, _ in parts], parts[-1][2]
        memory = "" if most is None else f"{most / 1e6:,.0f}"
        rows.append([parts[0][0], *(f"{rate:,.0f}" for rate in rates), f"{rates[-1] / rates[0]:.2f}", memory])
    print(f"\n{table(['per second', *devices, 'times the cores', 'most MB so far'], rows)}")


def _use_the_processor() -> None:
    jax.config.update("jax_platforms", "cpu")


def _medians(repetitions: int, quick: bool) -> list[tuple[str, float, int | None]]:
    """Returns what is measured on the default device: names, rates, and the most memory of the device so far."""
    device, rows = jax.local_devices()[0], []
    print(f"JAX {jax.__version__}, {device.device_kind}\n")
    for name, rate in _rates(quick):
        median = float(np.median([rate() for _ in range(repetitions + 1)][1:]))
        rows.append((name, median, (device.memory_stats() or {}).get("peak_bytes_in_use")))
        print(f"{name}: {median:,.0f}", flush=True)  # when it is known
    return rows


def _rates(quick: bool) -> Iterator[tuple[str, Rate]]:
    """Yields what is measured on the default device: a name and its rate."""
    kernel = jax.jit(jax.vmap(evaluate))
    for batch in (512,) if quick else (512, 4096, 32_768, 262_144):
        yield f"evaluations, batch {batch:,}", partial(_evaluation, kernel, batch)
    for method in ("ea", "map-elites"):
        for seeds in (16,) if quick else (16, 256, 4096):
            yield f"evaluations of the tuned {method}, {seeds:,} seeds", partial(_search, method, seeds, quick)
    for batch in (16,) if quick else (1024, 16_384):
        keys = jax.random.split(jax.random.key(2), batch)
        for name, begin, step in measured(32 if quick else _MAPS, batch):
            if name.startswith("views") and batch > 1024:
                continue  # a GPU draws a whole batch at once, which needs more memory than it has
            steps = _FRAMES if name.startswith(("camera", "views")) else _STEPS
            program, state = jax.jit(steps_of(step, batch, steps)), jax.jit(begin)(keys)
            yield f"{name}, {batch:,} at once", partial(_environment, program, batch * steps, state)


def _evaluation(kernel: Callable[[jax.Array], Pytree], batch: int) -> float:
    grids = jax.block_until_ready(jax.device_put(fresh_grids(batch, SHAPE)))
    return batch / timed(lambda: jax.block_until_ready(kernel(grids)))


def _search(method: str, seeds: int, quick: bool) -> float:
    generations = 8 if quick else max(32, 2**18 // (32 * seeds))
    devices = len(CORES) if jax.local_devices()[0].platform == "cpu" else 1
    return 1e6 / time_a_search(method, devices, seeds, generations)


_keys = iter(range(2**32))


def _environment(program: Callable[..., Pytree], steps: int, state: Pytree) -> float:
    key = jax.random.key(next(_keys))
    return steps / timed(lambda: jax.block_until_ready(program(key, state)))


if __name__ == "__main__":
    leave(main())
