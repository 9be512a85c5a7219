"""Raw archives of runs on a task.

This module reads and writes their files, and computes scores from grids that are measured again.
"""

import io
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int8
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, file_named, instance, one_of, unmasked
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.npz import read_npz
from elitelanes_jax.benchmark.measuring import Measured, measure_grids
from elitelanes_jax.benchmark.scores import Scores, compute_scores, grade
from elitelanes_jax.benchmark.tasks import Task, find_task

LEAST_RUNS = 10
"""The smallest number of runs on a board, each from another seed."""

TRACKS = ("open", "tiles", "links", "moves")
"""The tracks of the benchmark."""

# The largest size of the grids: `read_npz` reads 2**29 bytes on any machine.
_MOST_BYTES = 2**29 - 2**12


@keeps_copies
class Submission(NamedTuple):
    """The archives of R runs on a task, after each of the T budgets up to the task's own.

    Attributes:
      task: the task of the runs.
      grids: int8 ``[R, T, N, H, W]``, up to N elites of each archive, in any order; a vacant slot
        is all zeros. Grids that are not flawless, or have an empty cell although the task fills
        every cell, do not count. The grids are copied, and the copy is read-only.
      operators: the track: ``open``, or the operators that made all grids, ``tiles``, ``links`` or
        ``moves``. An archive does not prove it; running a seed again does.
    """

    task: Task
    grids: Int8[np.ndarray, "R T N H W"]
    operators: str = "open"

    def save(self, file: str | Path) -> None:
        """Writes a raw archive as an ``.npz``. A board takes archives of `LEAST_RUNS` runs or more.

        Raises:
          InputError: if the grids do not fit the task, for another type or track, a task that
            `find_task` does not have, or a file whose name does not end in .npz.
        """
        out = check_named("file", file_named(".npz"), file)
        grids = _checked_grids(self, str(file))
        # An archive has the task's name alone.
        known = check_named("submission: task", find_task, self.task.name)
        pairs = zip(map(np.asarray, self.task), map(np.asarray, known), strict=True)
        if not all(np.array_equal(one, other) for one, other in pairs):
            raise InputError("submission: task", "a task as find_task has it", "a changed one")
        content = io.BytesIO()
        np.savez_compressed(
            content,
            version=self.task.version,
            task=self.task.name,
            operators=self.operators,
            grids=grids,
        )
        write_atomic(out, content.getvalue())

    @classmethod
    def load(cls, file: str | Path) -> "Submission":
        """Reads a raw archive.

        Raises `InputError` for another file, version or task, or grids that do not fit the task.
        """
        _, stored = read_npz(file)
        names = ("version", "task", "grids")
        present = [name for name in names if name in stored]
        if len(present) < len(names):
            got = ", ".join(present) or "none"
            raise InputError(file, f"arrays {', '.join(names)}", got)
        version, task_name, grids = (stored[name] for name in names)
        try:
            task = find_task(task_name.tolist())
        except InputError as error:
            raise error.within(file) from None
        if version.tolist() != task.version:
            raise InputError(file, f"version {task.version}", repr(version.tolist()))
        _check(str(file), task, grids)
        # Archives of other programs need no track.
        operators = stored.get("operators", np.array("open")).tolist()
        check_named(f"{file}: operators", one_of(*TRACKS), operators)
        return cls(task, grids.astype(np.int8), operators)

    def score(self) -> tuple[NDArray[np.float64], Scores]:
        """Measures all grids, and scores them.

        Returns:
          float ``[R, T, F]``, the lowest fitness in each feasible niche, infinite if it is vacant;
          and the scores, each ``[R, T]``.

        Raises:
          InputError: for grids that do not fit the task, another track, or a grid that is better
            than its niche's certificate.
        """
        best = _best_fitness(self.task, _measure(self))
        return best, compute_scores(self.task, best)

    def grade(self) -> NDArray[np.float64]:
        """Computes the graded score of each run at each budget.

        The graded score gives flawed grids partial credit. A niche with a flawless network scores
        (1 + nearness) / 2, see `Scores`. A niche whose best grid has n flaws, see `Measured`,
        scores 1 / (2 + 2n). A vacant niche scores 0.

        Returns:
          float ``[R, T]`` in [0, 1], the means over feasible niches.

        Raises:
          InputError: as `score`.
        """
        measured = _measure(self)
        return _grade(self.task, _best_fitness(self.task, measured), measured)


