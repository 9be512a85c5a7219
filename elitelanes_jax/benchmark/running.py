"""Runs a user's search on a task or on several, and keeps its archives at every budget."""

from collections.abc import Callable, Generator, Iterable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int, Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    function_of,
    is_whole,
    listed,
    whole,
)
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.benchmark.submissions import LEAST_RUNS, Submission, measure_grids
from elitelanes_jax.benchmark.tasks import BUDGETS, Task, find_task


class Measured(NamedTuple):
    """What a search receives for the grids ``[B, H, W]`` that it yields.

    Attributes:
      fitness: int32 ``[B]``, lower is better.
      cyclomatic: int32 ``[B]``, the niche.
      flaws: int32 ``[B]``, the number of dead ends, boundary violations, mismatches, adjacent
        crossings, adjacent turns and components beside the first; and of empty cells, if the task
        fills every cell.
    """

    fitness: Int[np.ndarray, " B"]
    cyclomatic: Int[np.ndarray, " B"]
    flaws: Int[np.ndarray, " B"]

    @property
    def counts(self) -> Bool[np.ndarray, " B"]:
        """Whether the grid is flawless, bool ``[B]``. Other grids have no part in `Scores`."""
        return self.flaws == 0


Search = Callable[[Task, np.random.Generator], Generator[AnyArray, Measured, None]]
"""A search: yields batches of grids ``[B, H, W]``, and receives a `Measured` for each batch."""

MultiTaskSearch = Callable[
    [Sequence[Task], np.random.Generator], Generator[tuple[int, AnyArray], Measured, None]
]
"""A search of several tasks: yields the index of a task and grids for it, and receives a `Measured`."""

_ENDED = object()  # what a search that has ended yields


@name_wrong_arguments
def run(task: Task | str, search: Search, seeds: int | Iterable[int] = LEAST_RUNS) -> Submission:
    """Runs a search once for each seed, and keeps the best grid of each niche at every budget.

    The best grid has the fewest flaws, and among these the lowest fitness. The first of equal grids
    is kept.

    Args:
      task: to run, or its name.
      search: a generator function; see `Search`. It is stopped when the task's evaluations are
        spent. If a batch exceeds a budget, only its first grids count for this budget.
      seeds: their number, or the seeds of NumPy's generators. A submission needs 10 or more.

    Raises:
      InputError: for an unknown task, a search that is no generator, or grids of another shape or
        with other codes.
    """
    task = task if isinstance(task, Task) else find_task(task)
    return _run([task], search, task, lambda grids: (0, grids), seeds)[0]


@name_wrong_arguments
def run_tasks(
    tasks: Sequence[Task], search: MultiTaskSearch, seeds: int | Iterable[int] = LEAST_RUNS
) -> list[Submission]:
    """Runs a search of several tasks once for each seed; returns a submission for each task.

    A run has as many evaluations as the tasks have together, and the search divides them among the
    tasks. The archives of a budget are those after this budget times the number of tasks.

    Args:
      tasks: to run, of equal budgets: for instance
        ``[find_task(f"{size}-10000") for size in SIZES]``.
      search: a generator function; see `MultiTaskSearch`. It is stopped when all evaluations are
        spent.
      seeds: as in `run`.

    Raises:
      InputError: for anything else than tasks of equal budgets, for an index of no task, and for
        grids as in `run`.
    """
    budgets = {task.evaluations for task in check_named("tasks", listed(Task), tasks)}
    if len(budgets) != 1:
        raise InputError(
            f"tasks: expected equal budgets, got {', '.join(task.name for task in tasks) or 'no task'}"
        )
    return _run(tasks, search, tasks, partial(_check_index, len(tasks)), seeds)


def _check_index(tasks: int, batch: UserValue) -> tuple[int, AnyArray]:
    if not isinstance(batch, tuple | list) or len(batch) != 2:
        raise InputError(
            f"search: expected the index of a task and grids, got {type(batch).__name__}"
        )
    return check_named("search", whole(0, tasks - 1), batch[0]), batch[1]


