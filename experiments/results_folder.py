"""Folders of results: each belongs to one set of settings, and each of its files is written whole or not at all."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from elitelanes_jax import InputError
from elitelanes_jax._util.files import write_atomic, write_json
from elitelanes_jax._util.folders import compare_settings

__all__ = ["kept", "open_results"]

_SETTINGS = "settings.json"


def open_results(folder: Path, settings: dict[str, Any]) -> None:
    """Makes a folder of results, or opens the folder of an earlier run with the same settings.

    Raises:
      InputError: if the folder is a file, or holds other files or results of other settings.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder, got a file")
    file = folder / _SETTINGS
    if folder.is_dir() and any(not entry.name.startswith(".") for entry in folder.iterdir()):
        compare_settings(folder, file, settings, "use another folder")
        return
    folder.mkdir(parents=True, exist_ok=True)
    write_json(file, settings)


def kept(file: Path, make: Callable[[], Any]) -> Any:
    """Returns the content of a JSON file. If it does not exist, it is written with what `make` returns.

    Raises:
      InputError: if the file is not JSON.
    """
    if not file.exists():
        write_atomic(file, json.dumps(make()).encode())
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(
            f"{file}: expected results kept as JSON, got: {error}; without the file they are made again"
        ) from None