def score_and_grade(submission: Submission) -> dict[str, NDArray[np.float64]]:
    """Returns the scores and the graded score, by name, each ``[R, T]``; measures once."""
    measured = _measure(submission)
    best = _best_fitness(submission.task, measured)
    graded = _grade(submission.task, best, measured)
    return compute_scores(submission.task, best)._asdict() | {"graded": graded}


def _checked_grids(submission: Submission, source: str) -> NDArray[np.integer]:
    """Returns the grids; raises `InputError` for a task, a track or grids that are not valid."""
    check_named("submission: task", instance(Task), submission.task)
    check_named("submission: operators", one_of(*TRACKS), submission.operators)
    check_named("submission: grids", unmasked, submission.grids)
    grids = np.asarray(submission.grids)
    _check(source, submission.task, grids)
    return grids


def _check(source: str, task: Task, grids: np.ndarray) -> None:
    # The size is checked first, before all grids are read.
    if grids.nbytes > _MOST_BYTES:
        raise InputError(source, f"grids of at most {_MOST_BYTES:,} bytes", f"{grids.nbytes:,}")
    budgets = len(task.budgets)
    shape = f"[R, {budgets}, N, {task.shape[0]}, {task.shape[1]}]"
    if grids.ndim != 5 or grids.shape[1] != budgets or grids.shape[3:] != task.shape:
        raise InputError(source, f"grids {shape} for {task.name}", list(grids.shape))
    if not len(grids):
        raise InputError(source, "at least 1 run", 0)
    if not grids.size:
        raise InputError(source, "at least one slot in grids", list(grids.shape))
    if not np.issubdtype(grids.dtype, np.integer):
        raise InputError(source, "whole numbers in grids", grids.dtype)
    if not 0 <= grids.min() <= grids.max() <= 15:
        raise InputError(source, "tile codes 0 to 15 in grids", f"{grids.min()} to {grids.max()}")


def _measure(submission: Submission) -> Measured:
    """Checks and measures all grids, each field ``[R, T, N]``."""
    grids = _checked_grids(submission, "submission")
    measured = measure_grids(submission.task, grids.reshape(-1, *submission.task.shape))
    return Measured(*(values.reshape(*grids.shape[:3], *values.shape[1:]) for values in measured))


def _best_fitness(task: Task, measured: Measured) -> NDArray[np.float64]:
    """Returns the lowest fitness of a flawless grid in each feasible niche, ``[R, T, F]``.

    It is infinite for a vacant niche.

    Raises:
      InputError: for a grid that the task's certificates say cannot exist.
    """
    flawless = measured.counts
    certified = np.zeros_like(flawless)
    best = np.full((*flawless.shape[:2], len(task.niches)), np.inf)
    for niche, (descriptors, optimum) in enumerate(zip(task.niches, task.optimum, strict=True)):
        in_niche = (measured.niche == descriptors).all(axis=-1)
        certified |= in_niche
        # Several slots may be in the same niche, and the best one counts.
        here = flawless & in_niche
        best[..., niche] = np.where(here, measured.fitness, np.inf).min(axis=-1, initial=np.inf)
        better = np.argwhere(here & (measured.fitness < optimum))
        if len(better):
            index = tuple(better[0].tolist())
            got = (
                f"{measured.fitness[index]} at {_describe(task, descriptors)}, {_slot(task, index)}"
            )
            raise InputError(
                "grids", f"none better than the certified {optimum}", f"{got}: please report it"
            )
    beyond = np.argwhere(flawless & ~certified)
    if len(beyond):
        index = tuple(beyond[0].tolist())
        got = f"one at {_describe(task, measured.niche[index])}, {_slot(task, index)}"
        raise InputError(
            "grids", "none in niches that are certified to be empty", f"{got}: please report it"
        )
    return best


def _grade(task: Task, best: NDArray[np.float64], measured: Measured) -> NDArray[np.float64]:
    """Returns the graded score ``[R, T]``; `best` is that of `_best_fitness`."""
    fewest = np.full(best.shape, np.inf)
    for niche, descriptors in enumerate(task.niches):
        here = (measured.niche == descriptors).all(axis=-1)
        fewest[..., niche] = np.where(here, measured.flaws, np.inf).min(axis=-1, initial=np.inf)
    return grade(task, best, fewest)


def _describe(task: Task, descriptors: NDArray[np.integer]) -> str:
    tiles = "" if task.tiles is None else f" and {descriptors[1]} {task.tiles}"
    return f"cyclomatic number {descriptors[0]}{tiles}"


def _slot(task: Task, index: tuple[int, ...]) -> str:
    return f"run {index[0]}, {task.budgets[index[1]]:,} evaluations, slot {index[2]}"
