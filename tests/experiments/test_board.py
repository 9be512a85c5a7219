"""The board: scores of what rows find, its files, table and curves."""

import re
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax.benchmark.submissions import read_submission
from elitelanes_jax.benchmark.tasks import find_task
from elitelanes_jax.cli.main import main as command
from experiments.search import board
from experiments.search.board_rows import ROWS, Found, Row

ROOT = Path(__file__).parents[2]
TASK = find_task("5x5A-10000")


def play(task, runs, budgets):
    """Finds the first niche's optimum from 5,000 evaluations on, and all others' at the end of odd runs."""
    grids = np.zeros((runs, len(budgets), len(task.cyclomatic), *task.shape), np.int8)
    grids[:, np.array(budgets) >= 5000, 0] = task.witnesses[0]
    grids[1::2, -1] = task.witnesses
    there = grids.any(axis=(-1, -2))
    return Found(grids, np.where(there, task.optimum, 0), np.where(there, task.cyclomatic, 0))


def test_a_row_is_measured_and_told(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(ROWS, "tuned", Row("Ours", play))
    assert board.main(["tuned", "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert "tuned, 5x5A-10000, 10 runs: coverage 0.750, reliability 0.750, precision 1.000, optimal 0.750" in (
        capsys.readouterr().out
    )
    assert read_submission(tmp_path / "tuned-5x5A-10000.npz").grids.shape == (10, 1, 2, 5, 5)
    assert command(["score", str(tmp_path / "tuned-5x5A-10000.npz")]) == 0
    table = (tmp_path / "board.md").read_text()
    assert "| Ours | 0.75 (0.60 to 0.90) | 0.75 (0.60 to 0.90) | 1.00 (1.00 to 1.00) |" in table
    picture = tmp_path / "board.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"
    picture.unlink()
    assert board.main(["--picture", "--out", str(tmp_path)]) == 0 and picture.is_file()


OWN = """
def search(task, rng):
    yield task.witnesses[: rng.integers(1, 3)]
"""


def test_a_search_of_ones_own_gets_a_row_beside_the_others(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(ROWS, "tuned", Row("Ours", play))
    own = tmp_path / "own.py"
    own.write_text(OWN)
    assert board.main(["tuned", str(own), "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert "own, 5x5A-10000, 10 runs: coverage 0." in capsys.readouterr().out
    rows = [line for line in (tmp_path / "board.md").read_text().splitlines() if line.startswith(("| Ours", "| own"))]
    assert [row.split(" | ")[0] for row in rows] == ["| Ours", "| own"] and "| 1.00 (1.00 to 1.00) |" in rows[1]
    assert command(["score", str(tmp_path / "own-5x5A-10000.npz")]) == 0


def test_the_table_of_the_page_is_that_of_the_picture():
    """Reliability and optimal shares of the page, by size, search and budget."""
    found = board._read_table(ROOT / "experiments/search/results/board.md")
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    for size in found:
        heading = f"\n{size[:-1].replace('x', ' x ')} {size[-1]}: reliability, and the share"
        (table,) = re.findall(rf"{heading}.*?\n\n(.*?)\n\n", page, re.DOTALL)
        rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()[2:]]
        assert [title for title, *_ in rows] == list(found[size]["reliability"])
        for title, *cells in rows:
            both = [found[size][field][title] for field in ("reliability", "optimal")]
            means = [f"{one[1]:.2f}, {other[1]:.2f}" for one, other in zip(*both, strict=True)]
            assert [cell for cell in cells if cell] == means


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["best"], "ROW: expected one of paper, standard, tuned"),
        (["best.py"], "best.py: expected a file with a function search, got none"),
        ([__file__], "or FILE.py with a function search, got /"),
        ([], "got none"),
        (["tuned", "--tasks", "5x5A"], "task: expected SIZE-BUDGET"),
        (["--table"], "expected scores of rows, got none"),
    ],
)
def test_it_names_what_is_wrong(arguments, words, tmp_path, capsys):
    assert board.main([*arguments, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
