"""The links of a grid: pairs of neighbouring tiles that both connect to each other."""

from itertools import product

import numpy as np
from jaxtyping import Int

from elitelanes_jax._util.types import ArrayT, Untyped
from elitelanes_jax.network.codes import EAST, NORTH, SIDES, SOUTH, WEST

Cell = tuple[int, int]
"""A cell of a grid: row and column, from the north-west corner."""


def links_between(codes: ArrayT) -> tuple[ArrayT, ArrayT]:
    """Returns which tiles are linked to the next one, to the east and to the south.

    `codes` is ``[..., H, W]`` of NumPy or JAX. Returns bool ``[..., H, W - 1]`` and
    ``[..., H - 1, W]``.
    """
    east = (codes[..., :-1] & EAST > 0) & (codes[..., 1:] & WEST > 0)
    south = (codes[..., :-1, :] & SOUTH > 0) & (codes[..., 1:, :] & NORTH > 0)
    return east, south


def linked_neighbours(codes: Int[Untyped, "H W"]) -> dict[Cell, list[Cell]]:
    """Returns the linked neighbours of each non-empty tile, clockwise from north.

    Tiles are in the order of rows. A tile without links has no neighbours.
    """
    height, width = codes.shape
    # Beyond the border of the grid are empty cells. Single numbers are read faster from lists than
    # from arrays.
    padded = np.pad(codes, 1).tolist()
    neighbours: dict[Cell, list[Cell]] = {}
    for row, column in product(range(height), range(width)):
        code = padded[row + 1][column + 1]
        if code:
            neighbours[row, column] = [
                (row + side.down, column + side.right)
                for side in SIDES
                if code & side.bit
                and padded[row + 1 + side.down][column + 1 + side.right] & side.opposite
            ]
    return neighbours


def cut_dead_ends(neighbours: dict[Cell, list[Cell]]) -> None:
    """Removes tiles with fewer than two linked neighbours, until each tile has two or more."""
    dead_ends = [cell for cell, linked in neighbours.items() if len(linked) < 2]
    while dead_ends:
        cell = dead_ends.pop()
        for other in neighbours.pop(cell, []):
            neighbours[other].remove(cell)
            # The neighbour may now be a dead end itself.
            if len(neighbours[other]) < 2:
                dead_ends.append(other)
