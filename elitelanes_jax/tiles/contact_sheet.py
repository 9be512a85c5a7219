"""A sheet of many pictures with captions; and signs on pictures of maps, large enough to read."""

from collections.abc import Sequence
from functools import cache
from math import ceil, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, real
from elitelanes_jax._util.types import Untyped
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.tiles.files import check_picture
from elitelanes_jax.tiles.object_set import ObjectPictures, load_objects

PAPER, INK = (250, 249, 246), (40, 40, 44)
"""The colours of the paper and of text on it, RGB."""

# The colour of the lines below the first line of a caption, RGB.
_FAINT = (120, 120, 126)
# The gap between pictures and the height of a line of text, in pixels.
_GAP, _LINE = 28, 19
# The scales of titles and captions, as `write_text` takes them.
_TITLE, _CAPTION = 0.8, 0.46
# The width of a sign's face in tiles, the border for faces beside the map in tiles, and how many
# times as far from the corner of a crossing as their signs the faces are, and those of lights.
_FACE, _BORDER, _APART, _APART_LIGHT = 0.21, 0.55, 1.9, 1.4
# The side of a letter's square at scale 1, in outline fonts, in pixels.
_EM = 29


def contact_sheet(
    title: str, pictures: Sequence[NDArray[np.uint8]], captions: Sequence[Sequence[str]]
) -> NDArray[np.uint8]:
    """Lays out RGB pictures of one size in rows, with their captions below them.

    A caption is lines of ASCII text. The first line is darker. All pictures have the same
    number of lines.
    """
    height, width = pictures[0].shape[:2]
    # A column is as wide as the picture or the longest line of text.
    step = _GAP + max(width, *(text_width(line, _CAPTION) for lines in captions for line in lines))
    below = _GAP + _LINE * len(captions[0])
    # With this number of columns the sheet is about square.
    columns = max(1, round(sqrt(len(pictures) * (height + below) / step)))
    rows = ceil(len(pictures) / columns)
    top = 3 * _GAP
    across = _GAP + max(columns * step, text_width(title, _TITLE) + _GAP)
    sheet = np.full((top + rows * (height + below), across, 3), PAPER, np.uint8)
    write_text(sheet, title, (_GAP, 2 * _GAP - 6), _TITLE, INK)
    for index, (picture, lines) in enumerate(zip(pictures, captions, strict=True)):
        row, column = divmod(index, columns)
        y, x = top + row * (height + below), _GAP + column * step
        sheet[y : y + height, x : x + width] = picture
        for level, line in enumerate(lines):
            ink = _FAINT if level else INK
            write_text(sheet, line, (x, y + height + _LINE * (level + 1)), _CAPTION, ink)
    return sheet


def pin_signs(
    picture: NDArray[np.uint8], objects: Sequence[MapObject], tile_px: int
) -> NDArray[np.uint8]:
    """Returns a picture of a map with a border and with the faces of its signs and lights, upright.

    As seen from above a sign is a post. Faces are farther from the corners of crossings than their
    signs, so that they do not hide each other. Signs of street names are left out.
    """
    border = round(_BORDER * tile_px)
    paper = cv2.copyMakeBorder(picture, *(border,) * 4, cv2.BORDER_CONSTANT, value=PAPER)
    framed = np.asarray(paper, np.uint8)
    signs = [
        thing for thing in objects if thing.kind.startswith("sign_") or thing.kind == "trafficlight"
    ]
    signs = [sign for sign in signs if sign.kind != "sign_street_name"]
    for sign, pictures in zip(signs, load_objects().choose(signs), strict=True):
        face = _face(pictures, round(_FACE * tile_px))
        apart = _APART if pictures.tag else _APART_LIGHT
        # A sign stands near a corner of tiles. Its face moves away from this corner.
        corner_x, corner_y = round(sign.x), round(sign.y)
        x, y = corner_x + apart * (sign.x - corner_x), corner_y + apart * (sign.y - corner_y)
        _lay(framed, face, round(x * tile_px) + border, round(y * tile_px) + border)
    return framed


def _face(pictures: ObjectPictures, width: int) -> NDArray[np.uint8]:
    """Returns what a sign shows above its tag, or the upper part of a light, in RGB and opacity."""
    front = pictures.view(0)
    if pictures.tag:
        middle, side = pictures.tag
        # The face of a sign ends a row above its tag.
        rows = round(len(front) * (1 - (middle + side / 2) / pictures.height)) - 1
    else:
        # A light has no tag, and is narrower than a sign. Its face is its upper part, at most twice
        # as high as wide.
        rows, width = min(len(front), 2 * front.shape[1]), round(width / 2)
    size = width, max(1, round(width * rows / front.shape[1]))
    return np.asarray(cv2.resize(front[:rows], size, interpolation=cv2.INTER_AREA), np.uint8)


def _lay(picture: NDArray[np.uint8], face: NDArray[np.uint8], x: int, y: int) -> None:
    """Lays a face with its middle on a pixel of a picture.

    The part of the face that is beyond the picture is left out.
    """
    height, width = face.shape[:2]
    top, left = y - height // 2, x - width // 2
    rows = slice(max(top, 0), min(top + height, len(picture)))
    columns = slice(max(left, 0), min(left + width, picture.shape[1]))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        # A sign of the user's may be up to a tile outside of the map, beyond the border.
        return
    part = face[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
    part = part.astype(float)
    opacity = part[..., 3:] / 255
    mixed = part[..., :3] * opacity + picture[rows, columns] * (1 - opacity)
    picture[rows, columns] = mixed.round()


@cache
def _font() -> Untyped:
    """Returns a font of OpenCV 5, or None in OpenCV 4.

    Unlike the default font, its zeros have no slash.
    """
    font = cv2.FontFace("uni") if hasattr(cv2, "FontFace") else None
    return font if font is not None and font.getName() else None


def text_width(text: str, scale: float) -> int:
    """Returns the width of a line of text in pixels; fonts differ between versions of OpenCV."""
    if _font() is None:
        return cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, scale, 1)[0][0]
    return cv2.getTextSize((0, 0), text, (0, 0), _font(), round(_EM * scale))[2]


@name_wrong_arguments
def write_text(
    sheet: NDArray[np.uint8],
    text: str,
    position: tuple[int, int],
    scale: float,
    ink: tuple[int, int, int],
) -> None:
    """Writes a line of text on a picture uint8 ``[H, W, 3]``.

    Letters outside ASCII become question marks. `position` is x and y of its lower left corner in
    pixels, `scale` 1 about 22 pixels high, `ink` its colour in RGB.
    """
    # OpenCV 5 crashes for negative sizes.
    check_named("scale", real(0, 100, exclusive=True), scale)
    check_named("sheet", check_picture, sheet)
    words = text.encode("ascii", "replace").decode()
    if _font() is None:
        cv2.putText(sheet, words, position, cv2.FONT_HERSHEY_SIMPLEX, scale, ink, 1, cv2.LINE_AA)
    else:
        cv2.putText(sheet, words, position, ink, _font(), round(_EM * scale))
