"""Runs a user's search on a task, and keeps its archive at every budget."""

from collections.abc import Callable, Generator, Iterable

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    function_of,
    is_whole,
    unmasked,
    whole,
)
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.benchmark.measuring import Measured, measure_grids
from elitelanes_jax.benchmark.submissions import LEAST_RUNS, Submission
from elitelanes_jax.benchmark.tasks import Task, find_task

SearchFunction = Callable[[Task, np.random.Generator], Generator[AnyArray, Measured, None]]
"""A search: yields batches of grids ``[B, H, W]``, and receives a `Measured` for each batch."""

# Stands for the batch of a search that has ended.
_ENDED = object()


@name_wrong_arguments
def run_task(
    task: Task | str, search: SearchFunction, seeds: int | Iterable[int] = LEAST_RUNS
) -> Submission:
    """Runs a search once for each seed, and keeps the best grid of each niche at every budget.

    The best grid has the fewest flaws, and among these the lowest fitness. The first of equal grids
    is kept.

    Args:
      task: the task to run, or its name.
      search: a generator function; see `SearchFunction`. It is stopped when the task's evaluations
        are spent. If a batch exceeds a budget, only its first grids count for this budget.
      seeds: their number, or the seeds of NumPy's generators. A submission needs 10 or more.

    Raises:
      InputError: for an unknown task, a search that is no generator, or grids of another shape or
        with other codes.
    """
    task = task if isinstance(task, Task) else find_task(task)
    numbers = _check_seeds(seeds)
    if not callable(search):
        raise InputError(
            "search", "a generator function, which yields grids", shorten(repr(search))
        )
    # Otherwise a function of other arguments would raise a `TypeError` that does not name `search`.
    check_named("search", function_of("task", "generator"), search)
    runs = [_run_seed(task, search(task, np.random.default_rng(seed))) for seed in numbers]
    return Submission(task, np.stack(runs))


def _check_seeds(seeds: int | Iterable[int]) -> list[int]:
    """Returns the seeds: those given, or as many as a number says."""
    if hasattr(seeds, "tolist"):
        # An array without axes becomes a number.
        seeds = seeds.tolist()
    numbers = (
        list(seeds)
        if isinstance(seeds, Iterable)
        else list(range(check_named("seeds", whole(1), seeds)))
    )
    if not numbers or any(not is_whole(seed) or seed < 0 for seed in numbers):
        raise InputError("seeds", "a number or several, 0 or more", shorten(repr(seeds)))
    # Equal seeds give equal runs, which would narrow the intervals of the scores.
    check_unique("seeds", "seed", map(str, numbers))
    return numbers


def _run_seed(task: Task, search: UserValue) -> Int8[np.ndarray, "T N H W"]:
    """Returns the archive after each budget: the best grid of each cyclomatic number."""
    # A function that returns its grids instead of yielding them would receive no measurements.
    if not isinstance(search, Generator):
        raise InputError(
            "search", "a generator function, which yields grids", shorten(repr(search))
        )
    budgets = task.budgets
    archive = _Archive(task)
    at_budgets: list[Int8[np.ndarray, "N H W"]] = []
    spent, batch = 0, next(search, _ENDED)
    while batch is not _ENDED and len(at_budgets) < len(budgets):
        codes = _check(task, batch)
        measured = measure_grids(codes, fill=task.fill)
        # The grids are counted one at a time, because a budget may be spent within a batch.
        for number in range(len(codes)):
            archive.insert(codes[number], measured, number)
            # Every grid is an evaluation, also a flawed one or one that came already.
            spent += 1
            if len(at_budgets) < len(budgets) and spent == budgets[len(at_budgets)]:
                # The archive changes with the next grid, so a copy is kept.
                at_budgets.append(archive.grids.copy())
        try:
            batch = search.send(measured)
        except StopIteration:
            batch = _ENDED
    search.close()
    while len(at_budgets) < len(budgets):
        # The search ended before it had spent its budget.
        at_budgets.append(archive.grids)
    return np.stack(at_budgets)


class _Archive:
    """The best grid of each cyclomatic number.

    The best grid has the fewest flaws, and among these the lowest fitness.
    """

    def __init__(self, task: Task) -> None:
        # Linked tiles form fewer loops than there are tiles, so every cyclomatic number is an
        # index.
        niches = task.shape[0] * task.shape[1]
        self.grids = np.zeros((niches, *task.shape), np.int8)
        # The flaws and the fitness of each niche's grid.
        self._ranks = [(np.inf, np.inf)] * niches

    def insert(self, codes: Int8[np.ndarray, "H W"], measured: Measured, number: int) -> None:
        """Keeps a grid if it is better than its niche's.

        `measured` has the figures of the grid's batch, in which it is at index `number`.
        """
        niche = measured.cyclomatic[number]
        rank = (measured.flaws[number], measured.fitness[number])
        # Of equal ranks the first stays.
        if rank < self._ranks[niche]:
            self.grids[niche], self._ranks[niche] = codes, rank


def _check(task: Task, batch: UserValue) -> Int8[np.ndarray, "B H W"]:
    check_named("search", unmasked, batch)
    try:
        codes = np.asarray(batch)
    except ValueError as error:
        raise InputError("search", "an array of grids", shorten(str(error))) from None
    if (
        codes.ndim != 3
        or codes.shape[1:] != task.shape
        or not len(codes)
        or codes.dtype.kind not in "iu"
    ):
        shape = f"[B, {task.shape[0]}, {task.shape[1]}]"
        raise InputError(
            "search", f"grids {shape} of whole numbers", f"{codes.dtype} {list(codes.shape)}"
        )
    # Codes are checked before the conversion to int8, in which larger ones would overflow.
    if not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError("search", "tile codes 0 to 15", f"{codes.min()} to {codes.max()}")
    return codes.astype(np.int8)
