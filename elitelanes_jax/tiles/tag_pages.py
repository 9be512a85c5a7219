"""Pages with the AprilTags of a map, to print on A4 at their size."""

import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.formats.tags import STREET_NAMES, TAG_SIZE
from elitelanes_jax.tiles.object_set import draw_tag

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Lengths on pages are in millimetres.
_A4 = 210.0, 297.0
_SIDE = 1000 * TAG_SIZE
# The side of each of the eight cells along a black square.
_CELL = _SIDE / 8
# Readers of tags need a white margin of a cell.
_CUT = _SIDE + 2 * _CELL
# The columns and rows of tags on a page, the margin at the top, and the height of a caption.
_COLUMNS, _ROWS, _TOP, _CAPTION = 2, 3, 22.0, 7.0
# The length of a bar that tells whether the printer kept the size.
_BAR = 100.0
_FAINT = "#6d737d"


@name_wrong_arguments
def write_tags(road_map: UserValue, file: str | Path) -> int:
    """Writes the AprilTags of a map's signs and floor tags, to print without scaling.

    Returns the number of tags.

    A tag is a black square of 6.5 cm. It has a white margin, a grey line to cut along, and a
    caption with its number and the kind of its sign. Tags are in ascending order, each as often as
    the map has it.

    Args:
      road_map: a `RoadMap` or a file.
      file: a name that ends in .pdf; an existing file is replaced.

    Raises:
      InputError: for anything else, a map without tags, or without matplotlib.
      OSError: if the file cannot be written.
    """
    target = check_named("file", path, file)
    if target.suffix.lower() != ".pdf":
        raise InputError("file", "a name that ends in .pdf", quote(str(file)))
    objects = as_map(road_map).objects or ()
    tags = sorted((thing.tag, thing.kind) for thing in objects if thing.tag is not None)
    if not tags:
        raise InputError("map", "signs with tags, as furnish places them", "none")
    import_optional("matplotlib", "pages of tags need matplotlib")
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    content = io.BytesIO()
    with (
        rc_context({"pdf.fonttype": 42}),
        # Without a date, equal maps give equal files.
        PdfPages(content, metadata={"CreationDate": None, "Title": "AprilTags of a map"}) as pages,
    ):
        for page in _pages(tags):
            pages.savefig(page)
    write_atomic(target, content.getvalue())
    return len(tags)


def _pages(tags: Sequence[tuple[int, str]]) -> Iterator["Figure"]:
    """Draws the pages of tags: the number of each, and the kind of its object."""
    from matplotlib.figure import Figure

    of_page = _COLUMNS * _ROWS
    for first in range(0, len(tags), of_page):
        page = Figure(figsize=(_A4[0] / 25.4, _A4[1] / 25.4), facecolor="white")
        # The axes cover the page. Their unit is a millimetre, and y points down.
        ax = page.add_axes((0, 0, 1, 1))
        ax.set(xlim=(0, _A4[0]), ylim=(_A4[1], 0))
        ax.set_axis_off()
        left = (_A4[0] - _COLUMNS * _CUT) / 2
        ax.plot([left, left + _BAR], [12, 12], color="black", lw=1, marker="|")
        ax.text(
            left + _BAR + 4,
            12,
            "10 cm: print at 100 %, without scaling to the page",
            size=8,
            va="center",
        )
        for index, (number, kind) in enumerate(tags[first : first + of_page]):
            row, column = divmod(index, _COLUMNS)
            _draw_tag(ax, number, kind, left + column * _CUT, _TOP + row * (_CUT + _CAPTION))
        yield page


def _draw_tag(ax: "Axes", number: int, kind: str, left: float, top: float) -> None:
    """Draws a tag whose margin has its north-west corner there."""
    from matplotlib.patches import PathPatch, Rectangle
    from matplotlib.path import Path as Outline

    ax.add_patch(Rectangle((left, top), _CUT, _CUT, fill=False, ec=_FAINT, lw=0.3))
    squares = []
    for row, column in np.argwhere(draw_tag(number) == 0).tolist():
        x, y = left + (column + 1) * _CELL, top + (row + 1) * _CELL
        squares.append(
            Outline(
                [(x, y), (x + _CELL, y), (x + _CELL, y + _CELL), (x, y + _CELL), (x, y)],
                closed=True,
            )
        )
    # The squares are one outline, because viewers show lines between shapes that touch.
    ax.add_patch(PathPatch(Outline.make_compound_path(*squares), color="black", lw=0))
    words = f"{number}   {kind.removeprefix('sign_').replace('_', ' ')}"
    if kind == "sign_street_name" and number in STREET_NAMES:
        words += f": {STREET_NAMES[number]}"
    ax.text(left, top + _CUT + 4.5, words, size=8, color=_FAINT)
