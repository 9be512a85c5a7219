"""The board: scores of what rows find, its files, table and curves."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from elitelanes_jax.benchmark import Submission
from elitelanes_jax.benchmark.tasks import BUDGETS, find_task
from elitelanes_jax.cli.main import main as command
from experiments.search import board, tune
from experiments.search.board_rows import ROWS, TUNED, Row

ROOT = Path(__file__).parents[2]
TASK = find_task("5x5A-10000")


def play(task, seeds, budgets):
    """Finds the first niche's optimum from 5,000 evaluations on, and all others' at the end of odd runs."""
    grids = np.zeros((len(seeds), len(budgets), len(task.cyclomatic), *task.shape), np.int8)
    grids[:, np.array(budgets) >= 5000, 0] = task.witnesses[0]
    grids[1::2, -1] = task.witnesses
    return grids


@pytest.fixture
def published(tmp_path, monkeypatch):
    """A board of one row, of which the graded score is not known."""
    lines = [f"5x5A,ea,10000,{field},11,0.25,0.2,0.3" for field in board.FIELDS[:-1]]
    file = tmp_path / "published" / "board.csv"
    file.parent.mkdir()
    file.write_text("\n".join(["size,row,evaluations,score,runs,mean,low,high", *lines]))
    monkeypatch.setattr(board, "PUBLISHED", file)


def rows_of(table):
    lines = [line for line in table.read_text().splitlines() if line.startswith("| ")][2:]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


def test_a_row_is_measured_and_compared_with_the_published_rows(tmp_path, monkeypatch, capsys, published):
    monkeypatch.setitem(ROWS, "tuned", Row("Ours", play))
    assert board.main(["tuned", "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert (
        "tuned, 5x5A-10000, 10 runs: coverage 0.750, reliability 0.750, precision 1.000, optimal 0.750, graded 0.750"
        in (capsys.readouterr().out)
    )
    assert Submission.load(tmp_path / "tuned-5x5A-10000.npz").grids.shape == (10, 1, 2, 5, 5)
    assert command(["score", str(tmp_path / "tuned-5x5A-10000.npz")]) == 0
    scores = ["0.75 (0.60 to 0.90)"] * 2 + ["1.00 (1.00 to 1.00)"] + ["0.75 (0.60 to 0.90)"] * 2
    assert rows_of(tmp_path / "board.md") == [["Ours", *scores], [ROWS["ea"].title, *["0.25 (0.20 to 0.30)"] * 4, ""]]
    assert (tmp_path / "board.png").read_bytes()[:4] == b"\x89PNG"
    data = (tmp_path / "board.csv").read_text().splitlines()
    assert data[2] == "5x5A,tuned,10000,reliability,10,0.75,0.6,0.9" and data[6].startswith(
        "5x5A,ea,10000,coverage,11,"
    )
    monkeypatch.setitem(ROWS, "ea", Row("EA", play))  # a row of one's own replaces the published one
    assert board.main(["ea", "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert rows_of(tmp_path / "board.md") == [["Ours", *scores], ["EA", *scores]]


OWN = """
def search(task, rng):
    yield task.witnesses[: rng.integers(1, 3)]
