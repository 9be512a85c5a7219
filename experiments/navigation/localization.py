"""Task "where": how far one must drive to find out where on a known map one is, and what else a map is like."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int, Int8
from numpy.typing import NDArray

from elitelanes_jax import measure
from elitelanes_jax.drive import NEVER, ambiguity, lane_nodes, localization_steps
from elitelanes_jax.network import measure_town
from elitelanes_jax.problem import SHARE_UNIT

__all__ = ["find_places"]

_MOST, _DRIVERS = 32, 32


def find_places(tests: dict[str, NDArray[np.int8]]) -> dict[str, dict[str, list[float]]]:
    """Measures the maps of all tests.

    Returns:
      Of each test lists with a number for each map: "never", the share of places that a driver with random turns cannot
      tell, in 32 tiles, the mean of 32 such drivers; "tiles", the mean tiles until the others are known; and the
      features "ambiguity", "cyclomatic", "straight_share", "mean_detour" and "repetition" (see `TownFeatures`).
    """
    asked = jax.random.randint(jax.random.key(0), (_DRIVERS, _MOST), 0, 3)
    return {
        name: {key: np.asarray(values, float).round(5).tolist() for key, values in _measure(grids, asked).items()}
        for name, grids in tests.items()
    }


@jax.jit
@partial(jax.vmap, in_axes=(0, None))
def _measure(grid: Int8[Array, "H W"], asked: Int[Array, "N K"]) -> dict[str, Array]:
    steps = jax.vmap(partial(localization_steps, grid))(asked)
    known = steps < NEVER
    is_node = jnp.broadcast_to(lane_nodes(grid), steps.shape)
    counts, town = measure(grid), measure_town(grid)
    return {
        "never": 1 - known.sum() / is_node.sum(),
        "tiles": jnp.where(known, steps, 0).sum() / jnp.maximum(known.sum(), 1),
        "ambiguity": ambiguity(grid) / 100,
        "cyclomatic": counts.cyclomatic,
        "straight_share": counts.straights / jnp.maximum(counts.tiles, 1),
        "mean_detour": town.mean_detour / SHARE_UNIT,
        "repetition": town.repetition / SHARE_UNIT,
    }
