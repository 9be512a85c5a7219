"""Output folders and files that are written whole or not at all."""

import errno
import glob
import json
import os
import re
import shutil
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.limited_read import MIB, read_text
from elitelanes_jax._util.types import Plain

if TYPE_CHECKING:
    from filelock import BaseFileLock

_LOCK = ".elitelanes-lock"  # held by the process that writes in a hidden folder
_REPLACED = ".replaced"  # in it, what is removed when all new files have their places


@contextmanager
def new_folder(
    folder: str | Path, *, foreign: Callable[[Path], str | None] | None = None, force: bool = False
) -> Iterator[Path]:
    """Provides a hidden folder to write in; when the block ends it takes the place of the given one.

    The given folder is new or empty; an empty one is filled. If the block ends with an error, nothing has changed. What
    a process that was killed has left of the hidden folder is removed the next time.

    Args:
      folder: to be made.
      foreign: from a folder to its first file that an earlier run did not write, None where there is none.
      force: whether a folder without such a file is replaced.

    Raises:
      InputError: if the folder is a file, is not empty and not to be replaced, or cannot be made or written to.
      OSError: of the block; it names the file, as if it were in the given folder, or this folder.
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
                _check_replaceable(asked, folder, foreign, force)
            folder.parent.mkdir(parents=True, exist_ok=True)
            aside.mkdir()
            lock.acquire(blocking=False)
        except OSError as error:
            raise unwritable_error(asked, error) from None
        yield aside
        _let_go(lock)
        if there:
            new, old = sorted(aside.iterdir()), [entry for entry in folder.iterdir() if entry != aside]
            behind = aside / _REPLACED
            behind.mkdir()
            for entry in old:
                entry.replace(behind / entry.name)
            for entry in new:
                moved += [entry.replace(folder / entry.name)]
            shutil.rmtree(aside)
        else:
            aside.replace(folder)
    except BaseException as error:
        _let_go(lock)
        for place in moved:
            remove(place)
        for entry in (aside / _REPLACED).iterdir() if (aside / _REPLACED).is_dir() else ():
            entry.replace(folder / entry.name)
        remove(aside)
        for parent in missing:  # the deepest first
            if parent.is_dir():
                parent.rmdir()
        if isinstance(error, OSError) and error.errno is not None:  # names no file, or one in the hidden folder
            file = str(error.filename or asked).replace(str(aside), str(asked))
            raise OSError(error.errno, error.strerror, file) from None
        raise


def _check_replaceable(
    asked: str | Path, folder: Path, foreign: Callable[[Path], str | None] | None, force: bool
) -> None:
    found = foreign and foreign(folder)
    if force and found:
        raise InputError(f"{asked}: expected a folder with files of an earlier run alone, got one with {found}")
    if not force or foreign is None:
        hint = "; --force replaces it" if foreign and not found else ""
        raise InputError(f"{asked}: expected a folder that is new or empty, got one with files in it{hint}")


def check_apart(folder: str | Path, inputs: Iterable[str | Path]) -> None:
    """Checks that no input lies in a folder that is to be replaced, symbolic links followed.

    Raises:
      InputError: that names the first one that does.
    """
    place = os.path.realpath(folder)
    for one in inputs:
        if Path(os.path.realpath(one)).is_relative_to(place):
            raise InputError(
                f"{folder}: expected a folder to replace that holds none of the inputs, got one with {one}"
            )


def foreign_file(folder: Path, own: Callable[[str], Plain]) -> str | None:
    """Returns the first file in a folder and all below that is not an own one, in the order of names; None without one.

    Args:
      folder: to look through; a link in it is no own file.
      own: from a path relative to the folder, with slashes, to whether it is an own file's.
    """
    for place, names, files in os.walk(folder):
        names.sort()
        links = [name for name in names if (Path(place) / name).is_symlink()]
        for name in sorted([*files, *links]):
            path = Path(place, name)
            relative = path.relative_to(folder).as_posix()
            if path.is_symlink() or not own(relative):
                return relative
    return None


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


def write_json(file: Path, values: Plain) -> None:
    """Writes values as JSON, as `write_atomic` does."""
    write_atomic(file, json.dumps(values, indent=2).encode() + b"\n")


def unwritable_error(place: str | Path, error: OSError) -> InputError:
    """Makes the error that says why a place cannot be written to."""
    got = f" {error.filename}" if error.filename else ""
    return InputError(f"{place}: expected a place that can be written to, got{got}: {reason(error)}")


def compare_settings(folder: Path, file: Path, asked: dict[str, Plain]) -> None:
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
    difference = first_difference(json.loads(json.dumps(asked)), there)
    if difference is not None:
        name, mine, found = difference
        raise InputError(
            f"{folder}: expected results of {name} {mine!r}, got some of {found!r}; take another folder for these"
        )


def first_difference(asked: dict[str, Plain], there: dict[str, Plain]) -> tuple[str, Plain, Plain] | None:
    """Compares tables, and tables within them; returns the name of the first value that differs, and both values."""
    for name in asked | there:
        mine, found = asked.get(name), there.get(name)
        if isinstance(mine, dict) and isinstance(found, dict):
            if (within := first_difference(mine, found)) is not None:
                return within
        elif mine != found:
            return name, mine, found
    return None


def remove(place: Path) -> None:
    """Removes a file, or a folder with all in it, if there is one."""
    if place.is_dir():
        shutil.rmtree(place, ignore_errors=True)
    elif place.exists():
        place.unlink()
