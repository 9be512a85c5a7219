"""The leaderboard of tasks of two descriptors: entries, drafts, the checker, and the page."""

import json
from shutil import copytree

import jax.numpy as jnp
import numpy as np
import pytest

from elitelanes_jax.benchmark import Submission, find_task
from experiments.search import leaderboard
from experiments.search.track_rows import CITATIONS, TRACK_ROWS, dominated_novelty

TASK = "5x5B-straights-10000"

OWN = """
TITLE, CITATION = "my climber", "a stranger, 2026"


def search(task, rng, operators):
    grids = operators.random(50)
    while True:
        yield grids
        grids = operators.mutate(grids)
"""


def measure(tmp_path, *arguments, runs=10):
    own = tmp_path / "links" / "own.py"
    own.parent.mkdir(exist_ok=True)
    own.write_text(OWN)
    line = [str(own), "--track", "links", "--tasks", TASK, "--runs", str(runs), "--out", str(tmp_path), *arguments]
    return leaderboard.main(line)


@pytest.fixture
def unpublished(tmp_path_factory, monkeypatch):
    monkeypatch.setattr(leaderboard, "PUBLISHED", tmp_path_factory.mktemp("none"))


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory):
    """A folder with two measured runs, for copies: measuring takes seconds."""
    folder = tmp_path_factory.mktemp("runs")
    assert measure(folder, runs=2) == 0
    return folder


@pytest.mark.slow
def test_a_stranger_adds_a_row_that_is_checked(tmp_path, capsys, unpublished):
    assert measure(tmp_path) == 0 and measure(tmp_path, "--check", "--replay", "1", "--page") == 0
    printed = capsys.readouterr().out
    assert f"links, own, {TASK}: kept, 10 runs" in printed
    assert "10 runs, scores measured again, 1 run again, equal bit for bit" in printed
    page = (tmp_path / "leaderboard.md").read_text()
    assert "| my climber | a stranger, 2026 | 10 | 0.0" in page and "0 of 0" not in page
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_drafts_are_measured_and_left_out(tmp_path, capsys, unpublished):
    assert measure(tmp_path, "--check", runs=2) == 0
    assert "2 runs, a draft, because the board takes 10 or more" in capsys.readouterr().out
    assert leaderboard.read_entries(tmp_path) == []


