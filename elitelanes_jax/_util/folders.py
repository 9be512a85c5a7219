"""Output folders that are complete or do not exist.

The runs that write them can be killed at any moment and resumed. Unfinished work is kept in a
hidden folder next to the output folder, ``.NAME-unfinished``. Of a name longer than 243 bytes, the
start and a digest are in the hidden name. The hidden folder has:

- ``lock`` is held by the process that works, see `FolderLock`.
- ``settings.json`` has what the work depends on.
- ``kept`` has what the next run resumes from.
- ``files`` has the files so far. At the end the folder is renamed to the output folder.
- ``replaced`` is the output folder that was there before; ``files`` gets its permissions. If the
  process is killed before ``files`` has its name, the next run does the rest.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import copy_mode, read_json, unwritable_error, write_json
from elitelanes_jax._util.locks import FolderLock
from elitelanes_jax._util.types import Plain

# The entries of the hidden folder, see above.
_LOCK = "lock"
_SETTINGS = "settings.json"
_KEPT = "kept"
_FILES = "files"
_REPLACED = "replaced"

# Tables whose names say nothing about their entries: the options of a command are in these tables.
_UNNAMED = ("settings", "search")

# The most bytes of a name in common file systems.
_LONGEST_NAME = 255


class Unfinished(NamedTuple):
    """The folders of unfinished work.

    Attributes:
      files: a folder for the files; it becomes the output folder.
      kept: a folder for what the next run resumes from; it is deleted when the output folder is
        complete.
    """

    files: Path
    kept: Path


class Difference(NamedTuple):
    """The first difference between two tables.

    Attributes:
      name: the names of the tables around the entry, and its own name, such as "weights turns".
      value: its value in the first table; None if the table has no such entry.
      other: its value in the second table, in the same way.
    """

    name: str
    value: Plain
    other: Plain


@contextmanager
def output_folder(
    out: str | Path,
    settings: Mapping[str, Plain],
    *,
    inputs: Iterable[str | Path] = (),
    foreign: Callable[[Path], str | None] | None = None,
    force: bool = False,
    resume_files: bool = False,
) -> Iterator[Unfinished]:
    """Provides folders to work in. When the block ends, its files are the output folder.

    If the block raises an error, the output folder does not change. After an error with files in
    `kept`, or a kill, the next run resumes the work. Only one process at a time works for an output
    folder.

    Args:
      out: the output folder, new or empty.
      settings: what the work depends on, plain values for JSON. Work is resumed only with equal
        settings.
      inputs: paths that the work reads. A folder that contains one of them is not replaced.
      foreign: returns None if a folder may be replaced. Otherwise it returns the first file that no
        earlier run wrote, or another reason.
      force: whether a folder is replaced if `foreign` returns None. Unfinished work with other
        settings is deleted then, and a lock of a dead process on another host is replaced.
      resume_files: whether the work resumes with the files of an earlier run; by default it starts
        without files.

    Raises:
      InputError: if the output folder is a file, a mount or the current folder, or cannot be
        written to. Also if it is not empty and may not be replaced. Also if it has unfinished work
        with other settings or of another process.
      OSError: of the block. It names a file as if it were in the output folder already.
    """
    # Messages have the path as the user wrote it.
    asked = out
    try:
        # The work is next to the folder that a link leads to, because a folder can only be renamed
        # within a file system.
        out = Path(os.path.realpath(asked))
    except OSError as error:
        # The current folder was deleted.
        raise unwritable_error(asked, error) from None
    if out.is_symlink():
        raise InputError(asked, "a folder", "a link that leads to itself")
    hidden = _hidden(out)
    work = Unfinished(hidden / _FILES, hidden / _KEPT)
    has_own_files = False
    is_complete = False
    try:
        check_renamable(asked)
        # Where no folder is replaced, the caller has no option `force`.
        with locked(hidden, asked, force=None if foreign is None else force):
            _settle(hidden, out)
            _check_replaceable(asked, out, inputs, foreign, force)
            try:
                _resume(asked, hidden, settings, force, resume_files)
                # From here on the files are of this run. Until here they may be of a run with other
                # settings, and stay.
                has_own_files = True
                yield work
                # Somebody may have written to the output folder in the meantime.
                _check_replaceable(asked, out, inputs, foreign, force)
                _move(hidden, out)
                is_complete = True
            finally:
                if is_complete or not _has_work(hidden):
                    _clear(hidden, _LOCK)
                elif has_own_files and not resume_files:
                    # What the next run resumes from is in `kept`, and it writes the files again.
                    _clear(work.files)
    except OSError as error:
        if error.errno is None:
            # The error does not come from the system.
            raise
        file = str(error.filename or asked).replace(str(work.files), str(asked))
        raise OSError(error.errno, error.strerror, file) from None
    finally:
        # A folder with files stays.
        with suppress(OSError):
            hidden.rmdir()


def check_renamable(folder: str | Path) -> None:
    """Checks that a folder, if it exists, is no mount and not the current folder.

    Raises `InputError` for these. Raises `OSError` for a name that the system refuses, such as one
    that is too long.
    """
    target = Path(os.path.realpath(folder))
    with suppress(FileNotFoundError, NotADirectoryError):
        if os.path.ismount(target):
            got = "a mount"
        elif target.samefile(os.curdir):
            got = "the current one"
        else:
            return
        raise InputError(folder, "a folder that can be renamed", got, "name a new folder in it")


def has_unfinished(out: str | Path) -> bool:
    """Returns whether the next run for a folder resumes unfinished work."""
    try:
        return _has_work(_hidden(Path(os.path.realpath(out))))
    except OSError:
        # What cannot be read cannot be resumed.
        return False


def settle(out: str | Path) -> None:
    """Completes an output folder if a run was killed while it replaced the folder."""
    out = Path(os.path.realpath(out))
    hidden = _hidden(out)
    if hidden.is_dir():
        # Another process that holds it does the rest.
        with suppress(InputError), locked(hidden, out):
            _settle(hidden, out)
        # A folder with other work stays.
        with suppress(OSError):
            hidden.rmdir()


@contextmanager
def locked(folder: Path, asked: str | Path, *, force: bool | None = None) -> Iterator[None]:
    """Locks a folder, so that only one process at a time works in it; see `FolderLock`.

    A second process gets an `InputError` that names `asked`. The folder and its parents are made if
    they do not exist. At the end, the folders that were made are removed if they are empty. The
    block may remove the folder.
    """
    lock = FolderLock(folder / _LOCK)
    # The folders that are made here, the deepest one first.
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            lock.acquire(asked, force)
        except OSError as error:
            raise unwritable_error(asked, error) from None
        yield
    finally:
        lock.release()
        # A folder with files stays.
        for path in missing:
            with suppress(OSError):
                path.rmdir()


def compare_settings(
    folder: str | Path, file: Path, settings: Mapping[str, Plain], hint: str
) -> None:
    """Compares settings with those in a JSON file of an earlier run.

    The `InputError` names `folder` and the first setting that differs, and ends with `hint`.
    """
    try:
        earlier = read_json(file)
    except (OSError, ValueError, RecursionError):
        earlier = None
    if not isinstance(earlier, dict):
        raise InputError(folder, f"settings of an earlier run in {file}", "none", hint)
    # A dataset that an older program left unfinished does not name its command.
    if "command" not in earlier:
        settings = {name: value for name, value in settings.items() if name != "command"}
    # The earlier file may have further settings, which are not compared.
    earlier = {name: earlier.get(name) for name in settings}
    # The settings become as JSON has them: a tuple becomes a list.
    difference = first_difference(json.loads(json.dumps(settings)), earlier)
    if difference is None:
        return
    if difference.name == "command":
        got = f"that of {difference.other or 'another command'}"
        raise InputError(folder, f"unfinished work of {difference.value}", got, hint)
    value, got = quote(difference.value), quote(difference.other)
    raise InputError(folder, f"results with {difference.name} {value}", f"results with {got}", hint)


def first_difference(table: Mapping[str, Plain], other: Mapping[str, Plain]) -> Difference | None:
    """Returns the first difference between tables; None if they are equal.

    Tables within the tables are compared in the same way.
    """
    for name in {**table, **other}:
        value, other_value = table.get(name), other.get(name)
        if isinstance(value, Mapping) and isinstance(other_value, Mapping):
            within = first_difference(value, other_value)
            if within is not None and name in _UNNAMED:
                return within
            if within is not None:
                return within._replace(name=f"{name} {within.name}")
        elif value != other_value:
            return Difference(name, value, other_value)
    return None


def check_apart(folder: str | Path, inputs: Iterable[str | Path]) -> None:
    """Checks that a folder or file to be replaced is no input and contains none.

    Symbolic links are followed.
    """
    for path in inputs:
        if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
            continue
        if not Path(folder).is_dir():
            raise InputError(folder, "a file to replace that is no input", path)
        raise InputError(folder, "a folder to replace that contains no input", f"one with {path}")


def foreign_file(folder: Path, is_ours: Callable[[str], Plain]) -> str | None:
    """Returns the first file below a folder, by name, that is not ours, or None.

    `is_ours` takes its relative path, with slashes. A symbolic link is never ours.
    """
    for parent, names, files in os.walk(folder):
        # `os.walk` visits the folders in the order of this list.
        names.sort()
        # A link to a folder is among the folders, but is not walked into.
        links = [name for name in names if Path(parent, name).is_symlink()]
        for name in sorted([*files, *links]):
            path = Path(parent, name)
            relative = path.relative_to(folder).as_posix()
            if path.is_symlink() or not is_ours(relative):
                return relative
    return None


def remove(path: Path) -> None:
    """Removes a file, or a folder with everything in it, if it exists."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _hidden(out: Path) -> Path:
    """Returns the hidden folder of the unfinished work for an output folder."""
    name = out.name
    encoded = os.fsencode(name)
    if len(encoded) > _LONGEST_NAME - len(".-unfinished"):
        name = f"{name[:50]}-{sha256(encoded).hexdigest()[:16]}"
    # The root has no name, so `with_name` would raise an error for it.
    return out.parent / f".{name}-unfinished"


