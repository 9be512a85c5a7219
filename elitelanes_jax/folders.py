"""Output folders that are there whole or not at all."""

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from elitelanes_jax.errors import InputError

__all__ = ["new_folder"]


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
        why = (error.strerror or str(error)).lower()
        raise InputError(f"{asked}: expected a place that can be written to, got {error.filename}: {why}") from None
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
