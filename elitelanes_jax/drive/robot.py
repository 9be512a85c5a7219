"""The robot: a differential drive with Duckietown's measures, from commands to its next pose."""

from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float, Key

from elitelanes_jax._util.checks import none_or, real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import Record, traced
from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive.lanes import Pose, wrap_angle
from elitelanes_jax.network.bits import normal
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.xla import rounded

TILE = 0.585
"""The side of a tile in metres."""

# The number of kept commands.
_DELAYS = 5


@pytree
@dataclass(frozen=True)
class Robot(Record):
    """Measures of the robot. A pytree: numbers may be arrays, mapped by `jax.vmap`.

    The defaults, except `top_turn`, are constants of gym-duckietown's code. Wheels reach a
    command's speed at once, as in its versions of 2018. Its robot in version 6.1.34 is slower: a
    command takes effect after 0.15 s. Speed and turn approach their limits with time constants of
    0.2 s and 0.25 s. ``top_speed=0.6, wheel_distance=0.16`` has the same limits.

    Attributes:
      dt: seconds per step.
      top_speed: the top speed of a wheel in metres a second.
      top_turn: radians a second, for commands of speed and turn.
      wheel_distance: metres.
      width: the width of the body in metres.
      trim: share by which the right wheel turns too fast, and the left one too slow, -0.5 to 0.5.
      noise: standard deviation of each wheel's speed, as a share of the top speed; None for none.
      latency: steps until a command takes effect, 0 to 4, also fractions; None for none.
    """

    dt: Numeric = traced(1 / 30, real(0, 0.1, exclusive=True))
    top_speed: Numeric = traced(1.2, real(0, 1.2, exclusive=True))
    top_turn: Numeric = traced(8.0, real(0, 100, exclusive=True))
    wheel_distance: Numeric = traced(0.102, real(0, 1, exclusive=True))
    width: Numeric = traced(0.15, real(0, 1))
    trim: Numeric = traced(0.0, real(-0.5, 0.5))
    noise: Numeric | None = traced(None, none_or(real(0, 1)))
    latency: Numeric | None = traced(None, none_or(real(0, _DELAYS - 1)))


class Wheels(NamedTuple):
    """The wheels' state.

    Attributes:
      speed: the speed forward in metres a second.
      turn: the turn to the left in radians a second.
      commands: the last commands, the newest first; None without latency.
    """

    speed: Float[Array, ""]
    turn: Float[Array, ""]
    commands: Float[Array, "5 2"] | None


def still(robot: Robot) -> Wheels:
    """Returns the wheels of a robot at rest."""
    commands = None if robot.latency is None else jnp.zeros((_DELAYS, 2), jnp.float32)
    return Wheels(jnp.float32(0), jnp.float32(0), commands)


def to_wheels(
    speed: Float[ArrayLike, "..."], turn: Float[ArrayLike, "..."], robot: Robot
) -> Float[Array, "... 2"]:
    """Returns the commands of the wheels for metres and radians a second.

    The commands are those of the left and the right wheel, -1 to 1. If one wheel would exceed the
    top speed, both are slowed down, so that the curve stays the same.
    """
    # `half` is half of the difference between the speeds of the two wheels. A turn that is a
    # product is rounded first, because XLA multiplies three factors in different orders.
    half = rounded(rounded(turn) * robot.wheel_distance) / 2
    speeds = jnp.stack([speed - half, speed + half], axis=-1)
    # Without reciprocals XLA divides in a single program and multiplies by them in a batch.
    wheels = rounded(speeds * rounded(1 / robot.top_speed))
    return wheels / jnp.maximum(jnp.abs(wheels).max(axis=-1, keepdims=True), 1)


def tiles_driven(speed: Float[Array, ""], robot: Robot) -> Float[Array, ""]:
    """Returns the tiles that a robot drives in a step at a speed in metres a second."""
    return rounded(speed * rounded(robot.dt * (1 / TILE)))


def clip_command(command: Float[ArrayLike, "2"]) -> Float[Array, "2"]:
    """Returns a command as float32, clipped to -1 to 1, with 0 instead of NaN."""
    return jnp.clip(jnp.nan_to_num(jnp.asarray(command, jnp.float32), nan=0.0), -1, 1)


def drive(
    key: Key[Array, ""], pose: Pose, wheels: Wheels, command: Float[ArrayLike, "2"], robot: Robot
) -> tuple[Pose, Wheels]:
    """Drives for one step with constant speeds of the wheels: along an arc, computed exactly.

    A command is clipped to -1 to 1, and NaN is 0. The key is consumed for noise.

    Raises `InputError` if only the robot has a latency, or only the state of its wheels.
    """
    shares = clip_command(command)
    commands = wheels.commands
    if commands is None and robot.latency is not None:
        hint = "reset with this robot"
        raise InputError("robot", "no latency, as the state of the wheels", "a latency", hint)
    if commands is not None:
        if robot.latency is None:
            raise InputError("robot", "a latency, as the state of the wheels has", "none")
        commands = jnp.concatenate([shares[None], commands[:-1]])
        age = jnp.arange(_DELAYS, dtype=jnp.float32)
        # A latency between two steps mixes the commands of both, in proportion.
        weights = jnp.maximum(1 - jnp.abs(age - robot.latency), 0)
        shares = rounded(weights[:, None] * commands).sum(axis=0)
    if robot.noise is not None:
        shares = shares + rounded(robot.noise * rounded(normal(key, (2,))))
    # Each product is rounded before the next factor, because XLA multiplies three factors in
    # different orders.
    left = rounded(shares[0] * rounded(robot.top_speed * (1 - robot.trim)))
    right = rounded(shares[1] * rounded(robot.top_speed * (1 + robot.trim)))
    speed, turn = (left + right) / 2, rounded((right - left) * rounded(1 / robot.wheel_distance))
    angle = rounded(turn * robot.dt)
    half = angle / 2
    # The robot drives an arc. The chord to its end is as long as the arc times sin(half) / half.
    # Its direction is turned by half of the angle.
    bend = jnp.where(jnp.abs(half) < 1e-3, 1, jnp.sin(half) / jnp.where(half == 0, 1, half))
    chord = rounded(tiles_driven(speed, robot) * bend)
    middle = pose.theta + half
    # The axis y points south, so driving north makes it smaller.
    there = Pose(
        pose.x + rounded(chord * jnp.cos(middle)),
        pose.y - rounded(chord * jnp.sin(middle)),
        pose.theta + angle,
    )
    return there._replace(theta=wrap_angle(there.theta)), Wheels(speed, turn, commands)