def _check_replaceable(
    asked: str | Path,
    out: Path,
    inputs: Iterable[str | Path],
    foreign: Callable[[Path], str | None] | None,
    force: bool,
) -> None:
    """Checks that an output folder is new or empty, or may be replaced; see `output_folder`."""
    if out.exists() and not out.is_dir():
        raise InputError(asked, "a folder that is new or empty", "a file")
    if not out.exists() or not any(out.iterdir()):
        return
    # Without `foreign` no folder is replaced.
    foreign_name = None if foreign is None else foreign(out)
    if force and foreign_name:
        raise InputError(
            asked, "a folder with files of an earlier run alone", f"one with {foreign_name}"
        )
    if not force or foreign is None:
        hint = ""
        if foreign is not None and not foreign_name:
            hint = "force=True replaces it"
        raise InputError(asked, "a folder that is new or empty", "one with files in it", hint)
    check_apart(asked, inputs)


def _has_work(hidden: Path) -> bool:
    """Returns whether a hidden folder has files in `kept`, from which a run can resume."""
    if not (hidden / _FILES).is_dir():
        return False
    # A folder within `kept` may have a lock of its own, which is no work.
    return any(path.is_file() and path.name != _LOCK for path in (hidden / _KEPT).rglob("*"))


def _resume(
    asked: str | Path, hidden: Path, settings: Mapping[str, Plain], force: bool, resume_files: bool
) -> None:
    """Prepares the hidden folder: keeps the work of an earlier run with equal settings.

    Work with other settings is of no use to this run. With `force`, it is deleted. Otherwise the
    `InputError` of `compare_settings` is raised.
    """
    files, kept = hidden / _FILES, hidden / _KEPT
    resumes = _has_work(hidden)
    if resumes:
        try:
            compare_settings(
                asked,
                hidden / _SETTINGS,
                settings,
                f"delete {hidden}, or use force=True, to start anew",
            )
        except InputError:
            if not force:
                raise
            resumes = False
    if not resumes:
        _clear(hidden, _LOCK)
    # The settings are written before any work, so that work always has its settings.
    write_json(hidden / _SETTINGS, settings)
    for folder in (files, kept):
        folder.mkdir(exist_ok=True)
    # A process that was killed may have locked a folder within `kept`, and it is dead.
    for lock in kept.rglob(_LOCK):
        lock.unlink()
    if not resume_files:
        _clear(files)
    # A kill leaves the part of a file that was written.
    for part in files.rglob(".*.part*"):
        part.unlink()


