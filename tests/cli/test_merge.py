"""Runs in parts: `generate --part`, and `merge`."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from folders import files
from killed_runs import digest
from refusals import refused

from elitelanes_jax import GenerateSpec, Result, merge
from elitelanes_jax.cli.main import main

SMALL = ["--size", "5", "6", "--seeds", "3", "--maps", "6", "--generations", "5", "--tile-px", "16"]
SMALL += ["--method", "ea", "--preset", "paper"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """One run in one, and in two parts: of one seed and of two."""
    place = tmp_path_factory.mktemp("runs")
    assert main(["generate", *SMALL, "--out", str(place / "whole")]) == 0
    for number in (1, 2):
        assert main(["generate", *SMALL, "--part", f"{number}/2", "--out", str(place / f"part-{number}")]) == 0
    return place


def parts(place):
    return [str(place / f"part-{number}") for number in (1, 2)]


def test_parts_put_together_are_the_one_run(runs, tmp_path, capsys):
    assert main(["merge", *parts(runs)[::-1], "--out", str(tmp_path / "merged")]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.splitlines()[-1].startswith(f"6 maps in {tmp_path / 'merged' / 'maps'}")
    for name in ("archive.npz", "contact-sheet.png"):
        assert (tmp_path / "merged" / name).read_bytes() == (runs / "whole" / name).read_bytes()
    assert digest(tmp_path / "merged") == digest(runs / "whole")
    times = json.loads((tmp_path / "merged" / "run.json").read_text())["times"]
    each = [json.loads((Path(part) / "run.json").read_text())["times"] for part in parts(runs)]
    assert times["seconds"]["evolve"] >= sum(one["seconds"]["evolve"] for one in each)
    assert times["evaluations_per_second"] == round(np.median([one["evaluations_per_second"] for one in each]))


def test_a_part_has_its_seeds_and_no_maps(runs, capsys, tmp_path):
    for number, seeds in ((1, [0]), (2, [1, 2])):
        folder = runs / f"part-{number}"
        assert sorted(file.name for file in folder.iterdir()) == ["archive.npz", "run.json"]
        whole, part = (Result.load(one / "archive.npz") for one in (runs / "whole", folder))
        np.testing.assert_array_equal(part.elites.grids, whole.elites.grids[np.array(seeds)])
    assert main(["generate", *SMALL, "--maps", "600", "--part", "1/3", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert said == f"part 1 of 3, seeds 0 to 0, in {tmp_path / 'out'}; elitelanes merge joins all parts\n"


def test_every_seed_is_in_one_part():
    for seeds in range(1, 12):
        for count in range(1, seeds + 1):
            numbers = [GenerateSpec(seeds=seeds, part=(number, count)).seed_indices for number in range(1, count + 1)]
            assert [seed for one in numbers for seed in one] == list(range(seeds))
            assert all(numbers)


def settings(folder, **changes):
    record = json.loads((folder / "run.json").read_text())
    for name, value in changes.items():
        table = next(table for table in (record["settings"], record["settings"]["search"], record) if name in table)
        table[name] = value
    (folder / "run.json").write_text(json.dumps(record))


def cut(folder):
    archive = folder / "archive.npz"
    archive.write_bytes(archive.read_bytes()[:1000])


def swap(folder):
    shutil.copy(folder.parent / "part-1" / "archive.npz", folder / "archive.npz")


def unfinished(part):
    hidden = part.with_name(f".{part.name}-unfinished")
    (hidden / "files").mkdir(parents=True)
    shutil.copytree(part, hidden / "kept")
    shutil.rmtree(part)


# What is done to the second part, or what else is in its record, and what is said.
WRONG = {
    "one is missing": (shutil.rmtree, "part-2: expected a part of a run, made by"),
    "one is a whole run": ({"part": None}, "generate --part, got a whole run"),
    "one is not done": (unfinished, "got unfinished work; the same command completes it"),
    "one is of other settings": ({"seed": 7}, "part-2: expected a part of a run with seed 0, got 7"),
    "one has another search": ({"generations": 7}, "part-2: expected a part of a run with generations 5, got 7"),
    "one is of other versions": (
        {"versions": {"jax": "0.1"}},
        "part-2: expected a part of a run with versions elitelanes_jax",
    ),
    "one is of more parts": ({"part": [2, 3]}, "part-2: expected one of 2 parts, as "),
    "one comes twice": ({"part": [1, 2]}, "part-2: expected each part once, got 1/2 again, after "),
    "one is cut off": (cut, "archive.npz: expected NumPy's .npz, got a file that cannot be read as such"),
    "one has the archive of another": (swap, "part-2/archive.npz: expected 2 seeds of 5 x 6, got (1, 20, 5, 6)"),
    "one has the archive of another run": ({"archive": {}}, "part-2/archive.npz: expected the archive of the same run"),
    "one is no record": (lambda part: (part / "run.json").write_text("{}"), "got another folder"),
    "one is of a broken record": ({"part": "all"}, "part-2: expected a part of a run, made by"),
    "one has seconds in words": (
        {"times": {"seconds": {"evolve": "long"}}},
        "part-2: expected a part of a run, made by",
    ),
    "one has no device": ({"device": None}, "part-2: expected a part of a run, made by"),
    "all have settings that are none": (
        lambda part: [settings(one, seeds=-1) for one in (part, part.with_name("part-1"))],
        "run.json: seeds: expected a whole number",
    ),
    "the folder is there": (lambda part: shutil.copytree(part, part.with_name("out")), "got one with files"),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_not_all_parts_of_one_run_is_one_line_and_exit_code_2(wrong, runs, tmp_path, capsys):
    spoil, message = WRONG[wrong]
    place = shutil.copytree(runs, tmp_path / "runs", ignore=shutil.ignore_patterns("whole"))
    if isinstance(spoil, dict):
        settings(place / "part-2", **spoil)
    else:
        spoil(place / "part-2")
    before = files(place)
    assert main(["merge", *parts(place), "--out", str(place / "out")]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert message in captured.err
    assert files(place) == before


def test_no_part_is_replaced_by_what_it_is_merged_into(runs, tmp_path, capsys):
    place = shutil.copytree(runs, tmp_path / "runs")
    before, (first, _) = files(place), parts(place)
    words = f"{first}: expected a folder to replace that contains no input, got one with {first}"
    assert main(["merge", *parts(place), "--out", first, "--force"]) == 2
    assert capsys.readouterr().err == f"elitelanes: {words}\n"
    with refused(first, f"one with {first}"):
        merge(parts(place), first, force=True)
    assert files(place) == before


def test_missing_parts_are_named(runs, tmp_path, capsys):
    assert main(["merge", str(runs / "part-2"), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err == "elitelanes: parts: expected all 2 parts, got all but 1/2\n"
    assert not list(tmp_path.iterdir())


def test_too_few_maps_in_all_parts(runs, tmp_path, capsys):
    place = shutil.copytree(runs, tmp_path / "runs")
    for number in (1, 2):
        settings(place / f"part-{number}", maps=600)
    assert main(["merge", *parts(place), "--out", str(tmp_path / "out")]) == 1
    assert "of 600 maps among 60 elites" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
