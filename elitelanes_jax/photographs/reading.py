"""Reads photographs of phones and cameras, and calibrations of lenses.

Photographs are read at a size that fits the memory.
"""

import re
import sys
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, is_real, is_whole, path
from elitelanes_jax._util.errors import InputError, brief, reason
from elitelanes_jax._util.files import MIB, read_bytes, read_text
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.tiles.files import decode_png, plain_png, png_size

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
# The next marker of a JPEG file. Readers skip other bytes before it, and fill bytes 0xFF.
_MARKER = re.compile(rb"\xff+([^\x00\xff])", re.DOTALL)
# The markers of headers with the picture's size.
_FRAME_MARKERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# The markers that no length follows.
_LONE_MARKERS = {0x01, *range(0xD0, 0xD9)}
# The markers of the end, and of pixels, which come after the frame header.
_LAST_MARKERS = {0xD9, 0xDA}


class Photograph(NamedTuple):
    """A photograph.

    Attributes:
      name: the name of its file, for messages.
      image: uint8 ``[H, W, 3]``, RGB, upright.
      shrunk: how many times smaller than the file's picture it is.
      lens: the calibrated lens whose distortion was removed, None if there is none.
    """

    name: str
    image: NDArray[np.uint8]
    shrunk: int = 1
    lens: "Lens | None" = None

    @staticmethod
    @name_wrong_arguments
    def read(file: str | Path, lens: "Lens | str | Path | None" = None) -> "Photograph":
        """Reads a JPEG or PNG file of a photograph, turned upright as its EXIF data say.

        Args:
          file: the file, of at most 128 MiB. A JPEG of more than 26 megapixels is read at a half, a
            quarter or an eighth of its size.
          lens: the calibration of the camera, a YAML file as ROS's camera_calibration and
            Duckietown write it. The distortion of its lens is removed.

        Raises:
          InputError: for another file, transparent pixels, or sides below 200 pixels; the message
            says what to do.
        """
        file = Path(check_named("file", path, file))
        if isinstance(lens, str | Path):
            lens = read_lens(lens)
        content = _read_content(file)
        shrunk = _choose_reduction(file, content)
        picture = _decode(file, content, shrunk)
        if min(picture.shape[:2]) < _LEAST_SIDE:
            got = f"{picture.shape[1]} x {picture.shape[0]}"
            raise InputError(
                f"{file}: expected a photograph of at least {_LEAST_SIDE} pixels a side, got {got}"
            )
        # A JPEG file has no transparency.
        if not _is_jpeg(content) and _is_transparent(content):
            raise InputError(
                f"{file}: expected a photograph without transparent pixels, which hide colours; "
                "save it as JPEG"
            )
        image = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
        if lens is not None:
            try:
                image = lens.scaled(image).straighten_image(image)
            except InputError as error:
                raise InputError(f"{file}: {error}") from None
        return Photograph(file.name, image, shrunk, lens)

    def pixels_of(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` of the file's picture are in `image`."""
        # Whole numbers are the centres of pixels. Therefore half a pixel is added before sizes are
        # divided.
        pixels = (np.asarray(points, np.float64) + 0.5) / self.shrunk - 0.5
        return pixels if self.lens is None else self.lens.scaled(self.image).straighten(pixels)


class Lens(NamedTuple):
    """A calibrated camera, as ROS and Duckietown write it.

    Attributes:
      matrix: float ``[3, 3]``, of the camera.
      distortion: OpenCV's coefficients; four of a fisheye lens.
      fisheye: whether the model is ROS's `equidistant` or `fisheye`.
      width: the width of its pictures in pixels.
      height: the height of its pictures in pixels.
    """

    matrix: NDArray[np.float64]
    distortion: NDArray[np.float64]
    fisheye: bool
    width: int
    height: int

    def scaled(self, image: NDArray[np.uint8]) -> "Lens":
        """Returns the lens for pictures of an image's size.

        Raises `InputError` if the sides of the image have another ratio.
        """
        height, width = image.shape[:2]
        if abs(width * self.height - height * self.width) > 0.01 * width * self.height:
            raise InputError(
                f"expected a photograph of the camera's ratio {self.width} x {self.height}, "
                f"got {width} x {height}"
            )
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return Lens(scale @ self.matrix, self.distortion, self.fisheye, width, height)

    def straighten(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Returns where pixels ``[N, 2]`` are without the distortion."""
        undistort = cv2.fisheye.undistortPoints if self.fisheye else cv2.undistortPoints
        points = undistort(
            pixels[None].astype(np.float64), self.matrix, self.distortion, P=self.matrix
        )
        return np.asarray(points, np.float64).reshape(-1, 2)

    def straighten_image(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Returns an image of the lens's size without the distortion."""
        if self.fisheye:
            return np.asarray(
                cv2.fisheye.undistortImage(image, self.matrix, self.distortion, None, self.matrix)
            )
        return np.asarray(cv2.undistort(image, self.matrix, self.distortion), np.uint8)


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
    if not _is_jpeg(content) and content[:8] != b"\x89PNG\r\n\x1a\n":
        raise InputError(f"{file}: {_WORDS}, got another file")
    return content


def _is_jpeg(content: bytes) -> bool:
    return content[:3] == b"\xff\xd8\xff"


def _choose_reduction(file: Path, content: bytes) -> int:
    """Returns how many times smaller than its picture a file is read.

    The result is 1, 2, 4 or 8, and always 1 for PNG.
    """
    if _is_jpeg(content):
        size, most, remedy = _jpeg_size(content), _MOST_PIXELS, "save it smaller"
    else:
        size, most, remedy = _png_size(content), _MOST_READ, "save it smaller, or as JPEG"
    if size is None:
        raise _unreadable_error(file)
    width, height = size
    if width * height > most:
        raise InputError(
            f"{file}: expected at most {most / 1e6:g} megapixels, got {width} x {height}; {remedy}"
        )
    return next(shrunk for shrunk in _READ_FLAGS if width * height <= _MOST_READ * shrunk**2)


def _decode(file: Path, content: bytes, shrunk: int) -> NDArray[np.uint8]:
    """Returns the picture of a file, BGR, upright."""
    picture: NDArray | None = None
    try:
        if not _is_jpeg(content):
            # OpenCV turns the picture as its EXIF data say.
            content = plain_png(content, others=(b"eXIf",))
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), _READ_FLAGS[shrunk])
    except (cv2.error, ValueError):
        # The message says that the file cannot be read.
        pass
    if picture is None:
        raise _unreadable_error(file)
    return np.asarray(picture, np.uint8)


def _unreadable_error(file: Path) -> InputError:
    return InputError(f"{file}: {_WORDS}, got one that cannot be read")


def read_lens(file: str | Path) -> Lens:
    """Reads the calibration of a camera.

    The file is YAML, as ROS's camera_calibration and Duckietown write it.

    Raises:
      InputError: for another file; the message names the entry.
    """
    file = Path(check_named("file", path, file))
    try:
        values = yaml.safe_load(read_text(file, MIB))
    except OSError as error:
        raise InputError(f"{file}: expected a camera's calibration, got: {reason(error)}") from None
    except (yaml.YAMLError, ValueError, RecursionError):
        raise InputError(
            f"{file}: expected a camera's calibration in YAML, got another file"
        ) from None
    values = values if isinstance(values, dict) else {}
    model = values.get("distortion_model", "plumb_bob")
    if model not in ("plumb_bob", "rational_polynomial", "equidistant", "fisheye"):
        raise InputError(
            f"{file}: distortion_model: expected plumb_bob, rational_polynomial or equidistant"
        )
    fisheye = model in ("equidistant", "fisheye")
    matrix = _numbers(file, values, "camera_matrix", (9,)).reshape(3, 3)
    if not (matrix.diagonal()[:2] > 0).all():
        raise InputError(
            f"{file}: camera_matrix: expected focal lengths over 0, "
            f"got {matrix[0, 0]:g} and {matrix[1, 1]:g}"
        )
    if not np.array_equal(matrix[2], (0, 0, 1)):
        got = ", ".join(f"{number:g}" for number in matrix[2])
        raise InputError(f"{file}: camera_matrix: expected a last row of 0, 0, 1, got {got}")
    # OpenCV's model of a fisheye lens has four coefficients. Its other model has any of these
    # numbers.
    distortion = _numbers(
        file, values, "distortion_coefficients", (4,) if fisheye else (4, 5, 8, 12, 14)
    )
    width, height = (values.get(name, 0) for name in ("image_width", "image_height"))
    if not all(is_whole(side) and 0 < side < 1e5 for side in (width, height)):
        raise InputError(
            f"{file}: expected image_width and image_height in pixels, "
            f"got {brief(width)} and {brief(height)}"
        )
    return Lens(matrix, distortion, fisheye, int(width), int(height))


def _numbers(file: Path, values: dict, name: str, lengths: tuple[int, ...]) -> NDArray[np.float64]:
    entry = values.get(name)
    data = entry.get("data") if isinstance(entry, dict) else None
    numbers = [_number(part) for part in data] if isinstance(data, list) else []
    if len(numbers) not in lengths or None in numbers:
        raise InputError(
            f"{file}: {name}: expected data, a list of {' or '.join(map(str, lengths))} numbers"
        )
    return np.array(numbers, np.float64)


def _number(value: UserValue) -> float | None:
    """Returns a finite number, or None for anything else."""
    # Other programs write 1e-05, which PyYAML reads as text because it has no point.
    if isinstance(value, str):
        with suppress(ValueError):
            value = float(value)
    # A whole number may be larger than all floats.
    if not is_real(value) or not abs(value) <= sys.float_info.max:
        return None
    return float(value)


def _is_transparent(content: bytes) -> bool:
    """Whether a PNG file has pixels that are not opaque."""
    # Byte 25 is the type of colours: types 4 and 6 have opacity. Other files may declare colours
    # transparent in tRNS.
    has_alpha = content[25] in (4, 6)
    if not has_alpha and b"tRNS" not in content:
        return False
    # Of the other parts, the decoder may complain to the terminal.
    picture = decode_png(plain_png(content))
    if picture is None or picture.ndim < 3 or picture.shape[2] < 4:
        return False
    return bool((picture[..., 3] < np.iinfo(picture.dtype).max).any())


def _png_size(content: bytes) -> tuple[int, int] | None:
    """Returns width and height from the header of a PNG file; None if it has no header."""
    try:
        return png_size(content)
    except ValueError:
        return None


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Returns width and height from the frame header of a JPEG file.

    Returns None if the file has no frame header before its pixels.
    """
    position = 2
    while (marker := _MARKER.search(content, position)) is not None:
        kind, position = marker[1][0], marker.end()
        if kind in _FRAME_MARKERS:
            # The sides follow the length of the header, in two bytes, and the number of bits of a
            # colour, in one.
            height, width = (
                content[position + 3 : position + 5],
                content[position + 5 : position + 7],
            )
            return int.from_bytes(width), int.from_bytes(height)
        if kind in _LAST_MARKERS:
            return None
        if kind not in _LONE_MARKERS:
            position += int.from_bytes(content[position : position + 2])
    return None
