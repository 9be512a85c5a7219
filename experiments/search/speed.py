"""The speed of the kernels and of whole runs, beside the usual ways to write them, on one core and on more.

    python -m experiments.search.speed [--parts evaluation sizes ...] [--out results/benchmark.json]

Every repetition has new grids, because the processor's branch predictor learns a small batch that is timed twice. The
candidates take turns and the figures are medians, because the speed of a shared machine drifts. All but the searches on
several cores runs on one.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Grids = NDArray[np.int8]

# The run that is measured: the paper's MAP-Elites.
_PAPER: dict[str, Any] = {"preset": "paper", "fill": False, "generations": 200}

_SIDES = (8, 12, 16, 32, 64, 128, 256)


def main() -> None:
    options = _options()
    parts: dict[str, Callable[[], Any]] = {
        "evaluation": partial(evaluation, options.repetitions),
        "sizes": partial(sizes, options.repetitions),
        "corridors": partial(corridors, options.repetitions),
        "run": partial(whole_run, options.repetitions),
        "steps": partial(steps, options.repetitions),
        "cores": partial(cores, options.repetitions),
        "first_call": first_call,
        "memory": memory,
    }
    print(f"{len(_CORES)} cores, {platform.machine()}, Python {platform.python_version()}")
    record: dict[str, Any] = {
        "cores_here": len(_CORES),
        "machine": platform.machine(),
        "repetitions": options.repetitions,
    }
    for name in options.parts or parts:
        pin(1)
        record[name] = parts[name]()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(record, indent=2) + "\n")
    print(f"\nwritten to {options.out}")
    if "sizes" in record and "cores" in record:
        draw(record, options.out.with_suffix(".png"))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", nargs="+", metavar="NAME", help="of the JSON file; by default all")
    parser.add_argument("--repetitions", type=int, default=31, help="of each timing; by default 31")
    parser.add_argument("--out", type=Path, default=Path("results/benchmark.json"), help="a JSON file")
    return parser.parse_args()


_CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def pin(count: int) -> None:
    """Lets all threads of this process run on so many cores alone, where the system can do that."""
    if hasattr(os, "sched_setaffinity"):
        for thread in Path("/proc/self/task").iterdir():
            with suppress(ProcessLookupError):  # a thread that has ended since
                os.sched_setaffinity(int(thread.name), _CORES[:count])


def evaluation(repetitions: int) -> list[dict[str, Any]]:
    """Measures all metrics and the fitness of 12 x 12 grids: microseconds a grid by batch size."""
    from experiments.search.baselines import networkx_fitness, tarjan_fitness

    kernel, candidates = _evaluations()
    rows = []
    print("\nevaluation of 12 x 12 grids, all metrics and fitness\n")
    print(f"{'batch':>6} {'candidate':>15} {'µs a grid':>10} {'grids a second':>15} {'beside ours':>12}")
    for batch in (40, 512, 4096):
        check = fresh_grids(batch, (12, 12))
        expected = tarjan_fitness(check)
        assert (np.asarray(kernel(check)[0]) == expected).all()
        assert (networkx_fitness(check[:40]) == expected[:40]).all()
        medians = _in_turns(candidates, (12, 12), batch, repetitions)
        for name, median in medians.items():
            ratio = median / medians["elitelanes_jax"]
            rows.append({"batch": batch, "candidate": name, "us_per_grid": median * 1e6, "beside_ours": ratio})
            print(f"{batch:>6} {name:>15} {median * 1e6:>10.2f} {1 / median:>15,.0f} {ratio:>11.1f}x")
    return rows


def _evaluations() -> tuple[Callable[[Grids], Any], dict[str, Callable[[Grids], Any]]]:
    """Returns our compiled kernel, and all candidates by name: from grids ``[B, H, W]`` to their fitness or more."""
    import jax

    from elitelanes_jax import fitness, measure
    from experiments.search.baselines import cpp_fitness, networkx_fitness, tarjan_fitness

    def evaluate(grid: Any) -> Any:
        metrics = measure(grid)
        return fitness(metrics), metrics

    kernel = jax.jit(jax.vmap(evaluate))
    candidates: dict[str, Callable[[Grids], Any]] = {
        "elitelanes_jax": lambda grids: jax.block_until_ready(kernel(grids)),
        "numba": tarjan_fitness,
        "networkx": networkx_fitness,
    }
    compiled = cpp_fitness()
    return kernel, candidates if compiled is None else candidates | {"c++": compiled}


def _in_turns(
    candidates: dict[str, Callable[[Grids], Any]], shape: tuple[int, int], batch: int, repetitions: int
) -> dict[str, float]:
    """Returns the median seconds a grid of each candidate. NetworkX takes one grid at a time, and so a few suffice."""
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(repetitions):
        for name, candidate in candidates.items():
            share = max(20 * 144 // (shape[0] * shape[1]), 1) if name == "networkx" else batch
            candidate(fresh_grids(share, shape))  # the candidate before has left its own data in the caches
            seconds[name].append(timed(partial(candidate, fresh_grids(share, shape))) / share)
    return {name: float(np.median(values)) for name, values in seconds.items()}


def sizes(repetitions: int) -> list[dict[str, Any]]:
    """Measures all metrics and the fitness of square grids: microseconds a grid by side."""
    kernel, candidates = _evaluations()
    rows = []
    print("\nevaluation by size, µs a grid\n")
    print(f"{'side':>6} {'batch':>6} " + " ".join(f"{name:>15}" for name in candidates))
    for side in _SIDES:
        batch = min(max(2**19 // side**2, 8), 512)
        check = fresh_grids(batch, (side, side))
        fitness = np.asarray(kernel(check)[0])
        assert all((candidates[name](check) == fitness).all() for name in ("numba", "c++") if name in candidates)
        medians = _in_turns(candidates, (side, side), batch, max(repetitions // 4, 1))
        rows.append({"side": side, "batch": batch} | {name: median * 1e6 for name, median in medians.items()})
        print(f"{side:>6} {batch:>6} " + " ".join(f"{median * 1e6:>15,.1f}" for median in medians.values()))
    return rows


def corridors(repetitions: int) -> dict[str, float]:
    """Measures a batch with a 64 x 64 spiral, and its ratio to a batch of random grids."""
    import jax

    from elitelanes_jax import measure
    from experiments.search.corridors import spiral

    kernel = jax.jit(jax.vmap(measure))

    def evaluate(grids: Grids) -> None:
        jax.block_until_ready(kernel(grids))

    slow = spiral((64, 64))
    seconds: dict[str, list[float]] = {"random": [], "with a spiral": []}
    for repetition in range(repetitions // 2 + 1):
        for name, values in seconds.items():
            grids = fresh_grids(8, (64, 64))
            if name != "random":
                grids[repetition % 8] = slow
            spent = timed(partial(evaluate, grids))
            if repetition:  # the first one compiles
                values.append(spent)
    medians = {name: float(np.median(values)) / 8 * 1e6 for name, values in seconds.items()}
    ratio = medians["with a spiral"] / medians["random"]
    print(f"\n64 x 64: {medians['random']:.0f} µs a random grid; {ratio:.1f} times that with a spiral in the batch")
    return medians | {"ratio": ratio}


def whole_run(repetitions: int) -> list[dict[str, Any]]:
    """Measures 200 generations of 40 offspring of MAP-Elites at 12 x 12, one seed, after compilation."""
    import jax

    from elitelanes_jax import evolve
    from experiments.search.baselines import networkx_fitness, tarjan_map_elites

    tarjan_map_elites(0, 12, 12, 1)
    candidates: dict[str, Callable[[int], Any]] = {
        "elitelanes_jax": lambda seed: jax.block_until_ready(evolve(jax.random.key(seed), **_PAPER).elites),
        "numba": lambda seed: tarjan_map_elites(seed, 12, 12, 200),
    }
    candidates["elitelanes_jax"](0)
    seconds: dict[str, list[float]] = {name: [] for name in candidates}
    for seed in range(1, repetitions + 1):
        for name, candidate in candidates.items():
            seconds[name].append(timed(partial(candidate, seed)))
    medians = {name: float(np.median(values)) for name, values in seconds.items()}
    grids = fresh_grids(200, (12, 12))
    medians["networkx, evaluation alone"] = timed(partial(networkx_fitness, grids)) * 8000 / 200
    print("\nMAP-Elites, 200 generations of 40, 12 x 12, one seed\n")
    rows = []
    for name, median in medians.items():
        ratio = median / medians["elitelanes_jax"]
        rows.append({"candidate": name, "seconds": median, "beside_ours": ratio})
        print(f"{name:>30} {median:>9.4f} s {ratio:>9.1f}x")
    return rows


_SEEDS = 16


def _tuned(method: str, devices: int, generations: int) -> float:
    """Returns the seconds an evaluation that 16 seeds of a tuned method take on so many devices, once compiled."""
    from elitelanes_jax import evolve
    from elitelanes_jax.optimizers import seed_keys

    setting: dict[str, Any] = {"method": method, "preset": "tuned", "fill": True, "devices": devices}
    history = evolve(seed_keys(0, _SEEDS), generations=generations, progress=False, **setting).history
    return float(np.mean(1 / history.evaluations_per_second))


def steps(repetitions: int) -> dict[str, float]:
    """Measures a step of the tuned methods beside the evaluation of as many grids in one batch: µs a grid, one core."""
    candidates = _evaluations()[1]
    ours = {"evaluation": candidates["elitelanes_jax"]}
    methods = ("ea", "map-elites")
    seconds: dict[str, list[float]] = {name: [] for name in ("evaluation", *methods)}
    for repetition in range(repetitions // 4 + 2):
        for name, values in seconds.items():
            spent = _in_turns(ours, (12, 12), 512, 5)[name] if name in ours else _tuned(name, 1, 128)
            if repetition:  # the first one compiles
                values.append(spent)
    medians = {name: float(np.median(values)) * 1e6 for name, values in seconds.items()}
    print(f"\na step of the tuned methods, 12 x 12, {_SEEDS} seeds, one core\n")
    for name, median in medians.items():
        print(f"{name:>12} {median:>8.2f} µs an evaluation {median / medians['evaluation']:>6.1f}x")
    return medians


def cores(repetitions: int) -> list[dict[str, Any]]:
    """Measures 16 seeds of the tuned methods on 1, 2, 4 and all cores: µs an evaluation.

    Each number of cores has a process of its own, as JAX begins as many threads as a process has cores then.
    """
    rows = []
    counts = [count for count in sorted({1, 2, 4, len(_CORES)}) if count <= len(_CORES)]
    print(f"\n{_SEEDS} seeds of the tuned methods, 12 x 12, on several cores\n")
    with ExitStack() as stack:
        pools = {count: stack.enter_context(ProcessPoolExecutor(1, get_context("spawn"))) for count in counts}
        for count, pool in pools.items():
            pin(count)  # the process that starts now has these cores
            pool.submit(os.getpid).result()
        for method in ("ea", "map-elites"):
            seconds: dict[int, list[float]] = {count: [] for count in counts}
            for repetition in range(repetitions // 4 + 2):
                for count, values in seconds.items():
                    spent = pools[count].submit(_tuned, method, count, 384).result()
                    if repetition:  # the first one compiles
                        values.append(spent)
            medians = {count: float(np.median(values)) * 1e6 for count, values in seconds.items()}
            for count, median in medians.items():
                rows.append({"method": method, "cores": count, "us": median, "speedup": medians[1] / median})
                print(f"{method:>12} {count:>4} cores {median:>8.2f} µs an evaluation {medians[1] / median:>6.2f}x")
    return rows


_TUNED_CALL = """
import time
began = time.perf_counter()
import jax
from elitelanes_jax import evolve, use_compile_cache
imported = time.perf_counter()
use_compile_cache()
jax.block_until_ready(evolve(0, {arguments}, progress=False).elites)
spent = time.perf_counter() - imported
from pathlib import Path
status = Path("/proc/self/status")  # `resource` counts the process too that started this one
most = int(status.read_text().split("VmHWM:")[1].split()[0]) / 1024 if status.exists() else float("nan")
print(imported - began, spent, most)
"""


def _call_alone(cache: str, arguments: str) -> list[float]:
    """Returns seconds of the import and of a first `evolve` in a process of its own, and its most memory in MiB."""
    command = [sys.executable, "-c", _TUNED_CALL.format(arguments=arguments)]
    environment = os.environ | {"XDG_CACHE_HOME": cache}
    said = subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
    return [float(word) for word in said.split()]


def first_call() -> list[dict[str, Any]]:
    """Measures the first `evolve` in a process, and in a second process that finds the programs compiled."""
    pin(len(_CORES))
    print("\nimport, and the first call of evolve, all cores\n")
    rows = []
    for preset in ("paper", "tuned"):
        with tempfile.TemporaryDirectory() as cache:
            for state in ("nothing cached", "cached"):
                spent = _call_alone(cache, f"preset={preset!r}, generations=1")
                rows.append({"preset": preset, "state": state, "import": spent[0], "call": spent[1]})
                print(f"MAP-Elites, {preset}, {state:>14}: import {spent[0]:.1f} s, call {spent[1]:.1f} s")
    return rows


def memory() -> list[dict[str, float]]:
    """Measures the most memory of a process that runs the tuned MAP-Elites: MiB by seeds."""
    pin(len(_CORES))
    rows = []
    print()
    with tempfile.TemporaryDirectory() as cache:
        for seeds in (16, 64):
            _call_alone(cache, f"seeds={seeds}, generations=1")  # what the compiler takes is no matter of seeds
            rows.append({"seeds": seeds, "MiB": _call_alone(cache, f"seeds={seeds}, generations=256")[2]})
            print(f"{seeds} seeds: at most {rows[-1]['MiB']:,.0f} MiB")
    return rows


def draw(record: dict[str, Any], file: Path) -> None:
    """Plots the time an evaluation by cores, and the time a grid by its size."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained")
    for method in ("ea", "map-elites"):
        rows = [row for row in record["cores"] if row["method"] == method]
        counts = [row["cores"] for row in rows]
        (line,) = left.plot(counts, [1 / row["us"] for row in rows], "o-", label=f"{method}, tuned")
        left.plot(counts, [count / rows[0]["us"] for count in counts], ":", color=line.get_color())
    left.set(
        xlabel="cores (dotted: in proportion)", ylabel="million evaluations a second", xticks=counts, ylim=(0, None)
    )
    for name in [name for name in record["sizes"][0] if name not in ("side", "batch")]:
        right.plot(_SIDES, [row[name] for row in record["sizes"]], "o-", label=name)
    right.set(xscale="log", yscale="log", xlabel="side of the grid", ylabel="µs a grid, one core")
    right.set_xticks(_SIDES, [str(side) for side in _SIDES])
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    figure.savefig(file, dpi=130)
    print(f"plotted in {file}")


_random = np.random.default_rng(2026)


def fresh_grids(count: int, shape: tuple[int, int]) -> Grids:
    """Makes random grids such as a search starts with: tiles with two or more connections, matched."""
    codes = np.array([3, 5, 6, 7, 9, 10, 11, 12, 13, 14, 15], np.int8)[_random.integers(0, 11, (count, *shape))]
    east, south = codes[:, :, :-1] & 4 > 0, codes[:, :-1] & 2 > 0
    grids = np.zeros_like(codes)
    grids[:, :, :-1] |= np.where(east, 4, 0).astype(np.int8)
    grids[:, :, 1:] |= np.where(east, 1, 0).astype(np.int8)
    grids[:, :-1] |= np.where(south, 2, 0).astype(np.int8)
    grids[:, 1:] |= np.where(south, 8, 0).astype(np.int8)
    return grids


def timed(call: Callable[[], Any]) -> float:
    began = time.perf_counter()
    call()
    return time.perf_counter() - began


if __name__ == "__main__":
    main()
