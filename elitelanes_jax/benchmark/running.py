"""Runs a user's search on a task, and keeps its archive at every budget."""

from collections.abc import Callable, Generator, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.benchmark.submissions import LEAST_RUNS, Submission, measure_grids
from elitelanes_jax.benchmark.tasks import BUDGETS, Task, find_task


class Measured(NamedTuple):
    """What a search receives for the grids ``[B, H, W]`` that it yields.

    Attributes:
      fitness: int32 ``[B]``, lower is better.
      cyclomatic: int32 ``[B]``, the niche.
      counts: bool ``[B]``, whether the grid is flawless, and filled if the task requires it. Other grids score nothing.
    """

    fitness: Int[np.ndarray, " B"]
    cyclomatic: Int[np.ndarray, " B"]
    counts: Bool[np.ndarray, " B"]


Search = Callable[[Task, np.random.Generator], Generator[AnyArray, Measured, None]]
"""A search: yields batches of grids ``[B, H, W]``, and receives a `Measured` for each batch."""


def run(task: Task | str, search: Search, seeds: int | Iterable[int] = LEAST_RUNS) -> Submission:
    """Runs a search once for each seed, and keeps the best counting grid of each niche at every budget.

    Args:
      task: to run, or its name.
      search: a generator function; see `Search`. It is stopped when the task's evaluations are spent. If a batch
        exceeds a budget, only its first grids count for this budget.
      seeds: their number, or the seeds of NumPy's generators. A submission needs 10 or more.

    Raises:
      InputError: for an unknown task, a search that is no generator, or grids of another shape or with other codes.
    """
    task = task if isinstance(task, Task) else find_task(task)
    listed = seeds if isinstance(seeds, Iterable) else range(check_named("seeds", whole(1), seeds))
    begun = (search(task, np.random.default_rng(seed)) if callable(search) else search for seed in listed)
    runs = [_run(task, one) for one in begun]
    return Submission(task, *(np.stack(arrays) for arrays in zip(*runs, strict=True)))


def _run(task: Task, search: Generator[AnyArray, Measured, None]) -> tuple[np.ndarray, ...]:
    budgets = [budget for budget in BUDGETS if budget <= task.evaluations]
    if not isinstance(search, Generator):
        raise InputError(f"search: expected a generator function, which yields grids, got {shorten(repr(search))}")
    most = task.shape[0] * task.shape[1]
    grids, fitness = np.zeros((most, *task.shape), np.int8), np.full(most, np.iinfo(np.int32).max)
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    spent, batch = 0, next(search, None)
    while batch is not None and len(kept) < len(budgets):
        codes = _check(task, batch)
        counts = measure_grids(codes)
        counts["flawless"] &= (not task.fill) | (counts["empty_cells"] == 0)
        for index, (code, value, niche, good) in enumerate(
            zip(codes, *(counts[name] for name in ("fitness", "cyclomatic", "flawless")), strict=True), start=1
        ):
            if good and value < fitness[niche]:
                grids[niche], fitness[niche] = code, value
            if len(kept) < len(budgets) and spent + index == budgets[len(kept)]:
                kept.append((grids.copy(), fitness.copy()))
        spent += len(codes)
        try:
            batch = search.send(Measured(counts["fitness"], counts["cyclomatic"], counts["flawless"]))
        except StopIteration:
            batch = None
    search.close()
    kept += [(grids, fitness)] * (len(budgets) - len(kept))
    niches = np.broadcast_to(np.arange(most), (len(budgets), most))
    return np.stack([one for one, _ in kept]), np.stack([one for _, one in kept]), niches


def _check(task: Task, batch: AnyArray) -> Int8[np.ndarray, "B H W"]:
    codes = np.asarray(batch)
    if codes.ndim != 3 or codes.shape[1:] != task.shape or not len(codes) or codes.dtype.kind not in "iu":
        shape = f"[B, {task.shape[0]}, {task.shape[1]}]"
        raise InputError(f"search: expected grids {shape} of whole numbers, got {codes.dtype} {list(codes.shape)}")
    if not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError(f"search: expected tile codes 0 to 15, got {codes.min()} to {codes.max()}")
    return codes.astype(np.int8)
