"""Readers of a tile's files: pictures, masks and points; problems are collected, so that one call names all."""

import json
import math
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["read_mask", "read_picture", "read_points", "size_of"]

_MOST_PIXELS = 2**26


def read_picture(file: Path, problems: list[str]) -> NDArray[np.uint8] | None:
    """Reads a PNG picture of 8 bits a channel.

    Args:
      file: where it is.
      problems: gets a line if the file is there but not such a picture.

    Returns:
      uint8 ``[H, W, 3]`` or ``[H, W, 4]``, channels in RGB order, or ``[H, W]`` if it is grey; None if there is none.
    """
    if not file.is_file():
        return None
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    picture = None
    try:
        content = file.read_bytes()
        if _is_whole_png(content):
            picture = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
    except (OSError, cv2.error, zlib.error):
        pass
    if picture is None or picture.dtype != np.uint8:
        got = "one that cannot be read" if picture is None else str(picture.dtype)
        problems.append(f"{file}: expected a PNG picture of 8 bits a channel, got {got}")
        return None
    if picture.ndim == 3:
        picture = cv2.cvtColor(picture, cv2.COLOR_BGRA2RGB if picture.shape[2] == 4 else cv2.COLOR_BGR2RGB)
    return np.asarray(picture, np.uint8)


def read_mask(file: Path, image: NDArray[np.uint8] | None, problems: list[str]) -> NDArray[np.bool_] | None:
    """Reads a mask of 0 and one other value, as large as the image if there is one.

    Returns:
      bool ``[H, W]``, or None; either way `problems` gets a line for each fault.
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
    values = np.unique(mask)
    if len(values) > 2 or (len(values) == 2 and values[0] != 0):
        listed = ", ".join(map(str, values[:5])) + (", ..." if len(values) > 5 else "")
        problems.append(f"{file}: expected a mask of two values, 0 and one other, got {len(values)}: {listed}")
    return mask > 0


def read_points(file: Path, image: NDArray[np.uint8] | None, problems: list[str]) -> dict[str, NDArray[np.float64]]:
    """Reads the points of a picture, by name: ``{"name": [[x, y], ...], ...}``.

    x goes to the right and y down, in pixels, from the top left corner of the picture at (0, 0).

    Returns:
      float64 ``[N, 2]`` by name; names with anything else are left out, with a line in `problems`.
    """
    if not file.is_file():
        return {}
    try:
        values = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        problems.append(f"{file}: expected a readable JSON file, got: {error}")
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


def size_of(picture: NDArray[Any]) -> str:
    """Returns width and height of a picture, for messages."""
    return f"{picture.shape[1]} x {picture.shape[0]}"


def _is_point(point: Any) -> bool:
    numbers = isinstance(point, list) and all(type(value) in (int, float) for value in point)
    return numbers and len(point) == 2 and all(-math.inf < value < math.inf for value in point)


def _is_whole_png(content: bytes) -> bool:
    """Tells whether a PNG file is whole and of a reasonable size; of others the decoder complains to the terminal."""
    place, packed, pixels = 8, bytearray(), 0
    while content[:8] == b"\x89PNG\r\n\x1a\n" and len(content) >= place + 12:
        end = place + 8 + int.from_bytes(content[place : place + 4])
        kind, data = content[place + 4 : place + 8], content[place + 8 : end]
        if zlib.crc32(content[place + 4 : end]) != int.from_bytes(content[end : end + 4]):
            return False
        if kind == b"IHDR":
            pixels = int.from_bytes(data[:4]) * int.from_bytes(data[4:8])
        elif kind == b"IDAT":
            packed += data
        elif kind == b"IEND":
            unpacked = zlib.decompressobj()
            # Eight bytes for each pixel are the most there are, and one for each row.
            return 0 < pixels <= _MOST_PIXELS and bool(unpacked.decompress(packed, 9 * pixels)) and unpacked.eof
        place = end + 4
    return False
