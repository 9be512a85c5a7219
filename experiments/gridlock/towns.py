"""The towns of the study: 25 of each of eight sizes, from 5 x 8 to 12 x 12 tiles."""

import jax
import numpy as np

from elitelanes_jax import evolve
from elitelanes_jax.network import gridlock_number, measure

__all__ = ["SIZES", "make_towns"]

SIZES = ((5, 8), *((side, side) for side in range(6, 13)))
"""Rows and columns of the towns."""

TOWNS_OF_A_SIZE = 25
_KEY, _SEEDS, _EVALUATIONS = 7800, 4, 20_000


def make_towns() -> dict[str, list[list[int]]]:
    """Makes the towns; returns the codes of each, by its name.

    They are towns of the style `town` with two crossings or more. Those of a size are sorted by their crossings, then
    by their girth, and chosen at equal distances.
    """
    towns = {}
    for number, size in enumerate(SIZES):
        keys = jax.random.split(jax.random.key(_KEY + number), _SEEDS)
        result = evolve(keys, size, style="town", where="crossings=0..", evaluations=_EVALUATIONS)
        grids = np.stack([np.asarray(road_map.codes, np.int8) for road_map in result.choose(10_000).maps])
        crossings = np.asarray(jax.vmap(measure)(grids).crossings)
        girth = np.asarray(jax.vmap(gridlock_number)(grids)) + 1
        several = [index for index in range(len(grids)) if crossings[index] >= 2]
        several.sort(key=lambda index: (crossings[index], girth[index], grids[index].tobytes()))
        for place in np.linspace(0, len(several) - 1, TOWNS_OF_A_SIZE).round().astype(int):
            towns[f"{size[0]}x{size[1]}-{place}"] = grids[several[place]].tolist()
    return towns
