"""Draws photographs with the tiles that were found in them, and a sheet of the tiles that were cut."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.cells import column_name, describe_cell
from elitelanes_jax.network.codes import KIND_OF
from elitelanes_jax.network.plain_metrics import road_box
from elitelanes_jax.photographs._judging import SURE
from elitelanes_jax.photographs._views import FloorView, Points
from elitelanes_jax.photographs.laid import LaidFloor, read_laid
from elitelanes_jax.photographs.proposals import Proposal
from elitelanes_jax.photographs.reading import Photograph
from elitelanes_jax.tiles.contact_sheet import INK, PAPER, contact_sheet, text_width, write_text

Ink = tuple[int, int, int]

# The size of a photograph on the sheet, and the largest of one alone, in pixels.
_ON_SHEET, _ALONE = (640, 480), (1600, 1200)
_SURE_INK, _UNSURE_INK, _WRONG_INK, _FAINT_INK = (
    (235, 40, 160),
    (255, 140, 0),
    (255, 30, 30),
    (230, 230, 230),
)
_WORDS_INK = (255, 255, 255)
# The size of words on a photograph up to 1,000 pixels wide, as `write_text` takes it.
_TEXT = 0.42
# The points along a side of a tile's outline, which a lens bends.
_SIDE_POINTS = 13
# The distance of the names of rows and columns from the floor, in tiles.
_BESIDE = 0.25
# The height of a line of text below a photograph in pixels, its scale as `write_text` takes it, and
# the most lines.
_LINE, _LINE_TEXT, _MOST_LINES = 26, 0.6, 24


class Mark(NamedTuple):
    """What is drawn on a cell.

    Attributes:
      words: in its middle.
      ink: the colour of the outline, RGB.
      width: the width of the outline in pixels.
    """

    words: str
    ink: Ink
    width: int


def draw_proposal(photograph: Photograph, proposal: Proposal) -> NDArray[np.uint8]:
    """Returns the photograph, 640 x 480 pixels, with the outline and the kind of each tile.

    Unsure tiles are orange.
    """
    marks = {}
    for row, column in np.argwhere(np.array(proposal.codes) > 0).tolist():
        sure = proposal.is_sure and proposal.sure[row][column] >= SURE
        kind = KIND_OF[proposal.codes[row][column]] + ("" if sure else "?")
        marks[row, column] = Mark(kind, _SURE_INK if sure else _UNSURE_INK, 1)
    small = _draw_marks(photograph, proposal.view, read_laid(proposal), marks, _ON_SHEET)
    return _on_paper(small, *_ON_SHEET)


def draw_laid(photograph: Photograph, proposal: Proposal, laid: LaidFloor) -> NDArray[np.uint8]:
    """Draws on a photograph the names of rows and columns, and what to do with tiles.

    Cells that differ from the plan are red. Unsure cells are orange. Lines below the photograph say
    what was expected in each of these cells, and what lies there.

    Returns:
      uint8 ``[H, W, 3]``, RGB. The photograph in it has at most 1600 x 1200 pixels. The picture is
      wider than the photograph if a line of text is.
    """
    # Cells of the plan's empty border may be outside of the photograph, and behind the camera.
    rows, columns = map(_indices, road_box(laid.codes))
    marks = {(row, column): Mark("", _FAINT_INK, 1) for row in rows for column in columns}
    for row, column in laid.unsure:
        marks[row, column] = Mark("unsure", _UNSURE_INK, 3)
    for difference in laid.differences:
        is_unsure = [difference.row, difference.column] in laid.unsure
        words = difference.remedy + ("?" if is_unsure else "")
        ink = _UNSURE_INK if is_unsure else _WRONG_INK
        marks[difference.row, difference.column] = Mark(words, ink, 3)
    picture = _draw_marks(photograph, proposal.view, laid, marks, _ALONE)
    lines = [str(difference) for difference in laid.differences]
    lines += [f"{describe_cell(*cell)}: unsure" for cell in laid.unsure]
    if len(lines) > _MOST_LINES:
        lines = [*lines[: _MOST_LINES - 1], f"and {len(lines) - _MOST_LINES + 1} more"]
    margin = _LINE // 2
    width = max([picture.shape[1], *(text_width(line, _LINE_TEXT) + 2 * margin for line in lines)])
    height = picture.shape[0] + _LINE * len(lines) + margin
    paper = _on_paper(picture, width, height)
    for number, line in enumerate(lines, start=1):
        bottom = picture.shape[0] + _LINE * number - _LINE // 4
        write_text(paper, line, (margin, bottom), _LINE_TEXT, INK)
    return paper


def _draw_marks(
    photograph: Photograph,
    view: FloorView,
    laid: LaidFloor,
    marks: Mapping[tuple[int, int], Mark],
    size: tuple[int, int],
) -> NDArray[np.uint8]:
    """Returns a photograph of at most a size, with marks on cells and the names of rows and columns."""
    height, width = photograph.image.shape[:2]
    view = view.scaled(min(size[0] / width, size[1] / height))
    picture = np.asarray(
        cv2.resize(photograph.image, (view.width, view.height), interpolation=cv2.INTER_AREA),
        np.uint8,
    )

    def pixels_of(places: Points) -> Points:
        return view.pixels_of(laid.seen(places))

    steps = np.linspace(0, 1, _SIDE_POINTS)
    top = np.stack([steps, np.zeros(_SIDE_POINTS)], axis=1)
    right = np.stack([np.ones(_SIDE_POINTS), steps], axis=1)
    outline = np.concatenate([top, right, 1 - top, 1 - right])
    # Thick outlines are over thin ones.
    for (row, column), mark in sorted(marks.items(), key=lambda item: item[1].width):
        # With `shift`, OpenCV reads the last three bits of coordinates as parts of a pixel.
        exact = np.rint(pixels_of(outline + np.array([column, row])) * 8).astype(np.int32)
        cv2.polylines(picture, [exact], True, mark.ink, mark.width, cv2.LINE_AA, shift=3)
    scale = _TEXT * max(1, size[0] / 1000)
    words = [
        (np.array([column + 0.5, row + 0.5]), mark.words) for (row, column), mark in marks.items()
    ]
    for place, text in words + _names(laid.codes):
        _write_at(picture, pixels_of(place), text, scale)
    return picture


def _names(codes: NDArray[np.int8]) -> list[tuple[Points, str]]:
    """Returns the names of columns and rows, and where they are around the tiles, in tiles."""
    if codes.size == 1:
        return []
    names = []
    rows, columns = road_box(codes)
    for column in _indices(columns):
        name = column_name(column)
        beside = rows.start - _BESIDE, rows.stop + _BESIDE
        names += [(np.array([column + 0.5, y]), name) for y in beside]
    for row in _indices(rows):
        beside = columns.start - _BESIDE, columns.stop + _BESIDE
        names += [(np.array([x, row + 0.5]), str(row + 1)) for x in beside]
    return names


def _indices(cells: slice) -> range:
    return range(cells.start, cells.stop)


def _write_at(picture: NDArray[np.uint8], pixel: Points, words: str, scale: float) -> None:
    """Writes white words around a pixel, with a dark edge, so that they are seen on every ground."""
    height, width = picture.shape[:2]
    if not words or not (0 <= pixel[0] < width and 0 <= pixel[1] < height):
        return
    # A letter is about 10 pixels wide and 12 high for each half of the scale.
    x, y = int(pixel[0] - 9.5 * scale * len(words)), int(pixel[1] + 12 * scale)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            write_text(picture, words, (x + right, y + down), scale, INK)
    write_text(picture, words, (x, y), scale, _WORDS_INK)


def draw_sheet(
    title: str,
    photographs: Sequence[NDArray[np.uint8]],
    proposals: Sequence[Proposal],
    tiles: NDArray[np.uint8],
) -> NDArray[np.uint8]:
    """Returns one RGB picture of photographs and tiles.

    The photographs of `draw_proposal` are above. The sheet of tiles with their masks is below them.
    """
    captions = []
    for proposal in proposals:
        fits = f"score {proposal.score:.2f}" + ("" if proposal.is_sure else ": refused")
        words = ", ".join(f"{name} {value:g}" for name, value in proposal.evidence.items())
        captions.append((f"{proposal.photo}: {fits}", words))
    above = contact_sheet(title, photographs, captions)
    width = max(above.shape[1], tiles.shape[1])
    return np.vstack([_on_paper(part, width, len(part)) for part in (above, tiles)])


def _on_paper(picture: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Returns a picture of a larger size, with a picture in its top left corner."""
    paper = np.full((height, width, 3), PAPER, np.uint8)
    paper[: picture.shape[0], : picture.shape[1]] = picture
    return paper
