"""Small drawings of maps without tile pictures: as text for terminals, and as SVG for notebooks."""

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST, SIDES

# The characters of the codes.
_LINES = " ╴╷┐╶─┌┬╵┘│┤└┴├┼"
_ASCII = " -|+--++|+|+++++"


@name_wrong_arguments
def draw_text(codes: ArrayLike, *, ascii_only: bool = False) -> str:
    """Returns a grid of codes ``[H, W]`` in characters, see `RoadMap.to_text`.

    Raises `InputError` for a bad grid.
    """
    signs, along = (_ASCII, "-") if ascii_only else (_LINES, "─")
    rows = np.asarray(check_grid(codes)).tolist()
    return "\n".join(
        "".join(signs[code] + (along if code & EAST else " ") for code in row).rstrip()
        for row in rows
    )


@name_wrong_arguments
def draw_svg(grid: ArrayLike) -> str:
    """Returns a drawing of a map, codes ``[H, W]``, as the text of an SVG file.

    Raises:
      InputError: for a bad grid.
    """
    codes = np.asarray(check_grid(grid))
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
