"""Runs to be explored."""

import os
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax import Metrics, Result, SearchSpec
from elitelanes_jax.cli.main import main
from elitelanes_jax.network import plain_measure
from elitelanes_jax.network.plain_metrics import plain_town
from elitelanes_jax.network.records import METRIC_NAMES
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.problem.descriptor import paper_axes
from elitelanes_jax.search import History, MeasuredElites
from elitelanes_jax.search.records import RunState
from elitelanes_jax.search.resolve import resolve

__all__ = ["IN_BROWSER", "big_result", "float_result", "own_result", "write_run"]

PACKAGES = Path(__file__).parents[2] / "explorer" / "node_modules"
CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
IN_BROWSER = pytest.mark.skipif(
    not (PACKAGES / "playwright-core").is_dir() or not Path(CHROMIUM).exists() or shutil.which("node") is None,
    reason="the browser's tests need make explorer and chromium",
)

_LINE = "generate --size 5 6 --seeds 3 --maps 3 --generations 5 --method ea --preset paper --tile-px 16 --quiet --out"


def write_run(folder):
    """The folder of a small run."""
    assert main([*_LINE.split(), str(folder)]) == 0
    return folder


def own_result():
    """2 seeds with 20 maps of 6 x 6, and features beside the metrics: two of towns, and one of a search's own."""
    grids = generate_batch(np.random.default_rng(3), 40, (6, 6), border="closed").grid.astype(np.int8)
    for number, grid in enumerate(grids):
        grid[:, 6 - number % 4 :] = 0
        grid[: number % 3, :2] = 0
    measures = [plain_measure(grid) | plain_town(grid) | {"corners": int((grid == 6).sum())} for grid in grids]
    spec = SearchSpec(
        features=["corners"],
        axes=["symmetry:5", "corners:4:2", "box_length:3"],
        weights={"symmetry": -3, "corners": 50},
    )
    values = {name: np.array([one[name] for one in measures]).reshape(2, 20) for name in measures[0]}
    features = {name: values[name].astype(np.int32) for name in ("symmetry", "corners", "box_length")}
    search = resolve(spec, (6, 6))
    weights = search.weights._asdict() | dict(search.settings.weights)
    names = (*METRIC_NAMES, *dict(search.settings.weights))
    fitness = sum(weights[name] * values[name] for name in names) - weights["components"]
    metrics = Metrics(*[values[name] for name in Metrics._fields])
    descriptor = np.stack([features[axis.metric] for axis in search.axes], axis=-1)
    elites = MeasuredElites(
        grids.reshape(2, 20, 6, 6), fitness.astype(np.int32), descriptor, np.ones((2, 20), bool), metrics, features
    )
    state = RunState(np.array(0, np.int32), None, np.array(0, np.uint32))
    return Result(elites, History.empty(2), state, search)


def float_result():
    """The maps of `own_result`, with a float fitness from -3 to 1."""
    result = own_result()
    fitness = np.random.default_rng(1).uniform(-3, 1, result.elites.fitness.shape).astype(np.float32)
    return replace(result, elites=result.elites._replace(fitness=fitness))


def big_result():
    """32 seeds with 400 niches of 12 x 12: random codes, which pack worst."""
    shape = (32, 400)
    grids = np.random.default_rng(0).integers(0, 16, (*shape, 12, 12), np.int8)
    zeros = np.zeros(shape, np.int32)
    bins = np.stack(np.unravel_index(np.arange(400), (25, 2, 2, 2, 2)), axis=-1)
    axes = paper_axes((12, 12))
    niches = bins * [axis.width for axis in axes] + [axis.start for axis in axes]
    descriptor = np.broadcast_to(niches, (*shape, 5)).astype(np.int32)
    metrics = Metrics(*[zeros] * 19, zeros.astype(np.float32))
    elites = MeasuredElites(grids, zeros, descriptor, np.ones(shape, bool), metrics, {})
    steps, counts = np.arange(1, 501), np.zeros((32, 500), np.int32)
    history = History(steps, steps * 40, counts, counts, steps * 1.0, counts)
    state = RunState(np.array(0, np.int32), None, np.array(0, np.uint32))
    return Result(elites, history, state, replace(resolve(SearchSpec(), (12, 12)), axes=axes))
