"""The speed of the kernels and of a whole run, beside the usual ways to write them, on the same cores.

    python experiments/benchmark.py [--cores 1] [--out results/benchmark.json]

Every repetition has new grids, because the processor's branch predictor learns a small batch that is timed twice. The
candidates take turns and the figures are medians, because the speed of a shared machine drifts.
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
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Grids = NDArray[np.int8]

# The run that is measured: the paper's MAP-Elites.
_PAPER: dict[str, Any] = {"preset": "paper", "fill": False, "generations": 200}


def main() -> None:
    options = _options()
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))[: options.cores]
        os.sched_setaffinity(0, cores)  # before JAX counts them
    print(f"{options.cores} of {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}\n")
    record: dict[str, Any] = {"cores": options.cores, "machine": platform.machine(), "repetitions": options.repetitions}
    record["evaluation"] = evaluation(options.repetitions)
    record["corridors"] = corridors(options.repetitions)
    record["run"] = whole_run(options.repetitions)
    record["first_call"] = first_call()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(record, indent=2) + "\n")
    print(f"\nwritten to {options.out}")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cores", type=int, default=1, help="number of cores that the process may use; by default 1")
    parser.add_argument("--repetitions", type=int, default=31, help="of each timing; by default 31")
    parser.add_argument("--out", type=Path, default=Path("results/benchmark.json"), help="a JSON file")
    return parser.parse_args()


def evaluation(repetitions: int) -> list[dict[str, Any]]:
    """Measures all metrics and the fitness of 12 x 12 grids: microseconds a grid by batch size."""
    import jax
    from yardsticks import networkx_fitness, tarjan_fitness

    from elitelanes_jax import fitness, measure

    def evaluate(grid: Any) -> Any:
        metrics = measure(grid)
        return fitness(metrics), metrics

    kernel = jax.jit(jax.vmap(evaluate))
    candidates: dict[str, Callable[[Grids], Any]] = {
        "elitelanes_jax": lambda grids: jax.block_until_ready(kernel(grids)),
        "numba": tarjan_fitness,
        "networkx": networkx_fitness,
    }
    rows = []
    print("evaluation of 12 x 12 grids, all metrics and fitness\n")
    print(f"{'batch':>6} {'candidate':>15} {'µs a grid':>10} {'grids a second':>15} {'beside ours':>12}")
    for batch in (40, 512, 4096):
        check = fresh_grids(batch, (12, 12))
        expected = tarjan_fitness(check)
        assert (np.asarray(kernel(check)[0]) == expected).all()
        assert (networkx_fitness(check[:40]) == expected[:40]).all()
        seconds: dict[str, list[float]] = {name: [] for name in candidates}
        for _ in range(repetitions):
            for name, candidate in candidates.items():
                share = (
                    20 if name == "networkx" else batch
                )  # it takes one grid at a time: a larger batch would show the same
                candidate(fresh_grids(share, (12, 12)))  # the candidate before has left its own data in the caches
                grids = fresh_grids(share, (12, 12))
                seconds[name].append(timed(partial(candidate, grids)) / share)
        medians = {name: float(np.median(values)) for name, values in seconds.items()}
        for name, median in medians.items():
            ratio = median / medians["elitelanes_jax"]
            rows.append({"batch": batch, "candidate": name, "us_per_grid": median * 1e6, "beside_ours": ratio})
            print(f"{batch:>6} {name:>15} {median * 1e6:>10.2f} {1 / median:>15,.0f} {ratio:>11.1f}x")
    return rows


def corridors(repetitions: int) -> dict[str, float]:
    """Measures a batch with a 64 x 64 spiral, and its ratio to a batch of random grids."""
    import jax
    from corridors import spiral

    from elitelanes_jax import measure

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
    from yardsticks import networkx_fitness, tarjan_map_elites

    from elitelanes_jax import evolve

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


def first_call() -> dict[str, float]:
    """Measures the first `evolve` in a process, and in a second process that finds the programs compiled."""
    program = (
        "import time, jax\n"
        "from elitelanes_jax import evolve\n"
        "from elitelanes_jax.compile_cache import use_compile_cache\n"
        "use_compile_cache()\n"
        "key = jax.block_until_ready(jax.random.key(1))\n"
        "began = time.perf_counter()\n"
        f"jax.block_until_ready(evolve(key, **{_PAPER}).elites)\n"
        "print(time.perf_counter() - began)\n"
    )
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"XDG_CACHE_HOME": cache}
        first, second = (
            float(subprocess.run([sys.executable, "-c", program], env=environment, check=True, stdout=-1).stdout)
            for _ in range(2)
        )
    print(f"\nfirst call of evolve: {first:.2f} s, compilation included; {second:.2f} s in the next process")
    return {"compiling": first, "with_cache": second}


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
