"""Runs every kernel once, and the methods that its arguments name, and prints the digests of the results as JSON.

The environment variable XLA_FLAGS says how it compiles. Without it, XLA optimises as it does for users' long searches.
"""

import json
import sys
from functools import partial
from hashlib import sha256

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax import Weights, evolve, fitness, measure, mirror, random_grids, repair, rotate
from elitelanes_jax.drive import (
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    RoadTraffic,
    RoadTrafficParams,
    make_levels,
    make_traffic_levels,
)
from elitelanes_jax.network import measure_town
from elitelanes_jax.search import _compiling

SHAPE = (5, 6)


def digest(tree):
    """Returns a digest of arrays; floats count with four digits, as optimisation may round them otherwise."""
    content = sha256()
    for leaf in jax.tree.leaves(tree):
        array = np.asarray(leaf)
        if np.issubdtype(array.dtype, np.floating):
            array = np.char.mod("%.3e", array.astype(np.float64) + 1e-9)
        content.update(f"{array.dtype} {array.shape}".encode() + array.tobytes())
    return content.hexdigest()[:16]


def run_kernels():
    drawn = random_grids(jax.random.key(0), 64, SHAPE)
    mended = jax.jit(jax.vmap(repair))(drawn)
    kernels = {
        "measure": measure,
        "fitness": lambda grid: fitness(measure(grid), Weights(bridges=7)),
        "measure_town": measure_town,
        "fill": lambda grid: repair(grid, fill=True),
        "rotate": rotate,
        "mirror": mirror,
    }
    found = {name: jax.jit(jax.vmap(kernel))(mended) for name, kernel in kernels.items()}
    return {"random_grids": drawn, "repair": mended, **found}


def run_environments():
    maps = np.array([[[6, 7, 3], [10, 10, 10], [12, 13, 9]]], np.int8)
    levels, towns = make_levels(jax.random.key(1), maps, 8), make_traffic_levels(maps)
    keys, found = jax.random.split(jax.random.key(2), 8), {}
    for name, environment, params, actions in (
        ("RoadNav", RoadNav, RoadNavParams(levels), jnp.arange(8) % 3),
        ("LaneDrive", LaneDrive, LaneDriveParams(levels), jnp.linspace(-1, 1, 16).reshape(8, 2)),
        ("RoadTraffic", RoadTraffic, RoadTrafficParams(towns, robots=4), jnp.arange(32).reshape(8, 4) % 4),
    ):
        observed, states = jax.jit(jax.vmap(partial(environment.reset, params=params)))(keys)
        step = jax.vmap(partial(environment.step, params=params))
        found[name] = observed, jax.jit(step)(keys, states, actions)
    return found


def run_methods(names):
    _compiling._MOST_CELLS = (-1, -1)  # else so short a search is not optimised
    results = {}
    for name in names:
        method, preset = name.split(":")
        result = evolve(3, SHAPE, seeds=2, method=method, preset=preset, generations=12, progress=False)
        results[name] = result.elites, result.state.inner
    return results


if __name__ == "__main__":
    results = run_kernels() | run_environments() | run_methods(sys.argv[1:])
    print(json.dumps({name: digest(value) for name, value in results.items()}))
