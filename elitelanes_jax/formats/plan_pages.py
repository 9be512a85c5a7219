"""The pages of a plan, drawn with matplotlib: the map with its measures and its bill, and a check-list."""

import io
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from math import cos, degrees, sin
from pathlib import Path
from textwrap import wrap

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, path
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.files import write_atomic
from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped, UserValue
from elitelanes_jax.formats.duckietown import TILE_SIZE
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.plan import REFERENCE, TAPE_WIDTHS, Plan, make_plan, tapes_of

# Lengths on pages are in millimetres.
_A4, _MARGIN, _LINE = (210.0, 297.0), 14.0, 4.5
_SMALLEST, _LARGEST, _SAMPLE = 14.0, 40.0, 22.0  # sides of a tile of the map, and the side of a tile of the legend
_ROWS, _COLUMNS = 56, 3  # lines and columns of a page of the check-list

_GROUND, _ROAD, _INK, _FAINT = "#f3f5ee", "#c4c8ce", "#1d2026", "#6d737d"
_STOP, _SIGN, _THING = "#c01722", "#1f5fbf", "#3d7a3a"
_BOX = "\N{BALLOT BOX}"
# Objects on roads must hide tape and labels, or they disappear. Matplotlib draws lines at 2 and text at 3.
_OBJECTS, _ARROWS, _NUMBERS = 4, 5, 6


@name_wrong_arguments
def write_plan(road_map: UserValue, file: str | Path, *, tile_size: float = TILE_SIZE) -> Plan:
    """Writes the plan of a map with its bill of materials; a PDF also has a check-list.

    Args:
      road_map: as `make_plan` takes it.
      file: a name that ends in .pdf, .svg or .png; an existing file is replaced.
      tile_size: as `make_plan` takes it.

    Raises:
      InputError: as `make_plan` does, for another ending, or without matplotlib.
      OSError: if the file cannot be written.
    """
    target = check_named("file", path, file)
    if (kind := target.suffix.lower()) not in (".pdf", ".svg", ".png"):
        raise InputError(f"file: expected a name that ends in .pdf, .svg or .png, got {shorten(repr(str(file)))}")
    plan = make_plan(road_map, tile_size=tile_size)
    write_atomic(target, _draw_plan(plan, kind))
    return plan


def _draw_plan(plan: Plan, kind: str) -> bytes:
    """Returns a file of the plan: ``.pdf`` with all pages, or ``.svg`` or ``.png`` with the first one.

    It is made in memory, because on a full disk matplotlib fails once more while it closes a PDF file.
    """
    import_optional("matplotlib", "a plan needs matplotlib")
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    content = io.BytesIO()
    # The same plan gives the same bytes: no dates, no random names. Text stays text.
    with (
        rc_context({"svg.hashsalt": "plan", "svg.fonttype": "none", "pdf.fonttype": 42}),
        warnings.catch_warnings(),
    ):
        # The font draws a box for a character that it lacks.
        warnings.filterwarnings("ignore", "Glyph .* missing|Matplotlib currently does not support")
        if kind == ".pdf":
            with PdfPages(content, metadata={"CreationDate": None, "Title": "Plan of a map"}) as pages:
                for page in (_map_page(plan), *_list_pages(plan)):
                    pages.savefig(page)
        else:
            dates = {"Date": None} if kind == ".svg" else None
            _map_page(plan).savefig(content, format=kind[1:], dpi=150, metadata=dates)
    return content.getvalue()


