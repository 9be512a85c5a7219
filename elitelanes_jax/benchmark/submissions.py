"""Raw archives of runs on a task.

This module reads and writes their files, and computes scores from grids that are measured again.
"""

import io
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Int8
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, file_named, instance, unmasked
from elitelanes_jax._util.errors import InputError, pluralize
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.npz import unpack
from elitelanes_jax._util.types import AnyArray, UserValue
from elitelanes_jax.benchmark.scores import Scores, compute_scores, grade
from elitelanes_jax.benchmark.tasks import BUDGETS, VERSION, Task, find_task

if TYPE_CHECKING:
    from elitelanes_jax.network.records import Metrics

LEAST_RUNS = 10
"""The smallest number of runs, each from another seed."""

_BATCH = 4096
# The largest size of the grids: `unpack` reads 2**29 bytes on any machine.
_MOST_BYTES = 2**29 - 2**12


class Submission(NamedTuple):
    """The archives of R runs on a task, after each of the T budgets up to the task's own.

    Attributes:
      task: the task of the runs.
      grids: int8 ``[R, T, N, H, W]``, up to N elites of each archive, in any order; a vacant slot
        is all zeros. Grids that are not flawless, or have an empty cell although the task fills
        every cell, do not count.
    """

    task: Task
    grids: Int8[np.ndarray, "R T N H W"]

    def save(self, file: str | Path) -> None:
        """Writes a raw archive as an ``.npz``.

        Raises:
          InputError: if the grids do not fit the task, for another type, or a file with the suffix
            of another format.
        """
        write_submission(file, self)

    @classmethod
    def load(cls, file: str | Path) -> "Submission":
        """Reads a raw archive.

        Raises `InputError` for another file, version or task, or grids that do not fit the task.
        """
        return read_submission(file)

    def score(self) -> tuple[NDArray[np.float64], Scores]:
        """Measures all grids, and scores them.

        Returns:
          float ``[R, T, F]``, the lowest fitness in each feasible niche, infinite if it is vacant;
          and the scores, each ``[R, T]``.

        Raises:
          InputError: for grids that do not fit the task, or one that is better than its niche's
            certificate.
        """
        return score_submission(self)

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
        return grade_submission(self)


@name_wrong_arguments
def write_submission(file: str | Path, submission: Submission) -> None:
    """Writes a raw archive, see `Submission.save`."""
    _check_fields(submission)
    out, grids = check_named("file", file_named(".npz"), file), np.asarray(submission.grids)
    _check(str(file), submission.task, grids)
    content = io.BytesIO()
    np.savez_compressed(content, version=VERSION, task=submission.task.name, grids=grids)
    write_atomic(out, content.getvalue())


@name_wrong_arguments
def read_submission(file: str | Path) -> Submission:
    """Reads a raw archive, see `Submission.load`."""
    names = ("version", "task", "grids")
    _, stored = unpack(file)
    present = [name for name in names if name in stored]
    if len(present) < len(names):
        got = ", ".join(present) or "none"
        raise InputError(f"{file}: expected arrays {', '.join(names)}, got {got}")
    version, task_name, grids = (stored[name] for name in names)
    if version.tolist() != VERSION:
        raise InputError(f"{file}: expected version {VERSION}, got {version.tolist()!r}")
    try:
        task = find_task(task_name.tolist())
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    _check(str(file), task, grids)
    return Submission(task, grids)


def _check_fields(submission: UserValue) -> None:
    check_named("submission", instance(Submission), submission)
    check_named("submission: task", instance(Task), submission.task)
    check_named("submission: grids", unmasked, submission.grids)


def _check(source: str, task: Task, grids: np.ndarray, least: int = LEAST_RUNS) -> None:
    # The size is checked first, before all grids are read.
    if grids.nbytes > _MOST_BYTES:
        raise InputError(
            f"{source}: expected grids of at most {_MOST_BYTES:,} bytes, got {grids.nbytes:,}"
        )
    # A run is scored at its own budget and at all lower ones.
    budgets = sum(budget <= task.evaluations for budget in BUDGETS)
    shape = f"[R, {budgets}, N, {task.shape[0]}, {task.shape[1]}]"
    if grids.ndim != 5 or grids.shape[1] != budgets or grids.shape[3:] != task.shape:
        raise InputError(
            f"{source}: expected grids {shape} for {task.name}, got {list(grids.shape)}"
        )
    if len(grids) < least:
        raise InputError(f"{source}: expected at least {pluralize(least, 'run')}, got {len(grids)}")
    if not grids.size:
        raise InputError(f"{source}: expected at least one slot in grids, got {list(grids.shape)}")
    if not np.issubdtype(grids.dtype, np.integer):
        raise InputError(f"{source}: expected whole numbers in grids, got {grids.dtype}")
    if not 0 <= grids.min() <= grids.max() <= 15:
        raise InputError(
            f"{source}: expected tile codes 0 to 15 in grids, got {grids.min()} to {grids.max()}"
        )


