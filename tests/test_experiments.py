"""The paper's study: its statistics, its tables, its folder of results."""

import csv
import json
from itertools import combinations

import numpy as np
import pytest
from ambiguities import main as ambiguities
from compare import main as compare
from oracle import fitness as oracle_fitness
from oracle import measure as oracle
from paper import METHODS, METRICS, TABLE
from readings import READINGS
from results_folder import kept, open_results
from runs import run_method
from scaling import main as scaling
from significance import bootstrap_interval, compare_all, holm
from throughput import main as throughput

from elitelanes_jax import InputError, Weights
from elitelanes_jax.folders import write_whole
from elitelanes_jax.metrics import COUNTED
from elitelanes_jax.objective import check_weights

SMALL = ["--methods", "ea", "map-elites", "wfc", "--sizes", "5", "--seeds", "3", "--generations", "4"]


pytestmark = pytest.mark.usefixtures("own_compile_cache")


@pytest.fixture(scope="module")
def compared(own_compile_cache, tmp_path_factory):
    out = tmp_path_factory.mktemp("compared") / "out"
    assert compare([*SMALL, "--no-maps", "--out", str(out)]) == 0
    return out


def rows_of(folder):
    with (folder / "results.csv").open() as file:
        return list(csv.DictReader(file))


def test_holm_is_the_rule_one_after_another():
    rng = np.random.default_rng(0)
    for count in (1, 2, 7):
        chances = rng.random(count).tolist()
        expected, highest = {}, 0.0
        for rank, place in enumerate(sorted(range(count), key=lambda place: chances[place])):
            highest = max(highest, min(1, (count - rank) * chances[place]))
            expected[place] = highest
        np.testing.assert_allclose(holm(chances), [expected[place] for place in range(count)])
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])


def test_effects_are_shares_of_pairs():
    rng = np.random.default_rng(1)
    samples = {name: rng.integers(0, 6, 9).tolist() for name in "abc"}
    comparisons = compare_all(samples)
    assert list(comparisons) == list(combinations("abc", 2))
    for (one, other), (effect, p) in comparisons.items():
        pairs = [(x > y) - (x < y) for x in samples[one] for y in samples[other]]
        assert effect == pytest.approx(np.mean(pairs))
        assert 0 <= p <= 1
    apart = compare_all({"low": range(10), "high": range(20, 30)})["low", "high"]
    assert apart.effect == -1
    assert apart.p < 0.001
    assert compare_all({"one": [1] * 5, "same": [1] * 5})["one", "same"] == (0, 1)


def test_intervals_hold_the_mean_and_shrink():
    rng = np.random.default_rng(2)
    few, many = rng.normal(5, 2, 10), rng.normal(5, 2, 1000)
    for sample in (few, many):
        low, high = bootstrap_interval(sample)
        assert low < sample.mean() < high
        assert high - low == pytest.approx(2 * 1.96 * sample.std() / np.sqrt(sample.size), rel=0.25)
    assert bootstrap_interval([3, 3, 3]) == (3, 3)


def test_the_papers_tables_agree_with_its_text():
    assert set(TABLE) == set(METHODS)
    assert all(tuple(row) == tuple(METRICS) for row in TABLE.values())
    assert TABLE["wfc"]["dead_ends"] == TABLE["wfc"]["boundary_violations"] == (26.25, 3.096)
    assert {method for method, row in TABLE.items() if row["boundary_violations"].mean} == {"wfc"}
    assert all(row["coverage"] == (1, 0) for row in TABLE.values())


def test_every_reading_is_a_valid_setting():
    for name, reading in READINGS.items():
        assert reading.about, name
        check_weights(reading.weights, (12, 12))
        for config in reading.configs.values():
            config.checked()
    assert READINGS["ours"].weights == Weights()
    assert len({str(reading[1:]) for reading in READINGS.values()}) == len(READINGS)


def test_what_is_written(compared):
    names = {str(path.relative_to(compared)) for path in compared.rglob("*") if path.is_file()}
    runs = {f"runs/{method}-5x5.json" for method in ("ea", "map-elites", "wfc")}
    assert names == runs | {
        "settings.json", "results.csv", "tables.md", "timing.md", "comparison.png", "comparison.pdf",
    }  # fmt: skip
    text = (compared / "tables.md").read_text()
    for words in ("5 x 5 tiles, 3 seeds, 4 generations of 40", "| EA over WFC |", "QD score"):
        assert words in text
    assert "| *paper* |" not in text, "that is of 12 x 12"
    assert "| WFC |" in (compared / "timing.md").read_text()


