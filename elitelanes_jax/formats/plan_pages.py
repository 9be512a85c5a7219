"""A plan and its pages: the map with its measures and its bill, and a check-list."""

import io
import warnings
from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from math import degrees
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, NamedTuple

from elitelanes_jax._util.cells import cell_name, column_name
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.copies import keeps_copies
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.plan_drawing import (
    A4,
    COLUMNS,
    FAINT,
    LINE,
    MARGIN,
    draw_arrow,
    draw_object,
    draw_tiles,
    extent,
    label,
    new_page,
    write,
    write_columns,
)
from elitelanes_jax.formats.tapes import REFERENCE, TAPE_WIDTHS, tapes_of
from elitelanes_jax.network.links import Cell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The least and the largest side of a tile of the map, and the side of a tile of the legend.
_SMALLEST, _LARGEST, _SAMPLE = 14.0, 40.0, 22.0
_ABOVE_MAP, _BELOW_MAP = MARGIN + 16, 20.0
_BESIDE_MAP = 2 * MARGIN + 16
_BETWEEN_SAMPLES = 8.0
# The number of lines in a column of the check-list.
_ROWS = 56
# The room in tiles around a map with objects. Signs and lights of `furnish` need no more.
_ROOM_BEYOND = 0.3
# The distance in tiles, at least, from that room to the numbers of rows and columns: 4 mm, at
# `_LARGEST`. A corner of an object may be in it.
_CORNER_BEYOND = 0.1

_GROUND, _LOOP = "#f3f5ee", "#7a3fe0"
_BOX = "\N{BALLOT BOX}"
_DEGREE = "\N{DEGREE SIGN}"


class PlacedTile(NamedTuple):
    """A tile of a plan.

    Attributes:
      row: the row of the tile, from 0 in the north.
      column: the column of the tile, from 0 in the west.
      kind: straight, turn, crossing3 or crossing4.
      quarter_turns: the fewest counter-clockwise turns that rotate the tile in `REFERENCE` to this
        one, 0 to 3.
    """

    row: int
    column: int
    kind: str
    quarter_turns: int


@keeps_copies
class Plan(NamedTuple):
    """What it takes to build a map.

    Attributes:
      shape: rows and columns of tiles.
      tile_size: the pitch of the tiles in metres.
      floor: metres from west to east, and from north to south.
      placed: the tiles, row by row. Each has `row` and `column`, from 0 in the north-west; `kind`:
        straight, turn, crossing3 or crossing4; and `quarter_turns`, the fewest counter-clockwise
        turns of this kind's tile. Without turns a straight leads from north to south, a turn from
        south to west, and a crossing3 has no road to the east.
      tiles: the number of tiles of each kind, and of empty cells.
      tape: metres of each colour of tape, with the gaps that are cut into yellow tape.
      objects: what stands on the map, from north to south.
      loop: the tiles of the shortest loop, as `network.gridlock_loop` lists them. Fewer robots than
        these, one on each lane of a tile, can never block each other for ever.
    """

    shape: tuple[int, int]
    tile_size: float
    floor: tuple[float, float]
    placed: tuple[PlacedTile, ...]
    tiles: dict[str, int]
    tape: dict[str, float]
    objects: tuple[MapObject, ...]
    loop: tuple[Cell, ...]

    def save(self, file: str | Path) -> None:
        """Draws the plan with its bill of materials; a PDF also has a check-list.

        Args:
          file: a name that ends in .pdf, .svg or .png; an existing file is replaced.

        Raises:
          InputError: for another ending, or without matplotlib.
          OSError: if the file cannot be written.
        """
        target = check_named("file", path, file)
        write_atomic(target, _draw_plan(self, plan_kind(target)))


def plan_kind(file: Path) -> str:
    """Returns the kind of a plan's file, .pdf, .svg or .png; raises `InputError` for another."""
    kind = file.suffix.lower()
    if kind not in (".pdf", ".svg", ".png"):
        raise InputError("file", "a name that ends in .pdf, .svg or .png", quote(str(file)))
    return kind


