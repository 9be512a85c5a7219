"""Files of arrays by name, of which one is a JSON table: NumPy's ``.npz``, without pickles."""

import json
import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from elitelanes_jax._util.errors import InputError, reason

__all__ = ["pack", "unpack"]

_SETTINGS = "settings"


def pack(arrays: Mapping[str, np.ndarray], settings: Any) -> bytes:
    """Packs arrays of numbers or texts, and values for JSON; the same content gives the same bytes."""
    stream = BytesIO()
    np.savez_compressed(stream, **arrays, **{_SETTINGS: np.array(json.dumps(settings))})  # type: ignore[arg-type]
    return stream.getvalue()


def unpack(path: str | Path) -> tuple[Any, dict[str, np.ndarray]]:
    """Reads a file: the values of its JSON, None where it has none, and its arrays by name.

    Raises:
      InputError: if it cannot be read, is no such file, or is damaged.
    """
    try:
        with Path(path).open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError("a single array")
            settings = json.loads(str(archive[_SETTINGS])) if _SETTINGS in archive.files else None
            return settings, {name: archive[name] for name in archive.files if name != _SETTINGS}
    except OSError as error:
        raise InputError(f"{path}: {reason(error)}") from None
    # Of NumPy, JSON, the ZIP format; NotImplementedError for a kind of compression, RuntimeError for an encrypted file.
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError) as error:
        words = str(error).partition("\n")[0]
        raise InputError(f"{path}: expected NumPy's .npz, got one that does not hold: {words}") from None
