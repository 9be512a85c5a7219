"""The pages of a plan, drawn with matplotlib.

The pages are the map with its measures and its bill, and a check-list.
"""

import io
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from math import cos, degrees, sin
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

from elitelanes_jax._util.cells import cell_name, column_name
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.tapes import REFERENCE, TAPE_WIDTHS, tapes_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from elitelanes_jax.formats.plan import Plan

# Lengths on pages are in millimetres.
# These are the sizes of a page, its margin, and the height of a line.
_A4, _MARGIN, _LINE = (210.0, 297.0), 14.0, 4.5
# The least and the largest side of a tile of the map, and the side of a tile of the legend.
_SMALLEST, _LARGEST, _SAMPLE = 14.0, 40.0, 22.0
_ABOVE_MAP, _BELOW_MAP = _MARGIN + 16, 20.0
_BESIDE_MAP = 2 * _MARGIN + 16
_BETWEEN_SAMPLES = 8.0
# The number of lines and of columns on a page of the check-list.
_ROWS, _COLUMNS = 56, 3
# The room in tiles around a map with objects. Signs and lights of `furnish` need no more.
_ROOM_BEYOND = 0.3
# The distance in tiles, at least, from that room to the numbers of rows and columns: 4 mm, at
# `_LARGEST`. A corner of an object may be in it.
_CORNER_BEYOND = 0.1
# The length in metres of the arrow ahead of an object.
_ARROW_AHEAD = 0.07

_GROUND, _ROAD, _INK, _FAINT = "#f3f5ee", "#c4c8ce", "#1d2026", "#6d737d"
_STOP, _SIGN, _OTHER_OBJECT = "#c01722", "#1f5fbf", "#3d7a3a"
_LOOP = "#7a3fe0"
_BOX = "\N{BALLOT BOX}"
_DEGREE = "\N{DEGREE SIGN}"
# These are the layers of matplotlib for objects, arrows and numbers. They must hide tape and
# labels, which matplotlib draws on the layers 2 and 3.
_OBJECTS, _ARROWS, _NUMBERS = 4, 5, 6


def write_plan(plan: "Plan", file: str | Path) -> None:
    """Draws a plan, as `Plan.save` says."""
    target = check_named("file", path, file)
    write_atomic(target, _draw_plan(plan, plan_kind(target)))


def plan_kind(file: Path) -> str:
    """Returns the kind of a plan's file, .pdf, .svg or .png; raises `InputError` for another."""
    kind = file.suffix.lower()
    if kind not in (".pdf", ".svg", ".png"):
        raise InputError("file", "a name that ends in .pdf, .svg or .png", shorten(repr(str(file))))
    return kind


def _draw_plan(plan: "Plan", kind: str) -> bytes:
    """Returns the content of a file of the plan.

    A ``.pdf`` has all pages, and a ``.svg`` or ``.png`` the first one. It is made in memory,
    because on a full disk matplotlib fails once more while it closes a PDF file.
    """
    import_optional("matplotlib", "a plan needs matplotlib")
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    content = io.BytesIO()
    # The same plan gives the same bytes, so there are no dates and no random names. Text stays
    # text.
    with (
        rc_context({"svg.hashsalt": "plan", "svg.fonttype": "none", "pdf.fonttype": 42}),
        warnings.catch_warnings(),
    ):
        # For a character that the font lacks, matplotlib draws a box and warns.
        warnings.filterwarnings("ignore", "Glyph .* missing|Matplotlib currently does not support")
        if kind == ".pdf":
            with PdfPages(
                content, metadata={"CreationDate": None, "Title": "Plan of a map"}
            ) as pages:
                pages.savefig(_map_page(plan))
                for page in _list_pages(plan):
                    pages.savefig(page)
        else:
            dates = {"Date": None} if kind == ".svg" else None
            _map_page(plan).savefig(content, format=kind[1:], dpi=150, metadata=dates)
    return content.getvalue()


