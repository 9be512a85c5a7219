"""The metrics and some town features of one grid in NumPy alone.

Importing JAX takes longer than measuring a grid.
"""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Bool, Int8, Real

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.types import ArrayOrRows, OptionValue
from elitelanes_jax.network.checks import known_grid
from elitelanes_jax.network.codes import (
    CONNECTIONS,
    EAST,
    KINDS,
    NORTH,
    SOUTH,
    WEST,
    check_alphabet,
)
from elitelanes_jax.network.links import links_between

_Cells = Bool[np.ndarray, "_ _"]


@name_wrong_arguments
def plain_measure(
    grid: ArrayOrRows, alphabet: Iterable[int] | None = None
) -> dict[str, OptionValue]:
    """Measures one grid as `measure` does, without JAX; see `measure` for the arguments and errors.

    Returns:
      The fields of `Metrics` by name: ints, `coverage` a float32 of NumPy; equal to those of
      `measure`.
    """
    codes = known_grid(grid)
    allowed = range(16) if alphabet is None else check_alphabet(alphabet)
    connections = CONNECTIONS[codes]
    links = links_between(codes)
    crossing, turn = connections >= 3, np.isin(codes, KINDS["turn"])
    # Each connection of a tile leaves the grid, is returned by the neighbour, or is a mismatch.
    returned, outward = np.zeros(codes.shape, np.int8), np.zeros(codes.shape, np.int8)
    crossing_pairs = crossing_score = 0
    for link, (cell, neighbour) in zip(links, _SIDE_BY_SIDE, strict=True):
        returned[cell] += link
        returned[neighbour] += link
        are_crossings = link & crossing[cell] & crossing[neighbour]
        crossing_pairs += int(are_crossings.sum())
        crossing_score += int((connections[cell] + connections[neighbour])[are_crossings].sum())
    outward[0] += codes[0] & NORTH > 0
    outward[-1] += codes[-1] & SOUTH > 0
    outward[:, 0] += codes[:, 0] & WEST > 0
    outward[:, -1] += codes[:, -1] & EAST > 0
    along, upright = codes == EAST | WEST, codes == NORTH | SOUTH
    # The number of components follows from Euler's formula, see `elitelanes_jax.network._faces`.
    faces, bridges = _count_faces(*links)
    tiles, edges = int((codes > 0).sum()), sum(int(link.sum()) for link in links)
    return {
        "components": tiles - edges + faces,
        "cyclomatic": faces,
        "dead_ends": int(((connections == 1) | (connections != returned)).sum()),
        "boundary_violations": int((outward > 0).sum()),
        "bridges": bridges,
        "crossings": int(crossing.sum()),
        "adjacent_crossings": 2 * crossing_pairs,
        "adjacent_crossing_score": crossing_score,
        "adjacent_turns": _pairs(turn),
        "straight_score": _squared_runs(along) + _squared_runs(upright.T),
        "straights": int((along | upright).sum()),
        "turns": int(turn.sum()),
        # Of all pairs of crossings and turns, only those of two turns have no crossing.
        "crowded_crossings": _pairs(crossing | turn) - _pairs(turn),
        "unlinked_neighbours": _pairs(codes > 0) - edges,
        "tiles": tiles,
        "empty_cells": codes.size - tiles,
        "edges": edges,
        "mismatches": int((connections - returned - outward).sum()),
        "off_alphabet": int((~np.isin(codes, list(allowed))).sum()),
        "coverage": np.float32(tiles / codes.size),
    }


def count_tiles(grids: Int8[np.ndarray, "_ H W"]) -> dict[str, Real[np.ndarray, "..."]]:
    """Counts many grids at once.

    The counts are metrics of `plain_measure` that depend on single tiles and links.
    """
    east, south = links_between(grids)
    tiles = (grids > 0).sum((1, 2))
    return {
        "crossings": (CONNECTIONS[grids] >= 3).sum((1, 2)),
        "straights": np.isin(grids, KINDS["straight"]).sum((1, 2)),
        "turns": np.isin(grids, KINDS["turn"]).sum((1, 2)),
        "tiles": tiles,
        "empty_cells": grids[0].size - tiles,
        "edges": east.sum((1, 2)) + south.sum((1, 2)),
        "coverage": (tiles / grids[0].size).astype(np.float32),
    }


