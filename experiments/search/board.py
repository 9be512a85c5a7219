"""The board of the benchmark: searches of this package and of other libraries, each in its own loop.

    python -m experiments.search.board ROW ... [--tasks 6x6B-10000 ...] [--runs N] [--out DIR]
    python -m experiments.search.board ROW ... --table [--out DIR]
    python -m experiments.search.board --table [--out DIR]

A row runs on each task: one of the board's, or a Python file of yours with a function `search` as
`elitelanes_jax.benchmark.run_task` takes it. The program writes its raw archive, which `elitelanes score` measures, and
its scores. `--table` writes a table of the published scores and of the rows in the folder, the same as data, and a
picture. QDax, evosax and pyribs come with the extra `interop`.

All grids that a search evaluates are offered to a record of the best network of each niche, which the search does not
see. The record of the tuned EA has the grids that its chains move to.
"""

import argparse
import csv
import io
import json
import runpy
import time
from collections.abc import Sequence
from itertools import cycle, product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import InputError, benchmark
from elitelanes_jax.benchmark import (
    SIZES,
    Scores,
    Submission,
    Task,
    confidence_interval,
    find_task,
)
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, leave, require, run, save, table, whole, write
from experiments.search.board_rows import ROWS, Row

__all__ = ["FIELDS", "PUBLISHED", "TASKS", "Board", "Place", "Score", "main", "read_board"]

TASKS = [f"{size}-1000000" for size in ("6x6B", "7x7B")]

PUBLISHED = Path(__file__).parent / "results" / "board.csv"
"""The scores of all rows of the board, one on each line."""

FIELDS = (*Scores._fields, "graded")
"""The names of the scores."""

_COLOURS = (*(f"C{index}" for index in range(10)), "black", "gold", "navy")

_LIBRARIES = ("qdax", "ribs", "evosax")
"""Other libraries. A row whose name begins with one of them needs its package."""

Record = dict[str, Any]
"""The scores of a row on a task: `row`, `task`, `evaluations`, `seconds`, and each of `FIELDS` by run and budget."""


class Place(NamedTuple):
    """A row of the board, on a size and at a budget."""

    size: str
    row: str
    evaluations: int


class Score(NamedTuple):
    """The mean of a score over runs, with its bootstrap interval of 95 %."""

    runs: int
    mean: float
    low: float
    high: float

    @classmethod
    def of(cls, values: NDArray[np.float64]) -> "Score":
        low, high = confidence_interval(values)
        return cls(len(values), *(round(float(value), 4) for value in (np.nanmean(values), low, high)))


