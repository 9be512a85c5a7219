"""The records of LaneDrive: its options, the state of an episode, observations and metrics."""

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import jax
from jaxtyping import Array, Bool, Float, Int8, Int32, UInt8

from elitelanes_jax._util.checks import is_real, one_of, real, whole
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.records import REQUIRED, nested, option, static, traced
from elitelanes_jax._util.types import Numeric, Pytree, UserValue
from elitelanes_jax.drive._camera import Sight
from elitelanes_jax.drive._environment import EnvironmentParams
from elitelanes_jax.drive._levels import Level, check_batch
from elitelanes_jax.drive._objects import Objects
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.robot import TILE, Robot, Wheels
from elitelanes_jax.lanes.curves import HALF_ROAD, LANE_OFFSET, check_lane_offset
from elitelanes_jax.lanes.movements import LaneNode, Movement
from elitelanes_jax.network.pytrees import pytree


def _check_sight(value: UserValue) -> Sight | None:
    if value is None or isinstance(value, Sight):
        copy: Sight | None = jax.tree.map(frozen_copy, value)
        return copy
    raise InputError("", "a result of make_sight, or None", type(value).__name__)


def most_lane_offset(robot: Robot) -> float:
    """Returns the largest `lane_offset` at which a robot in the middle of its lane is on the road.

    It is in tiles. The width of the robot must be a number.
    """
    return HALF_ROAD - float(robot.width) / 2 / TILE


@pytree
@dataclass(frozen=True)
class LaneDriveParams(EnvironmentParams):
    """Options of `LaneDrive`. A pytree: numbers may be arrays, mapped by `jax.vmap`.

    Attributes:
      levels: a batch, from which `reset` draws; `make_levels` makes one.
      robot: its measures.
      limit: steps after which an episode is truncated.
      start_d: the largest distance of the start from the lane's centre, in tiles, to either side,
        at most `lane_offset`. A start on the grass ends the episode at the first step.
      start_phi: the largest angle between the start and the lane, in radians, to either side.
      progress_reward: the reward for each tile that a robot drives along its own lane and faces
        along it. A tile driven against the lane counts as -1.
      offset_cost: the cost per second for each tile from the lane's centre.
      heading_cost: the cost per second for each radian from the lane's direction.
      oncoming_cost: the cost per second in the oncoming lane.
      leaving_cost: the cost of leaving the road, or of entering a dead end that is not the goal of
        a route. Both terminate the episode.
      goal_reward: the reward for reaching the goal of a route.
      collision_cost: the cost of touching an object; per second, if that does not terminate the
        episode. The robot is a disc of its width, and an object the disc around its footprint.
      task: "route": turns lead to the goal by a shortest way from the robot's position. "lane":
        turns are random, and no goal ends the episode; static.
      collision: "terminate" or "cost": whether touching an object terminates the episode; static.
      action: "wheels": the commands of the left and the right wheel; "twist": speed and turn, as
        shares of the robot's top speed and top turn; static.
      observe: "lane": offset, heading, speed and curvature ahead; "camera": the picture of `sight`;
        static.
      lane_offset: tiles from the road's middle to the centre of a lane, over 0, and small enough
        for the robot to be on the road, whose edge is 0.379 tiles from its middle; static. A tile
        set may have its own, `TileSet.lane_offset`.
      sight: the camera and its tiles, from `make_sight`; None for none.
    """

    levels: Level = option(REQUIRED, check_batch)
    robot: Robot = nested(Robot())
    limit: Numeric = traced(1500, whole(1))
    start_d: Numeric = traced(0.03, real(0, 0.5))
    start_phi: Numeric = traced(0.15, real(0, 3.2))
    progress_reward: Numeric = traced(1.0, real(-1e6, 1e6))
    offset_cost: Numeric = traced(1.0, real(-1e6, 1e6))
    heading_cost: Numeric = traced(0.1, real(-1e6, 1e6))
    oncoming_cost: Numeric = traced(5.0, real(-1e6, 1e6))
    leaving_cost: Numeric = traced(10.0, real(-1e6, 1e6))
    goal_reward: Numeric = traced(10.0, real(-1e6, 1e6))
    collision_cost: Numeric = traced(10.0, real(-1e6, 1e6))
    collision: str = static("terminate", one_of("terminate", "cost"))
    task: str = static("route", one_of("route", "lane"))
    action: str = static("wheels", one_of("wheels", "twist"))
    observe: str = static("lane", one_of("lane", "camera"))
    lane_offset: float = static(LANE_OFFSET, check_lane_offset)
    sight: Sight | None = option(None, _check_sight)

    def check_together(self) -> None:
        """Checks the options that depend on each other.

        There must be a camera if one is observed, and robots must start in their own lane. The
        lane's centre must leave room for the robot on the road.
        """
        if is_real(self.robot.width):
            most = most_lane_offset(self.robot)
            if self.lane_offset > most:
                raise InputError(
                    "lane_offset",
                    f"at most {most:.3g}, so that the robot is on the road",
                    f"{self.lane_offset:g}",
                )
        if is_real(self.start_d) and self.start_d > self.lane_offset:
            raise InputError(
                "start_d", f"at most lane_offset, {self.lane_offset:g}", f"{self.start_d:g}"
            )
        if self.observe == "camera" and self.sight is None:
            raise InputError("sight", "a result of make_sight, to observe the camera", "None")
        if self.observe != "camera" and self.sight is not None:
            hint = "sight=None observes without a camera"
            raise InputError("observe", "'camera', to see with a sight", repr(self.observe), hint)


