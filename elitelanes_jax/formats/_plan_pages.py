"""The pages of a plan, drawn with matplotlib: the map with its measures, the bill of materials, a check-list."""

from collections import Counter
from collections.abc import Iterator
from math import ceil, cos, degrees, sin
from pathlib import Path
from typing import TypeAlias

from elitelanes_jax._util.packages import import_optional
from elitelanes_jax._util.types import Untyped
from elitelanes_jax.formats.objects import OBJECT_KINDS, MapObject
from elitelanes_jax.formats.plan import DASH, REFERENCE, WHITE, YELLOW, Plan, Tape, tapes_of
from elitelanes_jax.network.codes import rotate_codes

_Line: TypeAlias = tuple[str, dict[str, Untyped]]
"""A line of text and its style."""

# Lengths on pages are in millimetres.
_A4 = (210.0, 297.0)
_MARGIN, _LINE = 14.0, 4.5
_SMALLEST, _LARGEST = 14.0, 40.0  # sides of a tile of the map
_SAMPLE = 22.0  # the side of a tile of the legend
_LINES, _COLUMNS = 56, 3  # of a page of the check-list

_COLOURS = {"white": "#ffffff", "yellow": "#f5c71a", "red": "#d9202c"}
_WIDTHS = {"white": WHITE, "yellow": YELLOW, "red": WHITE}
_GROUND, _ROAD, _INK, _FAINT = "#f3f5ee", "#c4c8ce", "#1d2026", "#6d737d"
_STOP, _SIGN, _THING = "#c01722", "#1f5fbf", "#3d7a3a"
_HEADING: dict[str, Untyped] = {"weight": "bold"}
_SPACE: _Line = ("", {})


def draw_plan(plan: Plan, file: Path) -> None:
    """Writes the plan to a file that ends in .pdf, with all pages, or .svg or .png, with the first one."""
    import_optional("matplotlib", "a plan needs matplotlib")
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import PdfPages

    kind = file.suffix.lower()
    # The same plan gives the same bytes: no dates, no random names. Text stays text.
    with rc_context({"svg.hashsalt": "plan", "svg.fonttype": "none", "pdf.fonttype": 42}):
        if kind == ".pdf":
            with PdfPages(file, metadata={"CreationDate": None, "Title": "Plan of a map"}) as pages:
                for page in (_map_page(plan), *_list_pages(plan)):
                    pages.savefig(page)
        else:
            _map_page(plan).savefig(file, dpi=150, metadata={"Date": None} if kind == ".svg" else None)


def _map_page(plan: Plan) -> Untyped:
    """Draws the map with its measures, the bill of materials and a legend, on A4 or a larger sheet."""
    rows, columns = plan.shape
    bill = _bill(plan)
    bill_height = _LINE * (max(map(len, bill)) + 1)
    above, below = _MARGIN + 16, 20 + bill_height + _SAMPLE + 8 + _MARGIN
    beside = 2 * _MARGIN + 16
    fits = min((_A4[0] - beside) / columns, (_A4[1] - above - below) / rows)
    tile = min(max(fits, _SMALLEST), _LARGEST)
    width, height = max(_A4[0], columns * tile + beside), max(_A4[1], above + rows * tile + below)
    page, ax = _page(width, height)
    across, down = plan.floor
    _write(ax, _MARGIN, _MARGIN + 3, "Plan", size=15, weight="bold")
    facts = f"{rows} rows and {columns} columns of {plan.tile_size:g} m, {across:.2f} m wide and {down:.2f} m deep"
    _write(ax, _MARGIN + 18, _MARGIN + 3, facts, size=9, color=_FAINT)
    _draw_map(ax, plan, (width - columns * tile) / 2, above, tile)
    left, top = (width - _A4[0]) / 2 + _MARGIN, above + rows * tile + 20
    for column, lines in enumerate(bill):
        for line, (words, style) in enumerate(lines):
            _write(ax, left + column * (_A4[0] - 2 * _MARGIN) / len(bill), top + _LINE * line, words, size=8.5, **style)
    top += bill_height - _LINE / 2
    for column, (kind, code) in enumerate(REFERENCE.items()):
        x = left + column * (_SAMPLE + 8)
        _draw_tile(ax, code, plan.tile_size, x, top, _SAMPLE / plan.tile_size)
        _write(ax, x + _SAMPLE / 2, top + _SAMPLE + 4, _tile_name(kind, 0), size=8.5, ha="center")
    words = "Angles are counter-clockwise.\nN is north, but the floor may lie any way."
    _write(ax, left + 4 * (_SAMPLE + 8), top + _SAMPLE / 2, words, size=8.5, va="center", color=_FAINT)
    return page


