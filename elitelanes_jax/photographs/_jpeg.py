"""Reads the headers of JPEG files, and finds damage in their pixels."""

import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import simplejpeg
from numpy.typing import NDArray

# The next marker. Readers skip other bytes before it, and fill bytes 0xFF: the last 0xFF begins it.
_MARKER = re.compile(rb"\xff([^\x00\xff])", re.DOTALL)
# The markers of headers with the picture's size.
_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
# The markers that no length follows.
_LONE = {0x01, *range(0xD0, 0xD9)}
# The marker of data of applications, such as EXIF.
_APPLICATION = 0xE1
# The markers of pixels, which come after all other segments, and of the end.
_PIXELS, _END = 0xDA, 0xD9
_EXIF = b"Exif\0\0"
# The samplings of colours whose rows have two blocks above each other.
_TALL = {"420": 2, "440": 2}
# The parts of a row of blocks between which a shift is looked for.
_BEGINNINGS = 16
# The least shift of brightness that is damage, of 255.
_SHIFT = 8
# Damage reaches at least this part of its shift within a window, and an edge does not. A row of blocks
# has this many windows.
_SUDDEN, _WINDOWS = 0.65, 32
# The least part of the blocks beside the damage that are shifted by about the same amount.
_MOST = 0.6


class EncodedPicture(NamedTuple):
    """The picture in a file, as the sensor has it.

    Attributes:
      width: the width of the picture in pixels.
      height: the height of the picture in pixels.
      exif: the EXIF data, empty if there are none.
      content: a file of the same format without the bytes that decoders skip with a complaint.
    """

    width: int
    height: int
    exif: bytes
    content: bytes


def is_jpeg(content: bytes) -> bool:
    return content[:3] == b"\xff\xd8\xff"


def read_header(content: bytes) -> EncodedPicture | None:
    """Reads the header of a JPEG file. Returns None if it has no size before its pixels."""
    size, exif, parts = (0, 0), b"", [content[:2]]
    for segment in _segments_of(content):
        parts.append(segment.content)
        if segment.kind in _FRAMES:
            # The height and the width follow the number of bits of a colour, which is one byte.
            size = int.from_bytes(segment.data[3:5]), int.from_bytes(segment.data[1:3])
        if segment.kind == _APPLICATION and segment.data.startswith(_EXIF) and not exif:
            exif = segment.data.removeprefix(_EXIF)
    return EncodedPicture(*size, exif, b"".join(parts)) if all(size) else None


def is_damaged(picture: EncodedPicture) -> bool:
    """Returns whether the pixels of a JPEG file have a damaged or missing stretch.

    OpenCV decodes such files, and all pixels after the damage may be wrong.
    """
    try:
        # An eighth of the size is quick, and all of the file is read for it.
        content = picture.content
        blocks = simplejpeg.decode_jpeg(content, "BGR", min_height=1, min_width=1, strict=True)
        _, _, _, sampling = simplejpeg.decode_jpeg_header(content)
    except ValueError:
        return True
    return _is_shifted(blocks.astype(np.float32), _TALL.get(sampling, 1))


def _is_shifted(blocks: NDArray[np.float32], height: int) -> bool:
    """Returns whether all blocks after one of them are brighter or darker by the same amount.

    A block has its brightness as a difference from the block before. Damage that the decoder does
    not notice therefore shifts all later blocks. Their first row begins in the middle of the
    picture: to the right of it the step is at the top of this row, and to the left of it at the
    bottom. An edge that is slightly tilted has this form too, but it leads from the bottom to the
    top gradually.

    Args:
      blocks: the mean colours of the blocks ``[H, W, 3]``.
      height: the blocks in a row that the file has one after another, 1 or 2.
    """
    below = blocks[height::height]
    steps = below - blocks[height - 1 :: height][: len(below)]
    beginnings = {steps.shape[1] * part // _BEGINNINGS for part in range(1, _BEGINNINGS)}
    for column in beginnings - {0}:
        first, second = np.split(steps, [column], axis=1)
        left, right = (np.median(part, axis=1) for part in (first, second))
        at_top, at_bottom = right[:-1], left[1:]
        shift = np.minimum(np.abs(at_top), np.abs(at_bottom)) * (at_top * at_bottom > 0)
        elsewhere = np.maximum(np.abs(left[:-1]), np.abs(right[1:]))
        # Texture changes single blocks, and leaves most of them in step.
        is_one_step = np.minimum(*(_agreement(part) for part in (first[1:], second[:-1]))) > _MOST
        shifted = (shift > _SHIFT) & (elsewhere < shift / 3) & is_one_step
        for row in np.flatnonzero(shifted.any(axis=1)):
            # The step at the top begins where the one at the bottom ends.
            colour = shift[row].argmax()
            turns = (steps[row] - steps[row + 1])[:, colour]
            if _largest_jump(turns) > _SUDDEN * 2 * np.quantile(np.abs(turns), 0.8):
                return True
    return False


def _agreement(steps: NDArray[np.float32]) -> NDArray[np.float32]:
    """Returns the part of the steps ``[H, W, 3]`` of each row that are near their median."""
    middle = np.median(steps, axis=1, keepdims=True)
    return np.asarray((np.abs(steps - middle) < np.abs(middle) / 2).mean(axis=1), np.float32)


def _largest_jump(values: NDArray[np.float32]) -> float:
    """Returns the largest difference between medians of values before and after a place.

    At the place itself are a few blocks of any colours, which the decoder made of the damage.
    """
    width = max(len(values) // _WINDOWS, 2)
    windows = np.lib.stride_tricks.sliding_window_view(values, width)
    medians = np.median(windows, axis=1)
    return float(np.abs(medians[2 * width :] - medians[: -2 * width]).max(initial=0.0))


class _Segment(NamedTuple):
    """A segment of a JPEG file.

    Attributes:
      kind: its marker.
      data: what follows the marker and the length.
      content: all of its bytes.
    """

    kind: int
    data: bytes
    content: bytes


def _segments_of(content: bytes) -> Iterator[_Segment]:
    """Yields the segments of a JPEG file; the last one has all pixels."""
    position = 2
    while (marker := _MARKER.search(content, position)) is not None:
        kind, position = marker[1][0], marker.end()
        if kind in (_PIXELS, _END):
            yield _Segment(kind, b"", b"\xff" + content[position - 1 :])
            return
        if kind not in _LONE:
            start, position = position, position + int.from_bytes(content[position : position + 2])
            yield _Segment(
                kind, content[start + 2 : position], b"\xff" + content[start - 1 : position]
            )
