"""Checksums: of the files in a folder, in the form that ``sha256sum -c`` reads, and of lines.

Lines with checksums are for files that an interrupted run leaves. After a loss of power, the end of
such a file, or any block of it, may be missing or zero.
"""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from zlib import crc32

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import write_atomic

SUMS = "SHA256SUMS"
"""The file with the checksums of the other files in its folder."""

# The digits of a checksum. Two spaces follow it, and the path.
_DIGITS = 64


def write_sums(folder: Path) -> None:
    """Writes the checksums of all files in a folder, sorted by their paths."""
    write_atomic(folder / SUMS, "".join(_lines(folder)).encode())


def _lines(folder: Path) -> Iterator[str]:
    paths = sorted(
        file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()
    )
    for path in paths:
        # The file cannot have its own checksum.
        if path != SUMS:
            yield f"{sha256((folder / path).read_bytes()).hexdigest()}  {path}\n"


def read_sums(folder: Path) -> dict[str, str]:
    """Reads the checksums of a folder, by the relative paths of its files, with slashes.

    Raises:
      OSError: if there is no such file.
      UnicodeDecodeError: if the file is not text.
    """
    lines = (folder / SUMS).read_text(encoding="utf-8").splitlines()
    return {line[_DIGITS + 2 :]: line[:_DIGITS] for line in lines}


def read_checked(folder: Path, path: str, sums: Mapping[str, str]) -> bytes:
    """Reads a file of a folder, and checks it.

    Raises `InputError` if the file is missing or has another checksum than in `sums`.
    """
    file = folder / path
    if path not in sums:
        raise InputError(folder / SUMS, f"a checksum of {path}", "none")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise InputError(folder, f"all its files, as {SUMS} lists them", f"no {path}") from None
    if sha256(content).hexdigest() != sums[path]:
        raise InputError(file, f"the file whose checksum is in {SUMS}", "a damaged or another one")
    return content


def sealed_line(content: bytes) -> bytes:
    """Returns a line with the checksum of its content, which has no line break."""
    return b"%08x\t%s\n" % (crc32(content), content)


def read_sealed_lines(text: bytes) -> Iterator[bytes]:
    """Yields the contents of lines that `sealed_line` made. Damaged lines are left out."""
    # After the last line break there is nothing, or a part of a line.
    *lines, _ = text.split(b"\n")
    for line in lines:
        checksum, _, content = line.partition(b"\t")
        if checksum == b"%08x" % crc32(content):
            yield content
