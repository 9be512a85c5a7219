"""The board of the benchmark: searches of this package and of other libraries, each in its own loop.

    python -m experiments.search.board ROW ... [--tasks 6x6B-10000 ...] [--runs N] [--out DIR]
    python -m experiments.search.board --table [--out DIR]
    python -m experiments.search.board --picture [--out DIR]

A row runs on each task: one of the board's, or a Python file of yours with a function `search` as
`elitelanes_jax.benchmark.run` takes it. The program writes its raw archive, which `elitelanes score` measures, and its
scores. `--table` makes the table of all rows in the folder, and its picture. `--picture` draws a table again. QDax,
evosax and pyribs come with the extra `interop`.

All grids that a search evaluates are offered to a record of the best network of each niche, which the search does not
see. The record of the tuned EA has the grids that its chains move to.
"""

import argparse
import json
import re
import runpy
import time
from collections import defaultdict
from collections.abc import Sequence
from itertools import cycle, product
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import jax
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError, benchmark, fitness, measure
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
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, run, save, table, whole, write
from experiments.search.board_rows import ROWS, Found, Row

__all__ = ["TASKS", "best_of", "main"]

TASKS = [f"{size}-1000000" for size in ("6x6B", "7x7B")]

_COLOURS = (*mpl.color_sequences["tab10"], "black")