def _draw_plan(plan: Plan, kind: str) -> bytes:
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


def _map_page(plan: Plan) -> "Figure":
    """Draws the map with its measures, the bill of materials and a legend.

    The page is A4 or a larger sheet.
    """
    bill = _bill(plan)
    layout = _arrange_map(plan, bill)
    page, ax = new_page(layout.page_width, layout.page_height, "Plan")
    rows, columns = plan.shape
    width, depth = plan.floor
    facts = f"{rows} rows and {columns} columns of {plan.tile_size:g} m, {width:g} x {depth:g} m"
    write(ax, MARGIN + 18, MARGIN + 3, facts, color=FAINT)
    safety = (
        f"up to {len(plan.loop) - 1} robots can never block each other; "
        "beyond that, the dashed loop fills first"
    )
    write(ax, MARGIN + 18, MARGIN + 3 + LINE, safety, color=_LOOP)
    _draw_map(ax, plan, layout.left, layout.top, layout.tile, layout.edge)
    write_columns(ax, layout.bill_left, layout.bill_top, bill)
    _draw_legend(ax, plan, layout.bill_left, layout.legend_top)
    return page


def _arrange_map(plan: Plan, bill: list[list[str]]) -> _MapLayout:
    """Chooses the largest tiles that fit A4, within limits.

    The sheet grows if the smallest tiles do not fit.
    """
    rows, columns = plan.shape
    edge_tiles = _room_beyond(plan)
    bill_height = LINE * (max(map(len, bill)) + 0.5)
    # Below the map are the bill, the tiles of the legend and their names.
    below = _BELOW_MAP + bill_height + _SAMPLE + 8 + MARGIN
    fitting_width = (A4[0] - _BESIDE_MAP) / (columns + 2 * edge_tiles)
    fitting_height = (A4[1] - _ABOVE_MAP - below) / (rows + 2 * edge_tiles)
    tile = min(max(min(fitting_width, fitting_height), _SMALLEST), _LARGEST)
    edge = edge_tiles * tile
    # A page grows beyond A4 if the smallest tiles need more room.
    page_width = max(A4[0], columns * tile + 2 * edge + _BESIDE_MAP)
    depth = rows * tile + 2 * edge
    bill_top = _ABOVE_MAP + depth + _BELOW_MAP
    return _MapLayout(
        page_width=page_width,
        page_height=max(A4[1], _ABOVE_MAP + depth + below),
        tile=tile,
        edge=edge,
        left=(page_width - columns * tile) / 2,
        top=_ABOVE_MAP + edge,
        bill_left=(page_width - A4[0]) / 2 + MARGIN,
        bill_top=bill_top,
        legend_top=bill_top + bill_height,
    )


def _room_beyond(plan: Plan) -> float:
    """Returns the room in tiles that a map needs around it for the objects beyond it."""
    if not plan.objects:
        return 0.0
    rows, columns = plan.shape
    room = _ROOM_BEYOND
    for item in plan.objects:
        for x, y in extent(item, item.x, item.y, 1 / plan.tile_size):
            beyond = max(-x, -y, x - columns, y - rows)
            room = max(room, beyond - _CORNER_BEYOND)
    return room


def _draw_legend(ax: "Axes", plan: Plan, left: float, top: float) -> None:
    """Draws a tile of each kind, and says how angles are counted."""
    pitch = _SAMPLE + _BETWEEN_SAMPLES
    samples = [(kind, 0, left + index * pitch, top) for index, kind in enumerate(REFERENCE)]
    draw_tiles(ax, samples, plan.tile_size, _SAMPLE)
    for kind, turns, x, y in samples:
        write(ax, x + _SAMPLE / 2, y + _SAMPLE + 4, _tile_name(kind, turns), ha="center")
    words = (
        "Angles are counter-clockwise.\n"
        "N is up; the floor may lie any way.\n"
        "Files call A1 row 0, column 0."
    )
    x, y = left + len(samples) * pitch, top + _SAMPLE / 2
    write(ax, x, y, words, va="center", color=FAINT)


