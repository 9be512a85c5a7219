"""Rides of a robot across a map."""

import runpy
import sys
from collections.abc import Callable
from functools import partial
from inspect import iscoroutine
from operator import itemgetter
from pathlib import Path
from traceback import extract_tb
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, real, whole
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Pytree, UserValue
from elitelanes_jax.drive._camera import Camera
from elitelanes_jax.drive._environment import Transition
from elitelanes_jax.drive._lane_drive import LaneDrive, pure_pursuit
from elitelanes_jax.drive._lane_drive_records import (
    LaneDriveObservation,
    LaneDriveParams,
    most_lane_offset,
)
from elitelanes_jax.drive._levels import Level, make_levels
from elitelanes_jax.drive.lanes import check_lane
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.drive.scene_making import make_sight
from elitelanes_jax.formats.road_map import as_map
from elitelanes_jax.lanes.curves import LANE_OFFSET
from elitelanes_jax.network.bits import seed_key, split, uniform
from elitelanes_jax.tiles.tileset import TileSet

POLICIES = ("route", "random")
"""Drivers: one follows the route to the goal, the other turns its wheels at random."""

Policy: TypeAlias = Callable[[LaneDriveObservation], ArrayLike]
"""Your own driver, which takes an observation in NumPy.

It returns two numbers, -1 to 1, see `make_rides`. If it has an attribute `camera`, a `Camera`, it
observes only this camera's picture.
"""

RATE = 30
"""The steps of `LaneDrive` per second, and the frames of a film."""

# The side of a tile in the pictures that a policy observes, in pixels.
_SIGHT_PX = 128

# Tiles per second that the expert exceeds. It drives 0.3 m/s, which is 0.466 tiles per second if
# each tile is a left turn, the longest movement. Lanes farther out have longer left turns.
_PACE = 0.46

# The fewest tiles from a start to its goal. A short ride may have fewer.
_NEAREST_GOAL = 4

# The least room in tiles between a robot in its lane and the edge of the road. With 0.006 a ride of
# 12 left the road, with 0.011 none.
_LEAST_ROOM = 0.01

# The least room between a robot at its start and the edge of the road, because the robot may be
# turned outwards.
_START_ROOM = 0.02

# A day, whose poses take 31 MB a ride.
_LONGEST = 86_400


class Rides(NamedTuple):
    """Rides on one map.

    Attributes:
      levels: a batch of N.
      x: float32 ``[N, steps + 1]``, tiles east; constant after the end of a ride.
      y: float32 ``[N, steps + 1]``, tiles south.
      theta: float32 ``[N, steps + 1]``, radians counter-clockwise from east.
      steps: int ``[N]``, thirtieths of a second until the end.
      success: bool ``[N]``, the goal was reached.
      off_road: bool ``[N]``, the robot left the road, or its lane ended at a dead end.
    """

    levels: Level
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    theta: NDArray[np.float32]
    steps: NDArray[np.int32]
    success: NDArray[np.bool_]
    off_road: NDArray[np.bool_]


@name_wrong_arguments
@runs_jax
def make_rides(
    source: UserValue,
    count: int = 1,
    *,
    policy: str | Policy = "route",
    action: str = "wheels",
    seconds: float = 60,
    seed: int = 0,
    tiles: TileSet | None = None,
) -> Rides:
    """Drives on a map from random starts to random goals.

    From 2.3 seconds on, the expert reaches all goals in time.

    Args:
      source: a `RoadMap`, a grid ``[H, W]`` of codes, or a file.
      count: N, the number of rides.
      policy: "route", the expert; "random", a driver that turns its wheels forwards at random, and
        with "twist" draws a speed and a turn; or your own driver, a function from a
        `LaneDriveObservation` to two numbers, -1 to 1.
      action: what the two numbers are: "wheels", the commands of the left and the right wheel, or
        "twist", the speed and the turn, as in `LaneDriveParams.action`.
      seconds: the longest time of a ride, over 0, up to 86,400.
      seed: the seed of starts, goals and everything random, 0 to 2**32 - 1.
      tiles: whose lanes are driven, and that the camera of your own driver shows; by default the
        package's own.

    Raises:
      InputError: for a bad map, one without a lane, a `count`, `seconds` or `seed` out of its
        range, or another action. Also for tiles whose lanes are too near the edge of the road,
        another policy, or one that fails or does not return two numbers.
    """
    check_seconds = real(0, _LONGEST, unit="seconds, a number", exclusive=True)
    seconds = check_named("seconds", check_seconds, seconds)
    if not callable(policy) and policy not in POLICIES:
        raise InputError("policy", f"one of {', '.join(POLICIES)}", quote(policy))
    check_named("seed", SEED, seed)
    level_key, ride_key = split(seed_key(seed))
    codes = check_named("source", as_map, source).codes
    check_lane(codes)
    count = check_named("count", whole(1), count)
    lane_offset = LANE_OFFSET if tiles is None else tiles.lane_offset
    pace = _PACE * min((0.5 + LANE_OFFSET) / (0.5 + lane_offset), 1)
    furthest = int(max(pace * seconds, 1))
    nearest = min(_NEAREST_GOAL, furthest)
    levels = make_levels(level_key, codes[None], count, least=nearest, most=furthest)
    room = most_lane_offset(Robot()) - lane_offset
    if room < _LEAST_ROOM:
        most = lane_offset + room - _LEAST_ROOM
        expected = f"a lane_offset of at most {most:.3g}, so that the robot stays on the road"
        raise InputError("tiles", expected, f"{lane_offset:g}")
    # The usual distance of the start from the lane's centre may leave a narrow lane or the road.
    start_d = min(LaneDriveParams.start_d, lane_offset, max(room - _START_ROOM, 0))
    params = LaneDriveParams(levels, action=action, lane_offset=lane_offset, start_d=start_d)
    # Without a camera the driver observes its lane, and no picture is rendered.
    camera = getattr(policy, "camera", None)
    if camera is not None:
        if not isinstance(camera, Camera):
            raise InputError("policy", "a Camera in its attribute camera", quote(camera))
        sight = make_sight(tiles, camera, tile_px=_SIGHT_PX)
        params = params.replace(observe="camera", sight=sight)
    steps = max(round(seconds * RATE), 1)
    return _drive(policy, ride_key, params, steps)


