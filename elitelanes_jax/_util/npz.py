"""Files of named arrays and one JSON table: NumPy's ``.npz``, without pickles."""

import json
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path

import numpy as np

from elitelanes_jax._util.errors import InputError, reason, shorten
from elitelanes_jax._util.files import MIB
from elitelanes_jax._util.memory import free_memory
from elitelanes_jax._util.types import Plain

_SETTINGS = "settings"
# The limit of unpacked bytes is the largest of 512 MiB, 64 times the file's size and a quarter of
# the free memory. Elites are packed to a tenth of their size, vacant slots to a thousandth.
_MOST_BYTES, _MOST_RATIO = 512 * MIB, 64

# Errors of NumPy, JSON and ZIP for a damaged file, an encrypted one or an unknown compression.
_DAMAGES = (
    *(ValueError, TypeError, KeyError, EOFError, OverflowError, MemoryError, RecursionError),
    *(
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,
        RuntimeError,
        SyntaxError,
        tokenize.TokenError,
    ),
)


def npz_bytes(arrays: Mapping[str, np.ndarray], settings: Plain) -> bytes:
    """Packs arrays of numbers or texts, and values for JSON. Equal content gives equal bytes."""
    stream = BytesIO()
    # JSON as an array of text needs no pickle. NumPy gives all members the same date, so that equal
    # content has equal bytes.
    np.savez_compressed(stream, **arrays, **{_SETTINGS: np.array(json.dumps(settings))})  # type: ignore[arg-type]
    return stream.getvalue()


def read_npz(path: str | Path) -> tuple[Plain, dict[str, np.ndarray]]:
    """Returns the JSON values of a file, or None, and its arrays by name.

    Raises `InputError` if the file cannot be read.
    """
    try:
        with Path(path).open("rb") as stream:
            if stream.read(2) != b"PK":
                # NumPy would read a single array, or a pickle.
                raise zipfile.BadZipFile("no archive of arrays")
            with zipfile.ZipFile(stream) as members:
                # The sizes in the directory are read before anything is unpacked, so that a small
                # file cannot fill the memory.
                size = sum(member.file_size for member in members.infolist())
            most = max(_MOST_BYTES, _MOST_RATIO * stream.seek(0, 2), free_memory() // 4)
            if size > most:
                raise InputError("", f"at most {most:,} bytes unpacked", f"{size:,}")
            stream.seek(0)
            archive = np.load(stream, allow_pickle=False)
            arrays = {name: archive[name] for name in archive.files}
            for name, array in arrays.items():
                # NumPy returns the bytes of a member that is no array.
                if not isinstance(array, np.ndarray):
                    raise zipfile.BadZipFile(f"{name} is no array")
            settings = arrays.pop(_SETTINGS, None)
            return None if settings is None else json.loads(str(settings)), arrays
    except OSError as error:
        raise InputError(path, "", reason(error)) from None
    except _DAMAGES as error:
        words = shorten(str(error).partition("\n")[0] or type(error).__name__)
        raise InputError(
            path, "NumPy's .npz", f"a file that cannot be read as such: {words}"
        ) from None
