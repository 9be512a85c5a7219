"""Output folders: complete or not there, whenever their run is killed."""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from itertools import count
from pathlib import Path
from stat import S_IMODE

import pytest
from filelock import FileLock
from refusals import refused

from elitelanes_jax._util.folders import foreign_file, has_unfinished, locked, output_folder, settle

SETTINGS = {"command": "test"}
MINE = {"one", "sub", "sub/two", "three"}


def everything(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def contents(folder):
    return {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()}


def write(out, text="new", names=("one", "sub/two"), **options):
    with output_folder(out, SETTINGS, **options) as work:
        for name in names:
            file = work.files / name
            file.parent.mkdir(exist_ok=True)
            file.write_text(text)


def foreign(folder):
    return foreign_file(folder, lambda path: path in MINE)


def test_a_current_folder_that_was_deleted_is_an_error_of_the_output_folder(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with refused("out", "no such file..."):
        write("out")


def test_a_folder_that_cannot_be_renamed_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refused(".", "the current one"):
        write(".")
    monkeypatch.setattr(os.path, "ismount", lambda path: path == tmp_path / "out")
    with refused(tmp_path / "out", "a mount"):
        write(tmp_path / "out")
    assert not everything(tmp_path)


def test_the_root_is_refused():
    root = Path(Path.cwd().anchor)
    with refused(root, "a mount"):
        write(root)
    assert not has_unfinished(root)
    settle(root)


def test_a_link_to_itself_is_refused_before_the_work(tmp_path):
    (tmp_path / "there").symlink_to("here")
    (tmp_path / "here").symlink_to("there")
    with refused(tmp_path / "here", "a link that leads to itself"):
        write(tmp_path / "here", names=())
    assert {path.name for path in tmp_path.iterdir()} == {"here", "there"}


@pytest.mark.parametrize("out", ["out", "deep/down/out", "empty", "link"])
def test_a_folder_is_there_when_it_is_complete(tmp_path, out):
    (tmp_path / "empty").mkdir()
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there")
    out = tmp_path / out
    with output_folder(out, SETTINGS) as work:
        (work.files / "file").write_text("text")
        (work.kept / "file").write_text("text")
        assert not list(out.glob("[!.]*"))
    assert contents(out.resolve()) == {"file": "text"}
    assert (tmp_path / "link").is_symlink()
    assert not [path for path in everything(tmp_path) if "unfinished" in path]


@pytest.mark.parametrize("out", ["out", "deep/down/out", "empty"])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_nothing_remains_of_what_went_wrong(tmp_path, out, error):
    (tmp_path / "empty").mkdir()

    def fails():
        with output_folder(tmp_path / out, SETTINGS) as work:
            (work.files / "sub").mkdir()
            (work.files / "sub" / "file").write_text("text")
            raise error

    with pytest.raises(type(error)):
        fails()
    assert everything(tmp_path) == {"empty"}


def is_refused(out, got, hint="", settings=SETTINGS, **options):
    with refused(out, got, hint=hint) as caught, output_folder(out, settings, **options):
        raise AssertionError("not reached")
    return caught.value


def test_folders_that_cannot_be_made_are_refused(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("mine")
    is_refused(tmp_path / "file", "a file")
    assert not is_refused(tmp_path, "one with files in it").hint
    is_refused(tmp_path / "file" / "out", f"{tmp_path / 'file' / '.out-unfinished'}: ...")
    assert everything(tmp_path) == {"file"}

    def fail(path, *_, **__):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "mkdir", fail)
    is_refused(tmp_path / "out", "...: permission denied")


def test_one_process_at_a_time_works_for_a_folder(tmp_path):
    (tmp_path / "out").mkdir()
    with output_folder(tmp_path / "out", SETTINGS) as work:
        (work.files / "file").write_text("text")
        is_refused(tmp_path / "out", "one, ...", hint="lock")
    assert contents(tmp_path) == {"out/file": "text"}


def test_a_folder_is_replaced_if_that_is_asked_for(tmp_path):
    out = tmp_path / "out"
    write(out, "old", ("one", "three"))
    is_refused(out, "one with files in it", hint="force=True", foreign=foreign)
    assert not is_refused(out, "one with files in it", force=True).hint
    (tmp_path / "link").symlink_to(out / "three")
    inputs = [tmp_path / "other", tmp_path / "link"]
    is_refused(out, f"one with {inputs[1]}", foreign=foreign, force=True, inputs=inputs)
    write(out, foreign=foreign, force=True)
    assert contents(out) == {"one": "new", "sub/two": "new"}


@pytest.mark.skipif(sys.platform == "win32", reason="no such permissions")
def test_a_folder_keeps_its_permissions(tmp_path, monkeypatch):
    out = tmp_path / "out"
    out.mkdir(mode=0o700)
    write(out)
    assert S_IMODE(out.stat().st_mode) == 0o700
    out.chmod(0o750)
    write(out, foreign=foreign, force=True)
    assert S_IMODE(out.stat().st_mode) == 0o750
    # After a kill between the renames
    with monkeypatch.context() as patch, suppress(Killed), output_folder(out, SETTINGS, foreign=foreign, force=True):
        kill_at(patch, 2)
    assert not out.exists()
    settle(out)
    assert S_IMODE(out.stat().st_mode) == 0o750


@pytest.mark.parametrize("letter", ["a", "\N{GRINNING FACE}"])
def test_the_longest_names_are_those_of_folders_too(letter, tmp_path):
    """Unfinished work for two names that differ only in the end is kept apart, and found again."""
    whole = (letter * 255).encode()[:252].decode()
    for out in (tmp_path / f"{whole}{end}" for end in ("xyz", "xyy")):
        with suppress(KeyboardInterrupt), output_folder(out, SETTINGS) as work:
            (work.kept / "search").write_text(out.name)
            raise KeyboardInterrupt
    for out in (tmp_path / f"{whole}{end}" for end in ("xyz", "xyy")):
        assert has_unfinished(out)
        with output_folder(out, SETTINGS) as work:
            assert contents(work.kept) == {"search": out.name}
            (work.files / "file").write_text("text")
    assert {path.name for path in tmp_path.iterdir()} == {f"{whole}xyz", f"{whole}xyy"}
    too_long = tmp_path / f"{whole}xyz0"
    with pytest.raises(OSError, match=f"File name too long: '{too_long}'"), output_folder(too_long, SETTINGS):
        raise AssertionError("not reached")
    assert not has_unfinished(too_long)


@pytest.mark.parametrize("when", ["before", "meanwhile"])
@pytest.mark.parametrize("name", ["notes.txt", "sub/notes.txt", ".git/HEAD", "sub/link"])
def test_a_folder_with_anything_else_is_never_replaced(when, name, tmp_path):
    out = tmp_path / "out"
    write(out, "old")

    def add():
        (out / name).parent.mkdir(exist_ok=True)
        (out / name).symlink_to(tmp_path) if name.endswith("link") else (out / name).write_text("mine")

    def replace():
        with output_folder(out, SETTINGS, foreign=foreign, force=True) as work:
            (work.files / "one").write_text("new")
            add()

    if when == "before":
        add()
    with refused(out, f"one with {name}"):
        replace()
    assert (out / "one").read_text() == "old"
    assert name in everything(out) and not [path for path in everything(tmp_path) if "unfinished" in path]


class Killed(BaseException):
    pass


def kill_at(patch, step):
    """Ends the process, as it were, at a step: nothing is renamed or removed from then on."""
    steps, killed = count(1), []

    def ends(usual):
        def function(*arguments, **options):
            if killed or next(steps) == step:
                killed.append(True)
                raise Killed
            return usual(*arguments, **options)

        return function

    for owner, name in ((Path, "rename"), (Path, "rmdir"), (Path, "unlink"), (shutil, "rmtree")):
        patch.setattr(owner, name, ends(getattr(owner, name)))
    return killed


@pytest.mark.parametrize("there", ["nothing", "empty", "old"])
def test_killed_at_any_step_of_the_end_the_next_run_does_the_rest(there, tmp_path, monkeypatch):
    """The folder has all its old files or all its new files, in whole or, while they are moved, in part."""
    for step in count(1):
        out = tmp_path / str(step) / "out"
        if there == "old":
            write(out, "old", ("one", "three"))
        elif there == "empty":
            out.mkdir(parents=True)
        options = {"foreign": foreign, "force": True, "resume_files": True}
        with monkeypatch.context() as patch, suppress(Killed), output_folder(out, SETTINGS, **options) as work:
            (work.kept / "search").write_text("found")
            (work.files / "one").write_text("new")
            (work.files / "two").write_text("new")
            killed = kill_at(patch, step)
        found = {text for name, text in contents(out).items() if "unfinished" not in name} if out.exists() else set()
        assert len(found) <= 1
        settle(out)
        if has_unfinished(out):
            with output_folder(out, SETTINGS, **options) as work:
                assert contents(work.kept) == {"search": "found"}
                assert contents(work.files) == {"one": "new", "two": "new"}
        assert contents(out) == {"one": "new", "two": "new"}
        assert everything(out.parent) == {"out", "out/one", "out/two"}
        if not killed:
            break
    assert step > 3


@pytest.mark.parametrize("step", [1, 2])
def test_everything_stays_as_it_was_if_the_last_step_goes_wrong(step, tmp_path, monkeypatch):
    out = tmp_path / "out"
    write(out, "old", ("one", "three"))
    usual, steps = Path.rename, count(1)

    def rename(path, target):
        if next(steps) == step:
            raise OSError(28, "No space left on device", str(path))
        return usual(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", rename)
        with pytest.raises(OSError, match="No space"):
            write(out, foreign=foreign, force=True)
    assert contents(tmp_path) == {"out/one": "old", "out/three": "old"}


def test_work_of_another_command_is_named(tmp_path):
    """The folder of an unfinished dataset had "results with None"."""

    def interrupted():
        with output_folder(tmp_path / "out", {"command": "dataset"}) as work:
            (work.kept / "maps").write_text("found")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    settings = {"command": "generate", "size": [3, 3]}
    error = is_refused(tmp_path / "out", "that of dataset", hint="force=True", settings=settings)
    assert "generate" in error.expected and str(tmp_path / ".out-unfinished") in error.hint


def test_work_is_resumed_with_the_same_settings_alone(tmp_path):
    out = tmp_path / "out"

    def interrupted():
        with output_folder(out, {"seed": 1, "more": {"x": (2,)}}) as work:
            assert not list(work.files.iterdir())
            (work.files / "file").write_text("text")
            (work.kept / "search").write_text("found")
            raise KeyboardInterrupt

    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            interrupted()
        assert has_unfinished(out) and not out.exists()
    error = is_refused(out, "results with [2]", hint="force=True", settings={"seed": 1, "more": {"x": [3]}})
    assert "more x [3]" in error.expected and str(tmp_path / ".out-unfinished") in error.hint
    # A setting that only the earlier run had is a difference, as one that only this run has.
    error = is_refused(out, "results with [2]", settings={"seed": 1, "more": {}})
    assert "more x None" in error.expected
    assert has_unfinished(out)
    with output_folder(out, {"seed": 2}, force=True) as work:
        assert not list(work.kept.iterdir())
    assert everything(tmp_path) == {"out"}


KILLED = """
import os, signal, sys
from elitelanes_jax._util.folders import output_folder
with output_folder(sys.argv[1], {"command": "killed"}) as work:
    (work.files / "maps").mkdir()
    (work.files / "maps" / ".file-0123abcd.part.png").write_text("half")
    (work.kept / "search").mkdir()
    (work.kept / "search" / "lock").write_text("")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
@pytest.mark.parametrize("resume_files", [True, False])
@pytest.mark.parametrize("there", [True, False])
def test_what_a_killed_process_left_is_removed(there, resume_files, tmp_path):
    """Work of which nothing is kept is none: another command may use the folder."""
    out = tmp_path / "e[1]"
    if there:
        out.mkdir()
    killed = subprocess.run([sys.executable, "-c", KILLED, str(out)], check=False)
    assert killed.returncode == -signal.SIGKILL
    assert (tmp_path / ".e[1]-unfinished" / "lock").exists() and not has_unfinished(out)
    write(out, names=("file",), resume_files=resume_files)
    assert contents(tmp_path) == {"e[1]/file": "new"}


def test_an_interruption_while_the_lock_is_taken_leaves_no_folder(tmp_path, monkeypatch):
    class Interrupted(FileLock):
        tries = 0

        def _acquire(self):
            self.tries += 1
            if self.tries == 1:  # the file exists, the lock does not
                os.close(os.open(self.lock_file, os.O_CREAT))
                raise KeyboardInterrupt
            super()._acquire()

    folder = tmp_path / "folder"
    with monkeypatch.context() as patch:
        patch.setattr("filelock.FileLock", Interrupted)
        with pytest.raises(KeyboardInterrupt), locked(folder, folder):
            raise AssertionError("not reached")
    assert not folder.exists()
    with locked(folder, folder):
        assert (folder / "lock").exists()
    assert not folder.exists()


def test_an_interruption_at_any_line_before_the_work_leaves_nothing(tmp_path):
    out = tmp_path / "out"
    for line in count():
        left = line

        def trace(frame, event, _):
            nonlocal left
            if event == "line":
                left -= 1
                if left < 0:
                    raise KeyboardInterrupt
            return trace if frame.f_code.co_name == "_resume" else None

        try:
            sys.settrace(trace)
            write(out)
        except KeyboardInterrupt:
            assert not everything(tmp_path)
        else:
            break
        finally:
            sys.settrace(None)
    assert line > 5


def test_a_lock_leaves_no_folder_that_it_made_and_its_folder_may_be_removed(tmp_path):
    folder = tmp_path / "new" / "deep" / "jobs"
    with pytest.raises(KeyError), locked(folder, folder):
        raise KeyError
    with locked(folder, folder):
        shutil.rmtree(folder)
    assert not any(tmp_path.iterdir())
