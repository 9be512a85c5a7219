"""The speed of the environments and of the camera on one core.

python -m experiments.navigation.speed [--quick]

A thousand environments step at once and start anew, on one of 10,000 maps of 12 x 12 tiles, where an episode ends.
32 robots of RoadTraffic share each of 64 maps, and a step is that of all of them.
Seconds are those of the one core that this process is pinned to; those of compiling, by the clock.
"""

import argparse
import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeAlias

if __name__ == "__main__":  # before JAX starts its threads
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int8, Key

from elitelanes_jax import random_grids, repair
from elitelanes_jax.drive import (
    Camera,
    Environment,
    LaneDrive,
    LaneDriveParams,
    Pose,
    RoadNav,
    RoadNavParams,
    RoadTraffic,
    RoadTrafficParams,
    Sight,
    Variation,
    auto_reset,
    look,
    make_levels,
    make_scenes,
    make_sight,
    make_traffic_levels,
    random_pose,
    views,
)
from elitelanes_jax.tiles import load_tiles
from experiments.common import Parser, Pytree, leave, run

__all__ = ["main"]

SHAPE = (12, 12)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("driving_speed", __doc__)
    parser.add_argument("--quick", action="store_true", help="few environments, maps and steps, to see that it runs")
    options = parser.parse_args(arguments)
    return run("driving_speed", lambda: _measure(options))


