"""A lock on a folder, which one process at a time holds.

The system releases its locks when a process ends. Some file systems of clusters have no such locks.
There, the lock is a file that exists while the folder is locked. It names the process that made it,
and that process touches it all the time. A process that was killed leaves the file:

- On the same host, the next process sees that the process is dead, and replaces the lock.
- Nobody can ask another host. If the file was not touched for `_SILENCE` seconds, the lock may be
  replaced by force. A process that works touches its file more often, and a user can wait for this
  time.
"""

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from platform import node
from tempfile import TemporaryFile
from threading import Event, Thread
from typing import NamedTuple
from uuid import uuid4

from elitelanes_jax._util.errors import InputError

# Seconds between two touches of the file, and seconds without a touch after which the process is
# taken for dead. A busy file system may delay a touch.
_TOUCH, _SILENCE = 10.0, 120.0


class FolderLock:
    """A lock whose file is in the folder that it locks."""

    def __init__(self, file: Path) -> None:
        # Imported here, because loading it takes 50 ms.
        from filelock import FileLock

        self._file = file
        # The lock of the system. Its file has no content.
        self._lock = FileLock(file)
        self._has_system_locks = False
        # The content of the file that this process made, "" before.
        self._content = ""
        self._released = Event()

    def acquire(self, asked: str | Path, force: bool | None) -> None:
        """Locks the folder.

        Args:
          asked: the folder as the user wrote it, for messages.
          force: whether a lock of another host is replaced if it was not touched for a while. None
            if the caller has no such option.

        Raises:
          InputError: if another process holds the lock. The message names `asked` and the lock.
          OSError: if the file cannot be written.
        """
        from filelock import Timeout

        try:
            with TemporaryFile(dir=self._file.parent) as probe:
                self._has_system_locks = _can_lock(probe.fileno())
                # The clock of the file system may differ from the one of this host.
                now = os.fstat(probe.fileno()).st_mtime
        except OSError as error:
            # Nobody knows the name of the temporary file.
            raise OSError(error.errno, error.strerror, str(self._file)) from None
        content, age = self._read(now)
        holder = _Holder.read(content)
        if holder is not None:
            if not holder.is_dead() and not (force and age >= _SILENCE and not holder.is_here()):
                raise _held(asked, self._file, age, holder, force)
            self._remove(content)
        try:
            if self._has_system_locks:
                self._lock.acquire(blocking=False)
            else:
                self._make()
        except (Timeout, FileExistsError):
            raise _held(asked, self._file, age, _Holder.read(self._read(now)[0]), force) from None

    def release(self) -> None:
        """Unlocks the folder and deletes the file, also if `acquire` was interrupted.

        Does nothing if another process holds the lock. The folder may be gone.
        """
        self._released.set()
        if not self._has_system_locks:
            if self._content:
                self._remove(self._content)
            return
        from filelock import Timeout

        with suppress(OSError, Timeout):
            # A file with content is the lock of a host without system locks, which refused this
            # process. FileLock of filelock 3.15 would delete the content.
            if not self._file.parent.is_dir() or self._has_content():
                self._lock.release(force=True)
                return
            # An interruption may have come after the lock's file was made and before it was locked.
            # The file is removed then too. If another process holds the lock, this raises Timeout,
            # and the file stays.
            self._lock.acquire(blocking=False)
            try:
                # Windows deletes no open file; there the release deletes it.
                with suppress(OSError):
                    self._file.unlink()
            finally:
                # Each call of `acquire` counts. `force` releases the lock at once, because a
                # process that was interrupted may continue.
                self._lock.release(force=True)

    def _has_content(self) -> bool:
        return self._file.exists() and self._file.stat().st_size > 0

    def _read(self, now: float) -> tuple[str, float]:
        """Returns the content of the file, and the seconds since it was touched."""
        content, age = "", 0.0
        # There may be no file, and Windows lets nobody read a locked file.
        with suppress(OSError):
            age = max(now - self._file.stat().st_mtime, 0.0)
            content = self._file.read_text(encoding="utf-8", errors="replace")
        return content, age

    def _make(self) -> None:
        """Makes the file, and touches it until the release. Raises `FileExistsError`."""
        descriptor = os.open(self._file, os.O_CREAT | os.O_EXCL | os.O_WRONLY)
        self._content = _Holder.of_this_process().to_text()
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(self._content)
        Thread(target=self._touch, daemon=True).start()

    def _touch(self) -> None:
        while not self._released.wait(_TOUCH):
            # A failure of a moment must not stop it.
            with suppress(OSError):
                os.utime(self._file)

    def _remove(self, content: str) -> None:
        """Deletes the file if it has this content."""
        # Another process may replace a dead lock at the same time. The file that it made has other
        # content, and gets its name back.
        aside = self._file.with_name(f"{self._file.name}-{uuid4().hex}")
        with suppress(OSError):
            self._file.rename(aside)
            if aside.read_text(encoding="utf-8", errors="replace") == content:
                aside.unlink()
            else:
                aside.rename(self._file)


class _Holder(NamedTuple):
    """The process that holds a lock.

    Attributes:
      host: the name of its host.
      system: what differs between hosts, and between containers with process numbers of their own.
      process: the number of the process.
    """

    host: str
    system: str
    process: int

    @classmethod
    def of_this_process(cls) -> "_Holder":
        return cls(node(), _system(), os.getpid())

    @classmethod
    def read(cls, text: str) -> "_Holder | None":
        """Reads the content of a lock's file; returns None if it names no process."""
        try:
            values = json.loads(text)
            return cls(str(values["host"]), str(values["system"]), int(values["process"]))
        except (ValueError, TypeError, KeyError, RecursionError):
            return None

    def to_text(self) -> str:
        # The key tells two locks of one process apart.
        return json.dumps(self._asdict() | {"key": uuid4().hex})

    def is_here(self) -> bool:
        """Returns whether this process can see the holder."""
        return self.system == _system()

    def is_dead(self) -> bool:
        """Returns whether the process has surely ended."""
        import psutil

        return self.is_here() and not psutil.pid_exists(self.process)


def _system() -> str:
    """Returns a text that processes share if they see each other's numbers."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot} {Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        # Nothing tells hosts apart for sure, so no process is taken for one of this host.
        return uuid4().hex


def _can_lock(descriptor: int) -> bool:
    """Returns whether the system can lock an open file that no other process knows."""
    if sys.platform == "win32":
        return True
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (ImportError, OSError):
        return False
    return True


def _held(
    asked: str | Path, file: Path, age: float, holder: _Holder | None, force: bool | None
) -> InputError:
    """Returns the error for a folder that another process has locked."""
    got = "one"
    remedy = f"delete {file} if that run is dead"
    if holder is None:
        got += f", whose lock is {_duration(age)} old"
    else:
        got += f", process {holder.process} on {holder.host}, last seen {_duration(age)} ago"
        # By force, only a lock of another host is replaced.
        if force is not None and not holder.is_here():
            remedy = (
                f"force=True replaces its lock {_duration(_SILENCE)} after it was seen, or {remedy}"
            )
    return InputError(asked, "no other run at work in it", got, remedy)


def _duration(seconds: float) -> str:
    """Returns a duration in its largest unit, rounded down: 59 s, 2 min, 5 h, 3 days."""
    for unit, size, least in (("days", 86400, 2), ("h", 3600, 2), ("min", 60, 2)):
        if seconds >= least * size:
            return f"{int(seconds // size)} {unit}"
    return f"{int(seconds)} s"