def test_rows_are_what_the_grids_are(compared):
    rows = rows_of(compared)
    assert len(rows) == 3 + 3 * 3 + 3
    for method in ("ea", "map-elites", "wfc"):
        runs = json.loads((compared / "runs" / f"{method}-5x5.json").read_text())
        best = [row for row in rows if row["method"] == method and row["elite"] == "best"]
        assert [int(row["seed"]) for row in best] == [0, 1, 2]
        for row, codes in zip(best, runs["best"], strict=True):
            expected = oracle(np.array(codes))
            assert {name: float(row[name]) for name in COUNTED} == {name: expected[name] for name in COUNTED}
            assert float(row["fitness"]) == oracle_fitness(expected)
            assert float(row["seconds"]) > 0
    archives = [row for row in rows if row["elite"] == "archive"]
    random = [row for row in rows if row["elite"] == "random"]
    assert len(archives) == len(random) == 3
    for row in archives:
        assert int(row["qd_score"]) == pytest.approx(int(row["niches"]) * (480 * 25 - float(row["fitness"])))


def test_a_seed_is_the_same_among_few_and_many():
    few, many = (run_method("ea", (4, 5), seeds, 7, 5, READINGS["ours"], alone=False) for seeds in (2, 3))
    assert few.best == many.best[:2]
    few, many = (run_method("wfc", (4, 5), seeds, 7, 5, READINGS["ours"]) for seeds in (2, 3))
    assert few.best == many.best[:2]
    assert run_method("wfc", (4, 5), 1, 8, 5, READINGS["ours"]).best != few.best[:1]


def test_interrupted_and_started_again_it_goes_on(compared, tmp_path, monkeypatch, capsys):
    done = []

    def until_the_second(method, *arguments, **settings):
        if done:
            raise KeyboardInterrupt
        done.append(method)
        return run_method(method, *arguments, **settings)

    out = tmp_path / "out"
    monkeypatch.setattr("runs.run_method", until_the_second)
    assert compare([*SMALL, "--no-maps", "--out", str(out)]) == 130
    assert capsys.readouterr().err == "compare: interrupted; what is done is kept; start again to go on\n"
    assert [path.name for path in (out / "runs").iterdir()] == ["ea-5x5.json"]

    def all_but_the_first(method, *arguments, **settings):
        assert method not in done, "it was done before"
        return run_method(method, *arguments, **settings)

    monkeypatch.setattr("runs.run_method", all_but_the_first)
    assert compare([*SMALL, "--no-maps", "--out", str(out)]) == 0
    assert (out / "tables.md").read_bytes() == (compared / "tables.md").read_bytes()
    assert [row | {"seconds": ""} for row in rows_of(out)] == [row | {"seconds": ""} for row in rows_of(compared)]
    before = (out / "results.csv").read_bytes()
    monkeypatch.setattr("runs.run_method", None)
    assert compare([*SMALL, "--no-maps", "--out", str(out)]) == 0
    assert (out / "results.csv").read_bytes() == before


def test_maps_are_drawn_with_their_masks(tmp_path, monkeypatch):
    monkeypatch.setattr("compare._PICTURED", (4, 5))
    arguments = ["--methods", "wfc", "--sizes", "4", "4x5", "--paper", "--generations", "2"]
    assert compare([*arguments, "--out", str(tmp_path / "out")]) == 0
    place = tmp_path / "out" / "maps_4x5" / "wfc"
    assert {path.name for path in place.iterdir()} == {
        "image.png", "road.png", "red.png", "yellow.png", "labels.png", "map.json",
    }  # fmt: skip
    assert (tmp_path / "out" / "comparison_4x5.png").exists()
    assert json.loads((tmp_path / "out" / "settings.json").read_text())["seeds"] == 4