@name_wrong_arguments
def score_submission(submission: Submission) -> tuple[NDArray[np.float64], Scores]:
    """Measures all grids of a raw archive, and scores them, see `Submission.score`."""
    _check_fields(submission)
    task, grids = submission.task, np.asarray(submission.grids)
    # A user may score few runs. Only a file that is handed in needs `LEAST_RUNS`.
    _check("submission", task, grids, least=1)
    measured = _measure(submission)
    flawless = measured["flaws"] == 0
    # Such a grid would refute the certificates.
    beyond = np.argwhere(flawless & ~np.isin(measured["cyclomatic"], task.cyclomatic))
    if len(beyond):
        index = tuple(beyond[0].tolist())
        got = f"one at {measured['cyclomatic'][index]}, {_slot(index)}"
        raise InputError(
            f"grids: expected none in niches that are certified to be empty, got {got}: "
            "please report it"
        )
    best = np.full((*grids.shape[:2], len(task.cyclomatic)), np.inf)
    for niche, (cyclomatic, optimum) in enumerate(zip(task.cyclomatic, task.optimum, strict=True)):
        # Several slots may be in the same niche, and the best one counts.
        here = flawless & (measured["cyclomatic"] == cyclomatic)
        best[..., niche] = np.where(here, measured["fitness"], np.inf).min(axis=-1, initial=np.inf)
        better = np.argwhere(here & (measured["fitness"] < optimum))
        if len(better):
            index = tuple(better[0].tolist())
            got = f"{measured['fitness'][index]} at cyclomatic number {cyclomatic}, {_slot(index)}"
            raise InputError(
                f"grids: expected none better than the certified {optimum}, got {got}: "
                "please report it"
            )
    return best, compute_scores(task, best)


@name_wrong_arguments
def grade_submission(submission: Submission) -> NDArray[np.float64]:
    """Computes the graded score of each run at each budget, see `Submission.grade`."""
    best, _ = score_submission(submission)
    measured = _measure(submission)
    fewest = np.full(best.shape, np.inf)
    for niche, cyclomatic in enumerate(submission.task.cyclomatic):
        here = measured["cyclomatic"] == cyclomatic
        fewest[..., niche] = np.where(here, measured["flaws"], np.inf).min(axis=-1, initial=np.inf)
    return grade(submission.task, best, fewest)


def _measure(submission: Submission) -> dict[str, np.ndarray]:
    """Measures all grids of a checked submission.

    Returns the fields of `Measured`, each ``[R, T, N]``.
    """
    grids = np.asarray(submission.grids)
    measured = measure_grids(grids.reshape(-1, *submission.task.shape), fill=submission.task.fill)
    return {name: values.reshape(grids.shape[:3]) for name, values in measured.items()}


def _slot(index: tuple[int, ...]) -> str:
    return f"run {index[0]}, {BUDGETS[index[1]]:,} evaluations, slot {index[2]}"


def measure_grids(grids: Int8[np.ndarray, "P H W"], *, fill: bool) -> dict[str, np.ndarray]:
    """Measures grids in batches of one size, and returns the fields of `Measured`.

    Batches of one size need only one compiled program.
    """
    batches = []
    for start in range(0, len(grids), _BATCH):
        batch = grids[start : start + _BATCH].astype(np.int8)
        # The last batch is filled up to a power of two, so that few programs are compiled.
        filler = np.zeros(
            (min(_BATCH, 1 << (len(batch) - 1).bit_length()) - len(batch), *batch.shape[1:]),
            np.int8,
        )
        part = _measurer()(np.concatenate([batch, filler]), fill)
        batches.append({name: np.asarray(values)[: len(batch)] for name, values in part.items()})
    return {name: np.concatenate([part[name] for part in batches]) for name in batches[0]}


def count_flaws(metrics: "Metrics", fill: AnyArray) -> AnyArray:
    """Counts flaws: see `Measured.flaws`. `fill` says whether every cell has to be filled."""
    at_cells = (
        metrics.dead_ends
        + metrics.boundary_violations
        + metrics.mismatches
        # `fill` is a factor, because JAX traces it: one program serves both variants.
        + fill * metrics.empty_cells
    )
    between_cells = metrics.adjacent_crossings + metrics.adjacent_turns
    # A grid without roads has no component, which is one flaw.
    return at_cells + between_cells + abs(metrics.components - 1)


@cache
def _measurer() -> Callable[[AnyArray, bool], dict[str, AnyArray]]:
    import jax

    from elitelanes_jax.network.fitness import fitness
    from elitelanes_jax.network.metrics import measure

    @jax.jit
    def measure_batch(batch: AnyArray, fill: AnyArray) -> dict[str, AnyArray]:
        metrics = jax.vmap(measure)(batch)
        flaws = count_flaws(metrics, fill)
        return {"fitness": fitness(metrics), "cyclomatic": metrics.cyclomatic, "flaws": flaws}

    return measure_batch