def _map_page(plan: Plan) -> Untyped:
    """Draws the map with its measures, the bill of materials and a legend, on A4 or a larger sheet."""
    (rows, columns), bill = plan.shape, _bill(plan)
    bill_height = _LINE * (max(map(len, bill)) + 0.5)
    above, below, beside = _MARGIN + 16, 20 + bill_height + _SAMPLE + 8 + _MARGIN, 2 * _MARGIN + 16
    edge = 0.3 if plan.objects else 0.0  # in tiles: signs may be beyond the map
    fits = min((_A4[0] - beside) / (columns + 2 * edge), (_A4[1] - above - below) / (rows + 2 * edge))
    tile = min(max(fits, _SMALLEST), _LARGEST)
    edge *= tile
    width, deep = max(_A4[0], columns * tile + 2 * edge + beside), rows * tile + 2 * edge
    page, ax = _page(width, max(_A4[1], above + deep + below), "Plan")
    facts = f"{rows} rows and {columns} columns of {plan.tile_size:g} m, {plan.floor[0]:g} x {plan.floor[1]:g} m"
    _write(ax, _MARGIN + 18, _MARGIN + 3, facts, color=_FAINT)
    _draw_map(ax, plan, (width - columns * tile) / 2, above + edge, tile, edge)
    left, top = (width - _A4[0]) / 2 + _MARGIN, above + deep + 20
    _write_columns(ax, left, top, bill)
    samples = [(kind, 0, left + column * (_SAMPLE + 8), top + bill_height) for column, kind in enumerate(REFERENCE)]
    _draw_tiles(ax, samples, plan.tile_size, _SAMPLE)
    for kind, turns, x, y in samples:
        _write(ax, x + _SAMPLE / 2, y + _SAMPLE + 4, _tile_name(kind, turns), ha="center")
    words = "Angles are counter-clockwise.\nN is up; the floor may lie any way."
    _write(ax, left + 4 * (_SAMPLE + 8), top + bill_height + _SAMPLE / 2, words, va="center", color=_FAINT)
    return page


