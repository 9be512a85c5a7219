"""The paper's study: its statistics, its tables, its folder of results."""

import csv
import json
import shutil

import numpy as np
import pytest
from folders import files
from oracle import fitness as oracle_fitness
from oracle import measure as oracle

from elitelanes_jax.network.records import METRIC_NAMES, Weights, check_weights
from elitelanes_jax.network.wfc import generate_batch
from experiments.paper import runs
from experiments.paper.compare import main as compare
from experiments.paper.published import METHODS, METRICS, TABLE
from experiments.paper.readings import READINGS

# The search is compiled for three seeds and for one alone; all tests use these programs.
SMALL = ["--methods", "map-elites", "wfc", "--sizes", "5", "--seeds", "3", "--generations", "4", "--no-maps"]

SEARCHED, COLLAPSED = (f"runs/{method}-5x5.json" for method in ("map-elites", "wfc"))


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    out = tmp_path_factory.mktemp("compared") / "out"
    assert compare([*SMALL, "--out", str(out)]) == 0
    return out


@pytest.fixture
def unfinished(compared, tmp_path):
    """A folder of the same study in which only the search is done."""
    out = tmp_path / "out"
    (out / "runs").mkdir(parents=True)
    for name in ("settings.json", SEARCHED):
        shutil.copy(compared / name, out / name)
    return out


def rows_of(folder):
    with (folder / "results.csv").open() as file:
        return list(csv.DictReader(file))


def test_the_papers_tables_agree_with_its_text():
    assert set(TABLE) == set(METHODS)
    assert all(tuple(row) == tuple(METRICS) for row in TABLE.values())
    assert TABLE["wfc"]["dead_ends"] == TABLE["wfc"]["boundary_violations"] == (26.25, 3.096)
    assert {method for method, row in TABLE.items() if row["boundary_violations"].mean} == {"wfc"}
    assert all(row["coverage"] == (1, 0) for row in TABLE.values())


def test_every_reading_has_valid_settings_and_differs():
    for name, reading in READINGS.items():
        assert reading.about, name
        check_weights(reading.weights, (12, 12))
    assert READINGS["ours"].weights == Weights()
    assert len({str(reading[1:]) for reading in READINGS.values()}) == len(READINGS)


@pytest.mark.slow
def test_a_study_writes_tables_plots_and_its_runs(compared):
    assert set(files(compared)) == {
        "settings.json", SEARCHED, COLLAPSED, "results.csv", "tables.md", "timing.md", "comparison.png",
    }  # fmt: skip
    text = (compared / "tables.md").read_text()
    for words in ("5 x 5 tiles, 3 seeds, 4 generations of 40", "QD score"):
        assert words in text
    assert "| WFC |" in (compared / "timing.md").read_text()


@pytest.mark.slow
def test_rows_agree_with_the_grids(compared):
    rows = rows_of(compared)
    assert len(rows) == 3 * 3 + 3
    for method in ("map-elites", "wfc"):
        kept = json.loads((compared / "runs" / f"{method}-5x5.json").read_text())
        best = [row for row in rows if row["method"] == method and row["elite"] == "best"]
        assert [int(row["seed"]) for row in best] == [0, 1, 2]
        for row, codes in zip(best, kept[1], strict=True):
            expected = oracle(np.array(codes))
            assert {name: float(row[name]) for name in METRIC_NAMES} == {name: expected[name] for name in METRIC_NAMES}
            assert float(row["fitness"]) == oracle_fitness(expected)
            assert float(row["seconds"]) > 0
    archives = [row for row in rows if row["elite"] == "archive"]
    random = [row for row in rows if row["elite"] == "random"]
    assert len(archives) == len(random) == 3
    for row in archives:
        assert int(row["qd_score"]) == pytest.approx(int(row["niches"]) * (480 * 25 - float(row["fitness"])))


@pytest.mark.slow
def test_a_study_that_is_interrupted_continues(compared, tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr(runs, "generate_batch", interrupt)
        assert compare([*SMALL, "--out", str(out)]) == 130
    assert capsys.readouterr().err == "compare: interrupted; finished parts are kept; the same command continues\n"
    assert set(files(out)) == {"settings.json", SEARCHED}
    # The kept run is used as it is: no search could take so long.
    rows, *rest = json.loads((out / SEARCHED).read_text())
    rows = [[*row[:-1], row[-1] | {"seconds": 12345.0}] for row in rows]
    (out / SEARCHED).write_text(json.dumps([rows, *rest]))
    assert compare([*SMALL, "--out", str(out)]) == 0
    assert {row["seconds"] for row in rows_of(out) if row["method"] == "map-elites"} == {"12345.0"}
    assert [row | {"seconds": ""} for row in rows_of(out)] == [row | {"seconds": ""} for row in rows_of(compared)]
    for name in ("tables.md", "comparison.png"):
        assert (out / name).read_bytes() == (compared / name).read_bytes()


@pytest.mark.slow
def test_wfc_that_fails_is_counted_and_the_search_is_reported(unfinished, monkeypatch, capsys):
    failed = {"success": np.array([False])}
    monkeypatch.setattr(runs, "generate_batch", lambda *given: generate_batch(*given)._replace(**failed))
    assert compare([*SMALL, "--out", str(unfinished)]) == 0
    assert "wfc 5x5: 0 of 3 runs succeeded" in capsys.readouterr().out
    text = (unfinished / "tables.md").read_text()
    assert "| MAP-Elites, random elite |" in text
    assert "| WFC |" not in text


@pytest.mark.slow
def test_maps_are_drawn_and_the_papers_figures_stand_beside_its_size(tmp_path):
    out = tmp_path / "out"
    assert compare(["--methods", "wfc", "--sizes", "12", "14", "--paper", "--out", str(out)]) == 0
    place = out / "maps_14x14" / "wfc"
    assert set(files(place)) == {"image.png", "road.png", "red.png", "yellow.png", "labels.png", "map.json"}
    assert {"comparison_12x12.png", "comparison_14x14.png"} < set(files(out))
    assert json.loads((out / "settings.json").read_text())["seeds"] == 4
    of_12, of_14 = (out / "tables.md").read_text().split("# 14 x 14 tiles")
    assert "| *paper* | 4.75" in of_12
    assert "| *paper* |" not in of_14


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "ea", "luck"], "argument --methods: invalid choice: 'luck' "),
        (["--sizes", "1"], "argument --sizes: expected a size, 12 or 9x14, sides from 2 to 1024, got '1'"),
        (["--seeds", "0"], "argument --seeds: expected a whole number, 1 to 1048576, got '0'"),
    ],
)
def test_a_users_mistake_is_one_line_and_exit_code_2(arguments, message, tmp_path, capsys):
    try:
        code = compare([*SMALL, *arguments, "--out", str(tmp_path / "out")])
    except SystemExit as stop:
        code = stop.code
    captured = capsys.readouterr()
    assert code == 2
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())
