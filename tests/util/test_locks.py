"""Locks of folders, also on file systems without locks, as some clusters have them."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading
import time
import warnings

import pytest
from refusals import refused

from elitelanes_jax._util import locks
from elitelanes_jax._util.folders import locked, output_folder

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no flock")


@pytest.fixture(params=[errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP])
def no_flock(request, monkeypatch):
    """A file system without locks. A warning is an error."""

    def flock(*_):
        raise OSError(request.param, os.strerror(request.param))

    monkeypatch.setattr("fcntl.flock", flock)
    with warnings.catch_warnings(action="error"):
        yield


def write(out, **options):
    with output_folder(out, {"command": "test"}, foreign=lambda _: None, resume_files=True, **options) as work:
        (work.files / "second").write_text("2")


def contents(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def is_refused(out, got, hint="", **options):
    before = contents(out.parent)
    with refused(out, got, hint=hint) as caught:
        write(out, **options)
    assert "\n" not in str(caught.value)
    assert contents(out.parent) == before


def test_one_process_at_a_time_holds_a_lock(no_flock, tmp_path):
    out, lock = tmp_path / "out", tmp_path / ".out-unfinished" / "lock"
    with output_folder(out, {"command": "test"}, foreign=lambda _: None):
        for force in (False, True):
            is_refused(out, f"one, process {os.getpid()} on ..., last seen 0 s ago", hint=f"delete {lock}", force=force)
    assert contents(tmp_path) == {"out"}
    write(out, force=True)
    assert contents(tmp_path) == {"out", "out/second"}


def test_a_lock_of_the_system_is_named_too(tmp_path):
    out, lock = tmp_path / "out", tmp_path / ".out-unfinished" / "lock"
    with output_folder(out, {"command": "test"}):
        os.utime(lock, (time.time() - 500,) * 2)
        is_refused(out, "one, whose lock is 8 min old", hint=f"delete {lock}")
    assert contents(tmp_path) == {"out"}


KILLED = """
import errno, fcntl, os, signal, sys

def flock(*_):
    raise OSError(errno.ENOSYS, "")

fcntl.flock = flock
from elitelanes_jax._util.folders import locked, output_folder

with output_folder(sys.argv[1], {"command": "test"}) as work:
    (work.files / "first").write_text("1")
    (work.kept / "state").write_text("1")
    with locked(work.kept / "search", "search"):
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture
def killed(tmp_path):
    """An output folder whose process was killed, and the file of its lock."""
    out = tmp_path / "out"
    ran = subprocess.run([sys.executable, "-c", KILLED, str(out)], check=False)
    assert ran.returncode == -signal.SIGKILL
    return out, tmp_path / ".out-unfinished" / "lock"


def test_a_killed_process_on_this_host_blocks_nothing(no_flock, killed):
    out, _ = killed
    write(out)
    assert contents(out.parent) == {"out", "out/first", "out/second"}


def test_a_killed_process_blocks_nothing_where_the_system_has_locks(killed):
    out, _ = killed
    write(out)
    assert contents(out.parent) == {"out", "out/first", "out/second"}


def as_of_another_host(lock, seconds):
    """Makes a lock that of another host, last touched some seconds ago."""
    values = json.loads(lock.read_text()) | {"host": "node7", "system": "another"}
    lock.write_text(json.dumps(values))
    # The clock of a file system may be behind by some milliseconds.
    os.utime(lock, (time.time() - seconds - 1,) * 2)


def test_a_lock_of_another_host_is_replaced_by_force_if_nobody_touches_it(no_flock, killed):
    out, lock = killed
    as_of_another_host(lock, 63)
    process = json.loads(lock.read_text())["process"]
    seen = f"one, process {process} on node7, last seen"
    for force in (False, True):  # it may be alive
        is_refused(out, f"{seen} 6... s ago", hint="force=True", force=force)
    as_of_another_host(lock, 3 * 3600)
    is_refused(out, f"{seen} 3 h ago", hint="force=True")
    with refused(out, f"{seen} 3 h ago", hint=f"delete {lock}") as caught, output_folder(out, {}):
        raise AssertionError("not reached")  # a command without --force
    assert "force" not in caught.value.hint
    write(out, force=True)
    assert contents(out.parent) == {"out", "out/first", "out/second"}


def test_a_host_with_locks_keeps_the_lock_of_a_host_without(killed):
    out, lock = killed
    as_of_another_host(lock, 5)
    for _ in range(2):
        is_refused(out, "one, process ...", force=True)
    assert lock.exists()


def test_a_lock_that_names_nobody_is_deleted_by_hand(no_flock, killed):
    out, lock = killed
    for content in ("", "{}", '{"host": 1, "system": [], "process": "x"}', "\xe9"):
        lock.write_text(content, encoding="latin-1")
        os.utime(lock, (time.time() - 200_000,) * 2)
        is_refused(out, "one, whose lock is 2 days old", hint=f"delete {lock}", force=True)
    lock.unlink()
    write(out)
    assert contents(out.parent) == {"out", "out/first", "out/second"}


def test_a_process_at_work_touches_its_lock(no_flock, tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "_TOUCH", 0.01)
    with locked(tmp_path / "folder", "folder"):
        lock = tmp_path / "folder" / "lock"
        os.utime(lock, (0, 0))
        deadline = time.monotonic() + 20
        while lock.stat().st_mtime < time.time() - 10:
            assert time.monotonic() < deadline
            time.sleep(0.01)
        lock.unlink()  # somebody took the process for dead
    assert not any(tmp_path.iterdir())
    for thread in threading.enumerate():
        if "_touch" in thread.name:
            thread.join(20)
            assert not thread.is_alive()


def test_a_lock_that_another_process_replaced_stays(no_flock, tmp_path):
    with locked(tmp_path, tmp_path):
        lock = tmp_path / "lock"
        (tmp_path / "other").write_text("of another process")
        (tmp_path / "other").replace(lock)
    assert lock.read_text() == "of another process" and contents(tmp_path) == {"lock"}


def test_an_interruption_leaves_no_lock(no_flock, tmp_path, monkeypatch):
    with pytest.raises(KeyboardInterrupt), locked(tmp_path / "folder", "folder"):
        raise KeyboardInterrupt
    assert not contents(tmp_path)

    def fail(**_):
        raise PermissionError(13, "Permission denied", "tmp123")

    monkeypatch.setattr(locks, "TemporaryFile", fail)
    lock = tmp_path / "folder" / "lock"
    with refused("mine", f"{lock}: permission denied"), locked(tmp_path / "folder", "mine"):
        raise AssertionError("not reached")
    assert not contents(tmp_path)
