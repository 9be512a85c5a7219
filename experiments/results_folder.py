"""A folder of results that belongs to one set of settings, and is filled file by file, each whole or not at all."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from elitelanes_jax.errors import InputError
from elitelanes_jax.folders import check_same, write_whole

__all__ = ["kept", "open_results"]

_SETTINGS = "settings.json"


def open_results(folder: Path, settings: dict[str, Any]) -> None:
    """Makes a folder of results, or opens that of an earlier run with the same settings.

    Raises:
      InputError: if there is something else, or results of other settings.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file")
    file = folder / _SETTINGS
    if folder.is_dir() and any(not entry.name.startswith(".") for entry in folder.iterdir()):
        check_same(folder, file, settings)
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
