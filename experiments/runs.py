"""Runs of one method with many seeds, and their results."""

import argparse
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from readings import Reading
from results_folder import kept
from tqdm import tqdm

from elitelanes_jax import SearchSpec, evolve, fitness, measure
from elitelanes_jax.network import COUNT_NAMES
from elitelanes_jax.network.wfc import generate
from elitelanes_jax.optimizers import PRESETS, seed_keys

__all__ = ["METHODS", "OFFSPRING", "Runs", "kept_runs", "run_method"]

METHODS = ("ea", "map-elites", "pso", "gwo", "wfc")

# Every search evaluates this number of grids a generation.
OFFSPRING = 40

Row = dict[str, Any]


class Runs(NamedTuple):
    """The results of one method.

    Attributes:
      rows: a table by column names. The column `elite` says which grid of a run the row describes: "best", for
        MAP-Elites also "random" (an elite drawn at random) and "archive" (means over all elites, with the number of
        filled niches and the QD score).
      best: codes ``[S][H][W]``, the best grid of each seed.
      timing: seconds, by the name of the measurement.
    """

    rows: list[Row]
    best: list[list[list[int]]]
    timing: dict[str, float]


def run_method(
    method: str,
    shape: tuple[int, int],
    seeds: int,
    seed: int,
    generations: int,
    reading: Reading,
    *,
    alone: bool = True,
    archive: Path | None = None,
) -> Runs:
    """Runs a method with seeds 0, 1, ... of `seed`; a run does not depend on their number.

    Args:
      method: one of `METHODS`. WFC makes one grid for each seed and uses only the weights of the reading; a seed whose
        attempts all fail has no row.
      shape: (height, width).
      seeds: the number of runs.
      seed: the seed that all runs follow from.
      generations: of a search, 40 grids each.
      reading: of the paper.
      alone: whether to time one seed alone as well, which is compiled separately.
      archive: file to keep all elites of a search in, to be explored.
    """
    if method == "wfc":
        return _collapse(shape, seeds, seed, reading)
    keys = seed_keys(seed, seeds)
    config = reading.configs.get(method, PRESETS[method, "paper"])
    spec = SearchSpec(method=method, preset="paper", fill=reading.fill, generations=generations)
    spec = spec.replace(weights=reading.weights)

    began = time.perf_counter()
    result = evolve(keys, shape, spec=spec, config=config)
    best = np.asarray(result.best())
    total = time.perf_counter() - began
    if archive is not None:
        result.save(archive, state=False, seed=seed)
    working = result.history.seconds
    timing = {"all seeds": working, "a seed among them": working / seeds, "first call, compiling": total}
    if alone:
        evolve(keys[0], shape, spec=spec.replace(generations=1), config=config)  # compiles
        singles = [evolve(one, shape, spec=spec, config=config).history.seconds for one in keys[:5]]
        timing["a seed alone"] = float(np.median(singles))
    rows = []
    for number in range(seeds):
        mine = jax.tree.map(lambda array, number=number: np.asarray(array[number]), result.elites)
        held = np.flatnonzero(mine.valid)
        figures = {name: getattr(mine.metrics, name) for name in (*COUNT_NAMES, "coverage")} | {"fitness": mine.fitness}
        first = held[np.argmin(mine.fitness[held])]
        chosen: dict[str, Any] = {"best": first}
        if method == "map-elites":
            chosen["random"] = held[np.random.default_rng([seed, number]).integers(held.size)]
            chosen["archive"] = held
        for elite, places in chosen.items():
            row = {"method": method, "elite": elite, "height": shape[0], "width": shape[1], "seed": number}
            row |= {name: float(values[places].mean()) for name, values in figures.items()}
            if elite == "archive":
                # An elite's score is its distance below the fitness of a grid of dead ends: larger is better.
                row |= {
                    "niches": int(held.size),
                    "qd_score": int((480 * shape[0] * shape[1] - mine.fitness[held]).sum()),
                }
            rows.append(row | {"seconds": timing["a seed among them"]})
    return Runs(rows, best.tolist(), timing)


def kept_runs(
    file: Path,
    method: str,
    shape: tuple[int, int],
    options: argparse.Namespace,
    reading: Reading,
    *,
    alone: bool = False,
) -> dict[str, Any]:
    """Returns the fields of `Runs` from a file. If it does not exist, the method is run and the file written.

    Where a seed is timed alone, the elites are kept beside it, in ``.npz``.
    """
    numbers = options.seeds, options.seed, options.generations
    archive = file.with_suffix(".npz") if alone else None
    return kept(file, lambda: run_method(method, shape, *numbers, reading, alone=alone, archive=archive)._asdict())


def _collapse(shape: tuple[int, int], seeds: int, seed: int, reading: Reading) -> Runs:
    grids, seconds, succeeded = [], [], []
    generate(np.random.default_rng(seed), (2, 2))  # makes its tables, once
    for number in tqdm(range(seeds), desc=f"wfc {shape[0]}x{shape[1]}", delay=1, disable=None):
        began = time.perf_counter()
        collapsed = generate(np.random.default_rng([seed, number]), shape)
        seconds.append(time.perf_counter() - began)
        grids.append(collapsed.grid)
        succeeded.append(collapsed.success)
    metrics = jax.vmap(measure)(jnp.asarray(np.array(grids)))
    figures = {name: np.asarray(values) for name, values in metrics._asdict().items()}
    figures["fitness"] = np.asarray(fitness(metrics, reading.weights))
    rows = [
        {"method": "wfc", "elite": "best", "height": shape[0], "width": shape[1], "seed": number}
        | {name: float(values[number]) for name, values in figures.items()}
        | {"seconds": seconds[number]}
        for number in np.flatnonzero(succeeded).tolist()
    ]
    median = float(np.median(seconds))
    timing = {"all seeds": sum(seconds), "a seed among them": median, "a seed alone": median}
    return Runs(rows, np.array(grids).tolist(), timing)
