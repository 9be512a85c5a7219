"""The state of an unfinished dataset, so that it can be killed at any moment and continue."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from elitelanes_jax._util.atomic_io import compare_settings, unwritable_error, write_json
from elitelanes_jax._util.errors import InputError, NotEnoughMapsError
from elitelanes_jax._util.limited_read import MIB, read_text
from elitelanes_jax._util.locks import LOCK, locked
from elitelanes_jax._util.types import Plain

LAST = "dataset.json"
"""The file that is written last: with it the dataset is complete."""

WORK = ".unfinished"
"""The folder of unfinished work."""

SETTINGS = "settings.json"
"""The file in it with all that the dataset's files depend on."""


@contextmanager
def work_folder(out: Path, settings: dict[str, Plain]) -> Iterator[Path | None]:
    """Provides a folder within ``out`` for unfinished work, removed when the dataset is complete.

    After an error it stays, for the next run to continue from; but not where the settings were at fault (`InputError`,
    `NotEnoughMapsError`), since the next run has others. One run at a time has it.

    Args:
      out: the dataset's folder: new, empty, or one that a run with the same settings has begun.
      settings: all that the files depend on.

    Yields:
      The folder, or None if the dataset is complete.

    Raises:
      InputError: if the folder is anything else, of other settings, used by another run, or cannot be written to.
    """
    work, new = out / WORK, not out.exists()
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder that is new or empty, got a file")
    try:
        if out.is_dir() and not (work.exists() or (out / LAST).exists()) and any(out.iterdir()):
            raise InputError(f"{out}: expected a folder that is new, empty or a dataset's, got one with files in it")
        if (out / LAST).exists() and not work.exists():
            compare_settings(out, out / LAST, _of_dataset(out, settings))
            yield None
            return
    except OSError as error:
        raise unwritable_error(out, error) from None
    cleared = False
    try:
        with locked(work, out):
            if (out / LAST).exists():  # a run was killed while it cleared up, or another one has just ended
                compare_settings(out, out / LAST, _of_dataset(out, settings))
                _clear(work)
                cleared = True
                yield None
                return
            if (work / SETTINGS).exists():
                compare_settings(out, work / SETTINGS, settings)
            else:
                write_json(work / SETTINGS, settings)
            try:
                yield work
            except (InputError, NotEnoughMapsError):
                _clear(work)
                cleared = True
                raise
            _clear(work)
            cleared = True
    finally:
        if cleared:
            for folder in (work, out) if new else (work,):
                with suppress(OSError):  # it is gone, another run has it now, or other files are in it
                    folder.rmdir()


def _clear(work: Path) -> None:
    """Removes all but the lock: Windows does not remove an open file."""
    for entry in work.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        elif entry.name != LOCK:
            entry.unlink()


def _of_dataset(out: Path, settings: dict[str, Plain]) -> dict[str, Plain]:
    """Returns the record of a complete dataset with these settings in it."""
    try:
        there = json.loads(read_text(out / LAST, 32 * MIB))
    except (OSError, ValueError, RecursionError):
        there = {}
    return (there if isinstance(there, dict) else {}) | settings
