"""Whether roads can pass through fixed cells, and connect them."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Int

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import EAST, NORTH, SIDES, SOUTH, WEST
from elitelanes_jax.problem.fixed_cells import FixedCells

# The row and the column of a cell.
_Cell = tuple[int, int]


def check_connectable(fix: FixedCells, filled: bool) -> None:
    """Checks that roads can pass through the cells that need one, and connect them.

    `filled` says whether each free cell needs one; a free cell without any neighbour to link stays
    empty.
    """
    # The largest possible network has a road in every free cell to all its neighbours. Cells that
    # it cannot connect are connected on no map.
    is_fixed = fix.fixed
    ways = _ways(np.where(is_fixed, fix.grid, NORTH | EAST | SOUTH | WEST))
    # A free cell without neighbours to link stays empty.
    for cell, neighbours in list(ways.items()):
        if not neighbours and not is_fixed[cell]:
            del ways[cell]
    needed = [cell for cell in ways if filled or is_fixed[cell]]
    dead_ends = [cell for cell, neighbours in ways.items() if len(neighbours) < 2]
    if filled and dead_ends:
        expected = "two neighbours for a road in every free cell"
        hint = "with rules, an inventory or a style such as town it may stay empty"
        raise InputError("fix", expected, f"one at {describe_cell(*dead_ends[0])}", hint)
    # What remains after all dead ends are cut are loops and the ways between them. A cell that
    # needs a road has to be among these.
    _cut_dead_ends(ways, dead_ends)
    reachable: set[_Cell] = set()
    starts = needed or list(ways)
    if starts:
        reachable = _reachable(ways, starts[0])
    if not reachable:
        raise InputError("fix", "cells that leave room for a loop of roads", "none")
    for cell in needed:
        if cell not in reachable:
            expected = "cells whose roads can be connected"
            got = f"no way from {describe_cell(*needed[0])} to {describe_cell(*cell)}"
            raise InputError("fix", expected, got)


def _cut_dead_ends(ways: dict[_Cell, set[_Cell]], dead_ends: list[_Cell]) -> None:
    """Deletes the cells of dead ends from `ways`, and then the cells that this makes dead ends."""
    while dead_ends:
        cell = dead_ends.pop()
        for neighbour in ways.pop(cell):
            ways[neighbour].discard(cell)
            if len(ways[neighbour]) == 1:
                dead_ends.append(neighbour)


def _reachable(ways: Mapping[_Cell, set[_Cell]], start: _Cell) -> set[_Cell]:
    """Returns the cells that a road from a cell can reach.

    There are none if the cell itself can have no road.
    """
    reached: set[_Cell] = set()
    ahead = [start]
    while ahead:
        cell = ahead.pop()
        if cell in ways and cell not in reached:
            reached.add(cell)
            ahead += ways[cell]
    return reached


def _ways(codes: Int[np.ndarray, "H W"]) -> dict[_Cell, set[_Cell]]:
    """Returns the neighbours to which each cell can have a road, if free cells have all sides."""
    height, width = codes.shape
    ways: dict[_Cell, set[_Cell]] = {}
    for row, column in np.argwhere(codes).tolist():
        ways[row, column] = set()
        for side in SIDES:
            down, right = row + side.down, column + side.right
            is_inside = 0 <= down < height and 0 <= right < width
            if is_inside and codes[row, column] & side.bit and codes[down, right] & side.opposite:
                ways[row, column].add((down, right))
    return ways