class LaneDriveState(NamedTuple):
    """The state of an episode. `grid`, `ways`, `goal`, `shortest` and `objects` are the level's.

    Attributes:
      grid: the links of the level's map.
      ways: the level's ways to its goal.
      goal: the level's goal.
      shortest: the tiles of the level's shortest way.
      pose: the pose of the middle between the wheels.
      wheels: the state of the wheels.
      movement: the movement of the lane that the robot follows.
      next_turn: the turn of the movement on the next tile.
      d: the distance from the lane's centre, as in `LanePose`.
      phi: the angle to the lane, as in `LanePose`.
      s: the position along the lane, as in `LanePose`.
      tiles: the number of tiles entered so far.
      steps: the number of steps so far.
      objects: the level's objects; None without objects.
    """

    grid: Int8[Array, "H W"]
    ways: UInt8[Array, "H W"]
    goal: LaneNode
    shortest: Int32[Array, ""]
    pose: Pose
    wheels: Wheels
    movement: Movement
    next_turn: Int32[Array, ""]
    d: Float[Array, ""]
    phi: Float[Array, ""]
    s: Float[Array, ""]
    tiles: Int32[Array, ""]
    steps: Int32[Array, ""]
    objects: Objects | None = None


Parts: TypeAlias = dict[str, Pytree]
"""Parts of a state, by name."""


class LaneDriveObservation(NamedTuple):
    """An observation of the lane, or of the camera alone. Fields that are not observed are None.

    Attributes:
      d: float32, tiles to the left of the lane's centre.
      phi: float32, radians turned to the left of the lane.
      speed: float32, metres a second.
      turn: float32, radians a second.
      curvature: float32 ``[3]``, 1 / tiles, to the left, at the robot, and 0.25 and 0.5 tile ahead
        of it, at most on the next tile.
      image: uint8 ``[rows, columns, 3]``, RGB, the camera's picture.
    """

    d: Float[Array, ""] | None
    phi: Float[Array, ""] | None
    speed: Float[Array, ""] | None
    turn: Float[Array, ""] | None
    curvature: Float[Array, "3"] | None
    image: UInt8[Array, "rows columns 3"] | None = None


class LaneDriveInfo(NamedTuple):
    """Metrics after a step.

    Attributes:
      success: bool, the goal of the route is reached.
      off_road: bool, the robot has left the road, or its lane ends at a dead end.
      own_lane: bool, the middle between the wheels is within the own lane.
      oncoming: bool, the middle between the wheels is beyond the road's middle.
      tiles: int32, tiles entered so far, 0 on the first one.
      shortest: int32, tiles of a shortest way to the goal.
      spl: float32, success times shortest / tiles, at most 1.
      collision: bool, an object was touched; None without objects.
    """

    success: Bool[Array, ""]
    off_road: Bool[Array, ""]
    own_lane: Bool[Array, ""]
    oncoming: Bool[Array, ""]
    tiles: Int32[Array, ""]
    shortest: Int32[Array, ""]
    spl: Float[Array, ""]
    collision: Bool[Array, ""] | None = None