def cut_to_roads(grid: Int8[np.ndarray, "H W"]) -> Int8[np.ndarray, "h w"]:
    """Returns the smallest box that contains all tiles of a NumPy grid.

    A grid without tiles is returned whole.
    """
    return grid[road_box(grid)]


def road_box(grid: Int8[np.ndarray, "H W"]) -> tuple[slice, slice]:
    """Returns the rows and the columns of the smallest box that contains all tiles.

    The box of a grid without tiles is the whole grid.
    """
    rows, columns = np.flatnonzero(grid.any(axis=1)), np.flatnonzero(grid.any(axis=0))
    if rows.size == 0:
        return slice(0, grid.shape[0]), slice(0, grid.shape[1])
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def plain_town(grid: ArrayOrRows) -> dict[str, int]:
    """Measures the town features of one grid ``[H, W]`` that need no blocks and streets.

    The numbers are those of `measure_town`.
    """
    # Of these features only `box_share` depends on the size of the grid around the roads.
    codes = cut_to_roads(known_grid(grid))
    metrics, road = plain_measure(codes), codes > 0
    tiles = max(metrics["tiles"], 1)
    height, width = codes.shape
    alike = max(
        int((road == other).sum()) for other in (road[::-1], road[:, ::-1], road[::-1, ::-1])
    )
    # The box of a grid without tiles is the whole grid, but these features are then 0.
    some = bool(road.any())
    return {
        "loops_per_tile": 1000 * metrics["cyclomatic"] // tiles,
        "border_share": 1000 * (metrics["tiles"] - int(road[1:-1, 1:-1].sum())) // tiles,
        "box_fill": 1000 * metrics["tiles"] // codes.size,
        "box_share": some * 1000 * codes.size // np.size(grid),
        "box_length": some * 1000 * max(height, width) // min(height, width),
        "symmetry": some * 1000 * alike // codes.size,
        "adjacent_turns_per_tile": 1000 * metrics["adjacent_turns"] // tiles,
    }


# The slices of cells and of their neighbours to the east, then to the south.
_SIDE_BY_SIDE: list[tuple[tuple[slice, slice], tuple[slice, slice]]] = [
    (np.s_[:, :-1], np.s_[:, 1:]),
    (np.s_[:-1, :], np.s_[1:, :]),
]


def _pairs(cells: _Cells) -> int:
    """Counts the pairs of True cells that share a side."""
    return sum(int((cells[cell] & cells[neighbour]).sum()) for cell, neighbour in _SIDE_BY_SIDE)


def _squared_runs(straight: _Cells) -> int:
    # A run begins where the steps are 1, and ends where they are -1. The padding keeps apart the
    # runs of different rows.
    steps = np.diff(np.pad(straight, ((0, 0), (1, 1))).ravel().astype(np.int8))
    return int(((np.flatnonzero(steps < 0) - np.flatnonzero(steps > 0)) ** 2).sum())


def _count_faces(east_links: _Cells, south_links: _Cells) -> tuple[int, int]:
    """Counts the inner faces and the bridges, see `elitelanes_jax.network._faces`."""
    corners = np.arange((east_links.shape[0] + 1) * (south_links.shape[1] + 1)).reshape(
        -1, south_links.shape[1] + 1
    )
    # Neighbouring corners are joined, unless a link is between them. A link to the east separates
    # the corners north and south of it, and a link to the south the corners west and east.
    down, right = np.ones(corners[1:].shape, bool), np.ones(corners[:, 1:].shape, bool)
    down[:, 1:-1], right[1:-1] = ~east_links, ~south_links
    first = np.concatenate([corners[:-1][down], corners[:, :-1][right]])
    second = np.concatenate([corners[1:][down], corners[:, 1:][right]])
    face = corners.ravel()
    # A corner begins with its own index as its label. Each round passes the lesser label of a pair
    # to the corners that both labels name. Then each corner takes the label of the corner it names.
    while (face[first] != face[second]).any():
        least = np.minimum(face[first], face[second])
        for named in (face[first], face[second]):
            np.minimum.at(face, named, least)
        face = face[face]
    faces = face.reshape(corners.shape)
    bridges_east = east_links & (faces[:-1] == faces[1:])[:, 1:-1]
    bridges_south = south_links & (faces[:, :-1] == faces[:, 1:])[1:-1]
    return np.unique(face).size - 1, int(bridges_east.sum() + bridges_south.sum())