def _run(
    tasks: Sequence[Task],
    search: UserValue,
    argument: Task | Sequence[Task],
    split: Callable[[UserValue], tuple[int, AnyArray]],
    seeds: int | Iterable[int],
) -> list[Submission]:
    """Runs a search for each seed.

    `split` returns the index of a task and grids from what the search yields.
    """
    numbers = _check_seeds(seeds)
    if not callable(search):
        raise InputError(
            f"search: expected a generator function, which yields grids, got {shorten(repr(search))}"
        )
    check_named("search", function_of("task", "generator"), search)
    runs = []
    for seed in numbers:
        generator = search(argument, np.random.default_rng(seed))
        runs.append(_run_seed(tasks, generator, split))
    submissions = []
    for index, task in enumerate(tasks):
        submissions.append(Submission(task, np.stack([archives[index] for archives in runs])))
    return submissions


def _check_seeds(seeds: int | Iterable[int]) -> list[int]:
    """Returns the seeds: those given, or as many as a number says."""
    if hasattr(seeds, "tolist"):
        seeds = seeds.tolist()  # of an array without axes: a number
    numbers = (
        list(seeds)
        if isinstance(seeds, Iterable)
        else list(range(check_named("seeds", whole(1), seeds)))
    )
    if not numbers or any(not is_whole(seed) or seed < 0 for seed in numbers):
        raise InputError(
            f"seeds: expected a number or several, 0 or more, got {shorten(repr(seeds))}"
        )
    check_unique("seeds", "seed", map(str, numbers))
    return numbers


def _run_seed(
    tasks: Sequence[Task], search: UserValue, split: Callable[[UserValue], tuple[int, AnyArray]]
) -> list[Int8[np.ndarray, "T N H W"]]:
    """Returns the archives of each task after each budget: the best grid of each cyclomatic number."""
    if not isinstance(search, Generator):
        raise InputError(
            f"search: expected a generator function, which yields grids, got {shorten(repr(search))}"
        )
    ends = [budget * len(tasks) for budget in BUDGETS if budget <= tasks[0].evaluations]
    archives = [_Archive(task) for task in tasks]
    # The grids of each archive, after each budget.
    at_ends: list[list[Int8[np.ndarray, "N H W"]]] = []
    spent, batch = 0, next(search, _ENDED)
    while batch is not _ENDED and len(at_ends) < len(ends):
        index, grids = split(batch)
        codes = _check(tasks[index], grids)
        measured = Measured(**measure_grids(codes, fill=tasks[index].fill))
        for number in range(len(codes)):
            archives[index].insert(codes[number], measured, number)
            spent += 1
            if len(at_ends) < len(ends) and spent == ends[len(at_ends)]:
                at_ends.append([archive.grids.copy() for archive in archives])
        try:
            batch = search.send(measured)
        except StopIteration:
            batch = _ENDED
    search.close()
    while len(at_ends) < len(ends):  # the search ended early
        at_ends.append([archive.grids for archive in archives])
    return [np.stack(grids) for grids in zip(*at_ends, strict=True)]


class _Archive:
    """The best grid of each cyclomatic number: with the fewest flaws, and among these of the lowest fitness."""

    def __init__(self, task: Task) -> None:
        niches = task.shape[0] * task.shape[1]
        self.grids = np.zeros((niches, *task.shape), np.int8)
        self._ranks = [(np.inf, np.inf)] * niches  # flaws and fitness

    def insert(self, codes: Int8[np.ndarray, "H W"], measured: Measured, number: int) -> None:
        """Keeps a grid if it is better than its niche's; `measured` has the figures of its batch."""
        niche = measured.cyclomatic[number]
        rank = (measured.flaws[number], measured.fitness[number])
        if rank < self._ranks[niche]:
            self.grids[niche], self._ranks[niche] = codes, rank


def _check(task: Task, batch: AnyArray) -> Int8[np.ndarray, "B H W"]:
    try:
        codes = np.asarray(batch)
    except ValueError as error:
        raise InputError(f"search: expected an array of grids, got {shorten(str(error))}") from None
    if (
        codes.ndim != 3
        or codes.shape[1:] != task.shape
        or not len(codes)
        or codes.dtype.kind not in "iu"
    ):
        shape = f"[B, {task.shape[0]}, {task.shape[1]}]"
        raise InputError(
            f"search: expected grids {shape} of whole numbers, got {codes.dtype} {list(codes.shape)}"
        )
    if not 0 <= codes.min() <= codes.max() <= 15:
        raise InputError(f"search: expected tile codes 0 to 15, got {codes.min()} to {codes.max()}")
    return codes.astype(np.int8)
