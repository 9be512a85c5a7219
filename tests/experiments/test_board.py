"""The board: scores of what rows find, its files, table and curves, and what its settings were chosen from."""

import json
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax.benchmark.submissions import read_submission
from elitelanes_jax.benchmark.tasks import find_task
from elitelanes_jax.cli.main import main as command
from experiments.search import board
from experiments.search.board_rows import ROWS, Found, Row

TASK = find_task("5x5A-10000")
TUNING = Path(board.__file__).parent / "results" / "tuning"


def play(task, first, runs, budgets, settings):
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
    assert (tmp_path / "board.png").read_bytes()[:4] == b"\x89PNG"


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


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["best"], "ROW: expected one of paper, standard, tuned"),
        (["best.py"], "best.py: expected a file with a function search, got none"),
        ([__file__], "or FILE.py with a function search, got /"),
        (["tuned", "--tune"], "expected a row with settings to tune, got one without"),
        ([], "got none"),
        (["tuned", "--tasks", "5x5A"], "task: expected SIZE-BUDGET"),
        (["--table"], "expected scores of rows, got none"),
    ],
)
def test_it_names_what_is_wrong(arguments, words, tmp_path, capsys):
    assert board.main([*arguments, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


@pytest.mark.parametrize("name", [name for name, row in ROWS.items() if row.choices])
def test_every_row_was_tuned_with_equal_effort_and_has_the_best_settings(name):
    record = json.loads((TUNING / f"{name}.json").read_text())
    assert (record["row"], record["seeds"], len(record["trials"])) == (name, 4, board.TRIALS)
    assert [trial["settings"] for trial in record["trials"]] == board.drawn_settings(name)
    assert {tuple(trial["reliability"]) for trial in record["trials"]} == {tuple(board.TUNED_ON)}
    assert max(record["trials"], key=board.mean_reliability)["settings"] == ROWS[name].settings


def test_tuning_goes_on_where_it_was(tmp_path, monkeypatch, capsys):
    played = []

    def play_twice(task, first, runs, budgets, settings):
        played.append((task.name, first, runs, settings["effort"]))
        if len(played) == 6:
            raise KeyboardInterrupt
        return play(task, first, runs, [budget // 10 * settings["effort"] for budget in budgets], settings)

    monkeypatch.setattr(board, "TUNED_ON", ["5x5A-10000", "6x6A-10000"])
    monkeypatch.setitem(ROWS, "tuned", Row("Ours", play_twice, {"effort": 8}, {"effort": tuple(range(1, 9))}))
    assert board.main(["tuned", "--tune", "--out", str(tmp_path)]) == 130
    (file,) = (tmp_path / "tuning").iterdir()
    assert [len(trial["reliability"]) for trial in json.loads(file.read_text())["trials"]] == [2, 2, 1, 0, 0, 0, 0, 0]
    assert board.main(["tuned", "--tune", "--out", str(tmp_path)]) == 0
    assert len(played) == 6 + 11
    assert sorted({one[3] for one in played}) == list(range(1, 9))
    assert "the best of 8: {'effort': " in capsys.readouterr().out
