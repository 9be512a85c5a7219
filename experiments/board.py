"""The board of the benchmark: searches of this package and of other libraries, each in its own loop.

python experiments/board.py ROW ... [--tasks 6x6B-10000 ...] [--runs N] [--out DIR]
python experiments/board.py ROW ... --tune
python experiments/board.py --table [--out DIR]

A row is measured by one command. It writes the raw archive of each task, which `elitelanes score` measures anew, and
its scores. `--tune` tries six settings, drawn at random, on 5 x 5 and 6 x 6 alone, with other seeds: as many for each
row of another library. `--table` makes the table and the curves of all rows that are in the folder. QDax, evosax and
pyribs come with the extra `interop`.

All that a search evaluates is offered to a record of the best network of each niche, which the search does not see. The
record of the tuned EA has the grids that its chains move to.
"""

import argparse
import json
import sys
import time
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from board_rows import ROWS, Found
from numpy.typing import NDArray

from elitelanes_jax._util.atomic_io import write_atomic
from elitelanes_jax._util.checks import path, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.benchmark.scores import Scores, compute_scores, confidence_interval
from elitelanes_jax.benchmark.submissions import Submission, score_submission, write_submission
from elitelanes_jax.benchmark.tasks import BUDGETS, Task, find_task
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.compile_cache import use_compile_cache

TASKS = [f"{size}-1000000" for size in ("6x6B", "7x7B")]
TUNED_ON = [f"{size}-100000" for size in ("5x5B", "6x6A", "6x6B")]
_TRIALS, _TUNING_SEEDS, _FIRST_TUNING_SEED = 6, 4, 1000

_COLOURS = mpl.color_sequences["tab10"]


def best_of(task: Task, found: Found) -> NDArray[np.float64]:
    """Returns the fitness ``[R, T, F]`` in each feasible niche, infinite where it is vacant."""
    there = np.asarray((found.grids > 0).any(axis=(-1, -2)))[..., None]
    here = there & (found.cyclomatic[..., None] == task.cyclomatic)
    return np.where(here, found.fitness[..., None], np.inf).min(axis=2)


def measure_row(name: str, task: Task, runs: int, out: Path) -> None:
    """Runs a row on a task; writes its raw archive and its scores."""
    budgets = [budget for budget in _steps() if budget <= task.evaluations]
    began = time.process_time()
    found = ROWS[name].play(task, 0, runs, budgets, ROWS[name].settings)
    seconds = time.process_time() - began
    at = [budgets.index(budget) for budget in BUDGETS if budget <= task.evaluations]
    submission = Submission(task, *(array[:, at] for array in found))
    _, again = score_submission(submission)
    scores = compute_scores(task, best_of(task, found))
    for field, values in again._asdict().items():
        np.testing.assert_array_equal(values, getattr(scores, field)[:, at])
    write_submission(out / f"{name}-{task.name}.npz", submission)
    record = {"row": name, "task": task.name, "evaluations": budgets, "seconds": round(seconds, 1)}
    record |= {field: np.round(values, 6).tolist() for field, values in scores._asdict().items()}
    write_atomic(out / f"{name}-{task.name}.json", (json.dumps(record) + "\n").encode())
    say(f"{name}, {task.name}, {runs} runs: {_told(scores)} ({seconds:.0f} s)")


def tune(name: str) -> None:
    """Prints how well each of the settings that are tried does: the mean reliability, by budget and in all."""
    tried: list[dict[str, Any]] = []
    draws = np.random.default_rng(0)
    while len(tried) < _TRIALS:
        settings = {key: values[draws.integers(len(values))] for key, values in ROWS[name].choices.items()}
        if settings in tried:
            continue
        tried.append(settings)
        means = []
        for task in map(find_task, TUNED_ON):
            budgets = [budget for budget in BUDGETS if budget <= task.evaluations]
            found = ROWS[name].play(task, _FIRST_TUNING_SEED, _TUNING_SEEDS, budgets, settings)
            means.append(compute_scores(task, best_of(task, found)).reliability.mean(axis=0))
        of_tasks = ", ".join("/".join(f"{mean:.3f}" for mean in task) for task in means)
        say(f"{name}, {settings}: reliability {np.mean(means):.3f} ({of_tasks})")


def _steps() -> list[int]:
    """Returns the evaluations at which scores are kept: 1, 2 and 5 times the powers of ten."""
    return [factor * 10**power for power in range(3, 6) for factor in (1, 2, 5)] + [10**6]


