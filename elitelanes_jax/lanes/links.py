"""The links between tiles, and the roads that they form."""

from typing import TypeAlias

import numpy as np
from jaxtyping import Int

from elitelanes_jax._util.types import Untyped
from elitelanes_jax.network.checks import check_grid, known_grid
from elitelanes_jax.network.codes import CONNECTIONS, SIDE_TOWARDS, SIDES, Side
from elitelanes_jax.network.links import Cell, linked_neighbours

Codes: TypeAlias = Int[Untyped, "H W"]
"""A grid of codes, an array of NumPy or JAX."""


def linked_codes(codes: Codes) -> Codes:
    """Removes the connections of a grid that the neighbour does not return, or that leave the grid.

    Returns an array of JAX if `codes` is one, otherwise of NumPy. Raises `InputError` for a bad
    grid.
    """
    grid = check_grid(codes)
    # The same code serves arrays of NumPy and of JAX.
    xp = grid.__array_namespace__()
    height, width = grid.shape
    # Beyond the border of the grid are empty cells, which return no connection.
    padded = xp.pad(grid, 1)
    links = xp.zeros_like(grid)
    for side in SIDES:
        first_row, first_column = 1 + side.down, 1 + side.right
        # The padded grid, shifted by one cell, has each cell's neighbour at the cell's own index.
        neighbour = padded[first_row : first_row + height, first_column : first_column + width]
        # A link is a connection of both tiles, and only its own bit is kept.
        links |= xp.where(neighbour & side.opposite > 0, grid & side.bit, 0).astype(grid.dtype)
    return links


def ends_of_roads(codes: Codes) -> list[Cell]:
    """Returns the tiles where roads end, row by row.

    These tiles have one connection, or a connection that no neighbour returns.
    """
    grid = known_grid(codes)
    # A connection that `linked_codes` removes also ends a road.
    is_end = (CONNECTIONS[grid] == 1) | (linked_codes(grid) != grid)
    return [(row, column) for row, column in np.argwhere(is_end).tolist()]


def side_towards(cell: Cell, neighbour: Cell) -> Side:
    """Returns the side of a cell that faces a neighbour."""
    return SIDE_TOWARDS[neighbour[0] - cell[0], neighbour[1] - cell[1]]


def linked_tiles(codes: Codes) -> dict[Cell, list[Cell]]:
    """Returns the linked neighbours of each non-empty tile, see `linked_neighbours`.

    Raises:
      InputError: for a bad grid.
    """
    return linked_neighbours(check_grid(codes))


def walk_roads(links: dict[Cell, list[Cell]], nodes: set[Cell]) -> list[list[Cell]]:
    """Lists the tiles of each road from node to node, with both; each road once.

    `links` are those of `linked_tiles`. `nodes` are the tiles where roads end; all other tiles have
    two links. Roads are in the order of their first ends, those of an end clockwise from north.
    Rings without a node come last; each starts and ends at its first tile.
    """
    roads: list[list[Cell]] = []
    # Reversed, they are first steps from the other end.
    last_steps: set[tuple[Cell, Cell]] = set()
    passed = set(nodes)

    def walk_from(node: Cell, ends: set[Cell]) -> None:
        # Each link of a node starts a road, clockwise from north.
        for neighbour in links[node]:
            # A road whose other end came earlier is in the list already.
            if (node, neighbour) in last_steps:
                continue
            road = [node, neighbour]
            # A tile between the ends has two links. The road comes by one and goes on by the other.
            while road[-1] not in ends:
                road.append(next(tile for tile in links[road[-1]] if tile != road[-2]))
            # The last step, reversed, is how the road would begin at its other end.
            last_steps.add((road[-1], road[-2]))
            # Tiles that no road passes are left for the rings.
            passed.update(road)
            roads.append(road)

    for node in sorted(nodes):
        walk_from(node, nodes)
    for tile in links:
        # A tile that no road from a node has passed is on a ring.
        if tile not in passed:
            walk_from(tile, {tile})
    return roads
