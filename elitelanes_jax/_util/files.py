"""Reads files up to a size limit, and writes files whole or not at all."""

import errno
import json
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from itertools import count
from math import isfinite
from pathlib import Path
from shutil import copymode
from typing import NoReturn
from unicodedata import normalize

from elitelanes_jax._util.checks import check_unique
from elitelanes_jax._util.errors import InputError, reason, shorten
from elitelanes_jax._util.types import Plain, UserValue

KIB, MIB = 2**10, 2**20
"""Bytes in a kibibyte and in a mebibyte."""

# For a key of 20,000 parts, such as a.a.a, Python's reader takes 1.5 GB.
_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*"|'[^'\n]*')[ \t]*+\.[ \t]*+){32}""")

# The file that `never_replacing` protects.
_KEPT: ContextVar[Path | None] = ContextVar("kept", default=None)


def file_key(name: str) -> str:
    """Returns a text that two names share if they name the same file on some file systems.

    Such file systems ignore case, or how letters with accents are encoded.
    """
    # The case may change the form of a letter, so the form is set again.
    return normalize("NFC", normalize("NFC", name).casefold())


def read_bytes(file: str | Path, limit: int) -> bytes:
    """Reads a file of at most `limit` bytes.

    A larger file raises `InputError`, so that no file fills the memory.
    """
    with Path(file).open("rb") as stream:
        # One byte more tells a file that is too large. The size that the system reports may be 0,
        # as for a pipe.
        content = stream.read(limit + 1)
    if len(content) > limit:
        size = f"{limit / MIB:g} MiB" if limit >= MIB else f"{limit / KIB:g} KiB"
        raise InputError(file, f"a file of at most {size}", "a larger one")
    return content


def read_text(file: str | Path, limit: int) -> str:
    """Reads a file as UTF-8 without a byte order mark, see `read_bytes`.

    Other text raises `UnicodeDecodeError`.
    """
    return read_bytes(file, limit).decode("utf-8-sig")


def read_input(file: str | Path, limit: int, kind: str) -> str:
    """Reads a file that a user names, see `read_text`; `kind`, such as JSON, is for messages.

    Raises:
      InputError: if it cannot be read; the message names the file.
    """
    try:
        return read_text(file, limit)
    except FileNotFoundError:
        # The name may be meant for a folder.
        raise InputError(file, "", "no such file or directory") from None
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or error
        raise InputError(file, f"a readable {kind} file", why) from None


def read_json(file: str | Path) -> Plain:
    """Reads a file of JSON, at most 32 MiB; see `read_text` and `parse_json` for the errors.

    Each `InputError` names the file.
    """
    text = read_text(file, 32 * MIB)
    try:
        return parse_json(text)
    except InputError as error:
        raise error.within(file) from None


def read_toml(file: str | Path, source: str) -> dict[str, UserValue]:
    """Reads a file of TOML, at most 1 MiB.

    Other files are an `InputError`. It starts with the source, or with the path of a file that is
    too large.
    """
    try:
        text = read_text(file, MIB)
        if _LONG_KEY.search(text):
            raise ValueError("a key of more than 32 parts")
        return tomllib.loads(text)
    except InputError:
        # The file is too large, and the message names it.
        raise
    except OSError as error:
        raise InputError(source, "", reason(error)) from None
    except (ValueError, RecursionError) as error:
        # TOML has a `TOMLDecodeError`, and UTF-8 a `UnicodeDecodeError`; both are a ValueError.
        raise InputError(source, "TOML", shorten(str(error))) from None


def parse_json(text: str) -> Plain:
    """Parses JSON in which keys are unique and numbers are finite.

    If an object has a key twice, or a number is NaN or infinite, raises `InputError`. Other errors
    are a `ValueError`, or a `RecursionError` for a text that is nested too deeply.
    """
    return json.loads(text, object_pairs_hook=_object, parse_constant=_refuse, parse_float=_finite)


def _object(pairs: Sequence[tuple[str, Plain]]) -> dict[str, Plain]:
    check_unique("JSON", "key", [key for key, _ in pairs])
    return dict(pairs)


