"""Proven bounds for flawless networks of grids that are too large for a certificate, by cyclomatic number.

python experiments/bounds.py [SIZE ...] [--out FILE]

A size is 12x12; every cell is filled. The grid is cut into an upper and a lower part of whole rows, and the highest
straight score of each is found exactly, for each number of crossings. Relaxed are that the network has one component,
which tiles meet at the cut, and how long the straights across it are. Of such a straight with a tiles above and b below
the score is (a + b)^2 <= 2 a^2 + 2 b^2; the two terms are added up apart.

In a flawless network every tile has two links, a three-way crossing three and a four-way crossing four. With one
component its cyclomatic number is 1 + x / 2 + y, of x three-way and y four-way crossings; x + 2 y adds up.
Bridges only cost: the fitness is at least -2 (cyclomatic number + straight score).
"""

import argparse
import re
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
from frontier import STRAIGHT, Cell, insert, tile_of
from numpy.typing import NDArray

from elitelanes_jax._util.atomic_io import write_atomic
from elitelanes_jax._util.checks import path
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.cli.arguments import Parser, checked_by
from elitelanes_jax.cli.program import guarded, leave, say

__all__ = ["bounds", "main", "part_scores"]

_NONE = -1

# The lowest fitness of 12 x 12 filled cells that searches have found, from cyclomatic number 3 on (results/optimum.md).
FOUND = [-1734, -1752, -1826, -1858, -1898, -1696, -1622, -1548, -1494, -1344, -1258, -1180, -1050, -950, -842, -690]
FOUND += [-634, -488, -342]

# No network of 12 x 12 filled cells is below this, by integer programming.
LEAST = -1898


def bounds(height: int, width: int, most: int) -> dict[int, int]:
    """Returns for each cyclomatic number a fitness that no flawless network without empty cells is below.

    Args:
      height: of the grid, 2 to 14.
      width: of the grid, 2 to 12.
      most: the highest cyclomatic number that is asked for.
    """
    bins = 2 * most - 1
    upper, lower = part_scores(height // 2, width, bins), part_scores(height - height // 2, width, bins)
    best = np.full(bins, _NONE)
    for first in np.flatnonzero(upper >= 0):
        rest = lower[: bins - first]
        best[first:] = np.maximum(best[first:], np.where(rest >= 0, upper[first] + rest, _NONE))
    return {1 + k // 2: -2 * (1 + k // 2 + int(best[k])) for k in range(0, bins, 2) if best[k] >= 0}


def part_scores(height: int, width: int, bins: int) -> NDArray[np.int64]:
    """Returns the highest straight score of a part that is open along one side.

    Args:
      height: of the part.
      width: along the open side.
      bins: of the number of three-way crossings plus twice the four-way ones, from 0 on.

    Returns:
      int64 ``[bins]``, negative where there is none. Straights across the open side count twice.
    """
    # The line lies across the part, and goes along the open side.
    states, values = np.zeros((1, height // 4 + 1), np.uint64), np.full((1, bins), _NONE, np.int64)
    values[0, 0] = 0
    for row, column in np.ndindex(width, height):
        cell = Cell(width, height, row, column, fill=True, lengths=True, bridgeless=False, counting=True)
        table, found, used = _advance(cell, states, values)
        states, values = table[used], found[used]
    return np.asarray(values.max(axis=0, initial=_NONE))


@numba.njit(cache=True)
def _advance(cell: Any, old: Any, old_values: Any) -> Any:
    """Takes the line past one cell, as `frontier` does, without components; returns states, values and those used."""
    places, bins = cell.width + 1, old_values.shape[1]
    capacity = 1 << 8
    states = np.zeros((capacity, old.shape[1]), np.uint64)
    values = np.full((capacity, bins), _NONE, np.int64)
    origins = np.zeros((capacity, 0), np.int32)
    used = np.zeros(capacity, np.bool_)
    size = 0
    kinds = np.zeros(places, np.int64)
    state = np.zeros(old.shape[1], np.uint64)
    last = cell.column == cell.width - 1
    for source in range(len(old)):
        for place in range(places):
            kinds[place] = np.int64(old[source, place >> 2] >> np.uint64(16 * (place & 3))) & 15
        left, up = kinds[cell.column], kinds[cell.column + 1]
        for choice in range(4):
            right, down = choice >> 1, choice & 1
            if down and cell.row == cell.height - 1:
                continue
            gain, right_kind, down_kind = tile_of(cell, left, up, right, down)
            if gain < 0:
                continue
            if last and right_kind > STRAIGHT:
                gain += (right_kind - STRAIGHT) ** 2
            crossing = max(0, (left > 1) + (up > 1) + right + down - 2)
            for word in range(len(state)):
                state[word] = 0
            for place in range(places - last):
                kind = kinds[place]
                if place == cell.column:
                    kind = down_kind
                elif place == cell.column + 1:
                    kind = right_kind
                state[place + last >> 2] |= np.uint64(kind) << np.uint64(16 * (place + last & 3))
            before = size
            place, size, states, values, origins, used = insert(size, states, values, origins, used, state)
            if size > before:
                for bin_ in range(bins):
                    values[place, bin_] = _NONE
            for bin_ in range(bins - crossing):
                if old_values[source, bin_] >= 0:
                    value = old_values[source, bin_] + gain
                    if value > values[place, bin_ + crossing]:
                        values[place, bin_ + crossing] = value
    return states, values, used


def table(height: int, width: int) -> str:
    """Makes the table of a size; of 12 x 12 also with what searches have found, and how far the bound is from it."""
    # No flawless network of 12 x 12 cells with more than 21 is known; of smaller grids, none with more than a sixth.
    proven = bounds(height, width, max(3, height * width // 6))
    found = dict(enumerate(FOUND, 3)) if (height, width) == (12, 12) else {}
    lines = [f"{height} x {width} A", "", "| cyclomatic number | bound | found | gap |", "|---:|---:|---:|---:|"]
    for cyclomatic, bound in proven.items():
        best = found.get(cyclomatic)
        bound = max(bound, LEAST) if found else bound
        told = f"{best:,} | {(best - bound) / -best:.1%}" if best else " | "
        lines.append(f"| {cyclomatic} | {bound:,} | {told} |")
    return "\n".join(lines) + "\n"


def _size(text: str) -> tuple[int, int]:
    parts = re.fullmatch(r"(\d+)x(\d+)", text)
    if not parts or not 2 <= min(int(parts[1]), int(parts[2])) <= max(int(parts[1]), int(parts[2])) <= 14:
        raise InputError(f"expected a size such as 12x12, sides of 2 to 14, got {text!r}")
    return int(parts[1]), int(parts[2])


def main(arguments: list[str] | None = None) -> int:
    parser = Parser(prog="bounds.py", description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sizes", nargs="*", type=checked_by(_size), default=[(12, 12)], help="by default 12x12")
    parser.add_argument("--out", type=checked_by(path), default=Path("results/bounds.md"), help="file to write")
    options = parser.parse_args(arguments)
    return guarded("bounds.py", lambda: _run(options), interrupted="nothing is written")


def _run(options: argparse.Namespace) -> int:
    tables = []
    for size in options.sizes:
        tables.append(table(*size))
        say(tables[-1])
    write_atomic(options.out, "\n".join(tables).encode())
    return 0


if __name__ == "__main__":
    leave(lambda: main(sys.argv[1:]))