"""


def test_a_search_of_ones_own_gets_a_row_beside_the_published_ones(tmp_path, capsys, published):
    own = tmp_path / "own.py"
    own.write_text(OWN)
    assert board.main([str(own), "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert "own, 5x5A-10000, 10 runs: coverage 0." in capsys.readouterr().out
    other, row = rows_of(tmp_path / "board.md")
    assert (other[0], row[0]) == (ROWS["ea"].title, "own") and row[3] == "1.00 (1.00 to 1.00)"
    assert command(["score", str(tmp_path / "own-5x5A-10000.npz")]) == 0


def test_rows_of_files_are_drawn_otherwise_and_change_no_colour():
    names = list(ROWS)
    of_board = board._looks(names)
    looks = board._looks(["own", *names, "variant"])
    assert {name: looks[name] for name in names} == of_board
    assert len(set(looks.values())) == len(names) + 2
    _, size_of_own_mark, _ = looks["own"]
    assert all(size_of_own_mark > size for _, size, _ in of_board.values())


def test_a_missing_package_is_named(monkeypatch, capsys):
    monkeypatch.setattr("experiments.common.find_spec", lambda name: None)
    assert board.main(["ribs-moves", "--tasks", TASK.name]) == 2
    assert capsys.readouterr().err == "board: ribs-moves needs ribs: pip install ribs\n"
    assert board.main(["--table"]) == 2
    assert capsys.readouterr().err == "board: the picture of --table needs matplotlib: pip install matplotlib\n"


def test_vacant_archives_have_no_precision(tmp_path, monkeypatch, published):
    monkeypatch.setitem(ROWS, "tuned", Row("Ours", lambda *arguments: 0 * play(*arguments)))
    assert board.main(["tuned", "--tasks", TASK.name, "--out", str(tmp_path), "--table"]) == 0
    assert rows_of(tmp_path / "board.md")[0] == ["Ours", *["0.00 (0.00 to 0.00)"] * 2, "", *["0.00 (0.00 to 0.00)"] * 2]


def test_the_table_of_the_page_is_that_of_the_published_scores(tmp_path):
    """Graded score, reliability and optimal shares of the page, by size, search and budget."""
    published = board.read_board(tmp_path)
    page = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    for size in ("6x6B", "7x7A", "7x7B", "8x8A", "9x9B", "12x12A"):
        heading = f"\n{size[:-1].replace('x', ' x ')} {size[-1]}: graded score, reliability, and the share"
        (table,) = re.findall(rf"{heading}.*?\n\n(.*?)\n\n", page, re.DOTALL)
        rows = [[cell.strip() for cell in row.split("|")[1:-1]] for row in table.splitlines()[2:]]
        expected = {}
        for place, scores in published.items():
            if place.size == size:
                cells = expected.setdefault(place.row, [board._title(place.row), "", "", ""])
                means = [
                    f"{scores[name].mean:.2f}" if name in scores else "–"
                    for name in ("graded", "reliability", "optimal")
                ]
                cells[1 + BUDGETS.index(place.evaluations)] = ", ".join(means)
        assert rows == list(expected.values()) and len(rows) > 5


def test_the_table_is_made_from_the_published_scores(tmp_path):
    published = board.read_board(tmp_path)
    assert board._table(published) == board.PUBLISHED.with_suffix(".md").read_text(encoding="utf-8")
    assert all(
        score.runs >= 10 and 0 <= score.low <= score.mean <= score.high <= 1
        for scores in published.values()
        for score in scores.values()
    )


def test_settings_are_drawn_as_often_as_each_other():
    for row, (_, choices) in TUNED.items():
        drawn = tune.draw_settings(choices)
        assert drawn == tune.draw_settings(choices) and len(drawn) == 8
        for name, values in choices.items():
            counts = [sum(settings[name] == value for settings in drawn) for value in values]
            assert max(counts) - min(counts) <= 1
        trials = json.loads((ROOT / f"experiments/search/results/tuning/{row}.json").read_text())["trials"]
        assert [trial["settings"] for trial in trials] == drawn


def test_trials_are_kept_and_continued(tmp_path, monkeypatch, capsys):
    played = []

    def made(**settings):
        played.append(settings)
        return play

    choices = {"size": (1, 2, 3, 4), "share": (0.0, 0.5)}
    monkeypatch.setitem(TUNED, "tried", (made, choices))
    monkeypatch.setattr(tune, "_TASKS", [TASK])
    assert tune.main(["tried", "--out", str(tmp_path)]) == 0
    assert len(played) == 8 and "reliability 0.750" in capsys.readouterr().out
    content = json.loads((tmp_path / "tried.json").read_text())
    (tmp_path / "tried.json").write_text(json.dumps(content | {"trials": content["trials"][:5]}))
    assert tune.main(["tried", "--out", str(tmp_path)]) == 0
    assert len(played) == 11
    assert tune.main(["none", "--out", str(tmp_path)]) == 2
    assert "ROW: expected one of qdax-dns" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["best"], "ROW: expected one of paper, standard, tuned"),
        (["best.py"], "best.py: expected a file with a function search, got none"),
        ([__file__], "or FILE.py with a function search, got /"),
        ([], "got none"),
        (["tuned", "--tasks", "5x5A"], "task: expected SIZE-BUDGET"),
    ],
)
def test_it_names_what_is_wrong(arguments, words, tmp_path, capsys):
    assert board.main([*arguments, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