class _MapLayout(NamedTuple):
    """Where the parts of the first page are.

    Attributes:
      page_width: the width of the sheet.
      page_height: the height of the sheet.
      tile: the side of a tile of the map.
      edge: the room around the map for objects beyond it.
      left: the left edge of the map.
      top: the upper edge of the map.
      bill_left: the left edge of the bill of materials, and of the legend below it.
      bill_top: the upper edge of the bill of materials.
      legend_top: the upper edge of the legend.
    """

    page_width: float
    page_height: float
    tile: float
    edge: float
    left: float
    top: float
    bill_left: float
    bill_top: float
    legend_top: float


def _map_page(plan: "Plan") -> "Figure":
    """Draws the map with its measures, the bill of materials and a legend.

    The page is A4 or a larger sheet.
    """
    bill = _bill(plan)
    layout = _arrange_map(plan, bill)
    page, ax = _page(layout.page_width, layout.page_height, "Plan")
    rows, columns = plan.shape
    width, depth = plan.floor
    facts = f"{rows} rows and {columns} columns of {plan.tile_size:g} m, {width:g} x {depth:g} m"
    _write(ax, _MARGIN + 18, _MARGIN + 3, facts, color=_FAINT)
    safety = (
        f"up to {len(plan.loop) - 1} robots can never block each other; "
        "beyond that, the dashed loop fills first"
    )
    _write(ax, _MARGIN + 18, _MARGIN + 3 + _LINE, safety, color=_LOOP)
    _draw_map(ax, plan, layout.left, layout.top, layout.tile, layout.edge)
    _write_columns(ax, layout.bill_left, layout.bill_top, bill)
    _draw_legend(ax, plan, layout.bill_left, layout.legend_top)
    return page


def _arrange_map(plan: "Plan", bill: list[list[str]]) -> _MapLayout:
    """Chooses the largest tiles that fit A4, within limits.

    The sheet grows if the smallest tiles do not fit.
    """
    rows, columns = plan.shape
    edge_tiles = _room_beyond(plan)
    bill_height = _LINE * (max(map(len, bill)) + 0.5)
    # Below the map are the bill, the tiles of the legend and their names.
    below = _BELOW_MAP + bill_height + _SAMPLE + 8 + _MARGIN
    fitting_width = (_A4[0] - _BESIDE_MAP) / (columns + 2 * edge_tiles)
    fitting_height = (_A4[1] - _ABOVE_MAP - below) / (rows + 2 * edge_tiles)
    tile = min(max(min(fitting_width, fitting_height), _SMALLEST), _LARGEST)
    edge = edge_tiles * tile
    # A page grows beyond A4 if the smallest tiles need more room.
    page_width = max(_A4[0], columns * tile + 2 * edge + _BESIDE_MAP)
    depth = rows * tile + 2 * edge
    bill_top = _ABOVE_MAP + depth + _BELOW_MAP
    return _MapLayout(
        page_width=page_width,
        page_height=max(_A4[1], _ABOVE_MAP + depth + below),
        tile=tile,
        edge=edge,
        left=(page_width - columns * tile) / 2,
        top=_ABOVE_MAP + edge,
        bill_left=(page_width - _A4[0]) / 2 + _MARGIN,
        bill_top=bill_top,
        legend_top=bill_top + bill_height,
    )


def _room_beyond(plan: "Plan") -> float:
    """Returns the room in tiles that a map needs around it for the objects beyond it."""
    if not plan.objects:
        return 0.0
    rows, columns = plan.shape
    room = _ROOM_BEYOND
    for item in plan.objects:
        for x, y in _extent(item, item.x, item.y, 1 / plan.tile_size):
            beyond = max(-x, -y, x - columns, y - rows)
            room = max(room, beyond - _CORNER_BEYOND)
    return room


