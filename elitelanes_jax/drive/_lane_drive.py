"""LaneDrive: a robot with two wheels that keeps to its lane, or drives along a route to a goal."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Key

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import instance, is_real
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.drive._camera import look
from elitelanes_jax.drive._courses import draw_bits, draw_start, ends_lane, go_on
from elitelanes_jax.drive._environment import Environment, Transition, checks_first, read_at, spl
from elitelanes_jax.drive._lane_drive_records import (
    LaneDriveInfo,
    LaneDriveObservation,
    LaneDriveParams,
    LaneDriveState,
    Parts,
)
from elitelanes_jax.drive._levels import Level, check_single
from elitelanes_jax.drive._objects import touches
from elitelanes_jax.drive.lanes import (
    Pose,
    ground_at,
    lane_curvature,
    lane_errors,
    lane_length,
    lane_point,
)
from elitelanes_jax.drive.robot import (
    TILE,
    clip_command,
    drive,
    still,
    tiles_driven,
    to_wheels,
)
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.network.bits import randint
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import once, rounded

# The distances ahead at which the curvature is observed, in tiles.
_AHEAD = (0.0, 0.25, 0.5)


@name_wrong_arguments
@runs_jax
@checks_first(params=instance(LaneDriveParams))
@jax.jit
@divide_batches
def _reset(
    key: Key[Array, ""], params: LaneDriveParams
) -> tuple[LaneDriveObservation, LaneDriveState]:
    """Starts on a level drawn uniformly from ``params.levels``.

    The start is as in `reset_to_level`. The key is consumed.
    """
    levels = params.levels

    def draw() -> tuple[Array, Parts]:
        bits = draw_bits(key, params)
        index = randint(bits[0], levels.grid.shape[0])
        # Single tiles are read from the batch, because otherwise the level's whole map would be
        # copied.
        read = partial(read_at, (levels.grid, levels.ways), index)
        objects = read_at(levels.objects, index)
        return index, draw_start(bits, read_at(levels.start, index), read, objects, params)

    index, start = once(draw)
    return _begin(read_at(levels, index), start, params)


@name_wrong_arguments
@runs_jax
@checks_first(level=check_single, params=instance(LaneDriveParams))
@jax.jit
@divide_batches
def _reset_to_level(
    key: Key[Array, ""], level: Level, params: LaneDriveParams
) -> tuple[LaneDriveObservation, LaneDriveState]:
    """Puts the robot on the start of a level, at rest, near the middle of its lane.

    The key is consumed. If it would touch an object there, it starts at the first of 8 places along
    the lane of its tile where it touches none. If there is no such place, it stays.
    """
    read = partial(read_at, (level.grid, level.ways))

    def draw() -> Parts:
        return draw_start(draw_bits(key, params), level.start, read, level.objects, params)

    return _begin(level, once(draw), params)


def _begin(
    level: Level, start: Parts, params: LaneDriveParams
) -> tuple[LaneDriveObservation, LaneDriveState]:
    zero = jnp.int32(0)
    state = LaneDriveState(
        grid=level.grid,
        ways=level.ways,
        goal=level.goal,
        shortest=level.shortest,
        objects=level.objects,
        wheels=still(params.robot),
        tiles=zero,
        steps=zero,
        **start,
    )
    return _observe(state, params), state


class _Events(NamedTuple):
    """What happened in a step.

    Attributes:
      entered: bool, whether the robot came to another tile by a road.
      success: bool, whether the robot reached the goal of its route.
      off_road: bool, whether the robot left the road, or its lane ends at a dead end.
      along: float32, tiles driven along the lane; less than 0 against it.
      collision: bool, whether the robot touched an object; None without objects.
    """

    entered: Array
    success: Array
    off_road: Array
    along: Array
    collision: Array | None


def _clip_numbers(action: UserValue) -> UserValue:
    """Returns numbers of Python or NumPy clipped to -1 to 1; anything else unchanged.

    JAX would drop the upper bits of a number such as 2**32.
    """
    is_list = isinstance(action, list | tuple) and all(map(is_real, action))
    is_array = isinstance(action, np.ndarray) and action.dtype.kind in "iuf"
    if not is_list and not is_array:
        return action
    return np.clip(np.asarray(action, np.float64), -1, 1).astype(np.float32)


@name_wrong_arguments
@runs_jax
@checks_first(
    state=instance(LaneDriveState), action=_clip_numbers, params=instance(LaneDriveParams)
)
@jax.jit
@divide_batches
def _step(
    key: Key[Array, ""],
    state: LaneDriveState,
    action: Float[ArrayLike, "2"],
    params: LaneDriveParams,
) -> Transition:
    """Drives for one step of time.

    The episode terminates at the goal of a route, on a dead end, and when either side of the robot
    leaves the road. It also terminates when the robot touches an object, unless
    `LaneDriveParams.collision` is "cost". It is truncated at the limit. A robot that leaves its
    tile by another way than its movement continues on that way.

    Args:
      key: consumed, for noise and random turns.
      state: the state before.
      action: two numbers, clipped to -1 to 1, 0 instead of NaN; see `LaneDriveParams.action`.
      params: the options of the environment.
    """
    action = jnp.asarray(action)
    if action.shape != (2,):
        raise InputError("action", "two numbers, shape (2,)", f"shape {action.shape}")
    if jnp.iscomplexobj(action):
        raise InputError("action", "real numbers", action.dtype)
    # The rewards and the metrics use the same results many times.
    moved, events = once(lambda: _move(key, state, action, params))
    is_on_road = ~events.off_road
    own_lane = is_on_road & (jnp.abs(moved["d"]) <= params.lane_offset)
    oncoming = is_on_road & (moved["d"] > params.lane_offset)
    reward = _reward(moved, events, own_lane, oncoming, params)
    terminated = events.success | events.off_road
    if events.collision is not None and params.collision == "terminate":
        terminated |= events.collision
    tiles = state.tiles + events.entered.astype(jnp.int32)
    steps = state.steps + 1
    after = state._replace(**moved, tiles=tiles, steps=steps)
    info = LaneDriveInfo(
        success=events.success,
        off_road=events.off_road,
        own_lane=own_lane,
        oncoming=oncoming,
        tiles=tiles,
        shortest=state.shortest,
        spl=spl(events.success, state.shortest, tiles),
        collision=events.collision,
    )
    observation = _observe(after, params)
    return Transition(
        observation=observation,
        state=after,
        reward=reward,
        terminated=terminated,
        truncated=~terminated & (steps >= params.limit),
        info=info,
        reached=observation,
    )


def _reward(
    moved: Parts, events: _Events, own_lane: Array, oncoming: Array, params: LaneDriveParams
) -> Float[Array, ""]:
    """Returns the reward of a step, whose new parts of the state are `moved`."""
    d, phi = moved["d"], moved["phi"]
    # Products are rounded before they are added, so that single programs and batches return the
    # same bits (see `rounded`).
    costs = rounded(params.offset_cost * jnp.abs(d)) + rounded(params.heading_cost * jnp.abs(phi))
    costs += params.oncoming_cost * jnp.float32(oncoming)
    reward = rounded(params.progress_reward * events.along * jnp.float32(own_lane))
    reward -= rounded(costs * params.robot.dt)
    at_goal = params.goal_reward * jnp.float32(events.success)
    reward += at_goal - params.leaving_cost * jnp.float32(events.off_road)
    if events.collision is not None:
        # A touch that ends the episode costs its price once, any other touch per second.
        duration = 1 if params.collision == "terminate" else params.robot.dt
        reward -= rounded(params.collision_cost * jnp.float32(events.collision) * duration)
    return jnp.asarray(reward, jnp.float32)


def _move(
    key: Array, state: LaneDriveState, action: ArrayLike, params: LaneDriveParams
) -> tuple[Parts, _Events]:
    """Drives for one step; returns the new parts of the state, and what happened."""
    robot = params.robot
    pose, wheels = drive(
        jax.random.fold_in(key, 0), state.pose, state.wheels, _to_command(action, params), robot
    )
    course = go_on(jax.random.fold_in(key, 1), state, pose, params)
    d, phi, s = lane_errors(pose, course.movement, params.lane_offset)
    has_both_sides = _has_both_sides_on_road(state.grid, pose, params)
    # The goal's tile must be entered on the lane that leads to it.
    at_goal = course.entered & course.movement.node.equals(state.goal)
    success = at_goal & (params.task == "route")
    lane_ends = ends_lane(state.grid, course.movement.node)
    off_road = ~success & (course.astray | lane_ends | ~has_both_sides)
    along = _progress(wheels.speed, phi, params)
    collision = None
    if state.objects is not None:
        collision = touches(state.objects, state.pose, pose, robot.width / 2)
        if params.collision == "terminate":
            # A collision that ends the episode is no success, also on the goal.
            success &= ~collision
    moved = {
        "pose": pose,
        "wheels": wheels,
        "movement": course.movement,
        "next_turn": course.next_turn,
        "d": d,
        "phi": phi,
        "s": s,
    }
    return moved, _Events(course.entered, success, off_road, along, collision)


def _has_both_sides_on_road(grid: Array, pose: Pose, params: LaneDriveParams) -> Bool[Array, ""]:
    """Returns whether the points at both sides of the robot are on the road."""
    reach = params.robot.width / 2 / TILE
    east, south = -reach * jnp.sin(pose.theta), -reach * jnp.cos(pose.theta)
    left = ground_at(grid, pose.x + east, pose.y + south).on_road
    right = ground_at(grid, pose.x - east, pose.y - south).on_road
    return left & right


def _progress(speed: Array, phi: Array, params: LaneDriveParams) -> Float[Array, ""]:
    """Returns the tiles driven along the lane in a step; less than 0 against it."""
    facing = jnp.cos(phi)
    # Only the part of the speed in the lane's direction is progress.
    along = rounded(tiles_driven(speed, params.robot) * facing)
    # A robot that faces the other way and drives in reverse makes no progress.
    return jnp.where(facing > 0, along, jnp.minimum(along, 0))


@name_wrong_arguments
@runs_jax
@checks_first(state=instance(LaneDriveState), params=instance(LaneDriveParams))
@divide_batches
def _observe(state: LaneDriveState, params: LaneDriveParams) -> LaneDriveObservation:
    if params.observe == "camera" and params.sight is not None:
        image = look(state.pose, state.grid, params.sight, state.objects).image
        return LaneDriveObservation(None, None, None, None, None, image)
    # Points ahead that are beyond this tile take the curvature of the next one.
    turn, next_turn, lane_offset = state.movement.turn, state.next_turn, params.lane_offset
    beyond = state.s + jnp.asarray(_AHEAD, jnp.float32) > lane_length(turn, lane_offset)
    curvature = jnp.where(
        beyond, lane_curvature(next_turn, lane_offset), lane_curvature(turn, lane_offset)
    )
    return LaneDriveObservation(
        state.d, state.phi, state.wheels.speed, state.wheels.turn, curvature
    )


def _to_command(action: ArrayLike, params: LaneDriveParams) -> Array:
    if params.action == "wheels":
        # `drive` clips the command.
        return jnp.asarray(action, jnp.float32)
    shares = clip_command(action)
    robot = params.robot
    # The speed is a product, and `to_wheels` adds to it.
    speed = rounded(shares[0] * robot.top_speed)
    return to_wheels(speed, shares[1] * robot.top_turn, robot)


LaneDrive = Environment(_reset, _reset_to_level, _step, _observe, actions=None, action_size=2)
"""The environment of a robot with two wheels on lanes.