def _refuse(number: str) -> NoReturn:
    raise InputError("JSON", "numbers", shorten(number))


def _finite(number: str) -> float:
    value = float(number)
    if not isfinite(value):
        # A number such as 1e400 is infinite.
        _refuse(number)
    return value


@contextmanager
def new_file(file: Path) -> Iterator[Path]:
    """Provides a path next to a file for the block to write to.

    At the end of the block, the path is renamed to the file. A reader finds the whole file or none,
    even after a kill. Two processes may write the same file at once. Missing folders are made. An
    existing file is replaced and keeps its permissions; a symbolic link is followed. An `OSError`
    names `file`, and no part of the file is left.
    """
    target = Path(os.path.realpath(file)) if file.is_symlink() else file
    if not file.name:
        # "." has no parent to write a part in.
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(file))
    if target.is_symlink():
        # A link that leads to itself stays one.
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(file))
    before, after = _affixes_of_parts(target)
    part = target.with_name(before + os.urandom(4).hex() + after)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield part
        # This check comes as late as possible, because another process may write the file while the
        # block runs.
        if _KEPT.get() == file:
            check_new(file)
        copy_mode(target, part)
        # Renaming is atomic within a file system, which is why the part is next to the file.
        part.replace(target)
    except OSError as error:
        if error.filename not in (None, str(part)) and not target.is_relative_to(error.filename):
            # The block wrote another file.
            raise
        if isinstance(error, FileExistsError):
            # A file has the name of a parent folder.
            error = NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        raise OSError(error.errno, error.strerror, str(file)) from None
    finally:
        with suppress(OSError):
            part.unlink()


def write_atomic(file: Path, content: bytes | Iterable[bytes]) -> None:
    """Writes bytes, or an iterable of them, as `new_file` does."""
    with new_file(file) as part, part.open("wb") as stream:
        stream.writelines([content] if isinstance(content, bytes) else content)


def write_json(file: Path, values: Plain) -> None:
    """Writes values as JSON, as `new_file` does."""
    write_atomic(file, json.dumps(values, indent=2).encode() + b"\n")


def remove_parts(file: Path) -> None:
    """Removes the parts of a file that kills left in `new_file`.

    No other process may write the file meanwhile.
    """
    before, after = _affixes_of_parts(file)
    for path in file.parent.iterdir():
        if path.name.startswith(before) and path.name.endswith(after):
            path.unlink()


def _affixes_of_parts(file: Path) -> tuple[str, str]:
    """Returns how the name of a part of a file begins and ends."""
    # Cut, because a name has at most 255 bytes, and a character up to four.
    return f".{file.stem[:20]}-", f".part{file.suffix[:12]}"


def free_name(path: Path, name: str) -> Path:
    """Returns a path next to another one, for a new file or folder.

    Nothing exists there. The path has this name, or the name with -2, -3 and so on after it.
    """
    names = (name if number == 1 else f"{name}-{number}" for number in count(1))
    return next(free for free in map(path.with_name, names) if not free.exists())


def check_new(file: Path) -> None:
    """Raises `InputError` if a file of this name exists, or a symbolic link that leads nowhere."""
    if file.is_dir():
        got = "a folder"
    elif file.exists():
        got = "an existing one"
    elif file.is_symlink():
        got = "a link that leads nowhere"
    else:
        return
    raise InputError(file, "a new file", got)


def copy_mode(old: Path, new: Path) -> None:
    """Gives a file or folder the permissions of an older one.

    Does nothing if there is no older one, or the file system has no permissions.
    """
    with suppress(OSError):
        copymode(old, new)


@contextmanager
def never_replacing(file: Path) -> Iterator[None]:
    """Makes `new_file` refuse to replace a file within the block.

    If another process has written the file, it raises the error of `check_new`.
    """
    check_new(file)
    token = _KEPT.set(file)
    try:
        yield
    finally:
        _KEPT.reset(token)


def unwritable_error(path: str | Path, error: OSError) -> InputError:
    """Returns the error that says why a path cannot be written to."""
    got = ": ".join(filter(None, (error.filename, reason(error))))
    return InputError(path, "a path that can be written to", got)
