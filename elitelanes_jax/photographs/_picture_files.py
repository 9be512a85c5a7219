"""Reads the picture of a JPEG or PNG file, as the sensor has it, at a size that fits the memory."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.files import MIB, read_bytes
from elitelanes_jax.photographs._jpeg import EncodedPicture, is_damaged, is_jpeg, read_header
from elitelanes_jax.tiles.files import decode_png, plain_png, png_parts, png_size

# The most bytes of a file.
_MOST_BYTES = 128 * MIB
# The most pixels of a JPEG, which can be read at an eighth of its size.
_MOST_PIXELS = 200e6
# JPEGs of more pixels are read at a half, a quarter or an eighth of their size.
_MOST_READ = 26e6
# The least side in pixels. In smaller pictures a tile's lines are not seen.
_LEAST_SIDE = 200
# The largest side in pixels of the picture that is read. OpenCV samples no larger one.
_MOST_SIDE = 2**15 - 2
_EXPECTED = "a photograph, a JPEG or PNG file"
# The flag that reads a file at a part of its size, by how many times smaller its sides become.
_READ_FLAGS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


class SensorPicture(NamedTuple):
    """The picture of a file, not yet turned upright.

    Attributes:
      pixels: uint8 ``[H, W, 3]``, RGB.
      shrunk: how many times smaller than the file's picture it is: 1, 2, 4 or 8.
      exif: the EXIF data of the file, empty if there are none.
    """

    pixels: NDArray[np.uint8]
    shrunk: int
    exif: bytes


def read_picture(file: Path) -> SensorPicture:
    """Reads the picture of a JPEG or PNG file, at a size that fits the memory.

    Raises:
      InputError: for another file, damage, transparent pixels, or a picture that is too large or
        too small; the message names the file.
    """
    opened = _open(file)
    pixels = opened.width * opened.height
    shrunk = next(shrunk for shrunk in _READ_FLAGS if pixels <= _MOST_READ * shrunk**2)
    content = np.frombuffer(opened.content, np.uint8)
    try:
        picture = cv2.imdecode(content, _READ_FLAGS[shrunk] | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        picture = None
    if picture is None:
        raise _unreadable_error(file)
    height, width = picture.shape[:2]
    if min(height, width) < _LEAST_SIDE:
        raise InputError(
            file, f"a photograph of at least {_LEAST_SIDE} pixels a side", f"{width} x {height}"
        )
    if max(height, width) > _MOST_SIDE:
        raise InputError(
            file, f"a photograph of at most {_MOST_SIDE:,} pixels a side", f"{width} x {height}"
        )
    red_first = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
    return SensorPicture(red_first, shrunk, opened.exif)


def _open(file: Path) -> EncodedPicture:
    """Reads a JPEG or PNG file, whose picture is whole and neither too large nor transparent."""
    content = _read_content(file)
    return _open_jpeg(file, content) if is_jpeg(content) else _open_png(file, content)


def _open_jpeg(file: Path, content: bytes) -> EncodedPicture:
    picture = read_header(content)
    if picture is None:
        raise _unreadable_error(file)
    _check_pixels(file, picture.width, picture.height, _MOST_PIXELS, "save it smaller")
    if is_damaged(picture):
        raise InputError(
            file,
            "a whole photograph",
            "a file with a damaged stretch",
            "copy it from the camera again",
        )
    return picture


def _open_png(file: Path, content: bytes) -> EncodedPicture:
    try:
        width, height = png_size(content)
    except ValueError:
        raise _unreadable_error(file) from None
    _check_pixels(file, width, height, _MOST_READ, "save it smaller, or as JPEG")
    try:
        plain = plain_png(content)
    except ValueError:
        raise _unreadable_error(file) from None
    if _is_transparent(plain):
        expected = "a photograph without transparent pixels, which hide colours"
        raise InputError(file, expected, "one with some", "save it as JPEG")
    exif = next((part.data for part in png_parts(content) if part.kind == b"eXIf"), b"")
    return EncodedPicture(width, height, exif, plain)


def _read_content(file: Path) -> bytes:
    """Reads a file that begins as a JPEG or PNG file does."""
    if file.is_dir():
        raise InputError(file, _EXPECTED, "a folder", "name the files in it")
    try:
        content = read_bytes(file, _MOST_BYTES)
    except OSError as error:
        raise InputError(file, _EXPECTED, reason(error)) from None
    if content[4:8] == b"ftyp":
        hint = "convert it to JPEG, or let the phone take JPEGs"
        raise InputError(file, _EXPECTED, "HEIC, AVIF or a film", hint)
    if not is_jpeg(content) and content[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError(file, _EXPECTED, "another file")
    return content


def _check_pixels(file: Path, width: int, height: int, most: float, remedy: str) -> None:
    if width * height > most:
        raise InputError(
            file, f"at most {most / 1000000.0:g} megapixels", f"{width} x {height}", remedy
        )


def _unreadable_error(file: Path) -> InputError:
    return InputError(file, _EXPECTED, "one that cannot be read")


def _is_transparent(content: bytes) -> bool:
    """Whether the picture of a PNG file has pixels that are not opaque."""
    # Byte 25 is the type of colours: types 4 and 6 have opacity. Other files may declare colours
    # transparent in tRNS.
    has_alpha = content[25] in (4, 6)
    if not has_alpha and b"tRNS" not in content:
        return False
    picture = decode_png(content)
    if picture is None or picture.ndim < 3 or picture.shape[2] < 4:
        return False
    return bool((picture[..., 3] < np.iinfo(picture.dtype).max).any())