def _move(hidden: Path, out: Path) -> None:
    """Renames the files to the output folder.

    An error leaves everything as it was.
    """
    replaced = hidden / _REPLACED
    if out.exists():
        # The earlier folder is renamed instead of deleted, so that it can come back after an error.
        out.rename(replaced)
    try:
        _reveal(hidden, out)
    except BaseException:
        if replaced.exists():
            replaced.rename(out)
        raise


def _reveal(hidden: Path, out: Path) -> None:
    """Renames the files, with the permissions of the replaced folder."""
    copy_mode(hidden / _REPLACED, hidden / _FILES)
    (hidden / _FILES).rename(out)


def _settle(hidden: Path, out: Path) -> None:
    """Does the rest of a run that was killed after its files were complete."""
    if (hidden / _REPLACED).exists():
        # The kill came after the earlier folder was renamed and before the new one was.
        if not out.exists():
            _reveal(hidden, out)
        _clear(hidden, _LOCK)
    elif not (hidden / _FILES).exists():
        # The kill came before the work, or after the files got their name.
        _clear(hidden, _LOCK)


def _clear(folder: Path, but: str = "") -> None:
    """Removes everything in a folder, except for the entry `but`."""
    for entry in folder.iterdir():
        if entry.name != but:
            remove(entry)
