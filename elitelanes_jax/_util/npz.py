"""Files of arrays by name, of which one is a JSON table: NumPy's ``.npz``, without pickles."""

import json
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path

import numpy as np

from elitelanes_jax._util.errors import InputError, reason, shorten
from elitelanes_jax._util.files import MIB
from elitelanes_jax._util.memory import free_memory
from elitelanes_jax._util.types import Plain, Untyped

_SETTINGS = "settings"
# Bytes unpacked, at most: the most of these, and a quarter of the free memory. Elites shrink to a tenth, vacant places
# to a thousandth.
_MOST_BYTES, _MOST_RATIO = 512 * MIB, 64

# Errors that a damaged file raises: of NumPy, JSON, and ZIP, which may be packed in unknown ways or encrypted.
_DAMAGES = (
    *(ValueError, TypeError, KeyError, EOFError, OverflowError, MemoryError, RecursionError),
    *(zipfile.BadZipFile, zlib.error, NotImplementedError, RuntimeError, SyntaxError, tokenize.TokenError),
)


def pack(arrays: Mapping[str, np.ndarray], settings: Plain) -> bytes:
    """Packs arrays of numbers or texts, and values for JSON; the same content gives the same bytes."""
    stream = BytesIO()
    np.savez_compressed(stream, **arrays, **{_SETTINGS: np.array(json.dumps(settings))})  # type: ignore[arg-type]
    return stream.getvalue()


def unpack(path: str | Path) -> tuple[Plain, dict[str, np.ndarray]]:
    """Reads a file: the values of its JSON, None where it has none, and its arrays by name.

    Raises:
      InputError: if it cannot be read, is no such file, or is damaged.
    """
    try:
        with _open_arrays(path) as archive:
            settings = json.loads(str(archive[_SETTINGS])) if _SETTINGS in archive.files else None
            return settings, {name: archive[name] for name in archive.files if name != _SETTINGS}
    except OSError as error:
        raise InputError(f"{path}: {reason(error)}") from None
    except _DAMAGES as error:
        words = shorten(str(error).partition("\n")[0] or type(error).__name__)
        raise InputError(f"{path}: expected NumPy's .npz, got one that does not hold: {words}") from None


@contextmanager
def _open_arrays(path: str | Path) -> Iterator[Untyped]:
    """Opens a file of arrays by name, which are read without pickles.

    Raises:
      InputError: if it would unpack to over 512 MiB, over 64 times its size, and over a quarter of the free memory.
      OSError: if it cannot be read; and any of `_DAMAGES`, here and when arrays are read.
    """
    with Path(path).open("rb") as stream:
        if stream.read(2) != b"PK":  # NumPy would read a single array, or a pickle
            raise zipfile.BadZipFile("no archive of arrays")
        with zipfile.ZipFile(stream) as members:
            size = sum(member.file_size for member in members.infolist())
        most = max(_MOST_BYTES, _MOST_RATIO * stream.seek(0, 2), free_memory() // 4)
        if size > most:
            raise InputError(f"expected at most {most:,} bytes unpacked, got {size:,}")
        stream.seek(0)
        yield np.load(stream, allow_pickle=False)