def _draw_legend(ax: "Axes", plan: "Plan", left: float, top: float) -> None:
    """Draws a tile of each kind, and says how angles are counted."""
    pitch = _SAMPLE + _BETWEEN_SAMPLES
    samples = [(kind, 0, left + index * pitch, top) for index, kind in enumerate(REFERENCE)]
    _draw_tiles(ax, samples, plan.tile_size, _SAMPLE)
    for kind, turns, x, y in samples:
        _write(ax, x + _SAMPLE / 2, y + _SAMPLE + 4, _tile_name(kind, turns), ha="center")
    words = (
        "Angles are counter-clockwise.\n"
        "N is up; the floor may lie any way.\n"
        "Files call A1 row 0, column 0."
    )
    x, y = left + len(samples) * pitch, top + _SAMPLE / 2
    _write(ax, x, y, words, va="center", color=_FAINT)


def _draw_map(ax: "Axes", plan: "Plan", left: float, top: float, tile: float, edge: float) -> None:
    rows, columns = plan.shape
    right, bottom = left + columns * tile, top + rows * tile
    ax.fill(
        [left, right, right, left],
        [top, top, bottom, bottom],
        facecolor=_GROUND,
        edgecolor=_FAINT,
        lw=0.6,
    )
    tiles = []
    for row, column, kind, turns in plan.placed:
        tiles.append((kind, turns, left + column * tile, top + row * tile))
    _draw_tiles(ax, tiles, plan.tile_size, tile)
    middles = [
        (left + (column + 0.5) * tile, top + (row + 0.5) * tile) for row, column in plan.loop
    ]
    ax.plot(*zip(*middles, middles[0], strict=True), color=_LOOP, lw=1.5, ls=(0, (4, 2)))
    for row in range(rows):
        _write(ax, left - edge - 4, top + (row + 0.5) * tile, str(row + 1), ha="right", va="center")
        ax.plot([left, right], [top + row * tile] * 2, color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    for column in range(columns):
        name = column_name(column)
        _write(ax, left + (column + 0.5) * tile, top - edge - 3.5, name, ha="center")
        ax.plot([left + column * tile] * 2, [top, bottom], color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    # The label of a tile becomes smaller with the tile.
    label_size = min(7.0, 0.3 * tile)
    for placed, (kind, turns, x, y) in zip(plan.placed, tiles, strict=True):
        label = f"{cell_name(placed.row, placed.column)}\n{_tile_name(kind, turns)}"
        _label(ax, x + tile / 2, y + tile / 2, label, size=label_size)
    for number, item in enumerate(plan.objects, 1):
        x, y = left + item.x * tile, top + item.y * tile
        _draw_object(ax, item, number, x, y, tile / plan.tile_size)
    # Measures are outside the objects that are beyond the map.
    below = bottom + edge + 7
    beside = right + edge + 7
    width, depth = plan.floor
    _arrow(ax, (left, below), (right, below), "<|-|>")
    _label(ax, (left + right) / 2, below, f"{width:g} m")
    _arrow(ax, (beside, top), (beside, bottom), "<|-|>")
    _label(ax, beside, (top + bottom) / 2, f"{depth:g} m", rotation=90)
    _arrow(ax, (beside, top - 3), (beside, top - 9), "->")
    _write(ax, beside + 2, top - 4.5, "N")


def _draw_tiles(
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
    ax.add_collection(PolyCollection(squares, facecolors=_ROAD, edgecolors=_FAINT, linewidths=0.3))
    # The length of a dash in widths of the line, as matplotlib takes it. A dash is 5 cm.
    dash = 0.05 / TAPE_WIDTHS["yellow"]
    # The tape of a later layer covers that of earlier ones. White tape on white paper needs an
    # outline, so it is drawn twice.
    dashes = (0, (dash, dash / 2))
    layers: tuple[tuple[str, str, float, str | tuple[int, tuple[float, float]]], ...] = (
        ("red", "#d9202c", 0.0, "solid"),
        ("yellow", "#f5c71a", 0.0, dashes),
        ("white", _FAINT, 0.6, "solid"),
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


def _draw_object(
    ax: "Axes", item: MapObject, number: int, x: float, y: float, scale: float
) -> None:
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
        *corners, tip = _extent(item, x, y, scale)
        ax.add_patch(Polygon(corners, facecolor=colour, lw=0, zorder=_OBJECTS))
        _arrow(ax, (x, y), tip, "-|>", colour, zorder=_ARROWS)
    _write(
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


def _extent(item: MapObject, x: float, y: float, scale: float) -> list[tuple[float, float]]:
    """Returns the corners of an object's footprint, and the tip of its arrow.

    A round object has no arrow, and has the corners of the square around it. `x` and `y` are the
    middle of the object, and `scale` turns metres into their unit.
    """
    half_length = item.footprint[0] * scale / 2
    half_width = item.footprint[1] * scale / 2
    if item.is_round:
        east, south = 1.0, 0.0
    else:
        east, south = cos(item.angle), -sin(item.angle)
    points = []
    for ahead, aside in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        length = ahead * half_length
        width = aside * half_width
        points.append((x + length * east - width * south, y + length * south + width * east))
    if not item.is_round:
        reach = half_length + _ARROW_AHEAD * scale
        points.append((x + reach * east, y + reach * south))
    return points


def _colour_of(item: MapObject) -> str:
    if item.kind == "sign_stop":
        return _STOP
    if item.kind.startswith("sign_") or item.kind == "trafficlight":
        return _SIGN
    return _OTHER_OBJECT


def _bill(plan: "Plan") -> list[list[str]]:
    """Returns the columns of the bill of materials: tiles, tape, and objects if there are any."""
    tiles = ["Tiles"]
    for kind in REFERENCE:
        tiles.append(f"{plan.tiles[kind]} x {_tile_name(kind)}")
    tiles.append(f"{len(plan.placed)} with road")
    tiles.append(f"{plan.tiles['empty']} empty: bare or none")
    tape = ["Tape"]
    for colour, width in TAPE_WIDTHS.items():
        tape.append(f"{plan.tape[colour]:.2f} m {colour}, {100 * width:g} cm wide")
    tape += ["(yellow: laid whole, then cut to", "5 cm of tape and 2.5 cm of gap)"]
    columns = [tiles, tape]
    if plan.objects:
        columns.append(_bill_of_objects(plan))
    return columns


def _bill_of_objects(plan: "Plan") -> list[str]:
    lines = ["Signs and objects"]
    counts = Counter(item.kind for item in plan.objects)
    for kind in sorted(counts):
        words = f"{counts[kind]} x {_object_name(kind)}"
        tags = []
        for item in plan.objects:
            if item.kind == kind and item.tag is not None:
                tags.append(item.tag)
        if tags:
            words += f", tag {', '.join(map(str, sorted(tags)))}"
        lines += wrap(words, 38, subsequent_indent="      ")
    return lines


def _list_pages(plan: "Plan") -> Iterator["Figure"]:
    """Draws the check-list on A4."""
    lines = _check_list(plan)
    # Lines are cut into columns, and columns into pages.
    columns = [lines[first : first + _ROWS] for first in range(0, len(lines), _ROWS)]
    for first in range(0, len(columns), _COLUMNS):
        page, ax = _page(_A4[0], _A4[1], "Check-list")
        _write_columns(ax, _MARGIN, _MARGIN + 12, columns[first : first + _COLUMNS])
        yield page


def _check_list(plan: "Plan") -> list[str]:
    """Returns the lines of the check-list.

    They list tiles to tape by kind, tiles to lay by row, and objects to place by number.
    """
    lines = ["Tiles to tape, in cm"]
    for kind in REFERENCE:
        if plan.tiles[kind]:
            lines.append(f"{_BOX} {plan.tiles[kind]} x {_tile_name(kind)}, each with")
            lines += _tapes_to_cut(kind, plan.tile_size)
    for row, tiles in groupby(plan.placed, lambda tile: tile.row):
        lines += ["", f"Row {row + 1}"]
        for tile in tiles:
            name = _tile_name(tile.kind, tile.quarter_turns)
            lines.append(f"{_BOX} {cell_name(row, tile.column)}  {name}")
    if plan.objects:
        lines += ["", "Signs and objects", "(metres from the north-west corner)"]
    for number, item in enumerate(plan.objects, 1):
        lines += _object_to_place(item, number, plan.tile_size)
    return lines


def _tapes_to_cut(kind: str, tile_size: float) -> list[str]:
    """Returns a line for each kind of tape on a tile, with the number of equal strips."""
    strips: Counter[tuple[str, str, int]] = Counter()
    for tape in tapes_of(kind, 0, tile_size):
        strips[tape.colour, f"{100 * tape.length:.1f}", len(tape.points) - 1] += 1
    lines = []
    for (colour, length, pieces), count in strips.items():
        line = f"      {count} x {colour} of {length}"
        if colour == "white" and pieces > 1:
            line += f" in {pieces} pieces"
        lines.append(line)
    return lines


def _object_to_place(item: MapObject, number: int, tile_size: float) -> list[str]:
    """Returns the lines of an object: its name, and its position and direction."""
    name = f"{_BOX} {number}  {_object_name(item.kind)}"
    if item.tag is not None:
        name += f", tag {item.tag}"
    east = round(item.x * tile_size, 2)
    south = round(item.y * tile_size, 2)
    across = "west" if east < 0 else "east"
    down = "north" if south < 0 else "south"
    position = f"      {abs(east):.2f} {across}, {abs(south):.2f} {down}"
    if not item.is_round:
        position += f", faces {_direction(item.angle)}"
    return [name, position]


def _tile_name(kind: str, quarter_turns: int | None = None) -> str:
    name = {"crossing3": "3-way", "crossing4": "4-way"}.get(kind, kind)
    if quarter_turns is None or kind == "crossing4":
        return name
    return f"{name} {90 * quarter_turns}{_DEGREE}"


def _object_name(kind: str) -> str:
    name = kind.removeprefix("sign_").removeprefix("other:")
    return name.replace("4_way", "4-way").replace("_", " ")


def _direction(angle: float) -> str:
    """Returns the side of the world that an angle points to.

    Between the four sides, returns degrees counter-clockwise from the east.
    """
    turned = round(degrees(angle)) % 360
    sides = {0: "east", 90: "north", 180: "west", 270: "south"}
    return sides.get(turned, f"{turned}{_DEGREE}")


def _page(width: float, height: float, title: str) -> tuple["Figure", "Axes"]:
    """Returns a figure of a page and axes in millimetres from its north-west corner."""
    from matplotlib.figure import Figure

    # A figure has its size in inches.
    page = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
    ax = page.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(height, 0))
    ax.set_axis_off()
    _write(ax, _MARGIN, _MARGIN + 3, title, size=15, weight="bold")
    return page, ax


def _write_columns(ax: "Axes", left: float, top: float, columns: Sequence[Sequence[str]]) -> None:
    """Writes columns of lines. Lines that start with a letter are headings."""
    column_width = (_A4[0] - 2 * _MARGIN) / _COLUMNS
    for column, lines in enumerate(columns):
        for row, line in enumerate(lines):
            weight = "bold" if line[:1].isalpha() else "normal"
            _write(ax, left + column * column_width, top + row * _LINE, line, weight=weight)


def _write(ax: "Axes", x: float, y: float, words: str, **style: Untyped) -> None:
    defaults: dict[str, Untyped] = {"color": _INK, "size": 8.5, "va": "baseline"}
    ax.text(x, y, words, **(defaults | style))


def _label(ax: "Axes", x: float, y: float, words: str, **style: Untyped) -> None:
    """Writes words on a white box around a point."""
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.88, "linewidth": 0}
    _write(ax, x, y, words, ha="center", va="center", bbox=box, linespacing=1.05, **style)


def _arrow(
    ax: "Axes",
    start: tuple[float, float],
    end: tuple[float, float],
    style: str,
    colour: str = _INK,
    zorder: int = 3,
) -> None:
    properties = {"arrowstyle": style, "shrinkA": 0, "shrinkB": 0, "lw": 0.8, "color": colour}
    ax.annotate("", end, start, arrowprops=properties, zorder=zorder)