def _told(scores: Scores) -> str:
    last = {field: values[:, -1] for field, values in scores._asdict().items()}
    means = {field: f"{np.nanmean(values):.3f}" for field, values in last.items() if not np.isnan(values).all()}
    return ", ".join(f"{field} {mean}" for field, mean in means.items())


def _cell(values: NDArray[np.float64]) -> str:
    if np.isnan(values).all():
        return ""
    low, high = confidence_interval(values)
    return f"{np.nanmean(values):.2f} ({low:.2f} to {high:.2f})"


def write_table(out: Path) -> None:
    """Writes the table and the curves of all that was measured: of each row and size, the longest runs."""
    records: dict[tuple[str, str], dict[str, Any]] = {}
    for one in sorted(map(_read, out.glob("*.json")), key=lambda one: one["evaluations"][-1]):
        records[one["row"], one["task"].split("-")[0]] = one
    if not records:
        raise InputError(f"{out}: expected scores of rows, got none")
    sizes = sorted({size for _, size in records})
    lines = []
    for size, budget in product(sizes, BUDGETS):
        rows = {name: records[name, size] for name in ROWS if (name, size) in records}
        rows = {name: record for name, record in rows.items() if budget in record["evaluations"]}
        if rows:
            lines += [f"{size}-{budget}", "", "| search | coverage | reliability | precision | optimal |"]
            lines += ["|---|---:|---:|---:|---:|"]
        for name, of_row in rows.items():
            at = of_row["evaluations"].index(budget)
            cells = [_cell(np.array(of_row[field], float)[:, at]) for field in Scores._fields]
            lines.append(f"| {ROWS[name].title} | {' | '.join(cells)} |")
        lines += [""] * bool(rows)
    write_atomic(out / "board.md", "\n".join(lines).encode())
    figure, axes = plt.subplots(
        2,
        len(sizes),
        figsize=(max(8, 3.1 * len(sizes)), 6.5),
        layout="constrained",
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    for column, size in zip(axes.T, sizes, strict=True):
        column[0].set_title(size)
        for axis, field in zip(column, ("reliability", "optimal"), strict=True):
            for colour, (name, row) in zip(_COLOURS, ROWS.items(), strict=True):
                if record := records.get((name, size)):
                    values = np.array(record[field], float)
                    ends = np.array([confidence_interval(at) for at in values.T])
                    axis.plot(record["evaluations"], values.mean(axis=0), color=colour, label=row.title)
                    axis.fill_between(record["evaluations"], *ends.T, color=colour, alpha=0.15, linewidth=0)
            axis.set(xscale="log", ylim=(0, 1.02))
            axis.grid(alpha=0.3)
        column[1].set_xlabel("evaluations of a run")
    axes[0, 0].set_ylabel("reliability")
    axes[1, 0].set_ylabel("share of niches at the optimum")
    lines_of = {line.get_label(): line for axis in axes[0] for line in axis.get_lines()}
    shown = {row.title.replace("`", ""): lines_of[row.title] for row in ROWS.values() if row.title in lines_of}
    figure.legend(shown.values(), shown.keys(), loc="outside lower center", ncols=2, fontsize=9)
    figure.savefig(out / "board.png", dpi=110)
    plt.close(figure)
    say(f"written to {out}")


def _read(file: Path) -> dict[str, Any]:
    return dict(json.loads(file.read_text(encoding="utf-8")))


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="board.py", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"one of {', '.join(ROWS)}")
    parser.add_argument("--tasks", nargs="+", default=TASKS, metavar="TASK", help="by default all of the table")
    parser.add_argument("--runs", type=checked_by(whole(1)), default=10, help="of each task (default: %(default)s)")
    parser.add_argument("--out", type=checked_by(path), default=Path("results/board"), help="folder to write to")
    parser.add_argument("--tune", action="store_true", help="try the settings of the rows")
    parser.add_argument("--table", action="store_true", help="write the table of all rows that are there")
    options = parser.parse_args(arguments)
    return guarded("board.py", lambda: _run(options), interrupted="tasks that ended are kept")


def _run(options: argparse.Namespace) -> int:
    unknown = [name for name in options.rows if name not in ROWS]
    if unknown or not (options.rows or options.table):
        got = unknown[0] if unknown else "none"
        raise InputError(f"ROW: expected one of {', '.join(ROWS)}, got {got}")
    tasks = [find_task(name) for name in options.tasks]
    use_compile_cache()
    for name in options.rows:
        if options.tune:
            tune(name)
            continue
        for task in tasks:
            measure_row(name, task, options.runs, options.out)
    if options.table:
        write_table(options.out)
    return 0


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
