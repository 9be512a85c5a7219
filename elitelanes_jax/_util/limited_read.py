"""Files read up to a limit: whatever a file is, it takes a known amount of memory."""

from pathlib import Path

from elitelanes_jax._util.errors import InputError

KIB, MIB = 2**10, 2**20
"""Bytes in a kibibyte and in a mebibyte."""


def read_bytes(file: str | Path, most: int) -> bytes:
    """Reads a file.

    Args:
      file: its path.
      most: bytes that it may have.

    Raises:
      InputError: if it has more; the message names the file.
      OSError: if it cannot be read.
    """
    with Path(file).open("rb") as stream:
        content = stream.read(most + 1)
    if len(content) > most:
        limit = f"{most / MIB:g} MiB" if most >= MIB else f"{most / KIB:g} KiB"
        raise InputError(f"{file}: expected a file of at most {limit}, got a larger one")
    return content


def read_text(file: str | Path, most: int) -> str:
    """Reads a file as UTF-8, without a byte order mark; see `read_bytes`.

    Raises:
      UnicodeDecodeError: if it is anything else.
    """
    return read_bytes(file, most).decode("utf-8-sig")
