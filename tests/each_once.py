"""Runs every kernel and every method once, and prints the digests of what they return, as JSON.

As a program it compiles as users do: with XLA's own level of optimisation, which long searches have.
"""

import json
from functools import partial
from hashlib import sha256

import jax
import jax.numpy as jnp
import numpy as np

from elitelanes_jax import Weights, evolve, fitness, measure, mirror, random_grids, repair, rotate
from elitelanes_jax.drive import LaneDrive, LaneDriveParams, RoadNav, RoadNavParams, make_levels
from elitelanes_jax.network import measure_town
from elitelanes_jax.optimizers import PRESETS
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
    levels = make_levels(jax.random.key(1), np.array([[[6, 7, 3], [10, 10, 10], [12, 13, 9]]], np.int8), 8)
    keys, found = jax.random.split(jax.random.key(2), 8), {}
    for name, environment, params, actions in (
        ("RoadNav", RoadNav, RoadNavParams(levels), jnp.arange(8) % 3),
        ("LaneDrive", LaneDrive, LaneDriveParams(levels), jnp.linspace(-1, 1, 16).reshape(8, 2)),
    ):
        observed, states = jax.jit(jax.vmap(partial(environment.reset, params=params)))(keys)
        step = jax.vmap(partial(environment.step, params=params))
        found[name] = observed, jax.jit(step)(keys, states, actions)
    return found


def run_methods():
    _compiling._MOST_CELLS = (-1, -1)  # else so short a search is not optimised
    found = {}
    for method, preset in (one for one in PRESETS if one[1] in ("tuned", "paper")):
        result = evolve(3, SHAPE, seeds=2, method=method, preset=preset, generations=12, progress=False)
        found[f"{method}, {preset}"] = result.elites, result.state.inner
    return found


def main():
    return {name: digest(value) for name, value in (run_kernels() | run_environments() | run_methods()).items()}


if __name__ == "__main__":
    print(json.dumps(main()))
