"""A tile, and readers of its files: pictures, masks and points. They collect problems, so that one call names all."""

import json
import math
import tomllib
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError, reason
from elitelanes_jax._util.files import MIB, read_bytes, read_text
from elitelanes_jax._util.types import Plain

_LONGEST_SIDE = 4096
_MOST_BYTES = 72 * MIB  # a picture of that size with transparency that does not compress
_MOST_PARTS = 2**16
_MOST_POINTS = 8 * MIB  # of the file of points
_PNG = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by PNG's numbers for grey, RGB, palette, grey and RGB with transparency
# The passes of an interlaced PNG: first column and row, then the steps to the next ones.
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


class Tile(NamedTuple):
    """One elementary tile.

    Attributes:
      name: of its folder, ``<kind>_<n>``.
      code: the sides it opens, as a tile code.
      image: uint8 ``[S, S, 3]``, RGB.
      road: bool ``[S, S]``, the drivable surface.
      red: bool ``[S, S]``, the stop lines.
      yellow: bool ``[S, S]``, the lane separators.
      layers: bool ``[S, S]``, further masks, by name.
      points: float64 ``[N, 2]``, x to the right and y down in pixels from the top left corner of the image, by name.
    """

    name: str
    code: int
    image: NDArray[np.uint8]
    road: NDArray[np.bool_]
    red: NDArray[np.bool_]
    yellow: NDArray[np.bool_]
    layers: Mapping[str, NDArray[np.bool_]] = {}
    points: Mapping[str, NDArray[np.float64]] = {}


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
    except (OSError, cv2.error, zlib.error):
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


def read_points(file: Path, image: NDArray[np.uint8] | None, problems: list[str]) -> dict[str, NDArray[np.float64]]:
    """Reads the points of a picture, by name: ``{"name": [[x, y], ...], ...}``.

    x goes to the right and y down, in pixels, from the top left corner of the picture at (0, 0). Returns float64
    ``[N, 2]`` by name. Names with anything else are skipped, with a line in `problems`.
    """
    try:
        values = read_table(file, json.loads, _MOST_POINTS) if file.is_file() else {}
    except InputError as error:
        problems.append(str(error))
        return {}
    if not isinstance(values, dict):
        problems.append(f'{file}: expected points by name, {{"name": [[x, y], ...]}}, got {json.dumps(values)[:60]}')
        return {}
    points = {}
    height, width = image.shape[:2] if image is not None else (math.inf, math.inf)
    for name, listed in values.items():
        wrong = [listed] if not isinstance(listed, list) else [point for point in listed if not _is_point(point)]
        if wrong:
            problems.append(f"{file}: {name!r}: expected points [x, y], got {json.dumps(wrong[0])[:60]}")
            continue
        outside = [point for point in listed if not (0 <= point[0] <= width and 0 <= point[1] <= height)]
        if outside:
            problems.append(
                f"{file}: {name!r}: expected points within {width} x {height} pixels, got {json.dumps(outside[0])[:60]}"
            )
            continue
        points[name] = np.array(listed, np.float64).reshape(-1, 2)
    return points


def read_table(file: Path, parse: Callable[[str], Plain], limit: int) -> Plain:
    """Reads a file of JSON or TOML; raises `InputError` that names the file."""
    try:
        return parse(read_text(file, limit))
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:  # of the text, of numbers with too many digits, of nesting
        kind = "TOML" if parse is tomllib.loads else "JSON"
        got = reason(error) if isinstance(error, OSError) else error
        raise InputError(f"{file}: expected a readable {kind} file, got: {got}") from None


def size_of(picture: np.ndarray) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"


def _is_point(point: Plain) -> bool:
    numbers = isinstance(point, list) and all(type(value) in (int, float) for value in point)
    return numbers and len(point) == 2 and all(-math.inf < value < math.inf for value in point)


def _plain_png(content: bytes) -> bytes:
    """Returns the parts of a PNG file that hold its pixels, if they are complete; otherwise raises `ValueError`.

    For other files the decoder complains to the terminal, and some of the other parts unpack to any size.
    """
    if content[:8] != _PNG or content[12:16] != b"IHDR":
        raise ValueError("it is not a PNG file")
    rows = _rows(content[16:29])
    left = sum(height * (1 + length) for height, length in rows)
    unpacked = zlib.decompressobj()
    start, parts = 8, [_PNG]
    for _ in range(_MOST_PARTS):
        end = start + 12 + int.from_bytes(content[start : start + 4])
        kind, data = content[start + 4 : start + 8], content[start + 8 : end - 4]
        if end > len(content) or zlib.crc32(data, zlib.crc32(kind)) != int.from_bytes(content[end - 4 : end]):
            break
        if kind in (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"):
            parts.append(content[start:end])
        while kind == b"IDAT" and data and left >= 0 and not unpacked.eof:
            left -= len(unpacked.decompress(data, MIB))
            data = unpacked.unconsumed_tail
        if kind == b"IEND":
            if left == 0 and unpacked.eof:
                return b"".join(parts)
            break
        start = end
    raise ValueError("it is damaged or unfinished")


def _rows(header: bytes) -> list[tuple[int, int]]:
    """Returns the number of rows, and of bytes in each, for each pass over the pixels that a PNG header announces."""
    width, height = int.from_bytes(header[:4]), int.from_bytes(header[4:8])
    depth, channels, interlaced = header[8], _CHANNELS.get(header[9], 0), header[12]
    if not (0 < width <= _LONGEST_SIDE and 0 < height <= _LONGEST_SIDE):
        raise ValueError(f"it has {width} x {height} pixels, not 1 to {_LONGEST_SIDE} a side")
    steps = _PASSES if interlaced else ((0, 0, 1, 1),)
    sizes = (((height - y + down - 1) // down, (width - x + right - 1) // right) for x, y, right, down in steps)
    return [(rows, (columns * channels * depth + 7) // 8) for rows, columns in sizes if rows > 0 and columns > 0]