def _draw_map(ax: Untyped, plan: Plan, left: float, top: float, tile: float) -> None:
    from matplotlib.patches import Rectangle

    rows, columns = plan.shape
    right, bottom = left + columns * tile, top + rows * tile
    scale, size = tile / plan.tile_size, min(7.0, 0.3 * tile)
    ax.add_patch(Rectangle((left, top), columns * tile, rows * tile, facecolor=_GROUND, edgecolor=_FAINT, lw=0.6))
    for placed in plan.placed:
        code = rotate_codes(REFERENCE[placed.kind], placed.quarter_turns)
        _draw_tile(ax, code, plan.tile_size, left + placed.column * tile, top + placed.row * tile, scale)
    for row in range(rows):
        _write(ax, left - 4, top + (row + 0.5) * tile, str(row), size=9, ha="right", va="center")
        ax.plot([left, right], [top + row * tile] * 2, color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    for column in range(columns):
        _write(ax, left + (column + 0.5) * tile, top - 3.5, str(column), size=9, ha="center")
        ax.plot([left + column * tile] * 2, [top, bottom], color=_FAINT, lw=0.25, ls=(0, (2, 3)))
    for placed in plan.placed:
        words = f"{placed.row},{placed.column}\n{_tile_name(placed.kind, placed.quarter_turns)}"
        _label(ax, left + (placed.column + 0.5) * tile, top + (placed.row + 0.5) * tile, words, size=size)
    for number, thing in enumerate(plan.objects, 1):
        _draw_object(ax, thing, number, left + thing.x * tile, top + thing.y * tile, scale, size)
    across, down = plan.floor
    _arrow(ax, (left, bottom + 7), (right, bottom + 7), "<|-|>")
    _label(ax, (left + right) / 2, bottom + 7, f"{across:.2f} m", size=9)
    _arrow(ax, (right + 7, top), (right + 7, bottom), "<|-|>")
    _label(ax, right + 7, (top + bottom) / 2, f"{down:.2f} m", size=9, rotation=90)
    _arrow(ax, (right + 7, top - 3), (right + 7, top - 9), "->")
    _write(ax, right + 9, top - 4.5, "N", size=9)


def _draw_tile(ax: Untyped, code: int, tile_size: float, x: float, y: float, scale: float) -> None:
    from matplotlib.patches import Rectangle

    square = Rectangle((x, y), tile_size * scale, tile_size * scale, facecolor=_ROAD, edgecolor=_FAINT, lw=0.3)
    ax.add_patch(square)
    for tape in tapes_of(code, tile_size):
        across = [x + east * scale for east, _ in tape.points]
        down = [y + south * scale for _, south in tape.points]
        width = _WIDTHS[tape.colour] * scale * 72 / 25.4  # in points
        style: dict[str, Untyped] = {"solid_capstyle": "butt", "dash_capstyle": "butt"}
        if tape.dashed:
            style["dashes"] = (DASH / YELLOW, DASH / YELLOW / 2)  # in widths of the line
        if tape.colour == "white":  # white paper needs an outline
            ax.plot(across, down, color=_FAINT, lw=width + 0.6, clip_path=square, **style)
        ax.plot(across, down, color=_COLOURS[tape.colour], lw=width, clip_path=square, **style)


def _draw_object(ax: Untyped, thing: MapObject, number: int, x: float, y: float, scale: float, size: float) -> None:
    """Draws the footprint of an object, its number in the check-list, and an arrow the way that it faces."""
    from matplotlib.patches import Circle, Polygon

    length, width = (side * scale / 2 for side in thing.footprint)
    east, south = cos(thing.angle), -sin(thing.angle)
    is_sign = thing.kind.startswith("sign_") or thing.kind == "trafficlight"
    colour = _STOP if thing.kind == "sign_stop" else _SIGN if is_sign else _THING
    if OBJECT_KINDS[thing.kind].is_round:
        ax.add_patch(Circle((x, y), length, facecolor=colour, alpha=0.6, lw=0))
    else:
        corners = [(length, width), (length, -width), (-length, -width), (-length, width)]
        points = [(x + a * east - b * south, y + a * south + b * east) for a, b in corners]
        ax.add_patch(Polygon(points, facecolor=colour, alpha=0.6, lw=0))
        reach = length + 0.1 * scale
        _arrow(ax, (x, y), (x + reach * east, y + reach * south), "-|>", colour)
        x, y = x - (length + 0.05 * scale) * east, y - (length + 0.05 * scale) * south
    _label(ax, x, y, str(number), size=size, color=colour, weight="bold")


def _bill(plan: Plan) -> list[list[_Line]]:
    """Returns the columns of the bill of materials: tiles, tape, and objects if there are any."""
    roads = len(plan.placed)
    tiles: list[_Line] = [("Tiles", _HEADING)]
    tiles += [(f"{plan.tiles[kind]}  {_tile_name(kind)}", {}) for kind in REFERENCE]
    tiles += [(f"{roads}  with road", {}), (f"{plan.tiles['empty']}  empty: bare tiles or none", {"color": _FAINT})]
    tape: list[_Line] = [("Tape", _HEADING)]
    for colour, metres in plan.tape.items():
        tape.append((f"{metres:.2f} m {colour}, {100 * _WIDTHS[colour]:g} cm wide", {}))
    tape += [
        (words, {"color": _FAINT}) for words in ("Yellow tape is laid whole, then cut:", "5 cm of tape, 2.5 cm gap.")
    ]
    things: list[_Line] = [("Signs and objects", _HEADING)]
    for kind, tags in plan.tags.items():
        known = [str(tag) for tag in tags if tag is not None]
        more = f", {len(known) - 6} more" if len(known) > 6 else ""
        tagged = f": {'tags' if len(known) > 1 else 'tag'} {', '.join(known[:6])}{more}" if known else ""
        things.append((f"{len(tags)}  {_thing_name(kind)}{tagged}", {}))
    return [tiles, tape, things] if plan.objects else [tiles, tape]


def _list_pages(plan: Plan) -> Iterator[Untyped]:
    """Draws the check-list on A4: tiles to tape by kind, tiles to lay by row, objects to place by number."""
    columns: list[list[_Line]] = [[]]
    for block in _blocks(plan):
        if len(columns[-1]) + min(len(block), _LINES) > _LINES:
            columns.append([])
        for line in block:
            if len(columns[-1]) == _LINES:  # of a block that is longer than a column
                columns.append([])
            columns[-1].append(line)
    pages = ceil(len(columns) / _COLUMNS)
    for number in range(pages):
        page, ax = _page(*_A4)
        of = f", page {number + 1} of {pages}" if pages > 1 else ""
        _write(ax, _MARGIN, _MARGIN + 3, f"Check-list{of}", size=13, weight="bold")
        for place, column in enumerate(columns[number * _COLUMNS : (number + 1) * _COLUMNS]):
            x = _MARGIN + place * (_A4[0] - 2 * _MARGIN) / _COLUMNS
            for index, (words, style) in enumerate(column):
                _write(ax, x, _MARGIN + 12 + _LINE * index, words, size=8.5, **style)
        yield page


def _blocks(plan: Plan) -> Iterator[list[_Line]]:
    """Yields the lines of the check-list under each heading."""
    tape: list[_Line] = [("Tiles to tape, in cm", _HEADING)]
    for kind, code in REFERENCE.items():
        if plan.tiles[kind]:
            strips = Counter(_strip_name(strip) for strip in tapes_of(code, plan.tile_size))
            tape.append((_box(f"{plan.tiles[kind]}  {_tile_name(kind)}, each with"), {}))
            tape += [(f"      {count} {words}", {}) for words, count in strips.items()]
    yield [*tape, _SPACE]
    for row in range(plan.shape[0]):
        tiles = [tile for tile in plan.placed if tile.row == row]
        if tiles:
            lines = [_box(f"{row},{tile.column}  {_tile_name(tile.kind, tile.quarter_turns)}") for tile in tiles]
            yield [(f"Row {row}", _HEADING), *((line, {}) for line in lines), _SPACE]
    if plan.objects:
        yield [("Signs and objects", _HEADING), ("metres from the map's north-west corner", {"color": _FAINT})]
    for number, thing in enumerate(plan.objects, 1):
        tag = "" if thing.tag is None else f", tag {thing.tag}"
        east, south = thing.x * plan.tile_size, thing.y * plan.tile_size
        faces = "" if OBJECT_KINDS[thing.kind].is_round else f", faces {_direction(thing.angle)}"
        yield [
            (_box(f"{number}  {_thing_name(thing.kind)}{tag}"), {}),
            (f"      {east:.2f} east, {south:.2f} south{faces}", {}),
        ]


def _strip_name(strip: Tape) -> str:
    pieces = len(strip.points) - 1
    cut = f" in {pieces} pieces" if pieces > 1 and not strip.dashed else ""
    return f"{strip.colour} of {100 * strip.length:.1f}{cut}"


def _box(words: str) -> str:
    return f"\N{BALLOT BOX} {words}"


def _tile_name(kind: str, quarter_turns: int | None = None) -> str:
    name = {"crossing3": "3-way", "crossing4": "4-way"}.get(kind, kind)
    turned = quarter_turns is not None and kind != "crossing4"
    return f"{name} {90 * (quarter_turns or 0)}\N{DEGREE SIGN}" if turned else name


def _thing_name(kind: str) -> str:
    return kind.removeprefix("sign_").replace("_", " ")


def _direction(angle: float) -> str:
    """Returns the side of the world that an angle points to, or degrees counter-clockwise from the east."""
    turned = round(degrees(angle)) % 360
    return {0: "east", 90: "north", 180: "west", 270: "south"}.get(turned, f"{turned}\N{DEGREE SIGN}")


def _page(width: float, height: float) -> tuple[Untyped, Untyped]:
    """Returns a figure of a page and axes in millimetres from its north-west corner."""
    from matplotlib.figure import Figure

    page = Figure(figsize=(width / 25.4, height / 25.4), facecolor="white")
    ax = page.add_axes((0, 0, 1, 1))
    ax.set(xlim=(0, width), ylim=(height, 0))
    ax.set_axis_off()
    return page, ax


def _write(ax: Untyped, x: float, y: float, words: str, **style: Untyped) -> None:
    ax.text(x, y, words, **({"color": _INK, "va": "baseline"} | style))


def _label(ax: Untyped, x: float, y: float, words: str, **style: Untyped) -> None:
    """Writes words on a white box in the middle of a place."""
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "alpha": 0.88, "linewidth": 0}
    _write(ax, x, y, words, ha="center", bbox=box, linespacing=1.05, **({"va": "center"} | style))


def _arrow(ax: Untyped, start: tuple[float, float], end: tuple[float, float], style: str, colour: str = _INK) -> None:
    ax.annotate(
        "", end, start, arrowprops={"arrowstyle": style, "lw": 0.8, "color": colour, "shrinkA": 0, "shrinkB": 0}
    )