`LaneDriveParams` has its options. An action is two numbers, see `LaneDriveParams.action`.
"""

# The speed of `pure_pursuit` in metres a second, unless the robot's top speed is lower.
_SPEED = 0.3
# Tiles along the lane, from the point beside the robot to the point that it drives to.
_LOOKAHEAD = 0.12


@name_wrong_arguments
@runs_jax
# Uncompiled operations round products that compiled ones add without rounding.
@jax.jit
@divide_batches
def pure_pursuit(state: LaneDriveState, params: LaneDriveParams) -> Float[Array, "2"]:
    """Returns the expert's action, which follows the lane at up to 0.3 m/s.

    The expert drives along the arc to a point of the lane 0.12 tiles ahead. It is slower where a
    wheel would exceed its top speed.

    Source: Coulter, "Implementation of the pure pursuit path tracking algorithm", Carnegie Mellon
    University, 1992.

    Args:
      state: the state of the environment.
      params: the options of the environment.

    Returns:
      An action of `LaneDrive`, for either kind.
    """
    lane_offset = params.lane_offset
    length = lane_length(state.movement.turn, lane_offset)
    # The point ahead is on this movement's lane, or if that ends before, on the lane of the next
    # one.
    goal_s = state.s + _LOOKAHEAD
    onward = Movement(*state.movement.next_node, state.next_turn)
    here = lane_point(state.movement, goal_s, lane_offset=lane_offset)
    beyond = lane_point(onward, goal_s - length, lane_offset=lane_offset)
    target = jax.tree.map(lambda one, other: jnp.where(goal_s > length, other, one), here, beyond)
    # The target is relative to the robot, ahead and to the left.
    east, north = target.x - state.pose.x, state.pose.y - target.y
    cosine, sine = jnp.cos(state.pose.theta), jnp.sin(state.pose.theta)
    # Products are rounded before they are added, as in `_step`.
    ahead = rounded(east * cosine) + rounded(north * sine)
    left = rounded(north * cosine) - rounded(east * sine)
    # An arc from the origin, in direction of x, to a point has twice its y over its squared
    # distance.
    curvature = 2 * left / jnp.maximum(rounded(ahead * ahead) + rounded(left * left), 1e-6)
    robot = params.robot
    is_slow = robot.top_speed < _SPEED
    speed = jnp.where(is_slow, robot.top_speed, _SPEED)
    # The speed in tiles a second.
    pace = jnp.where(is_slow, rounded(robot.top_speed * (1 / TILE)), _SPEED / TILE)
    if params.action == "twist":
        turn = curvature * rounded(pace / robot.top_turn)
        return jnp.clip(jnp.stack([speed / robot.top_speed, turn]), -1, 1)
    return to_wheels(speed, pace * curvature, robot)
