"""A tile, and readers of its pictures and masks. They collect problems, so that one call names all."""

import zlib
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.files import MIB, read_bytes

_LONGEST_SIDE = 4096
_MOST_BYTES = 72 * MIB  # a picture of that size with transparency that does not compress
_MOST_PARTS = 2**16
_PNG = b"\x89PNG\r\n\x1a\n"


class Tile(NamedTuple):
    """One elementary tile.

    Attributes:
      name: of its folder, ``<kind>_<n>``.
      code: the sides it opens, as a tile code.
      image: uint8 ``[S, S, 3]``, RGB.
      road: bool ``[S, S]``, the drivable surface.
      red: bool ``[S, S]``, the stop lines.
      yellow: bool ``[S, S]``, the lane separators.
    """

    name: str
    code: int
    image: NDArray[np.uint8]
    road: NDArray[np.bool_]
    red: NDArray[np.bool_]
    yellow: NDArray[np.bool_]


def read_picture(file: Path, problems: list[str], *, opacity: bool = False) -> NDArray[np.uint8] | None:
    """Reads a PNG picture of 8 bits per channel; `problems` gets a line if the file exists but is not such a picture.

    Returns uint8 ``[H, W, 3]`` in RGB order, ``[H, W]`` if it is grey, or None if there is no file. With `opacity`, a
    picture with transparency keeps its fourth channel.
    """
    if not file.is_file():
        return None
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    picture, got = None, "one that cannot be read"
    try:
        content = _plain_png(read_bytes(file, _MOST_BYTES))
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except InputError as error:
        problems.append(str(error))
        return None
    except ValueError as error:
        got += f": {error}"
    except (OSError, cv2.error):
        pass
    if picture is None or picture.dtype != np.uint8:
        got = got if picture is None else str(picture.dtype)
        problems.append(f"{file}: expected a PNG picture of 8 bits a channel, got {got}")
        return None
    if picture.ndim == 3:
        kept = cv2.COLOR_BGRA2RGBA if opacity else cv2.COLOR_BGRA2RGB
        picture = cv2.cvtColor(picture, kept if picture.shape[2] == 4 else cv2.COLOR_BGR2RGB)
    return np.asarray(picture, np.uint8)


def read_mask(file: Path, image: NDArray[np.uint8] | None, problems: list[str]) -> NDArray[np.bool_] | None:
    """Reads a mask of 0 and one other value, as large as the image if there is one.

    Returns bool ``[H, W]``, or None; in both cases `problems` gets a line for each error.
    """
    mask = read_picture(file, problems)
    if mask is None:
        return None
    if mask.ndim == 3:
        if (mask != mask[..., :1]).any():
            problems.append(f"{file}: expected a grey mask, got one in colours")
            return None
        mask = mask[..., 0]
    if image is not None and mask.shape != image.shape[:2]:
        problems.append(f"{file}: expected {size_of(image)} pixels like image.png, got {size_of(mask)}")
    values = np.flatnonzero(np.bincount(mask.ravel()))
    if len(values) > 2 or (len(values) == 2 and values[0] != 0):
        listed = ", ".join(map(str, values[:5])) + (", ..." if len(values) > 5 else "")
        problems.append(f"{file}: expected a mask of two values, 0 and one other, got {len(values)}: {listed}")
    return mask > 0


def size_of(picture: np.ndarray) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"


def _plain_png(content: bytes) -> bytes:
    """Returns the parts of a PNG file that hold its pixels, if they are complete; otherwise raises `ValueError`.

    For damaged files the decoder complains to the terminal, and some of the other parts unpack to any size.
    """
    if content[:8] != _PNG or content[12:16] != b"IHDR":
        raise ValueError("it is not a PNG file")
    width, height = int.from_bytes(content[16:20]), int.from_bytes(content[20:24])
    if not (0 < width <= _LONGEST_SIDE and 0 < height <= _LONGEST_SIDE):
        raise ValueError(f"it has {width} x {height} pixels, not 1 to {_LONGEST_SIDE} a side")
    start, parts = 8, [_PNG]
    for _ in range(_MOST_PARTS):
        end = start + 12 + int.from_bytes(content[start : start + 4])
        kind, data = content[start + 4 : start + 8], content[start + 8 : end - 4]
        if end > len(content) or zlib.crc32(data, zlib.crc32(kind)) != int.from_bytes(content[end - 4 : end]):
            break
        if kind in (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"):
            parts.append(content[start:end])
        if kind == b"IEND":
            return b"".join(parts)
        start = end
    raise ValueError("it is damaged or unfinished")