def _drive(policy: str | Policy, key: Array, params: LaneDriveParams, steps: int) -> Rides:
    """Drives on all levels, side by side, for a number of steps at most."""
    count = params.levels.grid.shape[0]
    keys = split(key, count)
    observations, states = _begin(keys, params.levels, params)
    first_poses = np.stack(jax.device_get(states.pose), axis=1)
    # At first all steps have the pose of the start. Each step of a ride overwrites all later poses,
    # which then stay constant after its end.
    poses = np.repeat(first_poses[:, :, None], steps + 1, axis=2)
    lengths = np.zeros(count, np.int32)
    success = np.zeros(count, bool)
    off_road = np.zeros(count, bool)
    is_over = np.zeros(count, bool)
    actions = np.zeros((count, 2), np.float32)
    driver = None if callable(policy) else policy
    for step in range(1, steps + 1):
        if is_over.all():
            break
        if callable(policy):
            observed = jax.device_get(observations)
            # A ride that is over needs no action. Its last one is repeated, and the result is not
            # used.
            for index in np.flatnonzero(~is_over):
                observation = jax.tree.map(itemgetter(index), observed)
                actions[index] = _ask(policy, observation)
        transitions = _go(keys, step, states, actions, params, driver)
        observations = transitions.observation
        states = transitions.state
        # One transfer for all that the loop reads.
        info = transitions.info
        pose, reaches_goal, leaves_road, ends = jax.device_get(
            (states.pose, info.success, info.off_road, transitions.terminated)
        )
        is_driving = ~is_over
        poses[is_driving, :, step:] = np.stack(pose, axis=1)[is_driving, :, None]
        success |= reaches_goal & is_driving
        off_road |= leaves_road & is_driving
        lengths += is_driving
        is_over |= ends
    return Rides(
        levels=jax.device_get(params.levels),
        x=poses[:, 0],
        y=poses[:, 1],
        theta=poses[:, 2],
        steps=lengths,
        success=success,
        off_road=off_road,
    )


@jax.jit
@partial(jax.vmap, in_axes=(0, 0, None))
def _begin(key: Array, level: Level, params: LaneDriveParams) -> Pytree:
    return LaneDrive.reset_to_level(jax.random.fold_in(key, 0), level, params)


@partial(jax.jit, static_argnames="policy")
@partial(jax.vmap, in_axes=(0, None, 0, 0, None, None))
def _go(
    key: Array,
    step: Array,
    state: Pytree,
    action: Array,
    params: LaneDriveParams,
    policy: str | None,
) -> Transition:
    """Makes a step with the action, or with that of one of `POLICIES`."""
    moving = jax.random.fold_in(key, step)
    if policy == "route":
        action = pure_pursuit(state, params)
    elif policy == "random":
        action = uniform(jax.random.fold_in(moving, 0), (2,))
        if params.action == "twist":
            # The robot drives forwards, and turns to both sides.
            action = jnp.stack([action[0], 2 * action[1] - 1])
    return LaneDrive.step(moving, state, action, params)


def _ask(policy: Policy, observation: LaneDriveObservation) -> NDArray[np.float32]:
    try:
        answer = policy(observation)
        # NumPy makes no number of a coroutine, which is refused below.
        action = np.zeros(0) if iscoroutine(answer) else np.asarray(answer, np.float32)
    except (Exception, SystemExit) as error:
        # The error names the line of the driver's file that failed.
        file = getattr(getattr(policy, "__code__", None), "co_filename", "")
        raise InputError("policy", "an action", _describe(error, file)) from error
    expected = "two numbers, for both wheels or for speed and turn"
    if iscoroutine(answer):
        # Python warns of a coroutine that is neither awaited nor closed.
        answer.close()
        raise InputError("policy", expected, "a coroutine", "define the function without async")
    if action.shape != (2,):
        raise InputError("policy", expected, f"shape {action.shape}")
    if not np.isfinite(action).all():
        raise InputError("policy", "two finite numbers", f"{action[0]:g} and {action[1]:g}")
    return action


def load_policy(file: Path) -> Policy:
    """Loads a driver, the function ``act(observation)`` (see `Policy`), from a Python file.

    The file is run. The file may import modules from its folder, also later in `act`, as a program
    that Python starts.
    """
    # Python does the same for a program that it starts.
    sys.path.insert(0, str(file.resolve().parent))
    try:
        act = runpy.run_path(str(file)).get("act")
    except (Exception, SystemExit) as error:
        # Only an error of opening the file itself says that the file is not readable.
        if isinstance(error, OSError) and Path(str(error.filename)).resolve() == file.resolve():
            raise InputError(file, "a readable file", error.strerror or error) from None
        raise InputError(file, "a program that runs", _describe(error, str(file))) from error
    if not callable(act):
        raise InputError(file, "a function act(observation)", "none")
    return act


def _describe(error: BaseException, file: str) -> str:
    """Returns the text of an error, with the last line of the file that it came through."""
    words = f"{type(error).__name__}: {error}"
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == file]
    if lines:
        words += f" (line {lines[-1]} of {file})"
    return words
