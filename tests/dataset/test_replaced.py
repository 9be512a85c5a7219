"""--force replaces a dataset of an earlier run, and no folder with anything else in it."""

import importlib.util
import shutil
from pathlib import Path

import pytest
from folders import files
from given_maps import random_maps, small
from refusals import refused

from elitelanes_jax import make_dataset
from elitelanes_jax.cli.main import main
from elitelanes_jax.dataset._layouts import LAYOUTS

OTHERS = {"maps_from": random_maps(seed=1), "seed": 1}


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("written") / "out"
    make_dataset(small(), out)
    return out


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


@pytest.mark.parametrize("name", LAYOUTS)
def test_another_dataset_takes_the_place_of_one_of_any_format(name, folder, tmp_path):
    if LAYOUTS[name].needs and not importlib.util.find_spec(LAYOUTS[name].needs):
        pytest.skip(f"{LAYOUTS[name].needs} is not installed")
    with refused(tmp_path / "out", "results with ...", hint="force=True"):
        make_dataset(small(format=name, **OTHERS), folder)
    make_dataset(small(format=name, **OTHERS), folder, force=True)
    assert [entry.name for entry in tmp_path.iterdir()] == ["out"]
    make_dataset(small(format=name, **OTHERS), tmp_path / "new")
    assert files(folder) == files(tmp_path / "new")


def test_the_one_before_stays_until_the_new_one_is_complete(folder, tmp_path, monkeypatch):
    before, spec = files(folder), small(**OTHERS)
    make_dataset(spec, tmp_path / "expected")
    with monkeypatch.context() as patch:
        patch.setattr("elitelanes_jax.dataset._finishing.write_card", interrupt)
        with pytest.raises(KeyboardInterrupt):
            make_dataset(spec, folder, force=True)
    assert files(folder) == before
    hidden = tmp_path / ".out-unfinished" / "files"
    drawn = min(hidden.rglob("*000000.png"))
    when = drawn.stat().st_mtime_ns
    make_dataset(spec, folder, force=True)
    assert files(folder) == files(tmp_path / "expected")
    assert (folder / drawn.relative_to(hidden)).stat().st_mtime_ns == when, "it was not drawn again"
    assert {entry.name for entry in tmp_path.iterdir()} == {"out", "expected"}


def interrupt(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("add", "found"),
    [
        (lambda folder: (folder / "notes.txt").write_text("mine"), "notes.txt"),
        (lambda folder: (folder / "train" / "notes.png").write_text("mine"), "train/notes.png"),
        (lambda folder: (folder / "train" / "image" / "12.png").write_text("mine"), "train/image/12.png"),
        (lambda folder: (folder / "dataset.json").unlink(), "no dataset.json"),
        (lambda folder: (folder / "dataset.json").write_text("{}"), "dataset.json of another program"),
    ],
)
def test_a_folder_with_anything_else_is_never_removed(add, found, folder, capsys):
    add(folder)
    before = files(folder)
    assert main(["dataset", "--maps", "12", "--size", "5", "--seed", "1", "--force", "--out", str(folder)]) == 2
    assert f"expected a folder with files of an earlier run alone, got one with {found}" in capsys.readouterr().err
    assert files(folder) == before


@pytest.mark.parametrize("given", [str, Path])
def test_a_dataset_whose_maps_are_taken_is_not_replaced_by_them(given, folder):
    before = files(folder)
    with refused(folder, f"one with {folder}"):
        make_dataset(small(maps_from=given(folder), seed=1), folder, force=True)
    assert files(folder) == before