@pytest.mark.slow
def test_scaling(tmp_path):
    arguments = ["--methods", "gwo", "wfc", "--sizes", "4", "6", "--seeds", "2", "--generations", "3"]
    assert scaling([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "scaling.png").stat().st_size > 10_000
    assert "| GWO | 6 x 6 |" in (tmp_path / "out" / "scaling.md").read_text()
    assert len((tmp_path / "out" / "scaling.csv").read_text().splitlines()) == 1 + 2 * 2 * 2


@pytest.mark.slow
def test_other_readings(tmp_path):
    arguments = ["--methods", "ea", "gwo", "wfc", "--seeds", "2", "--generations", "3"]
    assert ambiguities([*arguments, "--out", str(tmp_path / "out")]) == 0
    text = (tmp_path / "out" / "ambiguities.md").read_text()
    assert "| `ours` | EA |" in text
    assert "| `comma` | EA |" in text
    assert "| `comma` | GWO |" not in text
    assert "| `omega-worst` | GWO |" in text
    assert "WFC" not in text


@pytest.mark.parametrize("command", [compare, scaling, ambiguities])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "ea", "luck"], "method: expected one of ea, map-elites, pso, gwo, wfc, got 'luck'"),
        (["--sizes", "1"], "argument --sizes: expected a size, 12 or 9x14, sides from 2 to 1024, got '1'"),
        (["--sizes", "5x"], "argument --sizes: expected a size, 12 or 9x14"),
        (["--seeds", "0"], "argument --seeds: expected a whole number, 1 to 1048576, got '0'"),
        (["--reading", "aloud"], "reading: expected one of ours, a-pairs"),
    ],
)
def test_what_the_user_got_wrong_is_one_line_and_exit_code_2(command, arguments, message, tmp_path, capsys):
    try:
        code = command([*SMALL, *arguments, "--out", str(tmp_path / "out")])
    except SystemExit as stop:
        code = stop.code
    captured = capsys.readouterr()
    assert code == 2
    assert message in captured.err
    assert len(captured.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_results_of_other_settings_are_left_alone(compared, tmp_path, capsys):
    before = {path: path.read_bytes() for path in compared.rglob("*") if path.is_file()}
    for change, message in (
        (["--seeds", "4"], "expected results of seeds 4, got some of 3; take another --out for these"),
        (["--reading", "fill"], "expected results of reading 'fill', got some of 'ours'"),
        ([], "expected results of maps True, got some of False"),
    ):
        assert compare([*SMALL, *change, "--out", str(compared)]) == 2
        assert message in capsys.readouterr().err
    assert {path: path.read_bytes() for path in compared.rglob("*") if path.is_file()} == before
    (tmp_path / "mine.txt").write_text("mine")
    assert compare([*SMALL, "--out", str(tmp_path)]) == 2
    assert "expected a folder that is new, or of the same settings, got another" in capsys.readouterr().err
    assert compare([*SMALL, "--out", str(tmp_path / "mine.txt")]) == 2
    assert "mine.txt: expected a folder, got a file" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_files_are_whole_or_not_at_all(tmp_path, monkeypatch):
    file = tmp_path / "file.json"
    assert kept(file, lambda: {"made": 1}) == {"made": 1}
    assert kept(file, lambda: {"made": 2}) == {"made": 1}

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.replace", fail)
    with pytest.raises(OSError, match="No space"):
        write_whole(file, b"other")
    assert json.loads(file.read_text()) == {"made": 1}


def test_a_folder_left_by_an_early_end_is_taken(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".settings.json.part").write_text("{")
    open_results(tmp_path / "out", {"seeds": 1})
    open_results(tmp_path / "out", {"seeds": 1})
    with pytest.raises(InputError, match="expected results of seeds 2, got some of 1"):
        open_results(tmp_path / "out", {"seeds": 2})


def test_damaged_results_are_named(tmp_path, capsys):
    arguments = ["--methods", "wfc", "--sizes", "4", "--seeds", "2", "--no-maps", "--out", str(tmp_path / "out")]
    assert compare(arguments) == 0
    file = tmp_path / "out" / "runs" / "wfc-4x4.json"
    file.write_text(file.read_text()[:20])
    assert compare(arguments) == 2
    assert "wfc-4x4.json: expected results kept as JSON" in capsys.readouterr().err
    (tmp_path / "out" / "settings.json").write_text("[]")
    assert compare(arguments) == 2
    assert "settings.json: expected a table of settings, got list" in capsys.readouterr().err


def test_wfc_that_fails_is_counted_and_leaves_the_others_be(tmp_path, capsys, monkeypatch):
    from elitelanes_jax.wfc import generate

    monkeypatch.setattr("runs.generate", lambda rng, shape: generate(rng, shape)._replace(success=False))
    arguments = ["--methods", "ea", "gwo", "wfc", "--sizes", "4", "--seeds", "3", "--generations", "2"]
    assert compare([*arguments, "--out", str(tmp_path / "out")]) == 0
    assert "wfc 4x4: 0 of 3 runs succeeded" in capsys.readouterr().out
    assert "| EA over GWO |" in (tmp_path / "out" / "tables.md").read_text()


def test_other_readings_are_of_the_papers_size(tmp_path, capsys):
    for arguments, message in (
        (["--sizes", "5"], "sizes: expected 12 x 12 alone"),
        (["--reading", "fill"], "reading: expected none, as all are run, got 'fill'"),
        (["--methods", "wfc"], "methods: expected a search"),
    ):
        assert ambiguities([*arguments, "--out", str(tmp_path / "out")]) == 2
        assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_the_papers_figures_stand_beside_its_size(tmp_path):
    arguments = ["--methods", "wfc", "--seeds", "3", "--no-maps", "--out", str(tmp_path / "out")]
    assert compare(arguments) == 0
    assert "| *paper* | 4.75" in (tmp_path / "out" / "tables.md").read_text()


def test_the_time_of_each_step_is_told(capsys):
    assert throughput(["--maps", "8", "--tile-px", "16"]) == 0
    printed = capsys.readouterr().out
    shares = [int(line.split("|")[3].strip(" %")) for line in printed.splitlines()[2:-1]]
    assert abs(sum(shares[:-1]) - 100) <= 3
    assert shares[-1] == 100
    assert "8 maps, all processors:" in printed
