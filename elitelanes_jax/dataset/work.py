"""The state of a dataset in the making, so that it can be killed at any moment and go on."""

import errno
import fcntl
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from elitelanes_jax.errors import InputError, NotEnoughMapsError
from elitelanes_jax.folders import check_same, unwritable, write_whole

__all__ = ["LAST", "work_folder"]

LAST = "dataset.json"
"""The file that is written last: where it is, the dataset is complete."""

_WORK, _SETTINGS, _LOCK = ".unfinished", "settings.json", "lock"


@contextmanager
def work_folder(out: Path, settings: dict[str, Any]) -> Iterator[Path | None]:
    """A folder within ``out`` for what is needed until the dataset is complete; then it goes.

    Left by an error it stays, for the next run to go on from; not so where the settings themselves were at fault
    (`InputError`, `NotEnoughMapsError`), since the next run has others. One run at a time has it.

    Args:
      out: the dataset's folder: new, empty, or one that a run with the same settings has begun.
      settings: all that the files depend on.

    Yields:
      The folder, or None if the dataset is complete.

    Raises:
      InputError: if the folder is anything else, of other settings, at work already, or cannot be written to.
    """
    work, new = out / _WORK, not out.exists()
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: expected a folder that is new or empty, got a file")
    try:
        if out.is_dir() and not (work.exists() or (out / LAST).exists()) and any(out.iterdir()):
            raise InputError(f"{out}: expected a folder that is new, empty or a dataset's, got one with files in it")
        if (out / LAST).exists() and not work.exists():
            check_same(out, out / LAST, _of_dataset(out, settings))
            yield None
            return
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / _LOCK).open("w")
    except OSError as error:
        raise unwritable(out, error) from None
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            raise InputError(f"{out}: expected no other run at work in it, got one") from None
        if (out / LAST).exists():  # killed while it was cleared up, or another run has just come to its end
            check_same(out, out / LAST, _of_dataset(out, settings))
            shutil.rmtree(work, ignore_errors=True)
            yield None
            return
        if (work / _SETTINGS).exists():
            check_same(out, work / _SETTINGS, settings)
        else:
            write_whole(work / _SETTINGS, json.dumps(settings, indent=2).encode() + b"\n")
        try:
            yield work
        except (InputError, NotEnoughMapsError):
            shutil.rmtree(work)
            if new:
                with suppress(OSError):  # what is in there stays
                    out.rmdir()
            raise
        shutil.rmtree(work)


def _of_dataset(out: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """Settings among all else that a complete dataset says of itself."""
    try:
        there = json.loads((out / LAST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        there = {}
    return (there if isinstance(there, dict) else {}) | settings