Board = dict[Place, dict[str, Score]]
"""The scores at each place, by name. The precision is missing if no run has a flawless network."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("board", __doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW", help=f"one of {', '.join(ROWS)}, or a file FILE.py")
    parser.add_argument("--tasks", nargs="+", default=TASKS, metavar="TASK", help=f"default {' '.join(TASKS)}")
    parser.add_argument("--runs", type=whole(10), default=10, metavar="N", help="of each task; default 10, the least")
    parser.add_argument("--out", type=Path, default=Path("results/board"), metavar="DIR", help="folder of results")
    parser.add_argument("--table", action="store_true", help="write a table of published and own scores")
    options = parser.parse_args(arguments)
    return run("board", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    if not (options.rows or options.table):
        raise InputError("ROW", f"one of {', '.join(ROWS)}, or FILE.py", "none")
    if options.table:
        require("the picture of --table needs", "matplotlib")
    rows = dict(_find_row(name) for name in options.rows)
    tasks = [find_task(name) for name in options.tasks]
    use_compile_cache()
    for name, row in rows.items():
        for task in tasks:
            _measure_row(name, row, task, options.runs, options.out)
    if options.table:
        _write_board(read_board(options.out), options.out)
        print(f"written to {options.out}")


def _find_row(name: str) -> tuple[str, Row]:
    """Returns a row of the board by its name, or a row that runs the search in a file."""
    if name in ROWS:
        library = name.partition("-")[0]
        if library in _LIBRARIES:
            require(f"{name} needs", library)
        return name, ROWS[name]
    file = Path(name)
    if file.suffix == ".py" and not file.is_file():
        raise InputError(file, "a file with a function search", "none")
    search = runpy.run_path(name).get("search") if file.suffix == ".py" else None
    if not callable(search):
        raise InputError("ROW", f"one of {', '.join(ROWS)}, or FILE.py with a function search", name)

    def play(task: Task, seeds: range, budgets: Sequence[int]) -> NDArray[np.int8]:
        return benchmark.run_task(task, search, seeds).grids

    return file.stem, Row(file.stem, play)


def _measure_row(name: str, row: Row, task: Task, runs: int, out: Path) -> None:
    """Runs a row on a task; writes its raw archive and its scores."""
    began = time.process_time()
    submission = Submission(task, row.play(task, range(runs), task.budgets))
    seconds = time.process_time() - began
    _, scores = submission.score()
    of_runs = scores._asdict() | {"graded": submission.grade()}
    submission.save(out / f"{name}-{task.name}.npz")
    record: Record = {"row": name, "task": task.name, "evaluations": list(task.budgets), "seconds": round(seconds, 1)}
    for field, values in of_runs.items():
        rounded = np.round(values, 4).astype(object)
        rounded[np.isnan(values)] = None  # JSON has no NaN
        record[field] = rounded.tolist()
    write(out / f"{name}-{task.name}.json", json.dumps(record) + "\n")
    last = {field: values[:, -1] for field, values in of_runs.items()}
    means = [f"{field} {np.nanmean(values):.3f}" for field, values in last.items() if not np.isnan(values).all()]
    print(f"{name}, {task.name}, {runs} runs: {', '.join(means)} ({seconds:.0f} s)", flush=True)


def read_board(folder: Path) -> Board:
    """Reads the published scores and those of the rows in a folder, which replace the published ones.

    The places are sorted by size, and within a size in the order of the rows. Rows of yours follow by name.
    """
    board: Board = {}
    with PUBLISHED.open(encoding="utf-8", newline="") as file:
        for line in csv.DictReader(file):
            place = Place(line["size"], line["row"], int(line["evaluations"]))
            score = Score(int(line["runs"]), float(line["mean"]), float(line["low"]), float(line["high"]))
            board.setdefault(place, {})[line["score"]] = score
    records = [json.loads(file.read_text(encoding="utf-8")) for file in folder.glob("*-*.json")]
    for record in sorted(records, key=lambda record: len(record["evaluations"])):
        for index, evaluations in enumerate(record["evaluations"]):
            place = Place(record["task"].split("-")[0], record["row"], evaluations)
            of_runs = {field: np.array(record[field], float)[:, index] for field in FIELDS}
            board[place] = {field: Score.of(values) for field, values in of_runs.items() if np.isfinite(values).any()}
    return dict(sorted(board.items(), key=lambda item: _order(item[0])))


def _order(place: Place) -> tuple[int, int, str, int]:
    names = list(ROWS)
    index = names.index(place.row) if place.row in names else len(names)
    return SIZES.index(place.size), index, place.row, place.evaluations


def _title(row: str) -> str:
    return ROWS[row].title if row in ROWS else row


def _write_board(board: Board, out: Path) -> None:
    """Writes a board as data, as a table and as a picture."""
    lines = io.StringIO(newline="")
    writer = csv.writer(lines, lineterminator="\n")
    writer.writerow([*Place._fields, "score", *Score._fields])
    writer.writerows([*place, field, *score] for place, scores in board.items() for field, score in scores.items())
    write(out / "board.csv", lines.getvalue())
    write(out / "board.md", _table(board))
    _draw(board, out / "board.png")


def _table(board: Board) -> str:
    about = "Means of the runs, with bootstrap intervals of 95 %. [The searches](../../../docs/benchmark.md#board)."
    parts = ["# The board", about]
    budgets = sorted({place.evaluations for place in board})
    for size, budget in product(_sizes(board), budgets):
        lines = [
            [_title(place.row), *(_cell(scores.get(field)) for field in FIELDS)]
            for place, scores in board.items()
            if (place.size, place.evaluations) == (size, budget)
        ]
        if lines:
            parts += [f"{size}-{budget}", table(["search", *FIELDS], lines)]
    return "\n\n".join(part.rstrip() for part in parts) + "\n"


def _sizes(board: Board) -> list[str]:
    return list(dict.fromkeys(place.size for place in board))


def _cell(score: Score | None) -> str:
    return "" if score is None else f"{score.mean:.2f} ({score.low:.2f} to {score.high:.2f})"


def _looks(rows: Sequence[str]) -> dict[str, tuple[str, int, str]]:
    """Returns the mark, its size and the colour of each row.

    Rows of a file are dashed, with squares, because they are too many for colours of their own. They do not change
    the colours of the board's rows. Their squares are large, because a row with one budget is a mark without a line.
    """
    named_rows = [row for row in rows if row in ROWS]
    file_rows = [row for row in rows if row not in ROWS]
    looks = {row: ("o-", 3, colour) for row, colour in zip(named_rows, cycle(_COLOURS), strict=False)}
    looks |= {row: ("s--", 6, colour) for row, colour in zip(file_rows, cycle(_COLOURS), strict=False)}
    return looks


def _draw(board: Board, file: Path) -> None:
    """Plots graded score, reliability and the share of niches at the optimum against evaluations, by size.

    A size without a score has no panel of it.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    sizes, rows = _sizes(board), list(dict.fromkeys(place.row for place in board))
    labels = {"graded": "graded score", "reliability": "reliability", "optimal": "share of niches at the optimum"}
    figure, axes = plt.subplots(
        len(labels),
        len(sizes),
        figsize=(max(8, 2.4 * len(sizes)), 9),
        layout="constrained",
        sharex=True,
        sharey=True,
        squeeze=False,
    )
    looks, lines = _looks(rows), {}
    for row, size, (axis_row, field) in product(rows, sizes, enumerate(labels)):
        places = [place for place in board if (place.row, place.size) == (row, size) and field in board[place]]
        scores = [board[place][field] for place in places]
        if scores:
            axis, evaluations = axes[axis_row, sizes.index(size)], [place.evaluations for place in places]
            mark, size_of_mark, colour = looks[row]
            means = [score.mean for score in scores]
            (lines[row],) = axis.plot(evaluations, means, mark, markersize=size_of_mark, color=colour)
            low, high = [score.low for score in scores], [score.high for score in scores]
            axis.fill_between(evaluations, low, high, color=colour, alpha=0.15, linewidth=0)
    for axis in axes.flat:
        axis.set(xscale="log", ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
        axis.set_visible(axis.has_data())
    for size, column in zip(sizes, axes.T, strict=True):
        panels = [axis for axis in column if axis.has_data()]
        panels[0].set_title(size)
        panels[-1].set_xlabel("evaluations of a run")
    for axis, label in zip(axes[:, 0], labels.values(), strict=True):
        axis.set_ylabel(label)
    names = [_title(row).replace("`", "") for row in rows]
    figure.legend([lines[row] for row in rows], names, loc="outside lower center", ncols=2, fontsize=9)
    save(figure, file)


if __name__ == "__main__":
    leave(main())
