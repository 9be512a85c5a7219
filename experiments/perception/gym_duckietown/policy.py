"""Trains a policy by PPO in `LaneDrive`: it sees our camera alone, and chooses speed and turn.

    python -m experiments.perception.gym_duckietown.policy --out FILE [--updates N]
    python -m experiments.perception.gym_duckietown.rides FILE --policy --out rides.json

The robot has the limits and the delay of gym-duckietown's. Background, light and colours of each picture are random,
and the white lines' positions differ from tile to tile. Training sees no picture of gym-duckietown.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Key, UInt8

from elitelanes_jax import load_tiles
from elitelanes_jax.drive import (
    Camera,
    Environment,
    LaneDrive,
    LaneDriveParams,
    Sight,
    Transition,
    make_levels,
    make_sight,
)
from elitelanes_jax.search import use_compile_cache
from experiments.common import Parser, Pytree, leave, run, whole
from experiments.navigation.ppo import Outputs, Ppo, train
from experiments.perception.gym_duckietown.nets import NETS, POLICY_ROWS, write_weights
from experiments.perception.gym_duckietown.world import our_towns
from experiments.perception.training_sets import shift_lines

__all__ = ["SeenNetwork", "main", "to_motion", "varied", "vary"]

_CAMERA = Camera(rows=POLICY_ROWS, columns=POLICY_ROWS * 4 // 3)
_TOP_SPEED, _TOP_TURN = 0.6, 4.0  # metres and radians a second
_ROBOT = {"dt": 1 / 15, "top_speed": _TOP_SPEED, "top_turn": _TOP_TURN, "wheel_distance": 0.16}
_ROBOT |= {"latency": 2.25, "noise": 0.05}
_SHIFTS = (-0.07, -0.035, 0.0, 0.035, 0.07)  # of the white lines, in tiles
_SLOWEST, _FASTEST = 0.15, 0.3  # metres a second
_TOWNS, _SIDE, _LEVELS = 32, 7, 1024


def to_motion(action: Float[Array, "2"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Returns metres a second, 0.15 to 0.3, and radians a second to the left, of an action within -1 to 1."""
    speed, turn = jnp.clip(action, -1, 1)
    return (_SLOWEST + _FASTEST) / 2 + (_FASTEST - _SLOWEST) / 2 * speed, _TOP_TURN * turn


class SeenNetwork(NamedTuple):
    """The policy as PPO takes it: see `ppo.Network`."""

    memory: int = 0

    def init(self, key: Key[Array, ""], memory: Array, seen: Pytree, first: Array) -> Pytree:
        """Returns random weights."""
        return NETS["policy"].init(key, seen.image[0])

    def apply(self, weights: Pytree, memory: Array, seen: Pytree, first: Array) -> Outputs:
        """Returns the memory, means and deviations of the two numbers of an action, and values."""
        found: Pytree = NETS["policy"].apply(weights, seen.image.reshape(-1, *seen.image.shape[2:]))
        found = found.reshape(*first.shape, 5)
        return memory, found[..., :4], found[..., 4]


def vary(key: Key[Array, ""], image: UInt8[Array, "H W 3"]) -> UInt8[Array, "H W 3"]:
    """Shows random patterns in place of the camera's plain ground and sky, in random light with random noise."""
    drawing, noisy = jax.random.split(key)
    draws = jax.random.uniform(drawing, (2 * 2 * 3 + 2 * 48 + 16 + 6,))
    colours, grains, field, tone = jnp.split(draws, [12, 108, 124])
    low, high = 255 * colours.reshape(2, 2, 3)
    patterns = jax.image.resize(grains.reshape(2, 6, 8), (2, *image.shape[:2]), "linear")[..., None]
    shown = image.astype(jnp.float32)
    for index, plain in enumerate((_CAMERA.ground, _CAMERA.sky)):
        pattern = low[index] + patterns[index] * (high[index] - low[index])
        shown = jnp.where((image == jnp.array(plain)).all(axis=-1, keepdims=True), pattern, shown)
    gain, curve, shadow, *warmth = 2 * tone - 1
    dark = jax.image.resize(field.reshape(4, 4), image.shape[:2], "linear") > 0.5
    light = 2 ** (0.7 * gain) * (1 - 0.6 * jnp.maximum(shadow, 0) * dark[..., None]) * (1 + 0.15 * jnp.array(warmth))
    shown = jnp.minimum(shown * light / 255, 1)
    shown = 255 * (shown + 0.8 * curve * shown * (1 - shown))
    noise = jax.random.bits(noisy, image.shape, jnp.uint8).astype(jnp.float32) - 127.5
    return jnp.clip(jnp.round(shown + noise / 8), 0, 255).astype(jnp.uint8)


