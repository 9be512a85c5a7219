"""A tile, and readers of its pictures and masks.

They collect problems, so that one call names all.
"""

import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import MIB, read_bytes
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.objects import OPAQUE

GROUND = (86, 118, 72)
"""The colour of empty cells, and of the transparent pixels of tile pictures, RGB: grass."""

# The shortest and the longest side of a picture, in pixels.
_SHORTEST_SIDE, _LONGEST_SIDE = 2, 4096
# The most bytes of a file. The largest picture with transparency has 64 MiB, which may not
# compress.
_MOST_BYTES = 72 * MIB
# The most parts of a PNG file. A file with more parts counts as damaged.
_MOST_PARTS = 2**16
_PNG = b"\x89PNG\r\n\x1a\n"
# The parts of a PNG file that hold its pixels.
_PIXEL_PARTS = frozenset((b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"))


@keeps_copies
class Tile(NamedTuple):
    """One elementary tile. It has read-only copies of its arrays.

    Attributes:
      name: the name of its folder, ``<kind>_<n>``.
      code: the sides it opens, as a tile code.
      image: uint8 ``[S, S, 3]``, RGB. Transparent pixels of its file have the colour of the ground.
      road: bool ``[S, S]``, the drivable surface.
      red: bool ``[S, S]``, the stop lines.
      yellow: bool ``[S, S]``, the lane separators.
      opaque: bool ``[S, S]``, the pixels that show the tile and not the ground; None for all.
      transparent: the share of pixels that are not wholly opaque in each file that has some, by the
        file's name.
    """

    name: str
    code: int
    image: NDArray[np.uint8]
    road: NDArray[np.bool_]
    red: NDArray[np.bool_]
    yellow: NDArray[np.bool_]
    opaque: NDArray[np.bool_] | None = None
    transparent: Mapping[str, float] = {}


class Layer(NamedTuple):
    """A picture or a mask of a tile.

    Attributes:
      pixels: uint8 ``[H, W, 3]``, RGB, of a picture, or bool ``[H, W]`` of a mask.
      opaque: bool ``[H, W]``, the pixels that have an opacity of at least one half in the file.
      transparent: the share of pixels that are not wholly opaque in the file.
    """

    pixels: NDArray
    opaque: NDArray[np.bool_]
    transparent: float


def read_picture(file: Path, problems: list[str]) -> NDArray[np.uint8] | None:
    """Reads a PNG picture of 8 bits per channel.

    `problems` gets a line if the file exists but is not such a picture. Returns uint8
    ``[H, W, 4]``, RGB and opacity, if the file has transparency, ``[H, W]`` if it is grey,
    otherwise ``[H, W, 3]``, RGB. Returns None if there is no file, or if `problems` gets a line.
    """
    if not file.is_file():
        return None
    picture: NDArray | None = None
    fault = "one that cannot be read"
    try:
        content = read_bytes(file, _MOST_BYTES)
        _check_sides(*png_size(content))
        picture = decode_png(plain_png(content))
    except InputError as error:
        # The file is too large, and the message names it.
        problems.append(str(error))
        return None
    except ValueError as error:
        fault += f": {error}"
    except OSError:
        # The message says that the file cannot be read.
        pass
    if picture is not None and picture.dtype != np.uint8:
        fault = str(picture.dtype)
        picture = None
    if picture is None:
        problems.append(f"{file}: expected a PNG picture of 8 bits a channel, got {fault}")
        return None
    if picture.ndim == 3:
        red_first = cv2.COLOR_BGRA2RGBA if picture.shape[2] == 4 else cv2.COLOR_BGR2RGB
        picture = cv2.cvtColor(picture, red_first)
    return np.asarray(picture, np.uint8)


def read_image(file: Path, problems: list[str]) -> Layer | None:
    """Reads the picture of a tile, and lays it over the ground.

    A pixel of an opacity below one half is ground, where no road is. A more opaque pixel is mixed
    with the ground. Returns None if the file is missing, or if `problems` gets a line.
    """
    picture = read_picture(file, problems)
    if picture is None:
        return None
    if picture.shape[0] != picture.shape[1]:
        problems.append(f"{file}: expected a square picture, got {size_of(picture)} pixels")
        return None
    if len(picture) < _SHORTEST_SIDE:
        problems.append(
            f"{file}: expected at least {_SHORTEST_SIDE} pixels a side, got {len(picture)}"
        )
        return None
    colours = picture[..., :3] if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    opacity = _opacity(picture)
    opaque = opacity >= OPAQUE
    if not opaque.any():
        problems.append(
            f"{file}: expected a picture with opaque pixels, got one that is transparent everywhere"
        )
        return None
    if (opacity < 255).any():
        # The ground replaces pixels below one half, and shines through the others.
        share = np.where(opaque, opacity, 0)[..., None] / 255
        colours = np.rint(colours * share + GROUND * (1 - share)).astype(np.uint8)
    return Layer(colours, opaque, float((opacity < 255).mean()))


def read_mask(file: Path, image: Layer | None, problems: list[str]) -> Layer | None:
    """Reads a mask of 0 and one other value, as large as the image if there is one.

    A transparent pixel is 0, whatever its hidden colour is. `problems` gets a line for each error.
    Returns None if the file is missing, is no grey picture, has half-transparent pixels, or has
    another size. A mask of other values is returned.
    """
    picture = read_picture(file, problems)
    if picture is None:
        return None
    opacity = _opacity(picture)
    opaque = opacity > 0
    between = np.unique(opacity[opaque & (opacity < 255)])
    if between.size:
        problems.append(
            f"{file}: expected pixels that are opaque or transparent, "
            f"got an opacity of {between[0]} of 255"
        )
        return None
    mask = picture
    if picture.ndim == 3:
        # The hidden colours of transparent pixels do not count.
        colours = picture[..., :3] * opaque[..., None]
        if (colours != colours[..., :1]).any():
            problems.append(f"{file}: expected a grey mask, got one in colours")
            return None
        mask = colours[..., 0]
    fits = image is None or mask.shape == image.opaque.shape
    # The values of a mask are checked even if its size is wrong, so that one call names both
    # errors.
    if image is not None and not fits:
        problems.append(
            f"{file}: expected {size_of(image.pixels)} pixels like image.png, got {size_of(mask)}"
        )
    values = np.flatnonzero(np.bincount(mask.ravel()))
    if len(values) > 2 or (len(values) == 2 and values[0] != 0):
        listed = ", ".join(map(str, values[:5])) + (", ..." if len(values) > 5 else "")
        problems.append(
            f"{file}: expected a mask of two values, 0 and one other, got {len(values)}: {listed}"
        )
    # Black lines on a transparent ground would make an empty mask.
    if opaque.any() and not opaque.all() and not mask.any():
        problems.append(f"{file}: expected a mask in white, got one in black on transparent ground")
    return Layer(mask > 0, opaque, 1 - float(opaque.mean())) if fits else None


def _opacity(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Returns the opacity ``[H, W]``, 0 to 255, of what `read_picture` returns."""
    if picture.shape[2:] == (4,):
        return picture[..., 3]
    return np.full(picture.shape[:2], 255, np.uint8)


def check_picture(pixels: UserValue) -> NDArray[np.uint8]:
    """Checks for an RGB picture, uint8 ``[H, W, 3]``.

    OpenCV also computes with other numbers and channels, and returns a wrong picture.
    """
    expected = f"uint8 [H, W, 3], at least {_SHORTEST_SIDE} pixels a side"
    if not isinstance(pixels, np.ndarray):
        raise InputError("", expected, quote(pixels))
    is_picture = pixels.ndim == 3 and pixels.shape[2] == 3 and pixels.dtype == np.uint8
    if not is_picture or min(pixels.shape[:2]) < _SHORTEST_SIDE:
        raise InputError("", expected, f"{pixels.dtype} {list(pixels.shape)}")
    return pixels


def size_of(picture: np.ndarray) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"


def decode_png(content: bytes) -> NDArray | None:
    """Decodes a PNG file. The picture is not turned, even if the file says that the camera was.

    Returns:
      uint8 or uint16: ``[H, W, 4]``, BGR and opacity, if the file has transparency; ``[H, W]`` if
      it is grey; otherwise ``[H, W, 3]``, BGR. None for a file that cannot be read.
    """
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except cv2.error:
        return None
    if picture is None or picture.ndim == 3:
        return picture
    transparent_grey = _transparent_grey(content)
    if transparent_grey is None:
        return picture
    most = 65535 if picture.dtype == np.uint16 else 255
    opacity = np.where(picture == transparent_grey, 0, most).astype(picture.dtype)
    return np.dstack([picture, picture, picture, opacity])


def _transparent_grey(content: bytes) -> int | None:
    """Returns the grey that a PNG file of greys declares transparent, or None.

    The grey has the value that OpenCV reads. OpenCV drops this declaration, and reads the
    transparency of all other files.
    """
    # The header has the bits of a channel in byte 24, and in byte 25 the type of colours, 0 for
    # greys.
    depth, has_greys = content[24], content[25] == 0
    for part in png_parts(content):
        if has_greys and part.kind == b"tRNS" and len(part.data) == 2:
            # OpenCV scales greys of less than 8 bits to 8 bits. The declared grey is scaled alike.
            white = 2**depth - 1
            white_in_picture = 65535 if depth == 16 else 255
            return (int.from_bytes(part.data) & white) * white_in_picture // white
    return None


def png_size(content: bytes) -> tuple[int, int]:
    """Returns width and height from the header of a PNG file.

    Raises `ValueError` for a file that does not begin with such a header.
    """
    if content[:8] != _PNG or content[12:16] != b"IHDR":
        raise ValueError("it is not a PNG file")
    # The header has four bytes for the width, and then four for the height.
    return int.from_bytes(content[16:20]), int.from_bytes(content[20:24])


def _check_sides(width: int, height: int) -> None:
    if not (0 < width <= _LONGEST_SIDE and 0 < height <= _LONGEST_SIDE):
        raise ValueError(f"it has {width} x {height} pixels, not 1 to {_LONGEST_SIDE} a side")


def plain_png(content: bytes) -> bytes:
    """Returns the parts of a PNG file that hold its pixels.

    Raises `ValueError` if the file is not complete. For damaged files the decoder complains to the
    terminal, and some of the parts that are left out unpack to any size.
    """
    parts = [_PNG]
    for part in png_parts(content):
        if part.kind in _PIXEL_PARTS:
            parts.append(part.content)
        if part.kind == b"IEND":
            return b"".join(parts)
    raise ValueError("it is damaged or unfinished")


class PngPart(NamedTuple):
    """A part of a PNG file.

    Attributes:
      kind: the four letters of the kind, such as IHDR.
      data: the data without length, kind and checksum.
      content: all bytes of the part.
    """

    kind: bytes
    data: bytes
    content: bytes


def png_parts(content: bytes) -> Iterator[PngPart]:
    """Yields the parts of a PNG file up to a damaged one."""
    start = len(_PNG)
    for _ in range(_MOST_PARTS):
        # The length, the kind and the checksum of a part have four bytes each.
        end = start + 12 + int.from_bytes(content[start : start + 4])
        kind, data = content[start + 4 : start + 8], content[start + 8 : end - 4]
        checksum = int.from_bytes(content[end - 4 : end])
        if end > len(content) or zlib.crc32(data, zlib.crc32(kind)) != checksum:
            return
        yield PngPart(kind, data, content[start:end])
        start = end
