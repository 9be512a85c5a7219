"""A small dataset of given maps, which needs no search, for several tests and for processes that they start."""

import numpy as np

from elitelanes_jax import DatasetSpec, RoadMap
from elitelanes_jax.network.wfc import generate_batch

__all__ = ["random_maps", "small"]


def random_maps(count=12, side=5, seed=0):
    """Returns maps in three niches."""
    grids = generate_batch(np.random.default_rng(seed), count, (side, side), border="closed").grid
    return [RoadMap(np.asarray(grid, np.int8), niche=[number % 3]) for number, grid in enumerate(grids)]


def small(**others):
    """Returns the specification of a dataset of 12 given maps, with other values in some fields."""
    return DatasetSpec(**{"maps_from": random_maps(), "tile_px": 16, "split": (0.5, 0.25, 0.25)} | others)
