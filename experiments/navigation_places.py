"""Task "where": how far one must drive to find out where on a known map one is, and what else a map is like."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax import measure
from elitelanes_jax.drive.distances import UNREACHABLE, distances, places
from elitelanes_jax.drive.lanes import Place
from elitelanes_jax.drive.localization import NEVER, ambiguity, localization_steps

__all__ = ["find_places"]

_MOST, _DRIVERS = 32, 32


def find_places(tests: dict[str, NDArray[np.int8]]) -> dict[str, Any]:
    """Measures the maps of all tests.

    Returns:
      Of each test lists with a number for each map: "never", the share of places that a driver with random turns cannot
      tell, in 32 tiles, the mean of 32 such drivers; "tiles", the mean tiles until the others are known; and the
      features "ambiguity", "cyclomatic", "straight_share", "detour" (mean tiles of the shortest way by tiles as the
      crow flies along the grid, over all pairs of places on different tiles).
    """
    asked = jax.random.randint(jax.random.key(0), (_DRIVERS, _MOST), 0, 3)
    return {
        name: {key: np.asarray(values, float).round(5).tolist() for key, values in _measure(grids, asked).items()}
        for name, grids in tests.items()
    }


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def _measure(grid: Any, asked: Any) -> dict[str, Any]:
    steps = jax.vmap(partial(localization_steps, grid))(asked)
    known = steps < NEVER
    is_place = jnp.broadcast_to(places(grid), steps.shape)
    counts = measure(grid)
    return {
        "never": 1 - known.sum() / is_place.sum(),
        "tiles": jnp.where(known, steps, 0).sum() / jnp.maximum(known.sum(), 1),
        "ambiguity": ambiguity(grid) / 100,
        "cyclomatic": counts.cyclomatic,
        "straight_share": counts.straights / jnp.maximum(counts.tiles, 1),
        "detour": _detour(grid),
    }


def _detour(grid: Any) -> Any:
    height, width = grid.shape
    rows, columns, headings = (jnp.asarray(part.ravel()) for part in np.indices((height, width, 4)))
    away = jax.vmap(lambda row, column, heading: distances(grid, Place(row, column, heading)))(rows, columns, headings)
    straight = (jnp.abs(rows[:, None] - rows) + jnp.abs(columns[:, None] - columns)).reshape(-1, height, width, 4)
    counts = (away < UNREACHABLE) & (straight > 0)
    return jnp.where(counts, away / jnp.maximum(straight, 1), 0).sum() / jnp.maximum(counts.sum(), 1)
