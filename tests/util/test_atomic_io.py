"""Output folders: whole or not at all."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from elitelanes_jax._util.atomic_io import check_new, new_folder, write_atomic
from elitelanes_jax._util.errors import InputError


def everything(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize("out", ["out", "deep/down/out"])
def test_a_folder_appears_when_all_is_written(tmp_path, out):
    with new_folder(tmp_path / out) as folder:
        (folder / "file").write_text("text")
        assert not (tmp_path / out).exists()
    assert (tmp_path / out / "file").read_text() == "text"
    assert not [path for path in everything(tmp_path) if ".out" in path]


def test_an_empty_folder_is_as_good_as_none(tmp_path):
    (tmp_path / "out").mkdir()
    with new_folder(tmp_path / "out") as folder:
        (folder / "file").write_text("text")
    assert everything(tmp_path) == ["out", "out/file"]


@pytest.mark.parametrize("out", ["out", "deep/down/out", "empty"])
@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_nothing_remains_of_what_went_wrong(tmp_path, out, error):
    (tmp_path / "empty").mkdir()

    def write():
        with new_folder(tmp_path / out) as folder:
            (folder / "file").write_text("text")
            (folder / "sub").mkdir()
            (folder / "sub" / "file").write_text("text")
            raise error

    with pytest.raises(error):
        write()
    assert everything(tmp_path) == ["empty"]


def test_nothing_remains_when_the_last_step_goes_wrong(tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir()
    replace = type(out).replace

    def fail(path, target):
        if path.name == "two":
            raise OSError(28, "No space left on device", str(path))
        return replace(path, target)

    monkeypatch.setattr(type(out), "replace", fail)

    def write():
        with new_folder(out) as folder:
            (folder / "one").mkdir()
            (folder / "two").write_text("text")

    with pytest.raises(OSError, match="No space"):
        write()
    assert everything(tmp_path) == ["out"]


def test_a_second_run_into_the_same_folder_is_refused(tmp_path):
    (tmp_path / "out").mkdir()
    with new_folder(tmp_path / "out") as folder:
        (folder / "file").write_text("text")
        with pytest.raises(InputError, match="got one with files in it"), new_folder(tmp_path / "out"):
            pass
    assert everything(tmp_path) == ["out", "out/file"]


def test_links_and_dots_lead_where_they_lead(tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with new_folder(tmp_path / "link") as folder:
        (folder / "file").write_text("text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there" / "file").exists()
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with new_folder(".") as folder:
        (folder / "file").write_text("text")
    assert (tmp_path / "here" / "file").exists()


def refused(folder, message):
    with pytest.raises(InputError, match=message), new_folder(folder):
        pass


def test_folders_that_cannot_be_made_are_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    refused(tmp_path / "file", "file: expected a folder that is new or empty, got a file")
    refused(tmp_path, "expected a folder that is new or empty, got one with files in it")
    refused(tmp_path / "file" / "out", "out: expected a place that can be written to, got .*file: ")
    assert everything(tmp_path) == ["file"]

    def fail(path, *_, **__):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", fail)
    refused(tmp_path / "out", "out: expected a place that can be written to, got .*: permission denied")


def test_the_message_names_the_file_that_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("mine")
    for file, why in ((tmp_path / "file" / "out", "Not a directory"), (tmp_path / ("a" * 250), "File name too long")):
        with pytest.raises(OSError, match=f"{why}: '{file}'$"):
            write_atomic(file, b"text")
    assert everything(tmp_path) == ["file"]


KILLED = """
import os, signal, sys
from elitelanes_jax._util.atomic_io import new_folder
with new_folder(sys.argv[1]) as folder:
    if sys.argv[2] == "full":
        (folder / "maps").mkdir()
        (folder / "maps" / "file").write_text("text")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.parametrize("content", ["empty", "full"])
@pytest.mark.parametrize("there", [True, False])
def test_what_a_killed_process_left_is_removed(there, content, tmp_path):
    out = tmp_path / "e[1]"
    if there:
        out.mkdir()
    killed = subprocess.run([sys.executable, "-c", KILLED, str(out), content], check=False)
    assert killed.returncode == -9
    assert [name for name in everything(tmp_path) if re.search(r"\.e\[1]-[0-9a-f]{8}/\.elitelanes-lock$", name)]
    with new_folder(out) as folder:
        (folder / "file").write_text("text")
    assert everything(tmp_path) == ["e[1]", "e[1]/file"]


def test_what_is_left_of_others_stays(tmp_path):
    (tmp_path / "out").mkdir()
    others = [".out-0123abcd", ".out-0123abcde", ".out-0123ABCD", ".other-0123abcd"]
    for name in others:
        (tmp_path / name).mkdir()
        (tmp_path / name / "mine").write_text("mine")
        (tmp_path / "out" / name).mkdir()
        (tmp_path / "out" / name / "mine").write_text("mine")
    refused(tmp_path / "out", "got one with files in it")
    with new_folder(tmp_path / "out2") as folder:
        (folder / "file").write_text("text")
    assert len(everything(tmp_path)) == 4 * len(others) + 1 + 2
    # An empty one was left before anything was written, even before the lock; a link is never ours.
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / ".new-0123abcd").mkdir()
    with new_folder(tmp_path / "new") as folder:
        (folder / "file").write_text("text")
    assert everything(tmp_path / "new") == ["file"]
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / ".linked-0123abcd").symlink_to(tmp_path / "new")
    refused(tmp_path / "linked", "got one with files in it")


def test_files_that_are_there_are_named(tmp_path):
    check_new(tmp_path / "file")
    (tmp_path / "file").write_text("mine")
    with pytest.raises(InputError, match="file: expected a file that is new, got one that is there"):
        check_new(tmp_path / "file")
