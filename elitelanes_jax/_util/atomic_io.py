"""Output folders and files that are written whole or not at all."""

import errno
import glob
import json
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.limited_read import MIB, read_text

if TYPE_CHECKING:
    from filelock import BaseFileLock

__all__ = ["check_new", "compare_settings", "new_folder", "unwritable_error", "write_atomic"]

_LOCK = ".elitelanes-lock"  # held by the process that writes in a hidden folder


@contextmanager
def new_folder(folder: str | Path) -> Iterator[Path]:
    """Provides a hidden folder to write in; when the block ends it takes the place of the given one.

    The given folder is new or empty; an empty one is filled. If the block ends with an error, nothing has changed. What
    a process that was killed has left of the hidden folder is removed the next time.

    Raises:
      InputError: if the folder is a file, is not empty, or cannot be made or written to.
    """
    from filelock import FileLock  # it takes 50 ms to load

    asked, folder = folder, Path(os.path.realpath(folder))
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{asked}: expected a folder that is new or empty, got a file")
    there = folder.is_dir()
    aside = (folder if there else folder.parent) / f".{folder.name}-{uuid.uuid4().hex[:8]}"
    missing, moved = [parent for parent in folder.parents if not parent.exists()], []
    lock = FileLock(aside / _LOCK)
    try:
        try:
            _remove_leftovers(aside.parent, folder.name)
            if there and any(folder.iterdir()):
                raise InputError(f"{asked}: expected a folder that is new or empty, got one with files in it")
            folder.parent.mkdir(parents=True, exist_ok=True)
            aside.mkdir()
            lock.acquire(blocking=False)
        except OSError as error:
            raise unwritable_error(asked, error) from None
        yield aside
        _let_go(lock)
        if there:
            for entry in sorted(aside.iterdir()):
                moved += [entry.replace(folder / entry.name)]
            aside.rmdir()
        else:
            aside.replace(folder)
    except BaseException:
        _let_go(lock)
        for place in (aside, *moved):
            _remove(place)
        for parent in missing:  # the deepest first
            if parent.is_dir():
                parent.rmdir()
        raise


def _remove_leftovers(place: Path, name: str) -> None:
    """Removes the hidden folders of processes that were killed: with a lock that nobody holds, or still empty."""
    from filelock import FileLock, Timeout

    for aside in place.glob(f".{glob.escape(name)}-*") if place.is_dir() else ():
        if not re.fullmatch("[0-9a-f]{8}", aside.name[-8:]) or len(aside.name) != len(name) + 10 or aside.is_symlink():
            continue
        with suppress(OSError, Timeout):
            if (aside / _LOCK).is_file():
                lock = FileLock(aside / _LOCK)
                lock.acquire(blocking=False)
                _let_go(lock)
                shutil.rmtree(aside)
            else:
                aside.rmdir()


def _let_go(lock: "BaseFileLock") -> None:
    """Releases a lock and removes its file."""
    file = Path(lock.lock_file)
    with suppress(OSError):
        file.unlink()  # while it is held, so that nobody else gets it; but Windows does not remove an open file
    lock.release()
    with suppress(OSError):
        file.unlink()


def check_new(file: Path) -> None:
    """Checks that there is no file of this name.

    Raises:
      InputError: if there is.
    """
    if file.exists():
        raise InputError(f"{file}: expected a file that is new, got one that is there")


def write_atomic(file: Path, content: bytes | Iterable[bytes]) -> None:
    """Writes a file beside its place, then renames it: a reader, even after a kill, finds it whole or not at all.

    Args:
      file: the path; missing folders are made.
      content: all of it, or piece by piece.

    Raises:
      OSError: that names the file, if it cannot be written; no part of it is left.
    """
    aside = file.with_name(f".{file.name}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as stream:
            stream.writelines([content] if isinstance(content, bytes) else content)
        aside.replace(file)
    except OSError as error:
        with suppress(OSError):  # the folder may not exist
            aside.unlink()
        if isinstance(error, FileExistsError):  # a file in the place of a folder
            error = NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        raise OSError(error.errno, error.strerror, str(file)) from None


def unwritable_error(place: str | Path, error: OSError) -> InputError:
    """Makes the error that says why a place cannot be written to."""
    got = f" {error.filename}" if error.filename else ""
    return InputError(f"{place}: expected a place that can be written to, got{got}: {reason(error)}")


def compare_settings(folder: Path, file: Path, asked: dict[str, Any]) -> None:
    """Compares settings with those that a folder was begun with.

    Args:
      folder: of the results.
      file: the JSON file with the earlier settings.
      asked: the settings now.

    Raises:
      InputError: that names the first setting that differs.
    """
    try:
        there = json.loads(read_text(file, 32 * MIB))
    except (OSError, ValueError, RecursionError):
        raise InputError(f"{folder}: expected a folder that is new, or of the same settings, got another") from None
    if not isinstance(there, dict):
        raise InputError(f"{file}: expected a table of settings, got {type(there).__name__}")
    _compare(folder, json.loads(json.dumps(asked)), there)


def _compare(folder: Path, asked: dict[str, Any], there: dict[str, Any]) -> None:
    for name in asked | there:
        mine, found = asked.get(name), there.get(name)
        if isinstance(mine, dict) and isinstance(found, dict):
            _compare(folder, mine, found)
        elif mine != found:
            raise InputError(
                f"{folder}: expected results of {name} {mine!r}, got some of {found!r}; take another --out for these"
            )


def _remove(place: Path) -> None:
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    elif place.exists():
        place.unlink()
