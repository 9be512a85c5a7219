"""Replacing a dataset that an earlier run wrote, once another one is complete."""

import json
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from elitelanes_jax._util.atomic_io import foreign_file
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.limited_read import MIB, read_text
from elitelanes_jax._util.locks import LOCK
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._formats import FORMATS
from elitelanes_jax.dataset._work import LAST, SETTINGS, WORK
from elitelanes_jax.dataset.spec import SPLITS
from elitelanes_jax.tiles.tileset import MASKS

_DESCRIBING = (
    rf"README\.md|contact-sheet\.png|{re.escape(LAST)}|(train|validation|test)/metadata\.jsonl"
    r"|metadata/(train|val|test)\.jsonl|annotations/(train|val|test)\.json"
)
_UNFINISHED = rf"{re.escape(WORK)}/({re.escape(SETTINGS)}|{LOCK}|maps/[\w-]+\.jsonl|records/\d{{3,}}/\d{{6,}}\.json)"


@contextmanager
def place_for(out: Path, settings: dict[str, Plain], *, force: bool) -> Iterator[Path]:
    """Provides the folder to make a dataset in: ``out``, or one beside it while another dataset is in ``out``.

    The two change places when the block ends well, and the other one is removed; until then it is as it was. A run that
    was killed is continued in the folder where it was, or has only the change of places left to do.

    Args:
      out: the dataset's folder.
      settings: all that the new files depend on.
      force: whether another dataset is replaced.

    Raises:
      InputError: if there is any other file in a folder to be replaced, or another run is at work there.
    """
    place = out.resolve()
    new, old = (place.with_name(f".{place.name}.{age}") for age in ("new", "old"))
    begun = place / WORK / SETTINGS
    if not place.exists() and (new / LAST).exists() and not (new / WORK).exists():  # killed between the two renamings
        new.rename(place)
    if place.exists() and old.exists():  # or after them
        remove_dataset(old)
        old.rmdir()
        begun = place / LAST
    if not force or not place.is_dir() or not any(place.iterdir()) or _is_of(begun, settings):
        yield out
        return
    _check_removable(out)
    if new.exists() and not any(_is_of(file, settings) for file in (new / WORK / SETTINGS, new / LAST)):
        remove_dataset(new)
    yield new
    _check_removable(out)
    place.rename(old)
    new.rename(place)
    remove_dataset(old)
    old.rmdir()


def remove_dataset(out: Path) -> None:
    """Removes the files of a dataset, finished or not; the folder stays.

    Args:
      out: the dataset's folder; nothing is done if it is new or empty.

    Raises:
      InputError: if any other file is in it, or another run is at work there; nothing is removed then.
    """
    if not out.is_dir() or not any(out.iterdir()):
        return
    with _held(out):
        # What the folder is recognised by goes last: killed in between, it can still be removed.
        for entry in out.iterdir():
            if entry.name not in (WORK, LAST):
                _remove(entry)
        (out / LAST).unlink(missing_ok=True)
        for entry in sorted((out / WORK).iterdir(), key=lambda entry: entry.name == SETTINGS):
            if entry.name != LOCK:
                _remove(entry)


def _check_removable(out: Path) -> None:
    with _held(out):
        pass


@contextmanager
def _held(out: Path) -> Iterator[None]:
    """Keeps other runs from a dataset's folder in which nothing else is; raises `InputError` if that cannot be."""
    found = _foreign(out)
    if found:
        raise InputError(f"{out}: expected a folder with files of an earlier run alone, got one with {found}")
    work = out / WORK
    work.mkdir(exist_ok=True)
    try:
        with FileLock(work / LOCK).acquire(blocking=False):
            yield
    except Timeout:
        raise InputError(f"{out}: expected no other run at work in it, got one") from None
    with suppress(OSError):  # another run may have the folder now
        (work / LOCK).unlink(missing_ok=True)
        work.rmdir()


def _is_of(file: Path, settings: dict[str, Plain]) -> bool:
    """Tells whether a file, if it is there, has these settings in it."""
    try:
        there = json.loads(read_text(file, 32 * MIB))
    except (OSError, ValueError, RecursionError):
        return False
    return there == settings or (file.name == LAST and isinstance(there, dict) and there | settings == there)


def _remove(entry: Path) -> None:
    if entry.is_dir():
        shutil.rmtree(entry)
    else:
        entry.unlink()


def _foreign(out: Path) -> str | None:
    """Returns the first file in a folder that no run wrote there; None without one."""
    record = next((file for file in (out / LAST, out / WORK / SETTINGS) if file.exists()), None)
    if record is None:
        return f"no {LAST}"
    try:
        own = _own_files(json.loads(read_text(record, 32 * MIB)))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return f"{record.relative_to(out)} of another program"
    return foreign_file(out, lambda path: own.fullmatch(re.sub(r"(^|/)\.([^/]+)\.part$", r"\1\2", path)))


def _own_files(about: Plain) -> re.Pattern[str]:
    """Returns the pattern of all files of a dataset that the record describes."""
    if "elitelanes_jax" not in about["versions"]:
        raise ValueError
    layout = FORMATS[about["settings"]["format"]]
    layers = ("image", "labels", *MASKS, *about["tile_set"]["layers"])
    pictures = [layout.file(split, 0, layer) for split in range(len(SPLITS)) for layer in layers]
    patterns = (re.escape(picture).replace("000000", r"\d{6,}") for picture in pictures)
    return re.compile("|".join([_DESCRIBING, _UNFINISHED, *patterns]))
