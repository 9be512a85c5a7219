"""The features of a town that need no blocks and streets, in NumPy alone, for options that are read without JAX."""

import numpy as np

from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.plain_metrics import plain_measure


def cut_to_roads(grid: AnyArray) -> AnyArray:
    """Returns the smallest box that contains all tiles of a NumPy grid; a grid without tiles is returned whole."""
    rows, columns = np.flatnonzero(grid.any(axis=1)), np.flatnonzero(grid.any(axis=0))
    return grid[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] if rows.size else grid


def plain_town(grid: AnyArray) -> dict[str, int]:
    """Measures these features of one grid ``[H, W]``, as `measure_town` does."""
    codes = cut_to_roads(np.asarray(check_grid(grid)))
    metrics, road = plain_measure(codes), codes > 0
    tiles = max(metrics["tiles"], 1)
    height, width = codes.shape
    alike = max(int((road == other).sum()) for other in (road[::-1], road[:, ::-1], road[::-1, ::-1]))
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
