"""The board of the benchmark: searches of this package and of other libraries, each in its own loop.

python -m experiments.search.board ROW ... [--tasks 6x6B-10000 ...] [--runs N] [--out DIR]
python -m experiments.search.board ROW ... --tune
python -m experiments.search.board --table [--out DIR]

A row is measured by one command. It writes the raw archive of each task, which `elitelanes score` measures anew, and
its scores. `--tune` tries settings on 6 x 6 alone, with other seeds: for every row as many, drawn at random
from its choices. The trials are kept in the folder `tuning`; the same command goes on where it was. `--table` makes the
table and the curves of all rows that are in the folder. QDax, evosax and pyribs come with the extra `interop`.

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
from numpy.typing import NDArray

from elitelanes_jax import InputError
from elitelanes_jax._util.checks import path, whole
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax.benchmark import (
    BUDGETS,
    Scores,
    Submission,
    Task,
    compute_scores,
    confidence_interval,
    find_task,
    score_submission,
    write_submission,
)
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say
from elitelanes_jax.search import use_compile_cache
from experiments.search.board_rows import ROWS, Found

TASKS = [f"{size}-1000000" for size in ("6x6B", "7x7B")]
TUNED_ON = [f"{size}-100000" for size in ("6x6A", "6x6B")]
TRIALS, _TUNING_SEEDS, _FIRST_TUNING_SEED = 8, 4, 1000

_COLOURS = (*mpl.color_sequences["tab10"], "black")


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


def tune(name: str, out: Path) -> None:
    """Tries settings of a row; writes the mean reliability of each at every budget of every task, and says the best."""
    file = out / "tuning" / f"{name}.json"
    known = _read(file)["trials"] if file.exists() else []
    fresh = [{"settings": settings, "reliability": {}, "seconds": 0.0} for settings in drawn_settings(name)]
    trials = [next((old for old in known if old["settings"] == one["settings"]), one) for one in fresh]
    for trial, task in product(trials, map(find_task, TUNED_ON)):
        if task.name not in trial["reliability"]:
            _try(name, trial, task)
            record = {"row": name, "seeds": _TUNING_SEEDS, "trials": trials}
            write_atomic(file, (json.dumps(record, indent=1) + "\n").encode())
    for trial in trials:
        say(f"{name}, {trial['settings']}: reliability {mean_reliability(trial):.3f}")
    best = max(trials, key=mean_reliability)["settings"]
    told = "as" if best == ROWS[name].settings else "not as"
    say(f"{name}, the best of {len(trials)}: {best}; {told} in board_rows.py")


def drawn_settings(name: str) -> list[dict[str, Any]]:
    """Draws the settings of a row that are tried, the same each time: every choice comes equally often, or nearly."""
    choices, draws = ROWS[name].choices, np.random.default_rng(0)
    if not choices:
        raise InputError(f"{name}: expected a row with settings to tune, got one without")
    while True:
        orders = [draws.permutation(np.arange(TRIALS) % len(values)) for values in choices.values()]
        drawn = list(zip(*orders, strict=True))
        if len(set(drawn)) == TRIALS:
            return [{key: values[at] for (key, values), at in zip(choices.items(), one, strict=True)} for one in drawn]


def mean_reliability(trial: dict[str, Any]) -> float:
    """Returns the mean reliability of a trial over tasks and budgets."""
    return float(np.mean(list(trial["reliability"].values())))


def _try(name: str, trial: dict[str, Any], task: Task) -> None:
    """Runs a trial on a task, and adds its mean reliability at every budget."""
    budgets = [budget for budget in BUDGETS if budget <= task.evaluations]
    began = time.process_time()
    found = ROWS[name].play(task, _FIRST_TUNING_SEED, _TUNING_SEEDS, budgets, trial["settings"])
    scores = compute_scores(task, best_of(task, found))
    trial["reliability"][task.name] = np.round(scores.reliability.mean(axis=0), 6).tolist()
    trial["seconds"] = round(trial["seconds"] + time.process_time() - began, 1)


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
    lines = [
        "# The board",
        "",
        "Means of the runs, with bootstrap intervals of 95 %. [What it is](../../docs/benchmark.md#board).",
        "",
    ]
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
    lines += _tuning(out / "tuning")
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


def _tuning(folder: Path) -> list[str]:
    """Makes the table of what was tried for each row: means of reliability over tasks and budgets."""
    records = {record["row"]: record["trials"] for record in map(_read, folder.glob("*.json"))}
    lines = [
        "Tuning",
        "",
        "| search | trials | best | median | worst | settings of the best |",
        "|---|---:|---:|---:|---:|---|",
    ]
    for name, row in ROWS.items():
        if trials := records.get(name):
            means = [mean_reliability(trial) for trial in trials]
            told = [f"{value:.2f}" for value in (max(means), np.median(means), min(means))]
            best = trials[int(np.argmax(means))]["settings"]
            settings = ", ".join(f"{key} {value}" for key, value in best.items())
            lines.append(f"| {row.title} | {len(trials)} | {' | '.join(told)} | {settings} |")
    return [*lines, ""] if records else []


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
            tune(name, options.out)
            continue
        for task in tasks:
            measure_row(name, task, options.runs, options.out)
    if options.table:
        write_table(options.out)
    return 0


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
