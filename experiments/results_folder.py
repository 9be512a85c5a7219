"""A folder of results that belongs to one set of settings, and is filled file by file, each whole or not at all."""

import csv
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from elitelanes_jax.errors import InputError

__all__ = ["csv_of", "kept", "open_results", "write_whole"]

_SETTINGS = "settings.json"


def open_results(folder: Path, settings: dict[str, Any]) -> None:
    """Makes a folder of results, or opens that of an earlier run with the same settings.

    Raises:
      InputError: if there is something else, or results of other settings.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file")
    settings = json.loads(json.dumps(settings))
    file = folder / _SETTINGS
    if folder.is_dir() and any(not entry.name.startswith(".") for entry in folder.iterdir()):
        try:
            there = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            raise InputError(f"{folder}: expected a folder that is new, or of the same settings, got another") from None
        if not isinstance(there, dict):
            raise InputError(f"{file}: expected a table of settings, got {type(there).__name__}")
        for name in settings | there:
            if settings.get(name) != there.get(name):
                raise InputError(
                    f"{folder}: expected results of {name} {settings.get(name)!r}, got some of {there.get(name)!r}; "
                    "take another --out for these"
                )
        return
    folder.mkdir(parents=True, exist_ok=True)
    write_whole(file, json.dumps(settings, indent=2).encode() + b"\n")


def kept(file: Path, make: Callable[[], Any]) -> Any:
    """What a JSON file holds, or, where there is none yet, what is made and then kept in it."""
    if not file.exists():
        write_whole(file, json.dumps(make()).encode())
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(
            f"{file}: expected results kept as JSON, got: {error}; without the file they are made anew"
        ) from None


def csv_of(rows: Sequence[dict[str, Any]]) -> bytes:
    """A table of all columns that any row has."""
    text = io.StringIO()
    columns = list(dict.fromkeys(name for row in rows for name in row))
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def write_whole(file: Path, content: bytes) -> None:
    """Writes aside, then renames."""
    file.parent.mkdir(parents=True, exist_ok=True)
    aside = file.with_name(f".{file.name}.part")
    aside.write_bytes(content)
    aside.replace(file)
