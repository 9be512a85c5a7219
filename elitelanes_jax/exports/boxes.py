"""Maps as text, for terminals."""

from typing import Any

import numpy as np

from elitelanes_jax.checks import check_grid
from elitelanes_jax.codes import EAST

__all__ = ["LINES", "boxes"]

LINES = " ╴╷┐╶─┌┬╵┘│┤└┴├┼"
"""The character of each code."""

_ASCII = " -|+--++|+|+++++"


def boxes(codes: Any, *, ascii_only: bool = False) -> str:
    """A grid drawn in characters, two a tile, a row a line: a connection is a line to that side.

    Args:
      codes: integer codes ``[H, W]``.
      ascii_only: draw with ``+``, ``-`` and ``|``, for what knows no box-drawing characters.

    Raises:
      InputError: for a bad grid (see `check_grid`).
    """
    signs, along = (_ASCII, "-") if ascii_only else (LINES, "─")
    rows = np.asarray(check_grid(codes)).tolist()
    return "\n".join("".join(signs[code] + (along if code & EAST else " ") for code in row).rstrip() for row in rows)