def _measure(options: argparse.Namespace) -> None:
    count, batch, steps = (32, 16, 8) if options.quick else (10_000, 1024, 200)
    print("| | steps or frames a second | compiled in |\n|---|---:|---:|")
    for name, begin, step in measured(count, batch):
        pictures = name.startswith(("camera", "views"))
        _row(name, batch, max(steps // 50, 2) if pictures else steps, begin, step)


Begin: TypeAlias = Callable[[Key[Array, " B"]], Pytree]
"""From keys to a batch of states."""

Step: TypeAlias = Callable[[Key[Array, " B"], Pytree], tuple[Pytree, Pytree]]
"""From keys and a batch of states to the next states and to what a learner reads of them."""


def measured(count: int, batch: int) -> Iterator[tuple[str, Begin, Step]]:
    """Yields the name of each environment and of the camera, and what begins and what steps a batch of it.

    Args:
      count: the number of maps.
      batch: the number of environments or cameras.
    """
    grids = jax.jit(jax.vmap(partial(repair, fill=True)))(random_grids(jax.random.key(0), count, SHAPE))
    levels = make_levels(jax.random.key(1), grids)
    yield "RoadNav, window 5 x 5", *_of_ours(RoadNav, RoadNavParams(levels, window=5), _turn)
    yield "LaneDrive, lane poses", *_of_ours(LaneDrive, LaneDriveParams(levels), _steer)
    traffic = RoadTrafficParams(make_traffic_levels(grids[:64]), robots=32)
    yield "RoadTraffic, 32 robots", *_of_ours(RoadTraffic, traffic, _choose)
    without_end = traffic.replace(ends_in_gridlock=False, limit=2**30)
    yield "RoadTraffic, 32 robots, no new episodes", *_of_traffic(without_end, observes=True)
    yield "RoadTraffic, 32 robots, no observations", *_of_traffic(without_end, observes=False)
    tiles = load_tiles()
    maps = jnp.resize(grids, (batch, *SHAPE))
    for words, noise in (("with labels", None), ("and noise", 3.0)):
        sight = make_sight(tiles, Camera(rows=48, columns=64, noise=noise))
        yield f"camera 64 x 48 {words}, poses given", *_of_the_camera(maps, sight, inside=False)
        yield f"camera 64 x 48 {words}, poses drawn", *_of_the_camera(maps, sight, inside=True)
    scenes = make_scenes(np.asarray(grids[:64]), tiles, tile_px=256)
    yield "views 64 x 48, one sample", *_of_views(scenes, batch, Camera(), Variation(), samples=1)
    large = Camera(rows=120, columns=160)
    yield "views 160 x 120, four samples", *_of_views(scenes, batch, large, Variation(), samples=2)
    yield "views 160 x 120, four samples, varied", *_of_views(scenes, batch, large, Variation.varied(), samples=2)


def steps_of(step: Step, batch: int, steps: int) -> Callable[[Key[Array, ""], Pytree], tuple[Pytree, Array]]:
    """Makes a function from a key and a state to the state after `steps` steps, and to the sum of all that was seen.

    The sum reads everything, because XLA leaves out what nothing reads.
    """

    def drive(key: Key[Array, ""], state: Pytree) -> tuple[Pytree, Array]:
        def go(carry: tuple[Pytree, Array], key: Key[Array, ""]) -> tuple[tuple[Pytree, Array], None]:
            state, total = carry
            state, seen = step(jax.random.split(key, batch), state)
            return (state, total + sum(part.astype(jnp.float32).sum() for part in jax.tree.leaves(seen))), None

        return jax.lax.scan(go, (state, jnp.float32(0)), jax.random.split(key, steps))[0]

    return drive


def _row(name: str, batch: int, steps: int, begin: Begin, step: Step) -> None:
    state = jax.jit(begin)(jax.random.split(jax.random.key(2), batch))
    began = time.perf_counter()
    compiled = jax.jit(steps_of(step, batch, steps)).lower(jax.random.key(0), state).compile()
    compiling, spent = time.perf_counter() - began, []
    for number in range(7):
        began = time.process_time()
        state, _ = jax.block_until_ready(compiled(jax.random.key(number), state))
        spent.append(time.process_time() - began)
    print(f"| {name} | {batch * steps / np.median(spent[1:]):,.0f} | {compiling:.1f} s |")


def _turn(keys: Key[Array, " B"], state: Pytree) -> Array:
    return (jax.random.key_data(keys)[:, 0] % 3).astype(jnp.int32)


def _steer(keys: Key[Array, " B"], state: Pytree) -> Array:
    return jnp.stack([0.4 - 2 * state.d, 0.4 + 2 * state.d], axis=-1)


def _choose(keys: Key[Array, " B"], state: Pytree) -> Array:
    return (jax.random.key_data(keys)[:, :1] + np.arange(32, dtype=np.uint32)).astype(jnp.int32) % 4


def _of_traffic(params: RoadTrafficParams, *, observes: bool) -> tuple[Begin, Step]:
    def step(keys: Key[Array, " B"], state: Pytree) -> tuple[Pytree, Pytree]:
        done = jax.vmap(RoadTraffic.step, in_axes=(0, 0, 0, None))(keys, state, _choose(keys, state), params)
        return done.state, (done.reward, done.terminated, done.observation if observes else None)

    return lambda keys: jax.vmap(RoadTraffic.reset, in_axes=(0, None))(keys, params)[1], step


def _of_ours(environment: Environment, params: Pytree, act: Callable[[Array, Pytree], Array]) -> tuple[Begin, Step]:
    stepping = auto_reset(environment)

    def step(keys: Key[Array, " B"], state: Pytree) -> tuple[Pytree, Pytree]:
        done = jax.vmap(stepping.step, in_axes=(0, 0, 0, None))(keys, state, act(keys, state), params)
        return done.state, (done.observation, done.reward, done.terminated, done.truncated)

    return lambda keys: jax.vmap(environment.reset, in_axes=(0, None))(keys, params)[1], step


def _of_the_camera(grids: Int8[Array, "B H W"], sight: Sight, *, inside: bool) -> tuple[Begin, Step]:
    """Returns a camera whose poses are moved on, or drawn on lanes in the same program."""

    # The maps belong to the state: XLA would take a minute to compute what depends on constants alone.
    def begin(keys: Key[Array, " B"]) -> Pytree:
        return jax.vmap(partial(jax.random.uniform, shape=(3,)))(keys) * jnp.array([*SHAPE, 6.0]), grids

    def step(keys: Key[Array, " B"], state: Pytree) -> tuple[Pytree, Pytree]:
        poses, maps = state
        drawn = jax.vmap(random_pose)(keys, maps) if inside else Pose(*poses.T)
        seen = jax.vmap(lambda pose, grid: look(pose, grid, sight))(drawn, maps)
        return ((poses + 0.013) % 12, maps), seen

    return begin, step


def _of_views(scenes: Pytree, batch: int, camera: Camera, variation: Variation, *, samples: int) -> tuple[Begin, Step]:
    def step(keys: Key[Array, " B"], state: Pytree) -> tuple[Pytree, Pytree]:
        return state, views(keys[0], scenes, batch, camera=camera, variation=variation, samples=samples)

    return lambda keys: jnp.float32(0), step


if __name__ == "__main__":
    leave(main())
