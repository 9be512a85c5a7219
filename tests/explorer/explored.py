"""Runs to be explored."""

import numpy as np

from elitelanes_jax import Result
from elitelanes_jax.cli.main import main
from elitelanes_jax.network.counts import Metrics
from elitelanes_jax.problem.descriptor import paper_axes
from elitelanes_jax.result import History, MeasuredElites, RunState
from elitelanes_jax.spec import SearchSpec

__all__ = ["big_result", "write_run"]

_LINE = "generate --size 5 6 --seeds 3 --maps 3 --generations 5 --method ea --preset paper --tile-px 16 --quiet --out"


def write_run(folder):
    """The folder of a small run."""
    assert main([*_LINE.split(), str(folder)]) == 0
    return folder


def big_result():
    """32 seeds with 400 niches of 12 x 12: random codes, which pack worst."""
    shape = (32, 400)
    grids = np.random.default_rng(0).integers(0, 16, (*shape, 12, 12), np.int8)
    zeros = np.zeros(shape, np.int32)
    metrics = Metrics(*[zeros] * 19, zeros.astype(np.float32))
    elites = MeasuredElites(grids, zeros, np.zeros((*shape, 5), np.int32), np.ones(shape, bool), metrics, {})
    steps = np.arange(1, 501)
    history = History(steps, steps * 40, np.zeros((32, 500), np.int32), np.zeros((32, 500), np.int32), steps * 1.0)
    state = RunState(np.array(0, np.int32), None, np.array(0, np.uint32))
    return Result(elites, history, state, SearchSpec(), paper_axes((12, 12)))
