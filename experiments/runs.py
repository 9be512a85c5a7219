"""Runs of one method with many seeds, and what each came to."""

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

from elitelanes_jax import evolve, fitness, measure
from elitelanes_jax.metrics import COUNTED
from elitelanes_jax.search import Result, preset_config, seed_keys
from elitelanes_jax.wfc import generate

__all__ = ["METHODS", "OFFSPRING", "Runs", "kept_runs", "run_method"]

METHODS = ("ea", "map-elites", "pso", "gwo", "wfc")

# All methods of a search evaluate so many grids a generation.
OFFSPRING = 40

Row = dict[str, Any]


class Runs(NamedTuple):
    """What one method came to.

    Attributes:
      rows: a table by column names. `elite` says which grid of a run a row is about: "best", for MAP-Elites also
        "random" (an elite drawn at random) and "archive" (means over all elites, with niches and QD score).
      best: codes ``[S][H][W]``, the best grid of each seed.
      timing: seconds by what was timed.
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
) -> Runs:
    """Runs a method with seeds 0, 1, ... of `seed`, each the same however many there are.

    Args:
      method: one of `METHODS`. WFC makes one grid a seed, and takes of the reading the weights alone; a seed whose
        attempts all fail has no row.
      shape: (height, width).
      seeds: how many runs.
      seed: what they all follow from.
      generations: of a search, 40 grids each.
      reading: of the paper.
      alone: whether to time one seed alone as well, compiled apart.
    """
    if method == "wfc":
        return _collapse(shape, seeds, seed, reading)
    keys = seed_keys(seed, seeds)
    config = reading.configs.get(method, preset_config(method, "paper"))
    settings: dict[str, Any] = {"method": method, "config": config, "weights": reading.weights, "fill": reading.fill}

    began = time.perf_counter()
    result = evolve(keys, shape, generations=generations, **settings)
    best = np.asarray(result.best())
    total = time.perf_counter() - began
    working = _working_seconds(result)
    timing = {"all seeds": working, "a seed among them": working / seeds, "first call, compiling": total}
    if alone:
        evolve(keys[0], shape, generations=1, **settings)
        timing["a seed alone"] = float(
            np.median([_working_seconds(evolve(one, shape, generations=generations, **settings)) for one in keys[:5]])
        )
    rows = []
    for number in range(seeds):
        mine = jax.tree.map(lambda array, number=number: np.asarray(array[number]), result.elites)
        held = np.flatnonzero(mine.valid)
        figures = {name: getattr(mine.metrics, name) for name in (*COUNTED, "coverage")} | {"fitness": mine.fitness}
        first = held[np.argmin(mine.fitness[held])]
        chosen: dict[str, Any] = {"best": first}
        if method == "map-elites":
            chosen["random"] = held[np.random.default_rng([seed, number]).integers(held.size)]
            chosen["archive"] = held
        for elite, places in chosen.items():
            row = {"method": method, "elite": elite, "height": shape[0], "width": shape[1], "seed": number}
            row |= {name: float(values[places].mean()) for name, values in figures.items()}
            if elite == "archive":
                # Each elite counts by how far it lies below a grid of dead ends: larger is better.
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
    """The fields of `Runs` that a file holds, or, where there is none yet, of runs made now and kept in it."""
    numbers = options.seeds, options.seed, options.generations
    return kept(file, lambda: run_method(method, shape, *numbers, reading, alone=alone)._asdict())


def _working_seconds(result: Result) -> float:
    """What the generations took by the clock, compilation aside."""
    history = result.history
    seeds = 1 if history.best_fitness.ndim == 1 else len(history.best_fitness)
    return float((OFFSPRING * seeds / history.evaluations_per_second).sum())


def _collapse(shape: tuple[int, int], seeds: int, seed: int, reading: Reading) -> Runs:
    grids, seconds, succeeded = [], [], []
    generate(np.random.default_rng(seed), (2, 2))  # its tables are made once
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
