"""What all experiments share: folders of results, intervals, and programs that run with tiny budgets and continue."""

import sys
from importlib import import_module

import numpy as np
import pytest
from folders import files
from refusals import refused

from experiments.common import bootstrap_interval, kept, open_results


def test_a_folder_that_an_early_end_left_is_used(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".settings.json.part").write_text("{")
    open_results(tmp_path / "out", {"seeds": 1})
    open_results(tmp_path / "out", {"seeds": 1})
    assert kept(tmp_path / "out" / "one.json", lambda: 1) == kept(tmp_path / "out" / "one.json", lambda: 2) == 1


@pytest.mark.parametrize(
    ("name", "text", "place", "got"),
    [
        (
            "settings.json",
            '{"seeds": 1}',
            "",
            "... of seeds 2, got some of 1",
        ),
        ("settings.json", "[]", "settings.json", "list"),
        ("mine.txt", "mine", "", "another"),
    ],
)
def test_folders_of_other_results_are_left_alone(name, text, place, got, tmp_path):
    (tmp_path / name).write_text(text)
    before = files(tmp_path)
    with refused(tmp_path / place, got):
        open_results(tmp_path, {"seeds": 2})
    with refused(tmp_path / name, "a file"):
        open_results(tmp_path / name, {"seeds": 2})
    assert files(tmp_path) == before


def test_damaged_results_are_named(tmp_path):
    (tmp_path / "run.json").write_text('{"a": ')
    with refused(tmp_path / "run.json", "Expecting value: ...", hint="delete"):
        kept(tmp_path / "run.json", dict)


def test_intervals_hold_the_mean_and_shrink():
    rng = np.random.default_rng(2)
    few, many = rng.normal(5, 2, 10), rng.normal(5, 2, 1000)
    for sample in (few, many):
        low, high = bootstrap_interval(sample)
        assert low < sample.mean() < high
        assert high - low == pytest.approx(2 * 1.96 * sample.std() / np.sqrt(sample.size), rel=0.25)
    assert bootstrap_interval([3, 3, 3]) == (3, 3)


def program(name):
    pytest.importorskip("flax", reason="flax and optax are not here")
    return import_module(f"experiments.{name}").main


@pytest.mark.parametrize(
    ("name", "package", "message"),
    [
        ("perception.segmentation", "flax", "segmentation: training needs flax and optax: pip install flax optax\n"),
        ("perception.detection", "pycocotools", "average precision needs pycocotools: pip install pycocotools\n"),
    ],
)
def test_without_a_package_it_says_what_to_install(name, package, message, tmp_path, monkeypatch, capsys):
    main = program(name)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(["--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.endswith(message) and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "arguments", "lost"),
    [
        ("navigation.study", ["--seeds", "1"], ["runs/map-ea-0.json", "runs/window-maps-1-0.json"]),
        ("perception.segmentation", ["--seeds", "1"], ["runs/ea-0.json", "segmentation.png"]),
        ("perception.detection", [], ["detection.md", "detection.jpg"]),
    ],
)
def test_a_study_continues_to_the_same_results(name, arguments, lost, tmp_path):
    main, out = program(name), tmp_path / "out"
    assert main(["--quick", *arguments, "--out", str(out)]) == 0
    before = files(out)
    for file in lost:
        (out / file).unlink()
    assert main(["--quick", *arguments, "--out", str(out)]) == 0
    assert files(out) == before
