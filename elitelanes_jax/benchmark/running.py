"""Runs a user's search on a task, and keeps its archive at every budget."""

from collections.abc import Callable, Generator, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Int8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    check_named,
    check_unique,
    function_of,
    is_whole,
    whole,
)
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.types import ArrayOrRows, UserValue
from elitelanes_jax.benchmark.checks import SpentError, check_batch
from elitelanes_jax.benchmark.measuring import Measured, measure_grids
from elitelanes_jax.benchmark.submissions import LEAST_RUNS, Submission
from elitelanes_jax.benchmark.tasks import Task, find_task

if TYPE_CHECKING:
    from elitelanes_jax.benchmark.operators import Operators

SearchFunction = Callable[..., Generator[ArrayOrRows, Measured, None]]
"""A search: yields batches of grids ``[B, H, W]``, and receives a `Measured` for each batch.

Its arguments are a `Task`, a generator of NumPy, and `Operators` if they are fixed.
"""

# Stands for the batch of a search that has ended.
_ENDED = object()


@name_wrong_arguments
def run_task(
    task: Task | str,
    search: SearchFunction,
    seeds: int | Iterable[int] = LEAST_RUNS,
    operators: str | None = None,
) -> Submission:
    """Runs a search once for each seed, and keeps the best grid of each niche at every budget.

    The best grid has the fewest flaws, and among these the lowest fitness. The first of equal grids
    is kept.

    Args:
      task: the task to run, or its name.
      search: a generator function; see `SearchFunction`. When the task's evaluations are spent,
        it still gets the last measurements, and is closed where it yields again. If a batch exceeds
        a budget, only its first grids count for this budget.
      seeds: their number, or the seeds of NumPy's generators. A board needs 10 or more.
      operators: the track. None is the open track: the search makes its grids. On a track of fixed
        operators, ``tiles``, ``links`` or ``moves`` (see `find_operators`), the search takes
        `Operators` as its third argument, and yields grids that they have made.

    Raises:
      InputError: for an unknown task, a search that is no generator, grids of another shape or
        with other codes, or grids that the operators have not made.
    """
    task = task if isinstance(task, Task) else find_task(task)
    numbers = _check_seeds(seeds)
    if not callable(search):
        raise InputError("search", "a generator function, which yields grids", quote(search))
    # Otherwise a function of other arguments would raise a `TypeError` that does not name `search`.
    names = ("task", "generator") if operators is None else ("task", "generator", "operators")
    check_named("search", function_of(*names), search)
    runs = []
    for seed in numbers:
        generator = np.random.default_rng(seed)
        if operators is None:
            runs.append(_run_seed(task, search(task, generator), None))
        else:
            # The open track does not need JAX before the first measurement.
            from elitelanes_jax.benchmark.operators import Operators

            fixed = Operators(operators, task, seed)
            runs.append(_run_seed(task, search(task, generator, fixed), fixed))
    return Submission(task, np.stack(runs), operators or "open")


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
        raise InputError("seeds", "a number or several, 0 or more", quote(seeds))
    # Equal seeds give equal runs, which would narrow the intervals of the scores.
    check_unique("seeds", "seed", map(str, numbers))
    return numbers


def _run_seed(
    task: Task, search: UserValue, operators: "Operators | None"
) -> Int8[np.ndarray, "T N H W"]:
    """Returns the archive after each budget: the best grid of each niche."""
    # A function that returns its grids instead of yielding them would receive no measurements.
    if not isinstance(search, Generator):
        raise InputError("search", "a generator function, which yields grids", quote(search))
    budgets = task.budgets
    archive = _Archive(task)
    at_budgets: list[Int8[np.ndarray, "N H W"]] = []
    spent, batch = 0, _advance(search, None)
    while batch is not _ENDED and len(at_budgets) < len(budgets):
        codes = check_batch("search", task, batch)
        if operators is not None:
            operators.check("search", codes)
        measured = measure_grids(task, codes)
        # The grids are counted one at a time, because a budget may be spent within a batch.
        for number in range(len(codes)):
            archive.insert(codes[number], measured, number)
            # Every grid is an evaluation, also a flawed one or one that came already.
            spent += 1
            if len(at_budgets) < len(budgets) and spent == budgets[len(at_budgets)]:
                # The archive changes with the next grid, so a copy is kept.
                at_budgets.append(archive.grids.copy())
        batch = _advance(search, measured)
    search.close()
    while len(at_budgets) < len(budgets):
        # The search ended before it had spent its budget.
        at_budgets.append(archive.grids)
    return np.stack(at_budgets)


def _advance(search: Generator[ArrayOrRows, Measured, None], measured: Measured | None) -> Any:
    """Returns the search's next batch, or `_ENDED`."""
    try:
        return search.send(measured)  # type: ignore[arg-type]  # None starts a generator
    except (StopIteration, SpentError):
        return _ENDED


class _Archive:
    """The best grid of each niche.

    The best grid has the fewest flaws, and among these the lowest fitness.
    """

    def __init__(self, task: Task) -> None:
        if task.tiles is None:
            # Linked tiles form fewer loops than there are tiles, so every cyclomatic number has a
            # slot.
            niches = [(number,) for number in range(task.shape[0] * task.shape[1])]
        else:
            # Grids in niches that have no network do not count, not even in the graded score.
            niches = [tuple(niche) for niche in task.niches.tolist()]
        self._slots = {niche: slot for slot, niche in enumerate(niches)}
        self.grids = np.zeros((len(niches), *task.shape), np.int8)
        # The flaws and the fitness of each niche's grid.
        self._ranks = [(np.inf, np.inf)] * len(niches)

    def insert(self, codes: Int8[np.ndarray, "H W"], measured: Measured, number: int) -> None:
        """Keeps a grid if it is better than its niche's.

        `measured` has the figures of the grid's batch, in which it is at index `number`.
        """
        slot = self._slots.get(tuple(measured.niche[number].tolist()))
        rank = (measured.flaws[number], measured.fitness[number])
        # Of equal ranks the first stays.
        if slot is not None and rank < self._ranks[slot]:
            self.grids[slot], self._ranks[slot] = codes, rank
