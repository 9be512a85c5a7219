"""Small drawings of maps without tile pictures: as text for terminals, and as SVG for notebooks."""

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.cells import column_name
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import EAST, SIDES

# The characters of the codes.
_LINES = " ╴╷┐╶─┌┬╵┘│┤└┴├┼"
_ASCII = " -|+--++|+|+++++"


@name_wrong_arguments
def draw_text(codes: ArrayLike, *, ascii_only: bool = False, named: bool = False) -> str:
    """Returns a grid of codes ``[H, W]`` in characters, see `RoadMap.to_text`.

    If `named`, the letters of columns are above, and the numbers of rows on the left, see
    `cell_name`. Raises `InputError` for a bad grid.
    """
    signs, along = (_ASCII, "-") if ascii_only else (_LINES, "─")
    rows = known_grid(codes).tolist()
    lines = [
        "".join(signs[code] + (along if code & EAST else " ") for code in row).rstrip()
        for row in rows
    ]
    if named:
        lines = _with_names(lines, len(rows[0]))
    return "\n".join(lines)


def _with_names(lines: list[str], columns: int) -> list[str]:
    """Returns the lines of a drawing with the names of rows and columns."""
    # A column has two characters. Names of several letters need more, so every second one is left
    # out.
    step = 1 if columns <= 26 else 2
    letters = "".join(column_name(column).ljust(2 * step) for column in range(0, columns, step))
    width = len(str(len(lines)))
    named = [f"{'':{width}} {letters}".rstrip()]
    for row, line in enumerate(lines, 1):
        named.append(f"{row:{width}} {line}".rstrip())
    return named


@name_wrong_arguments
def draw_svg(grid: ArrayLike) -> str:
    """Returns a drawing of a map, codes ``[H, W]``, as the text of an SVG file.

    Raises:
      InputError: for a bad grid.
    """
    codes = known_grid(grid)
    height, width = codes.shape
    # The side of a tile in pixels.
    scale = min(30, 480 / max(height, width))
    # Each connection is a line from the middle of its tile to a side. Two such lines meet at a
    # border.
    roads = "".join(
        f"M{column + 0.5} {row + 0.5}l{side.right / 2:g} {side.down / 2:g}"
        for row, column in np.ndindex(height, width)
        for side in SIDES
        if codes[row, column] & side.bit
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        f'width="{width * scale:.0f}" height="{height * scale:.0f}" '
        f'fill="none" stroke-linecap="round">'
        # One path is drawn twice, wide as the road and narrow as the line in its middle.
        f'<path fill="#9cb38a" d="M0 0h{width}v{height}H0z"/>'
        f'<path stroke="#4a4d52" stroke-width=".8" d="{roads}"/>'
        f'<path stroke="#f2c230" stroke-width=".05" d="{roads}"/></svg>'
    )
