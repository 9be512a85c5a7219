"""Whether roads can pass through fixed cells, and connect them."""

from collections.abc import Mapping

import numpy as np

from elitelanes_jax._util.cells import describe_cell
from elitelanes_jax._util.errors import InputError
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.links import Cell, cut_dead_ends, linked_neighbours
from elitelanes_jax.problem.fixed_cells import FixedCells


def check_connectable(fix: FixedCells, filled: bool) -> None:
    """Checks that roads can pass through the cells that need one, and connect them.

    `filled` says whether each free cell needs one; a free cell without any neighbour to link stays
    empty.
    """
    # The largest possible network has a road in every free cell to all its neighbours. Cells that
    # it cannot connect are connected on no map.
    is_fixed = fix.fixed
    ways = linked_neighbours(np.where(is_fixed, fix.grid, NORTH | EAST | SOUTH | WEST))
    # A free cell without neighbours to link stays empty.
    for cell, neighbours in list(ways.items()):
        if not neighbours and not is_fixed[cell]:
            del ways[cell]
    needed = [cell for cell in ways if filled or is_fixed[cell]]
    for cell, neighbours in ways.items():
        if filled and len(neighbours) < 2:
            expected = "two neighbours for a road in every free cell"
            hint = "with rules, an inventory or a style such as town it may stay empty"
            raise InputError("fix", expected, f"one at {describe_cell(*cell)}", hint)
    # What remains after all dead ends are cut are loops and the ways between them. A cell that
    # needs a road has to be among these.
    cut_dead_ends(ways)
    reachable: set[Cell] = set()
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


def _reachable(ways: Mapping[Cell, list[Cell]], start: Cell) -> set[Cell]:
    """Returns the cells that a road from a cell can reach.

    There are none if the cell itself can have no road.
    """
    reached: set[Cell] = set()
    ahead = [start]
    while ahead:
        cell = ahead.pop()
        if cell in ways and cell not in reached:
            reached.add(cell)
            ahead += ways[cell]
    return reached
