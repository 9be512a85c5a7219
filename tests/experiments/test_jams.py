"""The study of jams: its correlations, its page, and the bound of the smallest towns."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import spearmanr

from elitelanes_jax.network import gridlock_number, plain_measure
from experiments.gridlock import report
from experiments.gridlock.cost import SHOWN, least_tiles

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "experiments" / "gridlock" / "results"


def test_correlations_are_those_of_the_runs(monkeypatch):
    monkeypatch.setattr(report, "RESAMPLES", 200)
    rng = np.random.default_rng(0)
    shares = rng.integers(0, 9, 30)
    towns = [report.Predicted(2.0**share, int(9 - share), 8, *rng.integers(1, 9, 3)) for share in shares]

    def runs_of(share):
        usual = [[20, place < share, 100.0, 5.0 - share, 20] for place in rng.permutation(8)]
        return {"usual": usual, "below": [usual[0]], "below_loop": usual[:2], "above_loop": [usual[1]]}

    runs = [runs_of(share) for share in shares]
    jams = [{"loop": ["a"], "cars": []}, {"loop": [], "cars": []}]
    found = report.summarize(towns, runs, jams)
    assert (found["towns"], found["runs"], found["towns_that_jam"]) == (30, 240, np.count_nonzero(shares))
    assert found["jammed"] == pytest.approx(shares.mean() / 8)
    predictors = found["predictors"]
    assert predictors["potential"]["jams"] == predictors["gamma"]["jams"] == pytest.approx(1)
    assert predictors["potential"]["speed"] == pytest.approx(-1)
    streets = [-town.shortest_street for town in towns]
    assert predictors["shortest_street"]["jams"] == pytest.approx(spearmanr(streets, shares)[0])
    low, high = predictors["shortest_street"]["interval"]
    assert low < predictors["shortest_street"]["jams"] < high
    assert predictors["gamma"]["potential_minus_it"] == [0, 0]
    assert found["few_cars"]["below_loop"] == [60, sum(run[1] for town in runs for run in town["below_loop"])]
    assert found["full_loops"] == [2, 1]


def test_the_page_has_the_tables_of_the_results():
    assert (RESULTS / "gridlock.md").read_text() in (ROOT / "docs" / "gridlock.md").read_text()


def test_the_smallest_towns_have_their_numbers_and_keep_the_bound():
    towns = json.loads((RESULTS / "small_towns.json").read_text())
    for name, rows in towns.items():
        codes = np.array([[int(code, 16) for code in row] for row in rows], np.int8)
        number, loops = map(int, name.split(","))
        assert (int(gridlock_number(codes)), plain_measure(codes)["cyclomatic"]) == (number, loops)
        assert np.count_nonzero(codes) >= least_tiles(number, loops)
    assert {f"{number},{loops}" for number, loops in SHOWN} <= set(towns)