def varied(environment: Environment) -> Environment:
    """Makes the environment whose pictures vary, and whose first action is a speed between 0.15 and 0.3 m/s."""

    def observe(state: Pytree, params: Pytree) -> Pytree:
        seen = environment.observe(state, params)
        key = jax.random.key(0)
        for part in (state.pose.x, state.pose.theta):  # observations have no key
            key = jax.random.fold_in(key, jax.lax.bitcast_convert_type(part, jnp.uint32))
        return seen._replace(image=vary(key, seen.image))

    def reset(key: Key[Array, ""], params: Pytree) -> tuple[Pytree, Pytree]:
        _, state = environment.reset(key, params)
        return observe(state, params), state

    def step(key: Key[Array, ""], state: Pytree, action: Float[Array, "2"], params: Pytree) -> Transition:
        speed, turn = to_motion(action)
        done = environment.step(key, state, jnp.stack([speed / _TOP_SPEED, turn / _TOP_TURN]), params)
        seen = observe(done.state, params)
        return done._replace(observation=seen, reached=seen)

    return environment._replace(observe=observe, reset=reset, step=step)


def _sight() -> Sight:
    """Makes the camera, for tiles whose white lines are in several places."""
    tiles = load_tiles()
    sights = [make_sight(shift_lines(tiles, shift)) for shift in _SHIFTS]
    count = len(sights[0].atlas)
    pictures = [sight.tiles + count * index for index, sight in enumerate(sights)]
    atlas = jnp.concatenate([sight.atlas for sight in sights])
    return Sight(_CAMERA, atlas, jnp.stack(pictures, axis=-1).reshape(16, -1))


def train_policy(updates: int, seed: int, file: Path) -> None:
    """Trains a policy, and writes its weights after every fifth update."""
    towns = our_towns(_SIDE, _TOWNS, seed, 20_000)
    levels = make_levels(jax.random.key(seed), np.stack(towns), _LEVELS)
    params = LaneDriveParams(levels, task="lane", action="twist", observe="camera", sight=_sight(), limit=300)
    params = params.replace(start_d=0.1, start_phi=0.5, offset_cost=5, heading_cost=0.5)
    params = params.replace(robot=params.robot.replace(**_ROBOT))
    ppo = Ppo(updates, envs=64, steps=32, epochs=2, minibatches=4, rate=1e-3, discount=0.96, entropy=0.0)
    training = train(jax.random.key(seed), varied(LaneDrive), params, SeenNetwork(), ppo)
    for update, (weights, reward) in enumerate(training, 1):
        if update % 5 == 0 or update == updates:
            write_weights(file, weights)
            print(f"update {update} of {updates}, reward of a step {float(reward):.4f}", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns its exit code."""
    parser = Parser("policy", __doc__)
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="weights, .npz")
    parser.add_argument("--updates", type=whole(1), default=240, metavar="N", help="of PPO; default 240")
    parser.add_argument("--seed", type=whole(0), default=0, metavar="N", help="of everything random; default 0")
    options = parser.parse_args(arguments)
    return run("policy", lambda: _run(options))


def _run(options: argparse.Namespace) -> None:
    use_compile_cache()
    train_policy(options.updates, options.seed, options.out)


if __name__ == "__main__":
    leave(main())
