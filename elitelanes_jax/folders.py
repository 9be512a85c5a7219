"""Output folders that are there whole or not at all."""

import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["check_new_folder", "new_folder"]


def check_new_folder(folder: str | Path) -> None:
    """Raises ValueError unless the folder can be made: it is not there yet, or empty, and its parent is writable."""
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: expected a folder that is new or empty, got a file")
    if folder.is_dir() and any(folder.iterdir()):
        raise ValueError(f"{folder}: expected a folder that is new or empty, got one with files in it")
    parent = next(place for place in folder.absolute().parents if place.exists())
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise ValueError(f"{folder}: expected a place that can be written to, got {parent}, which cannot")


@contextmanager
def new_folder(folder: str | Path) -> Iterator[Path]:
    """A folder to write in beside the given one; when all is written it takes that one's place.

    Where the block is left by an error, nothing remains of it.

    Raises:
      ValueError: see `check_new_folder`.
    """
    folder = Path(folder)
    check_new_folder(folder)
    folder.absolute().parent.mkdir(parents=True, exist_ok=True)
    aside = folder.absolute().parent / f".{folder.name}-{uuid.uuid4().hex[:8]}"
    aside.mkdir()
    try:
        yield aside
        aside.replace(folder)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
        raise
