"""Measures the speed of the kernels and of whole runs, next to the usual ways to write them.

    python -m experiments.search.speed [--parts evaluation sizes ...] [--repetitions N] [--out FILE]

Every repetition has new grids, because the processor's branch predictor learns a small batch that is timed twice. The
candidates take turns and the figures are medians, because the speed of a shared machine drifts. All parts run on one
core, except the searches on several cores.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from experiments.common import Parser, leave, run, whole, write

if TYPE_CHECKING:
    from jax import Array

# JAX starts as many threads as the process has cores when it is first used: the functions below import it late.

Grids = NDArray[np.int8]
Record = dict[str, str | float]
Evaluation = Callable[[Grids], object]
"""From grids ``[B, H, W]`` to their fitness or more."""

_SIDES = (8, 12, 16, 32, 64, 128, 256)
_SEEDS = 16

CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("speed", __doc__)
    parser.add_argument(
        "--parts", nargs="+", choices=_PARTS, default=list(_PARTS), metavar="NAME", help=f"some of {', '.join(_PARTS)}"
    )
    parser.add_argument("--repetitions", type=whole(1), default=31, metavar="N", help="of each timing; default 31")
    parser.add_argument("--out", type=Path, default=Path("results/speed.json"), metavar="FILE", help="a JSON file")
    options = parser.parse_args(arguments)
    return run("speed", lambda: _measure(options))


def _measure(options: argparse.Namespace) -> None:
    record = {"cores": len(CORES), "machine": platform.machine(), "python": platform.python_version()}
    print(record)
    found: dict[str, list[Record]] = {}
    for part in options.parts:
        _pin(1)
        found[part] = _PARTS[part](options.repetitions)
    write(options.out, json.dumps(record | {"repetitions": options.repetitions} | found, indent=2) + "\n")
    print(f"\nwritten to {options.out}")
    if {"sizes", "cores"} <= found.keys():
        _draw(found["sizes"], found["cores"], options.out.with_suffix(".png"))


def _pin(count: int) -> None:
    """Lets all threads of this process run only on this number of cores, if the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        for thread in Path("/proc/self/task").iterdir():
            with suppress(ProcessLookupError):  # a thread that has ended since
                os.sched_setaffinity(int(thread.name), CORES[:count])


