"""--force replaces a folder of an earlier run, and no folder with anything else in it."""

import json
import os
import shutil
from pathlib import Path

import pytest

from elitelanes_jax.cli.main import main

SMALL = ["generate", "--size", "5", "6", "--seeds", "3", "--generations", "5", "--tile-px", "16", "--quiet"]
SMALL += ["--method", "ea", "--preset", "paper"]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("written") / "out"
    assert main([*SMALL, "--maps", "3", "--out", str(out)]) == 0
    return out


@pytest.fixture
def folder(written, tmp_path):
    return Path(shutil.copytree(written, tmp_path / "out"))


def files(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_folder_of_ours_is_replaced_if_that_is_asked_for(folder, capsys):
    before, place = files(folder), folder.stat().st_ino
    command = [*SMALL, "--maps", "2", "--seed", "3", "--out", str(folder)]
    assert main(command) == 2
    assert capsys.readouterr().err.endswith("got one with files in it; --force replaces it\n")
    assert files(folder) == before
    assert main([*command, "--force"]) == 0
    after = files(folder)
    assert {name.split("/")[1] for name in after if name.startswith("maps/")} == {"0000", "0001"}
    assert json.loads(after["run.json"])["settings"]["seed"] == 3
    assert folder.stat().st_ino == place
    assert [entry.name for entry in folder.parent.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("add", "found"),
    [
        (lambda folder: (folder / "notes.txt").write_text("mine"), "notes.txt"),
        (lambda folder: (folder / "maps" / "0001" / "large.png").write_text("mine"), "maps/0001/large.png"),
        (lambda folder: (folder / "maps" / "0001" / "image.png.bak").write_text("mine"), "maps/0001/image.png.bak"),
        (lambda folder: (folder / ".git").mkdir() or (folder / ".git" / "HEAD").write_text("mine"), ".git/HEAD"),
        (lambda folder: (folder / "maps" / "0003").symlink_to(folder.parent), "maps/0003"),
        (lambda folder: (folder / "run.json").unlink(), "no run.json"),
        (lambda folder: (folder / "run.json").write_text("[]"), "run.json of another program"),
        (
            lambda folder: (folder / "run.json").write_text('{"versions": {"numpy": "1"}, "tile_set": {}}'),
            "run.json of a",
        ),
    ],
)
@pytest.mark.parametrize("command", [SMALL, ["pick", "ARCHIVE"]], ids=["generate", "pick"])
def test_a_folder_with_anything_else_is_never_replaced(command, add, found, folder, written, capsys):
    add(folder)
    before = files(folder)
    command = [str(written / "archive.npz") if word == "ARCHIVE" else word for word in command]
    for force in ([], ["--force"]):
        assert main([*command, *force, "--out", str(folder)]) == 2
        said = capsys.readouterr().err
        assert "--force replaces" not in said
    assert f"expected a folder with files of an earlier run alone, got one with {found}" in said
    assert files(folder) == before


def test_what_is_to_be_replaced_stays_where_the_new_run_fails(folder, monkeypatch):
    before = files(folder)
    assert main([*SMALL, "--maps", "999", "--force", "--out", str(folder)]) == 1
    assert files(folder) == before
    usual, moved = Path.rename, []

    def rename(self, target):
        moved.append(self)
        if len(moved) == 8:  # the files are complete, four old entries are moved out, and a new one is in
            raise OSError(28, os.strerror(28), str(target))
        return usual(self, target)

    monkeypatch.setattr(Path, "rename", rename)
    assert main([*SMALL, "--maps", "2", "--force", "--out", str(folder)]) == 2
    assert len(moved) > 8
    assert files(folder) == before
    assert [entry.name for entry in folder.parent.iterdir()] == ["out"]


def test_pictures_are_replaced_too(folder, tmp_path, capsys):
    command = ["render", str(folder / "maps" / "0000" / "map.json"), "--out", str(tmp_path / "pictures")]
    assert main([*command, "--tile-px", "16", "--overlay"]) == 0
    before = files(tmp_path / "pictures")
    capsys.readouterr()
    assert main([*command, "--tile-px", "32"]) == 2
    assert capsys.readouterr().err.endswith("; --force replaces it\n")
    assert main([*command, "--tile-px", "32", "--force"]) == 0
    after = files(tmp_path / "pictures")
    assert before.keys() - after.keys() == {"overlay.png"}
    assert before["image.png"] != after["image.png"]
    (tmp_path / "pictures" / "labels.png").unlink()
    assert main([*command, "--force"]) == 2
    assert capsys.readouterr().err.endswith("earlier run alone, got one with no labels.png\n")