def _draw_map(ax: "Axes", plan: Plan, left: float, top: float, tile: float, edge: float) -> None:
    rows, columns = plan.shape
    right, bottom = left + columns * tile, top + rows * tile
    ax.fill(
        [left, right, right, left],
        [top, top, bottom, bottom],
        facecolor=_GROUND,
        edgecolor=FAINT,
        lw=0.6,
    )
    tiles = []
    for row, column, kind, turns in plan.placed:
        tiles.append((kind, turns, left + column * tile, top + row * tile))
    draw_tiles(ax, tiles, plan.tile_size, tile)
    middles = [
        (left + (column + 0.5) * tile, top + (row + 0.5) * tile) for row, column in plan.loop
    ]
    ax.plot(*zip(*middles, middles[0], strict=True), color=_LOOP, lw=1.5, ls=(0, (4, 2)))
    for row in range(rows):
        write(ax, left - edge - 4, top + (row + 0.5) * tile, str(row + 1), ha="right", va="center")
        ax.plot([left, right], [top + row * tile] * 2, color=FAINT, lw=0.25, ls=(0, (2, 3)))
    for column in range(columns):
        name = column_name(column)
        write(ax, left + (column + 0.5) * tile, top - edge - 3.5, name, ha="center")
        ax.plot([left + column * tile] * 2, [top, bottom], color=FAINT, lw=0.25, ls=(0, (2, 3)))
    # The label of a tile becomes smaller with the tile.
    label_size = min(7.0, 0.3 * tile)
    for placed, (kind, turns, x, y) in zip(plan.placed, tiles, strict=True):
        words = f"{cell_name(placed.row, placed.column)}\n{_tile_name(kind, turns)}"
        label(ax, x + tile / 2, y + tile / 2, words, size=label_size)
    for number, item in enumerate(plan.objects, 1):
        x, y = left + item.x * tile, top + item.y * tile
        draw_object(ax, item, number, x, y, tile / plan.tile_size)
    # Measures are outside the objects that are beyond the map.
    below = bottom + edge + 7
    beside = right + edge + 7
    width, depth = plan.floor
    draw_arrow(ax, (left, below), (right, below), "<|-|>")
    label(ax, (left + right) / 2, below, f"{width:g} m")
    draw_arrow(ax, (beside, top), (beside, bottom), "<|-|>")
    label(ax, beside, (top + bottom) / 2, f"{depth:g} m", rotation=90)
    draw_arrow(ax, (beside, top - 3), (beside, top - 9), "->")
    write(ax, beside + 2, top - 4.5, "N")


def _bill(plan: Plan) -> list[list[str]]:
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


def _bill_of_objects(plan: Plan) -> list[str]:
    lines = ["Signs and objects"]
    counts = Counter(item.kind for item in plan.objects)
    for kind in sorted(counts):
        words = f"{counts[kind]} x {_object_name(kind)}"
        tags = [item.tag for item in plan.objects if item.kind == kind and item.tag is not None]
        if tags:
            words += f", tag {', '.join(map(str, sorted(tags)))}"
        lines += wrap(words, 38, subsequent_indent="      ")
    return lines


def _list_pages(plan: Plan) -> Iterator["Figure"]:
    """Draws the check-list on A4."""
    lines = _check_list(plan)
    # Lines are cut into columns, and columns into pages.
    columns = [lines[first : first + _ROWS] for first in range(0, len(lines), _ROWS)]
    for first in range(0, len(columns), COLUMNS):
        page, ax = new_page(A4[0], A4[1], "Check-list")
        write_columns(ax, MARGIN, MARGIN + 12, columns[first : first + COLUMNS])
        yield page


def _check_list(plan: Plan) -> list[str]:
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