def timed(call: Callable[[], object]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


def _medians(calls: dict[str, Callable[[], float]], repetitions: int) -> dict[str, float]:
    """Returns the median of the seconds that each call says. The first round compiles, and does not count."""
    seconds = [{name: call() for name, call in calls.items()} for _ in range(repetitions + 1)]
    return {name: float(np.median([one[name] for one in seconds[1:]])) for name in calls}


_random = np.random.default_rng(2026)


def fresh_grids(count: int, shape: tuple[int, int]) -> Grids:
    """Makes random grids as a search starts with: tiles with two or more connections, matched."""
    codes = np.array([3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15], np.int8)[_random.integers(0, 11, (count, *shape))]
    east, south = codes[:, :, :-1] & 4 > 0, codes[:, :-1] & 2 > 0
    grids = np.zeros_like(codes)
    grids[:, :, :-1] |= np.where(east, 4, 0).astype(np.int8)
    grids[:, :, 1:] |= np.where(east, 1, 0).astype(np.int8)
    grids[:, :-1] |= np.where(south, 2, 0).astype(np.int8)
    grids[:, 1:] |= np.where(south, 8, 0).astype(np.int8)
    return grids


def evaluate(grid: "Array") -> tuple["Array", tuple["Array", ...]]:
    """Returns the fitness and all metrics of a grid."""
    from elitelanes_jax import fitness, measure

    metrics = measure(grid)
    return fitness(metrics), metrics


@cache
def _evaluations() -> tuple[Callable[[Grids], NDArray[np.int32]], dict[str, Evaluation]]:
    """Returns our compiled fitness, and all candidates by name."""
    import jax

    from elitelanes_jax.network import vmap_in_blocks
    from experiments.search.baselines import cpp_fitness, networkx_fitness

    kernel = jax.jit(vmap_in_blocks(evaluate))
    candidates: dict[str, Evaluation] = {
        "elitelanes_jax": lambda grids: jax.block_until_ready(kernel(grids)),
        "networkx": networkx_fitness,
    }
    if (compiled := cpp_fitness()) is not None:
        candidates["c++"] = compiled
    return lambda grids: np.asarray(kernel(grids)[0]), candidates


def _evaluation_times(names: Sequence[str], shape: tuple[int, int], batch: int, repetitions: int) -> dict[str, float]:
    """Returns the median microseconds a grid of each candidate. NetworkX takes one grid at a time, so it gets fewer."""
    candidates = _evaluations()[1]

    def call(name: str) -> float:
        count = max(20 * 144 // (shape[0] * shape[1]), 1) if name == "networkx" else batch
        candidates[name](fresh_grids(count, shape))  # the candidate before has left its own data in the caches
        return 1e6 * timed(partial(candidates[name], fresh_grids(count, shape))) / count

    return _medians({name: partial(call, name) for name in names}, repetitions)


def _evaluation(repetitions: int) -> list[Record]:
    """Measures all metrics and the fitness of 12 x 12 grids by batch size."""
    fitness, candidates = _evaluations()
    rows: list[Record] = []
    print("\nevaluation of 12 x 12 grids, all metrics and fitness\n")
    print(f"{'batch':>6} {'candidate':>15} {'µs a grid':>10} {'grids a second':>15} {'times ours':>12}")
    for batch in (40, 512, 4096):
        grids = fresh_grids(batch, (12, 12))
        assert (np.asarray(candidates["networkx"](grids[:40])) == fitness(grids[:40])).all()
        medians = _evaluation_times(list(candidates), (12, 12), batch, repetitions)
        for name, median in medians.items():
            ratio = median / medians["elitelanes_jax"]
            rows.append({"batch": batch, "candidate": name, "us_per_grid": median, "times_ours": ratio})
            print(f"{batch:>6} {name:>15} {median:>10.2f} {1e6 / median:>15,.0f} {ratio:>11.1f}x")
    return rows


def _sizes(repetitions: int) -> list[Record]:
    """Measures all metrics and the fitness of square grids by side."""
    fitness, candidates = _evaluations()
    rows: list[Record] = []
    print("\nevaluation by size, µs a grid\n")
    print(f"{'side':>6} {'batch':>6} " + " ".join(f"{name:>15}" for name in candidates))
    for side in _SIDES:
        batch = min(max(2**19 // side**2, 8), 512)
        grids = fresh_grids(batch, (side, side))
        assert "c++" not in candidates or (np.asarray(candidates["c++"](grids)) == fitness(grids)).all()
        medians = _evaluation_times(list(candidates), (side, side), batch, max(repetitions // 4, 1))
        rows.append({"side": side, "batch": batch, **medians})
        print(f"{side:>6} {batch:>6} " + " ".join(f"{median:>15,.1f}" for median in medians.values()))
    return rows


def _corridors(repetitions: int) -> list[Record]:
    """Measures a batch with a 64 x 64 spiral next to a batch of random grids."""
    import jax

    from elitelanes_jax import measure
    from experiments.search.corridors import spiral

    kernel, slow = jax.jit(jax.vmap(measure)), spiral((64, 64))

    def call(spirals: int) -> float:
        grids = fresh_grids(8, (64, 64))
        grids[_random.permutation(8)[:spirals]] = slow
        return 1e6 * timed(lambda: jax.block_until_ready(kernel(grids))) / 8

    medians = _medians({"random": partial(call, 0), "with a spiral": partial(call, 1)}, repetitions // 2 + 1)
    ratio = medians["with a spiral"] / medians["random"]
    print(f"\n64 x 64: {medians['random']:.0f} µs a random grid; {ratio:.1f} times that with a spiral in the batch")
    return [{**medians, "ratio": ratio}]


def time_a_search(method: str, devices: int, seeds: int, generations: int) -> float:
    """Returns the microseconds an evaluation that a tuned method takes on a number of devices.

    Its program is compiled before, with the highest level of optimisation, which long searches have.
    """
    _optimise(method, devices, seeds)
    return _time(method, devices, seeds, generations)


@cache
def _optimise(method: str, devices: int, seeds: int) -> None:
    _time(method, devices, seeds, 2**21 // (32 * seeds))  # evaluates more cells than searches of lower levels


def _time(method: str, devices: int, seeds: int, generations: int) -> float:
    from elitelanes_jax import SearchSpec, evolve

    spec = SearchSpec(method=method, preset="tuned", fill=True)
    key = int(_random.integers(2**32))
    found = evolve(key, spec=spec, seeds=seeds, devices=devices, generations=generations, progress=False)
    return float(np.mean(1e6 / found.history.evaluations_per_second))


def _steps(repetitions: int) -> list[Record]:
    """Measures a step of the tuned methods next to the evaluation of as many grids in one batch, on one core."""
    calls = {"evaluation": lambda: _evaluation_times(["elitelanes_jax"], (12, 12), 512, 5)["elitelanes_jax"]}
    calls |= {method: partial(time_a_search, method, 1, _SEEDS, 128) for method in ("ea", "map-elites")}
    medians = _medians(calls, repetitions // 4 + 1)
    print(f"\na step of the tuned methods, 12 x 12, {_SEEDS} seeds, one core\n")
    for name, median in medians.items():
        print(f"{name:>12} {median:>8.2f} µs an evaluation {median / medians['evaluation']:>6.1f}x")
    return [dict(medians)]


def _cores(repetitions: int) -> list[Record]:
    """Measures 16 seeds of the tuned methods on 1, 2, 4 and all cores, each in a process of its own."""
    rows: list[Record] = []
    counts = [count for count in sorted({1, 2, 4, len(CORES)}) if count <= len(CORES)]
    print(f"\n{_SEEDS} seeds of the tuned methods, 12 x 12, on several cores\n")
    with ExitStack() as stack:
        pools = {count: stack.enter_context(ProcessPoolExecutor(1, get_context("spawn"))) for count in counts}
        for count, pool in pools.items():
            _pin(count)  # the process that starts now has these cores
            pool.submit(os.getpid).result()

        def call(method: str, count: int) -> float:
            return pools[count].submit(time_a_search, method, count, _SEEDS, 384).result()

        for method in ("ea", "map-elites"):
            medians = _medians({str(count): partial(call, method, count) for count in counts}, repetitions // 4 + 1)
            for cores, median in medians.items():
                rows.append({"method": method, "cores": int(cores), "us": median, "speedup": medians["1"] / median})
                print(f"{method:>12} {cores:>4} cores {median:>8.2f} µs an evaluation {medians['1'] / median:>6.2f}x")
    return rows


_ALONE = """
import time
began = time.perf_counter()
import jax
from elitelanes_jax import evolve, use_compile_cache
use_compile_cache()
seconds = [time.perf_counter() - began]
for key in range(2):
    began = time.perf_counter()
    jax.block_until_ready(evolve(key, {arguments}, progress=False).elites)
    seconds.append(time.perf_counter() - began)
from pathlib import Path
status = Path("/proc/self/status")  # `resource` also counts the process that started this one
most = int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024 if status.exists() else float("nan")
print(*seconds, most)
"""


def _call_alone(cache: str, arguments: str) -> list[float]:
    """Returns the seconds of the import and of two calls of `evolve` in a new process, and its peak memory in MiB."""
    _pin(len(CORES))
    command = [sys.executable, "-c", _ALONE.format(arguments=arguments)]
    environment = os.environ | {"XDG_CACHE_HOME": cache}
    printed = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    return [float(word) for word in printed.split()]


_STARTS = {
    "6 x 6, 2 seeds, 2,000 evaluations": "(6, 6), seeds=2, evaluations=2_000",
    "12 x 12, 8 seeds, 2,000 evaluations": "seeds=8, evaluations=2_000",
    "12 x 12, 16 seeds, 50,000 evaluations": "seeds=16, evaluations=50_000",
}


def _start(repetitions: int) -> list[Record]:
    """Measures whole searches in new processes: with nothing cached, cached, and as a second call in the process."""
    print("\nseconds of a search in a new process, all cores; the shorter a search, the less optimised\n")
    print(f"{'search':>38} {'import':>8} {'cold':>8} {'cached':>8} {'second call':>12}")
    rows: list[Record] = []
    for name, arguments in _STARTS.items():
        found = []
        for _ in range(repetitions // 16 + 1):
            with tempfile.TemporaryDirectory() as folder:
                cold = _call_alone(folder, arguments)[1]
                found.append((cold, *_call_alone(folder, arguments)[:3]))
        cold, importing, cached, second = (float(one) for one in np.median(found, axis=0))
        rows.append({"search": name, "import": importing, "cold": cold, "cached": cached, "second call": second})
        print(f"{name:>38} {importing:>8.2f} {cold:>8.2f} {cached:>8.2f} {second:>12.3f}")
    return rows


def _memory(_: int) -> list[Record]:
    """Measures the peak memory of a process that runs the tuned MAP-Elites, by seeds."""
    rows: list[Record] = []
    print()
    with tempfile.TemporaryDirectory() as folder:
        for seeds in (16, 64):
            arguments = f"seeds={seeds}, generations=256"
            _call_alone(folder, arguments)  # compiles: the compiler's memory does not count
            rows.append({"seeds": seeds, "MiB": _call_alone(folder, arguments)[3]})
            print(f"{seeds} seeds: at most {rows[-1]['MiB']:,.0f} MiB")
    return rows


_PARTS: dict[str, Callable[[int], list[Record]]] = {
    "evaluation": _evaluation,
    "sizes": _sizes,
    "corridors": _corridors,
    "steps": _steps,
    "cores": _cores,
    "start": _start,
    "memory": _memory,
}


def _draw(sizes: list[Record], cores: list[Record], file: Path) -> None:
    """Plots evaluations a second by cores, and the time a grid by its size."""
    import matplotlib.pyplot as plt

    from experiments.common import save

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    counts = sorted({int(row["cores"]) for row in cores})
    for method in ("ea", "map-elites"):
        speeds = [1 / float(row["us"]) for row in cores if row["method"] == method]
        (line,) = left.plot(counts, speeds, "o-", label=f"{method}, tuned")
        left.plot(counts, [count * speeds[0] for count in counts], ":", color=line.get_color())
    left.set(
        xlabel="cores (dotted: in proportion)", ylabel="million evaluations a second", xticks=counts, ylim=(0, None)
    )
    for name in [name for name in sizes[0] if name not in ("side", "batch")]:
        right.plot(_SIDES, [row[name] for row in sizes], "o-", label=name)
    right.set(xscale="log", yscale="log", xlabel="side of the grid", ylabel="µs a grid, one core")
    right.set_xticks(_SIDES, [str(side) for side in _SIDES])
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    save(figure, file, dpi=130)
    print(f"plotted in {file}")


if __name__ == "__main__":
    leave(main())
