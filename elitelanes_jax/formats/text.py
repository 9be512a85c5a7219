"""Maps as text, for terminals."""

import numpy as np
from numpy.typing import ArrayLike

from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import EAST

LINES = " ╴╷┐╶─┌┬╵┘│┤└┴├┼"
"""The character of each code."""

_ASCII = " -|+--++|+|+++++"


def draw_text(codes: ArrayLike, *, ascii_only: bool = False) -> str:
    """Returns a grid in characters, two per tile, a line for each row. A connection is a line to that side.

    Args:
      codes: integer codes ``[H, W]``.
      ascii_only: whether to draw with ``+``, ``-`` and ``|`` instead of box-drawing characters.

    Raises:
      InputError: for a bad grid (see `check_grid`).
    """
    signs, along = (_ASCII, "-") if ascii_only else (LINES, "─")
    rows = np.asarray(check_grid(codes)).tolist()
    return "\n".join("".join(signs[code] + (along if code & EAST else " ") for code in row).rstrip() for row in rows)
