"""Runs one method with many seeds, and measures the grids that it finds."""

import time
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from elitelanes_jax import SearchSpec, evolve, fitness, measure
from elitelanes_jax.network import Metrics
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.optimizers import PRESETS, seed_keys
from experiments.common import kept
from experiments.paper.readings import Reading

__all__ = ["METHODS", "Row", "Runs", "Settings", "kept_runs", "run_method"]

METHODS = ("ea", "map-elites", "pso", "gwo", "wfc")


class Settings(NamedTuple):
    """What runs of a method have in common.

    Attributes:
      seeds: number of runs. A run does not depend on it.
      seed: the random seed of all runs.
      generations: generations of a search, of 40 grids each.
      reading: of the paper. WFC uses only its weights.
    """

    seeds: int
    seed: int
    generations: int
    reading: Reading


class Row(NamedTuple):
    """Measurements of one run.

    Attributes:
      method: one of `METHODS`.
      elite: the grid that the values describe: "best", or of MAP-Elites "random" (an elite drawn at random) and
        "archive" (means over all elites).
      height: rows of the grid.
      width: columns of the grid.
      seed: index of the run.
      values: metrics, "fitness" and "seconds" by name; of an archive also "niches", the number of filled niches, and
        "qd_score".
    """

    method: str
    elite: str
    height: int
    width: int
    seed: int
    values: dict[str, float]

    def flat(self) -> dict[str, str | float]:
        """Returns the row of a table, by the names of its columns."""
        return {name: value for name, value in self._asdict().items() if name != "values"} | self.values


class Runs(NamedTuple):
    """The results of one method.

    Attributes:
      rows: of all runs. A run of WFC whose attempts all failed has no row.
      best: codes ``[S][H][W]``, the best grid of each seed.
      timing: seconds, by the name of the measurement.
    """

    rows: list[Row]
    best: list[list[list[int]]]
    timing: dict[str, float]


def run_method(method: str, shape: tuple[int, int], settings: Settings, *, alone: bool) -> Runs:
    """Runs a method with many seeds in one call. WFC makes one grid for each seed.

    Args:
      method: one of `METHODS`.
      shape: (height, width).
      settings: of the runs.
      alone: whether to time also one seed alone, which is compiled separately.
    """
    if method == "wfc":
        return _collapse(shape, settings)
    seeds, seed, generations, reading = settings
    keys = seed_keys(seed, seeds)
    config = reading.configs.get(method, PRESETS[method, "paper"])
    spec = SearchSpec(method=method, preset="paper", fill=reading.fill)
    search = partial(evolve, shape=shape, spec=spec, config=config, weights=reading.weights)

    began = time.perf_counter()
    result = search(keys, generations=generations)
    best = np.asarray(result.best())
    total = time.perf_counter() - began
    working = result.history.seconds
    timing = {"all seeds": working, "a seed among them": working / seeds, "first call, compiling": total}
    if alone:
        search(keys[0], generations=1)  # compiles
        singles = [search(one, generations=generations) for one in keys[:5]]
        timing["a seed alone"] = float(np.median([single.history.seconds for single in singles]))
    rows = []
    for index in range(seeds):
        elites = jax.tree.map(lambda array, index=index: np.asarray(array[index]), result.elites)
        filled = np.flatnonzero(elites.valid)
        columns = elites.metrics._asdict() | {"fitness": elites.fitness}
        chosen = {"best": filled[[np.argmin(elites.fitness[filled])]]}
        if method == "map-elites":
            drawn = np.random.default_rng([seed, index]).integers(filled.size)
            chosen |= {"random": filled[[drawn]], "archive": filled}
        for elite, slots in chosen.items():
            values = {name: float(columns[name][slots].mean()) for name in (*Metrics._fields, "fitness")}
            if elite == "archive":
                # An elite's score is the distance of its fitness from that of a grid of dead ends: larger is better.
                score = (480 * shape[0] * shape[1] - elites.fitness[filled]).sum()
                values |= {"niches": int(filled.size), "qd_score": int(score)}
            rows.append(Row(method, elite, *shape, index, values | {"seconds": timing["a seed among them"]}))
    return Runs(rows, best.tolist(), timing)


def kept_runs(file: Path, method: str, shape: tuple[int, int], settings: Settings, *, alone: bool = False) -> Runs:
    """Returns runs from a file. If the file does not exist, runs the method and writes it."""
    rows, best, timing = kept(file, lambda: run_method(method, shape, settings, alone=alone))
    return Runs([Row(*row) for row in rows], best, timing)


def _collapse(shape: tuple[int, int], settings: Settings) -> Runs:
    grids, seconds, succeeded = [], [], []
    generate_batch(np.random.default_rng(settings.seed), 1, (2, 2))  # makes its tables, once
    for index in tqdm(range(settings.seeds), desc=f"wfc {shape[0]}x{shape[1]}", delay=1, disable=None):
        began = time.perf_counter()
        collapsed = generate_batch(np.random.default_rng([settings.seed, index]), 1, shape)
        seconds.append(time.perf_counter() - began)
        grids.append(collapsed.grid[0])
        succeeded.append(collapsed.success[0])
    metrics = jax.vmap(measure)(jnp.asarray(np.array(grids)))
    columns = {name: np.asarray(values) for name, values in metrics._asdict().items()}
    columns["fitness"] = np.asarray(fitness(metrics, settings.reading.weights))
    rows = []
    for index in np.flatnonzero(succeeded).tolist():
        values = {name: float(column[index]) for name, column in columns.items()}
        rows.append(Row("wfc", "best", *shape, index, values | {"seconds": seconds[index]}))
    median = float(np.median(seconds))
    timing = {"all seeds": sum(seconds), "a seed among them": median, "a seed alone": median}
    return Runs(rows, np.array(grids).tolist(), timing)