def changed_archive(file, entry):
    submission = Submission.load(file.with_suffix(".npz"))
    grids = submission.grids.copy()
    grids[0] = 0
    submission._replace(grids=grids).save(file.with_suffix(".npz"))
    return entry


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda file, entry: entry | {"seeds": list(range(1, 3))}, "expected seeds [0, 1], got [1, 2]"),
        (lambda file, entry: entry | {"evaluations": [100]}, "expected evaluations [100, 200, 500"),
        (lambda file, entry: entry | {"version": 1}, "expected version 2, got 1"),
        (lambda file, entry: entry | {"citation": " "}, "expected a text citation, got ' '"),
        (lambda file, entry: entry | {"track": "moves"}, "expected track links, got moves"),
        (lambda file, entry: entry | {"coverage": (np.array(entry["coverage"]) + 0.1).tolist()}, "coverage as in"),
        (
            lambda file, entry: entry | {"graded": (np.array(entry["graded"]) + 0.1).tolist()},
            "graded as in the archive",
        ),
        (lambda file, entry: entry | {"archives": entry["archives"][::-1]}, "others in runs [0, 1] of 2"),
        (lambda file, entry: {name: entry[name] for name in entry if name != "task"}, "an entry with task"),
        (changed_archive, "others in runs [0] of 2"),
        (lambda file, entry: entry | {"optimal": np.full(np.shape(entry["optimal"]), np.nan).tolist()}, "from 0 to 1"),
        (lambda file, entry: entry | {"graded": np.full(np.shape(entry["graded"]), 7.5).tolist()}, "from 0 to 1"),
        (lambda file, entry: entry | {"graded": [[1.0], [1.0, 1.0]]}, "expected an entry"),
        (lambda file, entry: entry | {"seeds": 10}, "expected seeds [0], got 10"),
        (lambda file, entry: entry | {"archives": None}, "expected archives of runs: 2, got None"),
        (lambda file, entry: entry | {"title": None}, "expected a text title, got None"),
        (lambda file, entry: entry | {"title": "best"}, "expected a title my climber, got best"),
        (lambda file, entry: entry | {"program": "0"}, "expected results of own.py with the checksum"),
    ],
)
def test_the_checker_names_what_is_wrong(change, words, tmp_path, capsys, unpublished, two_runs):
    copytree(two_runs, tmp_path, dirs_exist_ok=True)
    file = tmp_path / "links" / f"own-{TASK}.json"
    file.write_text(json.dumps(change(file, json.loads(file.read_text()))))
    assert leaderboard.main(["--check", "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"leaderboard: {file}: ") and words in line


def test_entries_that_were_changed_are_neither_kept_nor_drawn(tmp_path, capsys, unpublished):
    assert measure(tmp_path, runs=2) == 0
    own = tmp_path / "links" / "own.py"
    own.write_text(own.read_text() + "# Another search.\n")
    line = [str(own), "--track", "links", "--tasks", TASK, "--runs", "2", "--out", str(tmp_path)]
    assert leaderboard.main(line) == 2
    assert "expected results of this own.py, got those of another" in capsys.readouterr().err
    file = tmp_path / "links" / f"own-{TASK}.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | {"citation": 5}))
    assert leaderboard.main(["--page", "--out", str(tmp_path)]) == 2
    assert "expected a text citation, got 5" in capsys.readouterr().err
    own.rename(own.with_name("map-elites.py"))
    line[0] = str(own.with_name("map-elites.py"))
    assert leaderboard.main(line) == 2
    assert "expected a name that no row of the track has, got map-elites" in capsys.readouterr().err


def test_the_checker_measures_witnesses_as_optimal(tmp_path):
    task = find_task(TASK)
    grids = np.broadcast_to(task.witnesses, (2, len(task.budgets), *task.witnesses.shape)).copy()
    grids[0, 0, 0] = 0
    scores = leaderboard._rescore(tmp_path, Submission(task, grids))
    _, expected = Submission(task, grids).score()
    for field, values in scores.items():
        np.testing.assert_allclose(values, getattr(expected, field))
    assert scores["coverage"][0, 0] == 50 / 51 and (scores["optimal"][1] == 1).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "ROW: expected a row, or --all, --check or --page, got none"),
        (["best"], "ROW: expected one of random, genetic, map-elites"),
        (["map-elites", "--tasks", "5x5B-10000"], "--tasks: expected a task of 5x5B-straights"),
        ([__file__], "expected a text TITLE, which the page shows, got None"),
        (["--check"], "expected entries in TRACK/ROW-TASK.json, got none"),
    ],
)
def test_it_says_what_is_wrong_with_a_command(arguments, words, tmp_path, capsys):
    assert leaderboard.main([*arguments, "--out", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line


def test_the_published_entries_are_complete_and_on_the_page():
    page = (leaderboard.PUBLISHED / "leaderboard.md").read_text(encoding="utf-8")
    files = sorted(leaderboard.PUBLISHED.glob("*/*.json"))
    for file in files:
        entry = json.loads(file.read_text(encoding="utf-8"))
        runs = len(entry["seeds"])
        assert leaderboard.check_entry(file).endswith(
            f"{runs} runs, scores not measured, because its archive is not here"
        )
        assert f"| {entry['title']} | {entry['citation']} | {len(entry['seeds'])} |" in page
    assert len(files) >= 20
    summary = leaderboard.make_summary(leaderboard.read_entries(leaderboard.PUBLISHED)).rstrip()
    root = leaderboard.PUBLISHED.parents[3]
    assert summary in page and summary in (root / "docs" / "leaderboard.md").read_text(encoding="utf-8")


def test_each_row_has_a_citation():
    assert {name for rows in TRACK_ROWS.values() for name in rows} == set(CITATIONS)


def test_dominated_novelty_is_the_mean_distance_to_the_nearest_fitter():
    fitness = jnp.array([5.0, 1.0, 3.0, 3.0, 9.0, 0.0])
    descriptors = jnp.array([[0.0, 0], [3, 4], [0, 1], [0, 2], [0, 0], [0, 0]])
    valid = jnp.array([True, True, True, True, True, False])
    found = dominated_novelty(fitness, descriptors, valid)
    three = (np.hypot(3, 3) + 0) / 1
    expected = [(5 + 1 + 2) / 3, np.inf, three, np.hypot(3, 2), (0 + 1 + 2) / 3, -np.inf]
    np.testing.assert_allclose(found, expected, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["random", "genetic", "map-elites", "dns"])
def test_rows_of_a_track_repeat_alone_and_together(name):
    task, row = find_task(TASK), TRACK_ROWS["links"][name]
    together = row.play(task, range(2), task.budgets)
    np.testing.assert_array_equal(row.play(task, range(1), task.budgets)[0], together[0])
