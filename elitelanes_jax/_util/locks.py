"""Folders that one process at a time works in."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from elitelanes_jax._util.atomic_io import unwritable_error
from elitelanes_jax._util.errors import InputError

LOCK = "lock"
"""The name of the file that is locked. The system unlocks it when its process ends, killed or not."""


@contextmanager
def locked(folder: Path, asked: str | Path) -> Iterator[None]:
    """Keeps a folder, which is made where it is missing, from other processes that ask for it.

    A folder that was made is removed again if nothing is in it at the end.

    Args:
      folder: to work in.
      asked: the place that the user named, for messages.

    Raises:
      InputError: if another process works in it, or it cannot be written to.
    """
    new, lock = not folder.exists(), FileLock(folder / LOCK)
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock.acquire(blocking=False)
        except Timeout:
            raise InputError(f"{asked}: expected no other run at work in it, got one") from None
        except OSError as error:
            raise unwritable_error(asked, error) from None
        yield
    finally:
        if new and not lock.is_locked:  # an interruption while it was taken leaves its file, and the folder with that
            with suppress(OSError, Timeout):
                lock.acquire(blocking=False)
        if lock.is_locked:
            with suppress(OSError):  # while it is held, so that nobody else gets it; but Windows removes no open file
                (folder / LOCK).unlink()
            lock.release()
            with suppress(OSError):  # another run has it now
                (folder / LOCK).unlink(missing_ok=True)
        if new:
            with suppress(OSError):  # something is in it
                folder.rmdir()