def _draw_map(ax: Untyped, plan: Plan, left: float, top: float, tile: float, edge: float) -> None:
    (rows, columns), scale, size = plan.shape, tile / plan.tile_size, min(7.0, 0.3 * tile)
    right, bottom = left + columns * tile, top + rows * tile
    ax.fill([left, right, right, left], [top, top, bottom, bottom], facecolor=_GROUND, edgecolor=_FAINT, lw=0.6)
    tiles = [(kind, turns, left + column * tile, top + row * tile) for row, column, kind, turns in plan.placed]
    _draw_tiles(ax, tiles, plan.tile_size, tile)
    for row in range(rows):
        _write(ax, left - edge - 4, top + (row + 0.5) * tile, str(row), ha="right", va="center")
        ax.plot([left, right], [top + row * tile] * 2, color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    for column in range(columns):
        _write(ax, left + (column + 0.5) * tile, top - edge - 3.5, str(column), ha="center")
        ax.plot([left + column * tile] * 2, [top, bottom], color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    for (row, column, *_), (kind, turns, x, y) in zip(plan.placed, tiles, strict=True):
        _label(ax, x + tile / 2, y + tile / 2, f"{row},{column}\n{_tile_name(kind, turns)}", size=size)
    for index, thing in enumerate(plan.objects, 1):
        _draw_object(ax, thing, index, left + thing.x * tile, top + thing.y * tile, scale)
    below, beside = bottom + edge + 7, right + edge + 7
    _arrow(ax, (left, below), (right, below), "<|-|>")
    _label(ax, (left + right) / 2, below, f"{plan.floor[0]:g} m")
    _arrow(ax, (beside, top), (beside, bottom), "<|-|>")
    _label(ax, beside, (top + bottom) / 2, f"{plan.floor[1]:g} m", rotation=90)
    _arrow(ax, (beside, top - 3), (beside, top - 9), "->")
    _write(ax, beside + 2, top - 4.5, "N")


def _draw_tiles(ax: Untyped, tiles: Sequence[tuple[str, int, float, float]], tile_size: float, side: float) -> None:
    """Draws tiles: kind, quarter turns, and the position of the north-west corner."""
    from matplotlib.collections import LineCollection, PolyCollection

    squares = [[(x, y), (x + side, y), (x + side, y + side), (x, y + side)] for _, _, x, y in tiles]
    ax.add_collection(PolyCollection(squares, facecolors=_ROAD, edgecolors=_FAINT, linewidths=0.3))
    scale, dash = side / tile_size, 0.05 / TAPE_WIDTHS["yellow"]  # the latter in widths of the line
    strips = [
        (tape.colour, [(x + east * scale, y + south * scale) for east, south in tape.points])
        for kind, turns, x, y in tiles
        for tape in tapes_of(kind, turns, tile_size)
    ]
    # The last tape covers the others. White tape on white paper needs an outline.
    inks = (("red", "#d9202c", 0.0), ("yellow", "#f5c71a", 0.0), ("white", _FAINT, 0.6), ("white", "#ffffff", 0.0))
    for colour, ink, outline in inks:
        lines = [line for of, line in strips if of == colour]
        points = TAPE_WIDTHS[colour] * scale * 72 / 25.4 + outline
        style = (0, (dash, dash / 2)) if colour == "yellow" else "solid"
        ax.add_collection(LineCollection(lines, colors=ink, linewidths=points, linestyles=style, capstyle="butt"))


def _draw_object(ax: Untyped, thing: MapObject, index: int, x: float, y: float, scale: float) -> None:
    """Draws the footprint of an object with its number in the check-list, and an arrow the way that it faces."""
    from matplotlib.patches import Circle, Polygon

    length, width = (side * scale / 2 for side in thing.footprint)
    east, south = cos(thing.angle), -sin(thing.angle)
    is_sign = thing.kind.startswith("sign_") or thing.kind == "trafficlight"
    colour = _STOP if thing.kind == "sign_stop" else _SIGN if is_sign else _THING
    if thing.is_round:
        ax.add_patch(Circle((x, y), length, facecolor=colour, lw=0, zorder=_OBJECTS))
    else:
        corners = [(length, width), (length, -width), (-length, -width), (-length, width)]
        points = [(x + a * east - b * south, y + a * south + b * east) for a, b in corners]
        ax.add_patch(Polygon(points, facecolor=colour, lw=0, zorder=_OBJECTS))
        reach = length + 0.07 * scale
        _arrow(ax, (x, y), (x + reach * east, y + reach * south), "-|>", colour, zorder=_ARROWS)
    style = {"size": min(6.5, 0.11 * scale), "color": "white", "weight": "bold", "zorder": _NUMBERS}
    _write(ax, x, y, str(index), ha="center", va="center_baseline", **style)


def _bill(plan: Plan) -> list[list[str]]:
    """Returns the columns of the bill of materials: tiles, tape, and objects if there are any."""
    tiles = ["Tiles", *(f"{plan.tiles[kind]} x {_tile_name(kind)}" for kind in REFERENCE)]
    tiles += [f"{len(plan.placed)} with road", f"{plan.tiles['empty']} empty: bare or none"]
    tape = [f"{plan.tape[name]:.2f} m {name}, {100 * TAPE_WIDTHS[name]:g} cm wide" for name in TAPE_WIDTHS]
    tape = ["Tape", *tape, "(yellow: laid whole, then cut to", "5 cm of tape and 2.5 cm of gap)"]
    things = ["Signs and objects"]
    for kind, count in sorted(Counter(thing.kind for thing in plan.objects).items()):
        tags = sorted(thing.tag for thing in plan.objects if thing.kind == kind and thing.tag is not None)
        tagged = f", tag {', '.join(map(str, tags))}" if tags else ""
        things += wrap(f"{count} x {_thing_name(kind)}{tagged}", 38, subsequent_indent="      ")
    return [tiles, tape, things] if plan.objects else [tiles, tape]


def _list_pages(plan: Plan) -> Iterator[Untyped]:
    """Draws the check-list on A4."""
    lines = _check_list(plan)
    columns = [lines[first : first + _ROWS] for first in range(0, len(lines), _ROWS)]
    for first in range(0, len(columns), _COLUMNS):
        page, ax = _page(*_A4, "Check-list")
        _write_columns(ax, _MARGIN, _MARGIN + 12, columns[first : first + _COLUMNS])
        yield page


def _check_list(plan: Plan) -> list[str]:
    """Returns the lines of the check-list: tiles to tape by kind, tiles to lay by row, objects to place by number."""
    lines = ["Tiles to tape, in cm"]
    for kind in (kind for kind in REFERENCE if plan.tiles[kind]):
        tapes = tapes_of(kind, 0, plan.tile_size)
        strips = Counter((tape.colour, f"{100 * tape.length:.1f}", len(tape.points) - 1) for tape in tapes)
        lines += [f"{_BOX} {plan.tiles[kind]} x {_tile_name(kind)}, each with"]
        for (colour, length, pieces), count in strips.items():
            cut = f" in {pieces} pieces" if colour == "white" and pieces > 1 else ""
            lines += [f"      {count} x {colour} of {length}{cut}"]
    for row, tiles in groupby(plan.placed, lambda tile: tile.row):
        lines += ["", f"Row {row}"]
        lines += [f"{_BOX} {row},{column}  {_tile_name(kind, turns)}" for _, column, kind, turns in tiles]
    lines += ["", "Signs and objects", "(metres from the north-west corner)"] if plan.objects else []
    for index, thing in enumerate(plan.objects, 1):
        tag = "" if thing.tag is None else f", tag {thing.tag}"
        east, south = (round(length * plan.tile_size, 2) for length in (thing.x, thing.y))
        across, down = "west" if east < 0 else "east", "north" if south < 0 else "south"
        faces = "" if thing.is_round else f", faces {_direction(thing.angle)}"
        lines += [f"{_BOX} {index}  {_thing_name(thing.kind)}{tag}"]
        lines += [f"      {abs(east):.2f} {across}, {abs(south):.2f} {down}{faces}"]
    return lines


def _tile_name(kind: str, quarter_turns: int | None = None) -> str:
    name = {"crossing3": "3-way", "crossing4": "4-way"}.get(kind, kind)
    return name if quarter_turns is None or kind == "crossing4" else f"{name} {90 * quarter_turns}\N{DEGREE SIGN}"


def _thing_name(kind: str) -> str:
    return kind.removeprefix("sign_").removeprefix("other:").replace("4_way", "4-way").replace("_", " ")


def _direction(angle: float) -> str:
    """Returns the side of the world that an angle points to, or degrees counter-clockwise from the east."""
    turned = round(degrees(angle)) % 360
    return {0: "east", 90: "north", 180: "west", 270: "south"}.get(turned, f"{turned}\N{DEGREE SIGN}")


def _page(width: float, height: float, title: str) -> tuple[Untyped, Untyped]:
    """Returns a figure of a page and axes in millimetres from its north-west corner."""
    from matplotlib.figure import Figure

    page = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
    ax = page.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(height, 0))
    ax.set_axis_off()
    _write(ax, _MARGIN, _MARGIN + 3, title, size=15, weight="bold")
    return page, ax


def _write_columns(ax: Untyped, left: float, top: float, columns: Sequence[Sequence[str]]) -> None:
    """Writes columns of lines; those that start with a letter are headings."""
    for column, lines in enumerate(columns):
        for row, line in enumerate(lines):
            x, weight = left + column * (_A4[0] - 2 * _MARGIN) / _COLUMNS, "bold" if line[:1].isalpha() else "normal"
            _write(ax, x, top + row * _LINE, line, weight=weight)


def _write(ax: Untyped, x: float, y: float, words: str, **style: Untyped) -> None:
    ax.text(x, y, words, **({"color": _INK, "size": 8.5, "va": "baseline"} | style))


def _label(ax: Untyped, x: float, y: float, words: str, **style: Untyped) -> None:
    """Writes words on a white box around a point."""
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.88, "linewidth": 0}
    _write(ax, x, y, words, ha="center", va="center", bbox=box, linespacing=1.05, **style)


def _arrow(
    ax: Untyped, start: tuple[float, float], end: tuple[float, float], style: str, colour: str = _INK, zorder: int = 3
) -> None:
    ends = {"arrowstyle": style, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", end, start, arrowprops={**ends, "lw": 0.8, "color": colour}, zorder=zorder)