Record = dict[str, str | float | list[int] | list[list[float]]]
"""The scores of a row on a task: `row`, `task`, `evaluations`, `seconds`, and each of `Scores` by run and budget."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("board", __doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"one of {', '.join(ROWS)}, or a file FILE.py")
    parser.add_argument("--tasks", nargs="+", default=TASKS, metavar="TASK", help=f"default {' '.join(TASKS)}")
    parser.add_argument("--runs", type=whole(10), default=10, metavar="N", help="of each task; default 10, the least")
    parser.add_argument("--out", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    parser.add_argument("--table", action="store_true", help="write the table of all rows in the folder")
    parser.add_argument("--picture", action="store_true", help="draw the table in the folder")
    options = parser.parse_args(arguments)
    return run("board", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    if not (options.rows or options.table or options.picture):
        raise InputError(f"ROW: expected one of {', '.join(ROWS)}, or FILE.py, got none")
    rows = dict(_find_row(name) for name in options.rows)
    tasks = [find_task(name) for name in options.tasks]
    use_compile_cache()
    for name, row in rows.items():
        for task in tasks:
            _measure_row(name, row, task, options.runs, options.out)
    if options.table:
        _write_table(options.out)
    if options.table or options.picture:
        _draw(options.out)
        print(f"written to {options.out}")


def _find_row(name: str) -> tuple[str, Row]:
    """Returns a row of the board by its name, or a row that runs the search in a file."""
    if name in ROWS:
        return name, ROWS[name]
    file = Path(name)
    if file.suffix == ".py" and not file.is_file():
        raise InputError(f"{file}: expected a file with a function search, got none")
    search = runpy.run_path(name).get("search") if file.suffix == ".py" else None
    if not callable(search):
        raise InputError(f"ROW: expected one of {', '.join(ROWS)}, or FILE.py with a function search, got {name}")

    def play(task: Task, runs: int, budgets: Sequence[int]) -> Found:
        grids = benchmark.run(task, search, range(runs)).grids
        metrics = jax.jit(jax.vmap(measure))(grids.reshape(-1, *task.shape))
        values = (np.asarray(one).reshape(grids.shape[:3]) for one in (fitness(metrics), metrics.cyclomatic))
        return Found(grids, *values)

    return file.stem, Row(file.stem, play)


def best_of(task: Task, found: Found) -> NDArray[np.float64]:
    """Returns the fitness ``[R, T, F]`` in each feasible niche, infinite where it is vacant."""
    present = np.asarray((found.grids > 0).any(axis=(-1, -2)))[..., None]
    in_niche = present & (found.cyclomatic[..., None] == task.cyclomatic)
    return np.where(in_niche, found.fitness[..., None], np.inf).min(axis=2)


def _measure_row(name: str, row: Row, task: Task, runs: int, out: Path) -> None:
    """Runs a row on a task; writes its raw archive and its scores."""
    budgets = [budget for budget in BUDGETS if budget <= task.evaluations]
    began = time.process_time()
    found = row.play(task, runs, budgets)
    seconds = time.process_time() - began
    submission = Submission(task, found.grids)
    _, again = score_submission(submission)
    scores = compute_scores(task, best_of(task, found))
    for field, values in again._asdict().items():
        np.testing.assert_array_equal(values, getattr(scores, field))
    write_submission(out / f"{name}-{task.name}.npz", submission)
    record: Record = {"row": name, "task": task.name, "evaluations": budgets, "seconds": round(seconds, 1)}
    record |= {field: np.round(values, 6).tolist() for field, values in scores._asdict().items()}
    write(out / f"{name}-{task.name}.json", json.dumps(record) + "\n")
    last = {field: values[:, -1] for field, values in scores._asdict().items()}
    means = [f"{field} {np.nanmean(values):.3f}" for field, values in last.items() if not np.isnan(values).all()]
    print(f"{name}, {task.name}, {runs} runs: {', '.join(means)} ({seconds:.0f} s)", flush=True)


def _write_table(out: Path) -> None:
    """Writes the table of all results: of each row and size, the longest runs."""
    records = {
        (record["row"], record["task"].split("-")[0]): record
        for record in sorted(map(_read, out.glob("*.json")), key=lambda record: record["evaluations"][-1])
    }
    if not records:
        raise InputError(f"{out}: expected scores of rows, got none")
    titles = {name: row.title for name, row in ROWS.items()} | {name: name for name, _ in records if name not in ROWS}
    sizes = sorted({size for _, size in records})
    about = "Means of the runs, with bootstrap intervals of 95 %. [The searches](../../../docs/benchmark.md#board)."
    parts = ["# The board", about]
    for size, budget in product(sizes, BUDGETS):
        lines = []
        for name, title in titles.items():
            record = records.get((name, size))
            if record and budget in record["evaluations"]:
                at = record["evaluations"].index(budget)
                values = [np.array(record[field], float)[:, at] for field in Scores._fields]
                lines.append([title, *map(_cell, values)])
        if lines:
            parts += [f"{size}-{budget}", table(["search", *Scores._fields], lines)]
    write(out / "board.md", "\n\n".join(part.rstrip() for part in parts) + "\n")


def _cell(values: NDArray[np.float64]) -> str:
    if np.isnan(values).all():
        return ""
    low, high = confidence_interval(values)
    return f"{np.nanmean(values):.2f} ({low:.2f} to {high:.2f})"


def _read_table(file: Path) -> dict[str, dict[str, dict[str, list[list[float]]]]]:
    """Reads a table: by size, score and search, the budgets, each with the mean and both ends of its interval."""
    found: dict = defaultdict(lambda: defaultdict(lambda: defaultdict(list)))
    size, budget = "", 0.0
    for line in file.read_text(encoding="utf-8").splitlines():
        if heading := re.fullmatch(r"(\w+)-(\d+)", line):
            size, budget = heading[1], float(heading[2])
        elif line.startswith("| ") and not line.startswith(("| search ", "| ---")):
            title, *cells = (cell.strip() for cell in line.split("|")[1:-1])
            for field, cell in zip(Scores._fields, cells, strict=True):
                if cell:
                    found[size][field][title].append([budget, *map(float, re.findall(r"[\d.]+", cell))])
    return found


def _draw(out: Path) -> None:
    """Plots reliability and the share of niches at the optimum in the table against evaluations, by size."""
    scores = _read_table(out / "board.md")
    figure, axes = plt.subplots(
        2,
        len(scores),
        figsize=(max(8, 2.4 * len(scores)), 6.5),
        layout="constrained",
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    titles = dict.fromkeys(title for of_size in scores.values() for title in of_size["reliability"])
    colours, lines = dict(zip(titles, cycle(_COLOURS), strict=False)), {}
    for column, (size, of_size) in zip(axes.T, scores.items(), strict=True):
        column[0].set_title(size)
        for axis, field in zip(column, ("reliability", "optimal"), strict=True):
            for title, values in of_size[field].items():
                evaluations, means, *ends = np.transpose(values)
                (lines[title],) = axis.plot(evaluations, means, "o-", markersize=3, color=colours[title])
                axis.fill_between(evaluations, *ends, color=colours[title], alpha=0.15, linewidth=0)
            axis.set(xscale="log", ylim=(-0.02, 1.02))
            axis.grid(alpha=0.3)
        column[1].set_xlabel("evaluations of a run")
    axes[0, 0].set_ylabel("reliability")
    axes[1, 0].set_ylabel("share of niches at the optimum")
    shown = [title for title in titles if title in lines]
    names = [title.replace("`", "") for title in shown]
    figure.legend([lines[title] for title in shown], names, loc="outside lower center", ncols=2, fontsize=9)
    save(figure, out / "board.png")


def _read(file: Path) -> dict:
    return dict(json.loads(file.read_text(encoding="utf-8")))


if __name__ == "__main__":
    leave(main())
