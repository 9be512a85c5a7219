"""The parts of a plan's pages, drawn with matplotlib: tape, objects, words and arrows.

Lengths on pages are in millimetres, from the north-west corner.
"""

from collections.abc import Sequence
from math import cos, sin
from typing import TYPE_CHECKING

from elitelanes_jax._util.types import Untyped
from elitelanes_jax.formats.objects import MapObject, corners_of
from elitelanes_jax.formats.tapes import TAPE_WIDTHS, tapes_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

A4 = (210.0, 297.0)
"""The width and the height of a page."""

MARGIN, LINE = 14.0, 4.5
"""The margin of a page, and the height of a line."""

COLUMNS = 3
"""The number of columns of lines on an A4 page."""

FAINT = "#6d737d"
"""The colour of outlines, grids and remarks."""

# The length in metres of the arrow ahead of an object.
_ARROW_AHEAD = 0.07
_ROAD, _INK = "#c4c8ce", "#1d2026"
_STOP, _SIGN, _OTHER_OBJECT = "#c01722", "#1f5fbf", "#3d7a3a"
# These are the layers of matplotlib for objects, arrows and numbers. They must hide tape and
# labels, which matplotlib draws on the layers 2 and 3.
_OBJECTS, _ARROWS, _NUMBERS = 4, 5, 6


def draw_tiles(
    ax: "Axes", tiles: Sequence[tuple[str, int, float, float]], tile_size: float, side: float
) -> None:
    """Draws tiles: kind, quarter turns, and the position of the north-west corner."""
    from matplotlib.collections import LineCollection, PolyCollection

    # All squares are one artist, and so is each layer of tape, because a map may have thousands of
    # tiles.
    squares = []
    lines: dict[str, list[list[tuple[float, float]]]] = {colour: [] for colour in TAPE_WIDTHS}
    scale = side / tile_size
    for kind, turns, x, y in tiles:
        squares.append([(x, y), (x + side, y), (x + side, y + side), (x, y + side)])
        for tape in tapes_of(kind, turns, tile_size):
            points = [(x + east * scale, y + south * scale) for east, south in tape.points]
            lines[tape.colour].append(points)
    ax.add_collection(PolyCollection(squares, facecolors=_ROAD, edgecolors=FAINT, linewidths=0.3))
    # The length of a dash in widths of the line, as matplotlib takes it. A dash is 5 cm.
    dash = 0.05 / TAPE_WIDTHS["yellow"]
    # The tape of a later layer covers that of earlier ones. White tape on white paper needs an
    # outline, so it is drawn twice.
    dashes = (0, (dash, dash / 2))
    layers: tuple[tuple[str, str, float, str | tuple[int, tuple[float, float]]], ...] = (
        ("red", "#d9202c", 0.0, "solid"),
        ("yellow", "#f5c71a", 0.0, dashes),
        ("white", FAINT, 0.6, "solid"),
        ("white", "#ffffff", 0.0, "solid"),
    )
    for tape_colour, ink, outline, style in layers:
        # A line of matplotlib has its width in points, 72 to an inch of 25.4 mm.
        points_wide = TAPE_WIDTHS[tape_colour] * scale * 72 / 25.4
        tape_lines = LineCollection(
            lines[tape_colour],
            colors=ink,
            linewidths=points_wide + outline,
            linestyles=style,
            capstyle="butt",
        )
        ax.add_collection(tape_lines)


def draw_object(ax: "Axes", item: MapObject, number: int, x: float, y: float, scale: float) -> None:
    """Draws the footprint of an object with its number in the check-list.

    An arrow points the way that the object faces. `scale` is in millimetres of the page for each
    metre.
    """
    from matplotlib.patches import Circle, Polygon

    colour = _colour_of(item)
    if item.is_round:
        radius = item.footprint[0] * scale / 2
        ax.add_patch(Circle((x, y), radius, facecolor=colour, lw=0, zorder=_OBJECTS))
    else:
        *corners, tip = extent(item, x, y, scale)
        ax.add_patch(Polygon(corners, facecolor=colour, lw=0, zorder=_OBJECTS))
        draw_arrow(ax, (x, y), tip, "-|>", colour, zorder=_ARROWS)
    write(
        ax,
        x,
        y,
        str(number),
        ha="center",
        va="center_baseline",
        size=min(6.5, 0.11 * scale),
        color="white",
        weight="bold",
        zorder=_NUMBERS,
    )


def extent(item: MapObject, x: float, y: float, scale: float) -> list[tuple[float, float]]:
    """Returns the corners of an object's footprint, and the tip of its arrow.

    A round object has no arrow, and has the corners of the square around it. `x` and `y` are the
    middle of the object, and `scale` turns metres into their unit.
    """
    half_length, half_width = (side * scale / 2 for side in item.footprint)
    if item.is_round:
        return corners_of(x, y, half_length, half_width, 0)
    reach = half_length + _ARROW_AHEAD * scale
    tip = x + reach * cos(item.angle), y - reach * sin(item.angle)
    return [*corners_of(x, y, half_length, half_width, item.angle), tip]


def _colour_of(item: MapObject) -> str:
    if item.kind == "sign_stop":
        return _STOP
    if item.kind.startswith("sign_") or item.kind == "trafficlight":
        return _SIGN
    return _OTHER_OBJECT


def new_page(width: float, height: float, title: str) -> tuple["Figure", "Axes"]:
    """Returns a figure of a page and axes in millimetres from its north-west corner."""
    from matplotlib.figure import Figure

    # A figure has its size in inches.
    page = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
    ax = page.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(height, 0))
    ax.set_axis_off()
    write(ax, MARGIN, MARGIN + 3, title, size=15, weight="bold")
    return page, ax


def write_columns(ax: "Axes", left: float, top: float, columns: Sequence[Sequence[str]]) -> None:
    """Writes columns of lines. Lines that start with a letter are headings."""
    column_width = (A4[0] - 2 * MARGIN) / COLUMNS
    for column, lines in enumerate(columns):
        for row, line in enumerate(lines):
            weight = "bold" if line[:1].isalpha() else "normal"
            write(ax, left + column * column_width, top + row * LINE, line, weight=weight)


def write(ax: "Axes", x: float, y: float, words: str, **style: Untyped) -> None:
    defaults: dict[str, Untyped] = {"color": _INK, "size": 8.5, "va": "baseline"}
    ax.text(x, y, words, **(defaults | style))


def label(ax: "Axes", x: float, y: float, words: str, **style: Untyped) -> None:
    """Writes words on a white box around a point."""
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.88, "linewidth": 0}
    write(ax, x, y, words, ha="center", va="center", bbox=box, linespacing=1.05, **style)


def draw_arrow(
    ax: "Axes",
    start: tuple[float, float],
    end: tuple[float, float],
    style: str,
    colour: str = _INK,
    zorder: int = 3,
) -> None:
    properties = {"arrowstyle": style, "shrinkA": 0, "shrinkB": 0, "lw": 0.8, "color": colour}
    ax.annotate("", end, start, arrowprops=properties, zorder=zorder)
