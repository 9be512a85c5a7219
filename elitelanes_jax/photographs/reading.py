"""Reads photographs of phones and cameras, at a size that fits the memory."""

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.files import MIB, read_bytes
from elitelanes_jax.photographs._jpeg import is_damaged, is_jpeg, read_header
from elitelanes_jax.photographs._upright import UPRIGHT, Turn
from elitelanes_jax.photographs.lenses import Lens, read_lens
from elitelanes_jax.tiles.files import decode_png, plain_png, png_parts, png_size

# The most bytes of a file.
_MOST_BYTES = 128 * MIB
# The most pixels of a JPEG, which can be read at an eighth of its size.
_MOST_PIXELS = 200e6
# JPEGs of more pixels are read at a half, a quarter or an eighth of their size.
_MOST_READ = 26e6
# The least side in pixels. In smaller pictures a tile's lines are not seen.
_LEAST_SIDE = 200
_WORDS = "expected a photograph, a JPEG or PNG file"
# The flag that reads a file at a part of its size, by how many times smaller its sides become.
_READ_FLAGS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}


class Photograph(NamedTuple):
    """A photograph.

    Attributes:
      name: the name of its file with its folder, for messages.
      image: uint8 ``[H, W, 3]``, RGB, upright.
      shrunk: how many times smaller than the file's picture it is.
      lens: the calibrated lens whose distortion was removed, for pictures of this size as the
        sensor has them; None if there is none.
      turn: how the sensor's picture became upright.
    """

    name: str
    image: NDArray[np.uint8]
    shrunk: int = 1
    lens: Lens | None = None
    turn: Turn = UPRIGHT

    @staticmethod
    @name_wrong_arguments
    def read(file: str | Path, lens: Lens | str | Path | None = None) -> "Photograph":
        """Reads a JPEG or PNG file of a photograph, turned upright as its EXIF data say.

        Args:
          file: the file, of at most 128 MiB. A JPEG of more than 26 megapixels is read at a half, a
            quarter or an eighth of its size.
          lens: the calibration of the camera, a YAML file of ROS, Duckietown, OpenCV or Kalibr. The
            distortion of its lens is removed.

        Raises:
          InputError: for another file, transparent pixels, or sides below 200 pixels; the message
            says what to do.
        """
        file = Path(check_named("file", path, file))
        if isinstance(lens, str | Path):
            lens = read_lens(lens)
        picture_file = _open(file)
        sensor, shrunk = _decode(file, picture_file)
        if min(sensor.shape[:2]) < _LEAST_SIDE:
            got = f"{sensor.shape[1]} x {sensor.shape[0]}"
            raise InputError(
                f"{file}: expected a photograph of at least {_LEAST_SIDE} pixels a side, got {got}"
            )
        if lens is not None:
            # The lens bends the sensor's picture, before anything turns it.
            try:
                lens = lens.scaled(sensor)
            except InputError as error:
                raise InputError(f"{file}: {error}") from None
            sensor = lens.straighten_image(sensor)
        turn = Turn.of_exif(picture_file.exif)
        return Photograph(str(file), turn.picture(sensor), shrunk, lens, turn)

    def pixels_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` of the file's picture, seen upright, are in `image`."""
        # Whole numbers are the centres of pixels. Therefore half a pixel is added before sizes are
        # divided.
        pixels = (np.asarray(points, np.float64) + 0.5) / self.shrunk - 0.5
        if self.lens is None:
            return pixels
        height, width = self.image.shape[:2]
        sensor = self.lens.straighten(self.turn.sensor_pixels(pixels, width, height))
        return self.turn.pixels(sensor, width, height)


class _PictureFile(NamedTuple):
    """A file of a picture.

    Attributes:
      content: the bytes of the file that hold the picture.
      width: the width of the sensor's picture in pixels.
      height: the height of the sensor's picture in pixels.
      exif: the EXIF data, empty if there are none.
    """

    content: bytes
    width: int
    height: int
    exif: bytes


def _open(file: Path) -> _PictureFile:
    """Reads a JPEG or PNG file, whose picture is whole and neither too large nor transparent."""
    content = _read_content(file)
    return _open_jpeg(file, content) if is_jpeg(content) else _open_png(file, content)


def _open_jpeg(file: Path, content: bytes) -> _PictureFile:
    header = read_header(content)
    if header is None:
        raise _unreadable_error(file)
    _check_pixels(file, header.width, header.height, _MOST_PIXELS, "save it smaller")
    if is_damaged(header):
        raise InputError(
            f"{file}: expected a whole photograph, got a file with a damaged stretch; "
            "copy it from the camera again"
        )
    return _PictureFile(header.plain, header.width, header.height, header.exif)


def _open_png(file: Path, content: bytes) -> _PictureFile:
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
        raise InputError(
            f"{file}: expected a photograph without transparent pixels, which hide colours; "
            "save it as JPEG"
        )
    exif = next((part.data for part in png_parts(content) if part.kind == b"eXIf"), b"")
    return _PictureFile(plain, width, height, exif)


def _read_content(file: Path) -> bytes:
    """Reads a file that begins as a JPEG or PNG file does."""
    if file.is_dir():
        raise InputError(f"{file}: {_WORDS}, got a folder; name the files in it")
    try:
        content = read_bytes(file, _MOST_BYTES)
    except OSError as error:
        raise InputError(f"{file}: {_WORDS}, got: {reason(error)}") from None
    if content[4:8] == b"ftyp":
        raise InputError(
            f"{file}: {_WORDS}, "
            "got HEIC, AVIF or a film; convert it to JPEG, or let the phone take JPEGs"
        )
    if not is_jpeg(content) and content[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError(f"{file}: {_WORDS}, got another file")
    return content


def _check_pixels(file: Path, width: int, height: int, most: float, remedy: str) -> None:
    if width * height > most:
        raise InputError(
            f"{file}: expected at most {most / 1e6:g} megapixels, got {width} x {height}; {remedy}"
        )


def _decode(file: Path, picture_file: _PictureFile) -> tuple[NDArray[np.uint8], int]:
    """Returns the sensor's picture, RGB, and how many times smaller than the file's it is.

    A picture may be 1, 2, 4 or 8 times smaller.
    """
    pixels = picture_file.width * picture_file.height
    shrunk = next(shrunk for shrunk in _READ_FLAGS if pixels <= _MOST_READ * shrunk**2)
    content = np.frombuffer(picture_file.content, np.uint8)
    try:
        picture = cv2.imdecode(content, _READ_FLAGS[shrunk] | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        picture = None
    if picture is None:
        raise _unreadable_error(file)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8), shrunk


def _unreadable_error(file: Path) -> InputError:
    return InputError(f"{file}: {_WORDS}, got one that cannot be read")


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
