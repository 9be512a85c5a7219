"""Output folders and files that are there whole or not at all."""

import errno
import json
import os
import shutil
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from elitelanes_jax.errors import InputError, reason

__all__ = ["check_same", "new_folder", "unwritable", "write_whole"]


@contextmanager
def new_folder(folder: str | Path) -> Iterator[Path]:
    """A folder to write in, hidden; when all is written it takes the place of the given one.

    The given folder is new, or empty: then it stays, and is filled. Where the block is left by an error, all is as it
    was before.

    Raises:
      InputError: if the folder is a file, is not empty, or cannot be made or written to.
    """
    asked, folder = folder, Path(os.path.realpath(folder))
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{asked}: expected a folder that is new or empty, got a file")
    there = folder.is_dir()
    try:
        if there and any(folder.iterdir()):
            raise InputError(f"{asked}: expected a folder that is new or empty, got one with files in it")
        made = _make_parents(folder)
        aside = (folder if there else folder.parent) / f".{folder.name}-{uuid.uuid4().hex[:8]}"
        aside.mkdir()
    except OSError as error:
        raise unwritable(asked, error) from None
    moved: list[Path] = []
    try:
        yield aside
        if there:
            for entry in sorted(aside.iterdir()):
                moved += [entry.replace(folder / entry.name)]
            aside.rmdir()
        else:
            aside.replace(folder)
    except BaseException:
        for place in (aside, *moved):
            _remove(place)
        for parent in made:
            parent.rmdir()
        raise


def write_whole(file: Path, content: bytes | Iterable[bytes]) -> None:
    """Writes a file aside, then renames it: whoever reads it, even after a kill, finds it whole or not at all.

    Args:
      file: where; folders above it are made.
      content: all of it, or piece by piece.

    Raises:
      OSError: that names the file, if it cannot be written; nothing is left of it then.
    """
    aside = file.with_name(f".{file.name}.part")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with aside.open("wb") as stream:
            stream.writelines([content] if isinstance(content, bytes) else content)
        aside.replace(file)
    except OSError as error:
        with suppress(OSError):  # such as a place that cannot be
            aside.unlink()
        if isinstance(error, FileExistsError):  # in a folder's place
            error = NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        raise OSError(error.errno, error.strerror, str(file)) from None


def unwritable(place: str | Path, error: OSError) -> InputError:
    """The error that says why a place cannot be written to."""
    got = f" {error.filename}" if error.filename else ""
    return InputError(f"{place}: expected a place that can be written to, got{got}: {reason(error)}")


def check_same(folder: Path, file: Path, asked: dict[str, Any]) -> None:
    """Holds settings against those that a folder was begun with.

    Args:
      folder: that they are of.
      file: that keeps those it was begun with, as JSON.
      asked: settings now.

    Raises:
      InputError: that names the first that is another.
    """
    try:
        there = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
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
    else:
        place.unlink(missing_ok=True)


def _make_parents(folder: Path) -> list[Path]:
    """Makes the folders above one that are not there; returns them, the deepest first."""
    missing = [parent for parent in folder.parents if not parent.exists()]
    folder.parent.mkdir(parents=True, exist_ok=True)
    return missing
