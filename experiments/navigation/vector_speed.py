"""The speed of Gymnasium's vector environments beside the same steps in one compiled loop, on all cores.

python -m experiments.navigation.vector_speed [--quick]

It needs Gymnasium: `make rl` has it. Actions are random, and are NumPy's. Episodes start anew on one of 1,000 maps of
12 x 12 tiles. Both candidates take turns, and the table has the medians of their rounds.
"""

import argparse
import time
from collections.abc import Callable, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from elitelanes_jax import random_grids, repair
from elitelanes_jax.drive import (
    Environment,
    LaneDrive,
    LaneDriveParams,
    RoadNav,
    RoadNavParams,
    auto_reset,
    make_levels,
)
from elitelanes_jax.drive.interop import gymnasium_vector_env
from experiments.common import Parser, Pytree, leave, require, run
from experiments.navigation.speed import SHAPE

__all__ = ["main"]

Round = Callable[[], object]


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("vector_speed", __doc__)
    parser.add_argument("--quick", action="store_true", help="few environments and steps, to see that it runs")
    options = parser.parse_args(arguments)
    return run("vector_speed", lambda: _measure(options))


def _measure(options: argparse.Namespace) -> None:
    require("the vector environments need", "gymnasium")
    maps, sizes, rounds = (16, (8,), 3) if options.quick else (1000, (256, 4096), 15)
    grids = jax.jit(jax.vmap(partial(repair, fill=True)))(random_grids(jax.random.key(0), maps, SHAPE))
    levels = make_levels(jax.random.key(1), grids)
    print("| | environments | steps a second | in one compiled loop | microseconds of a step beside the loop |")
    print("|---|---:|---:|---:|---:|")
    for environment, params in ((RoadNav, RoadNavParams(levels)), (LaneDrive, LaneDriveParams(levels))):
        name = type(params).__name__.removesuffix("Params")
        for envs in sizes:
            steps = max(10, 51200 // envs)
            seconds = _alternate(
                [_vector(environment, params, envs, steps), _loop(environment, params, envs, steps)], rounds
            )
            vector, loop = np.median(seconds, axis=0) / steps
            print(f"| {name} | {envs:,} | {envs / vector:,.0f} | {envs / loop:,.0f} | {1e6 * (vector - loop):.0f} |")


def _alternate(candidates: Sequence[Round], rounds: int) -> list[list[float]]:
    """Returns the seconds of each candidate in each round, after a first one."""
    rows: list[list[float]] = []
    for _ in range(rounds + 1):
        seconds = []
        for candidate in candidates:
            began = time.perf_counter()
            candidate()
            seconds.append(time.perf_counter() - began)
        rows.append(seconds)
    return rows[1:]


def _actions(environment: Environment, envs: int) -> Pytree:
    rng = np.random.default_rng(0)
    if environment.actions is not None:
        return rng.integers(environment.actions, size=envs)
    return rng.uniform(-1, 1, (envs, environment.action_size)).astype(np.float32)


def _vector(environment: Environment, params: Pytree, envs: int, steps: int) -> Round:
    import gymnasium

    made = gymnasium_vector_env(environment, params, gymnasium, envs=envs)
    made.reset(seed=0)
    actions = _actions(environment, envs)

    def drive() -> None:
        for _ in range(steps):
            made.step(actions)

    return drive


def _loop(environment: Environment, params: Pytree, envs: int, steps: int) -> Round:
    """Makes a compiled loop that sums what a learner reads, because XLA leaves out what nothing reads."""
    resetting = jax.vmap(auto_reset(environment).step, (0, 0, 0, None))
    _, state = jax.vmap(environment.reset, (0, None))(jax.random.split(jax.random.key(0), envs), params)
    actions = jnp.asarray(_actions(environment, envs))

    def go(carry: tuple[Pytree, Array], key: Array) -> tuple[tuple[Pytree, Array], None]:
        state, total = carry
        done = resetting(jax.random.split(key, envs), state, actions, params)
        seen = done.observation, done.reward, done.terminated, done.truncated, done.info
        return (done.state, total + sum(part.astype(jnp.float32).sum() for part in jax.tree.leaves(seen))), None

    @jax.jit
    def drive(key: Array, state: Pytree) -> tuple[Pytree, Array]:
        return jax.lax.scan(go, (state, jnp.float32(0)), jax.random.split(key, steps))[0]

    return lambda: jax.block_until_ready(drive(jax.random.key(1), state))


if __name__ == "__main__":
    leave(main())
