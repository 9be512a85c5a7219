"""A sheet of many pictures with captions."""

from collections.abc import Sequence
from functools import cache
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, real
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.types import Untyped

_GROUND, _INK, _FAINT = (250, 249, 246), (40, 40, 44), (120, 120, 126)
_GAP, _LINE = 28, 19
_TITLE, _CAPTION = 0.8, 0.46
_EM = 29  # pixels of a letter's square at scale 1, in outline fonts


def contact_sheet(
    title: str, pictures: Sequence[NDArray[np.uint8]], captions: Sequence[Sequence[str]]
) -> NDArray[np.uint8]:
    """Lays out RGB pictures of one size in rows, each with its lines of ASCII text below it, the first line darker.

    All pictures have the same number of lines.
    """
    height, width = pictures[0].shape[:2]
    step = _GAP + max(width, *(_length(line, _CAPTION) for lines in captions for line in lines))
    below = _GAP + _LINE * len(captions[0])
    columns = max(1, round(sqrt(len(pictures) * (height + below) / step)))
    rows = ceil(len(pictures) / columns)
    top = 3 * _GAP
    across = _GAP + max(columns * step, _length(title, _TITLE) + _GAP)
    sheet = np.full((top + rows * (height + below), across, 3), _GROUND, np.uint8)
    write_text(sheet, title, (_GAP, 2 * _GAP - 6), _TITLE, _INK)
    for index, (picture, lines) in enumerate(zip(pictures, captions, strict=True)):
        row, column = divmod(index, columns)
        y, x = top + row * (height + below), _GAP + column * step
        sheet[y : y + height, x : x + width] = picture
        for level, line in enumerate(lines):
            ink = _FAINT if level else _INK
            write_text(sheet, line, (x, y + height + _LINE * (level + 1)), _CAPTION, ink)
    return sheet


@cache
def _font() -> Untyped:
    """Returns a font of OpenCV 5 whose zeros have no slash, unlike its default font; None in OpenCV 4."""
    font = cv2.FontFace("uni") if hasattr(cv2, "FontFace") else None
    return font if font is not None and font.getName() else None


def _length(text: str, scale: float) -> int:
    """Returns the width of a line of text in pixels; fonts differ between versions of OpenCV."""
    if _font() is None:
        return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]
    return cv2.getTextSize((0, 0), text, (0, 0), _font(), round(_EM * scale))[2]


def write_text(
    sheet: NDArray[np.uint8], text: str, position: tuple[int, int], scale: float, ink: tuple[int, int, int]
) -> None:
    """Writes a line of text on a picture uint8 ``[H, W, 3]``; letters outside ASCII become question marks.

    `position` is x and y of its lower left corner in pixels, `scale` 1 about 22 pixels high, `ink` its colour in RGB.
    """
    check_named("scale", real(0, 100, exclusive=True), scale)  # OpenCV 5 crashes for negative sizes
    if getattr(sheet, "dtype", None) != np.uint8 or sheet.ndim != 3:
        raise InputError(f"sheet: expected uint8 [H, W, 3], got {shorten(repr(sheet))}")
    words = text.encode("ascii", "replace").decode()
    if _font() is None:
        cv2.putText(sheet, words, position, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, 1, cv2.LINE_AA)
    else:
        cv2.putText(sheet, words, position, ink, _font(), round(_EM * scale))
