"""LaneDrive: a robot with two wheels that keeps to its lane, or drives along a route to a goal."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int8, Int32, Key, UInt8
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import instance, is_real, one_of, real, whole
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.pytrees import pytree, static, traced
from elitelanes_jax._util.records import REQUIRED, Record, nested, option
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric, Pytree, UserValue
from elitelanes_jax.drive._camera import Sight, look
from elitelanes_jax.drive._distances import NO_WAY
from elitelanes_jax.drive._environment import Environment, Transition, checks_first
from elitelanes_jax.drive._levels import Level, check_batch, check_single
from elitelanes_jax.drive._objects import Objects, stands_on, touches
from elitelanes_jax.drive.lanes import (
    Pose,
    ground_at,
    lane_curvature,
    lane_errors,
    lane_length,
    lane_point,
    wrap_angle,
)
from elitelanes_jax.drive.robot import TILE, Robot, Wheels, drive, still, to_wheels
from elitelanes_jax.lanes.curves import LANE_OFFSET, check_lane_offset
from elitelanes_jax.lanes.movements import MOVEMENTS, LaneNode, Movement
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import once, rounded


def _check_sight(value: UserValue) -> Sight | None:
    if value is None or isinstance(value, Sight):
        return value
    raise InputError(f"expected a result of make_sight, or None, got {type(value).__name__}")


@pytree
@dataclass(frozen=True)
class LaneDriveParams(Record):
    """Options of `LaneDrive`. A pytree: numbers may be arrays, mapped by `jax.vmap`.

    Attributes:
      levels: a batch, from which `reset` draws; `make_levels` makes one.
      robot: its measures.
      limit: steps after which an episode is truncated.
      start_d: the largest distance of the start from the lane's centre, in tiles, to either side,
        at most `lane_offset`.
      start_phi: the largest angle between the start and the lane, in radians, to either side.
      progress_reward: the reward for each tile that a robot drives along its own lane and faces
        along it. A tile driven against the lane counts as -1.
      offset_cost: the cost per second for each tile from the lane's centre.
      heading_cost: the cost per second for each radian from the lane's direction.
      oncoming_cost: the cost per second in the oncoming lane.
      leaving_cost: the cost of leaving the road, which terminates the episode.
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
      lane_offset: tiles from the road's middle to the centre of a lane, over 0 and under 0.5;
        static. A tile set may have its own, `TileSet.lane_offset`.
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

        There must be a camera if one is observed, and robots must start in their own lane.
        """
        if is_real(self.start_d) and self.start_d > self.lane_offset:
            raise InputError(
                f"start_d: expected at most lane_offset, {self.lane_offset:g}, got {self.start_d:g}"
            )
        if self.observe == "camera" and self.sight is None:
            raise InputError(
                "sight: expected a result of make_sight, to observe the camera, got None"
            )

    @property
    def max_steps_in_episode(self) -> Numeric:
        """The limit, by the name in Gymnax."""
        return self.limit


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
      tiles: int32, entered so far.
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


# The distances ahead at which the curvature is observed, in tiles.
_AHEAD = (0.0, 0.25, 0.5)
# The places, evenly along the lane of a tile, at which a start that touches no object is sought.
_START_PLACES = 8

# A function that returns the code and the ways of the tile at a row and a column.
_Reader = Callable[[Array, Array], tuple[Array, Array]]
# The parts of a state, by name.
_Parts = dict[str, Pytree]


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

    def draw() -> tuple[Array, _Parts]:
        bits = _reset_bits(key, params)
        index = randint(bits[0], levels.grid.shape[0])
        # Single tiles are read from the batch, because otherwise the level's whole map would be
        # copied.
        read = partial(_at, (levels.grid, levels.ways), index)
        objects = _at(levels.objects, index)
        return index, _start(bits, _at(levels.start, index), read, objects, params)

    index, start = once(draw)
    return _begin(_at(levels, index), start, params)


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
    the lane of its tile where it touches none, and stays if there is none.
    """
    read = partial(_at, (level.grid, level.ways))

    def draw() -> _Parts:
        return _start(_reset_bits(key, params), level.start, read, level.objects, params)

    return _begin(level, once(draw), params)


def _reset_bits(key: Array, params: LaneDriveParams) -> Array:
    """Draws all bits of a reset at once.

    There is a word for the level, two words for the start, and one for each random turn.
    """
    return random_bits(key, (5,) if params.task == "lane" else (3,))


def _at(tree: Pytree, *index: Array) -> Pytree:
    return jax.tree.map(lambda part: jnp.asarray(part)[index], tree)


def _start(
    bits: Array, node: LaneNode, read: _Reader, objects: Objects | None, params: LaneDriveParams
) -> _Parts:
    # A share needs 16 bits. One word has two of them.
    along, beside, turned = (
        (word & 0xFFFF).astype(jnp.float32) / 2**16 for word in (bits[1], bits[1] >> 16, bits[2])
    )
    # With task "lane" these words are used for the turns alone. Otherwise no turn is random.
    turn = _choose_turn(bits[-1], read, node, params)
    movement = Movement(*node, turn)
    # The robot starts in the first half of its tile.
    length = lane_length(turn, params.lane_offset)
    s = along * length / 2
    d = rounded((2 * beside - 1) * params.start_d)
    if objects is not None:
        s = _find_free_place(s, length, d, movement, objects, params)
    phi = rounded((2 * turned - 1) * params.start_phi)
    pose = lane_point(movement, s, d, params.lane_offset)
    return {
        "pose": pose._replace(theta=wrap_angle(pose.theta + phi)),
        "movement": movement,
        "next_turn": _choose_turn(bits[-2], read, movement.next_node, params),
        "d": jnp.asarray(d, jnp.float32),
        "phi": jnp.asarray(phi, jnp.float32),
        "s": s,
    }


def _find_free_place(
    s: Array,
    length: Array,
    d: Array,
    movement: Movement,
    objects: Objects,
    params: LaneDriveParams,
) -> Array:
    """Returns the first of a few places along a lane where the robot touches no object.

    The first place is `s`. The places after the end of the lane continue from its start. Returns
    `s` if no place is free.
    """
    # `s` is a product, and is rounded before the sum as `rounded` says. The first place is `s`
    # itself.
    steps = rounded(length * (np.arange(1, _START_PLACES, dtype=np.float32) / _START_PLACES))
    further = rounded(s) + steps
    further = jnp.where(further < length, further, further - length)
    places = jnp.concatenate([s[None], further])
    poses = lane_point(movement, places, d, params.lane_offset)
    is_free = ~jax.vmap(partial(stands_on, objects, radius=params.robot.width / 2))(poses)
    return places[jnp.argmax(is_free)]


def _begin(
    level: Level, start: _Parts, params: LaneDriveParams
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
) -> Transition[LaneDriveObservation, LaneDriveState]:
    """Drives for one step of time.

    The episode terminates at the goal of a route, on a dead end, when either side of the robot
    leaves the road, and when it touches an object, unless `LaneDriveParams.collision` is "cost". It
    is truncated at the limit. A robot that leaves its tile by another way than its movement
    continues on that way.

    Args:
      key: consumed, for noise and random turns.
      state: the state before.
      action: two numbers, clipped to -1 to 1, 0 instead of NaN; see `LaneDriveParams.action`.
      params: the options of the environment.
    """
    action = jnp.asarray(action)
    if action.shape != (2,):
        raise InputError(f"action: expected two numbers, shape (2,), got shape {action.shape}")
    if jnp.iscomplexobj(action):
        raise InputError(f"action: expected real numbers, got {action.dtype}")
    # The rewards and the metrics use the same results many times.
    moved, events = once(lambda: _move(key, state, action, params))
    success, off_road, d, phi = events.success, events.off_road, moved["d"], moved["phi"]
    own, oncoming = (
        ~off_road & (jnp.abs(d) <= params.lane_offset),
        ~off_road & (d > params.lane_offset),
    )
    # Products are rounded before they are added, so that single programs and batches return the
    # same bits (see `rounded`).
    costs = rounded(params.offset_cost * jnp.abs(d)) + rounded(params.heading_cost * jnp.abs(phi))
    costs += params.oncoming_cost * jnp.float32(oncoming)
    reward = rounded(params.progress_reward * events.along * jnp.float32(own))
    reward -= rounded(costs * params.robot.dt)
    reward += params.goal_reward * jnp.float32(success) - params.leaving_cost * jnp.float32(
        off_road
    )
    terminated = success | off_road
    if events.collision is not None:
        # A touch that ends the episode costs its price once, any other touch per second.
        ends = params.collision == "terminate"
        duration = 1 if ends else params.robot.dt
        reward -= rounded(params.collision_cost * jnp.float32(events.collision) * duration)
        terminated |= events.collision & ends
    tiles, steps = state.tiles + events.entered.astype(jnp.int32), state.steps + 1
    after = state._replace(**moved, tiles=tiles, steps=steps)
    # A robot that turns round on a tile may need fewer tiles than a shortest way. The metric stays
    # at most 1.
    spl = (
        success.astype(jnp.int32)
        * state.shortest
        / jnp.maximum(jnp.maximum(tiles, state.shortest), 1)
    )
    info = LaneDriveInfo(
        success,
        off_road,
        own,
        oncoming,
        tiles,
        state.shortest,
        spl.astype(jnp.float32),
        events.collision,
    )
    seen = _observe(after, params)
    reward = jnp.asarray(reward, jnp.float32)
    return Transition(
        seen, after, reward, terminated, ~terminated & (steps >= params.limit), info, seen
    )


def _move(
    key: Array, state: LaneDriveState, action: ArrayLike, params: LaneDriveParams
) -> tuple[_Parts, _Events]:
    grid, robot = state.grid, params.robot
    pose, wheels = drive(
        jax.random.fold_in(key, 0), state.pose, state.wheels, _to_command(action, params), robot
    )
    course = _go_on(jax.random.fold_in(key, 1), state, pose, params)
    d, phi, s = lane_errors(pose, course.movement, params.lane_offset)
    # The points at both sides of the robot have to be on the road.
    reach = robot.width / 2 / TILE
    east, south = -reach * jnp.sin(pose.theta), -reach * jnp.cos(pose.theta)
    left = ground_at(grid, pose.x + east, pose.y + south).on_road
    right = ground_at(grid, pose.x - east, pose.y - south).on_road
    here, goal = course.movement.node, state.goal
    # The goal counts only on the lane that leads to it, so the heading is compared, too.
    success = (
        course.entered
        & (here.row == goal.row)
        & (here.column == goal.column)
        & (here.heading == goal.heading)
    )
    success &= params.task == "route"
    # On this tile no turn is open: the lane has ended.
    laneless = _count_open(_turns_of(grid[here.row, here.column], here.heading)) == 0
    off_road = ~success & (course.astray | laneless | ~(left & right))
    facing = jnp.cos(phi)
    # Only the part of the speed in the lane's direction is progress.
    along = wheels.speed * robot.dt / TILE * facing
    # A robot that faces the other way and drives in reverse makes no progress.
    along = jnp.where(facing > 0, along, jnp.minimum(along, 0))
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
    shares = jnp.clip(jnp.nan_to_num(jnp.asarray(action, jnp.float32), nan=0.0), -1, 1)
    if params.action == "wheels":
        return shares
    robot = params.robot
    # The speed is a product, and `to_wheels` adds to it.
    speed = rounded(shares[0] * robot.top_speed)
    return to_wheels(speed, shares[1] * robot.top_turn, robot)


class _Course(NamedTuple):
    """Where a robot goes from a new pose.

    Attributes:
      movement: the movement of the lane that it follows.
      next_turn: int32, the turn of the movement on the next tile.
      entered: bool, whether it came to another tile by a road.
      astray: bool, whether it came to another tile without a road.
    """

    movement: Movement
    next_turn: Array
    entered: Array
    astray: Array


def _go_on(key: Array, state: LaneDriveState, pose: Pose, params: LaneDriveParams) -> _Course:
    """Returns the course of a robot that has come to a new pose."""
    before, grid = state.movement, state.grid
    read = partial(_at, (grid, state.ways))
    down = jnp.floor(pose.y).astype(jnp.int32) - before.row
    right = jnp.floor(pose.x).astype(jnp.int32) - before.column
    code = grid[before.row, before.column].astype(jnp.int32)
    heading, entered = jnp.int32(0), jnp.bool_(False)
    for index, side in enumerate(SIDES):
        # Roads lead to the four neighbours alone. On any other tile the robot is astray.
        is_way = (down == side.down) & (right == side.right) & (code & side.bit > 0)
        heading, entered = jnp.where(is_way, index, heading), entered | is_way
    astray = ~entered & ((down != 0) | (right != 0))
    node = LaneNode(
        jnp.where(entered, before.row + down, before.row),
        jnp.where(entered, before.column + right, before.column),
        jnp.where(entered, heading, before.heading),
    )
    # A robot that leaves its tile as its movement says makes the turn that was announced. Any other
    # way is followed with a turn of its own.
    is_announced = heading == before.next_node.heading
    bits = random_bits(key, (2,)) if params.task == "lane" else jnp.zeros(2, jnp.uint32)
    other = _choose_turn(bits[0], read, node, params)
    turn = jnp.where(entered, jnp.where(is_announced, state.next_turn, other), before.turn)
    movement = Movement(*node, turn)
    onward = _choose_turn(bits[1], read, movement.next_node, params)
    return _Course(movement, jnp.where(entered, onward, state.next_turn), entered, astray)


def _choose_turn(bits: Array, read: _Reader, node: LaneNode, params: LaneDriveParams) -> Array:
    """Returns the turn at a node; straight on if none is open.

    In a route it is the turn of a shortest way, or the first open one if no way leads to the goal.
    Otherwise it is a random open one.
    """
    code, way = read(node.row, node.column)
    turns = _turns_of(code, node.heading)
    if params.task == "lane":
        # The table lists the open turns, so one draw among their number is enough.
        return _open_turn(turns, randint(bits, jnp.maximum(_count_open(turns), 1)))
    # A way has the turns of all four headings, two bits each.
    turn = way.astype(jnp.int32) >> (2 * node.heading) & 3
    return jnp.where(turn == NO_WAY, _open_turn(turns, 0), turn)


def _pack_turns(is_open: NDArray[np.bool_]) -> int:
    """Packs the open turns of a tile for a heading.

    The lowest two bits are the number of open turns, which `_count_open` reads. Two bits for each
    open turn follow, which `_open_turn` reads. If no turn is open, straight on follows.
    """
    # One number with all open turns replaces a loop over turns in each step.
    open_turns = np.flatnonzero(is_open).tolist()
    packed = len(open_turns)
    for index, turn in enumerate(open_turns or [1]):
        packed |= turn << (2 * index + 2)
    return packed


# The packed turns of a tile and a heading are at 4 * code + heading.
_TURNS = np.array([_pack_turns(is_open) for is_open in MOVEMENTS.reshape(-1, 3)], np.int32)


def _turns_of(code: Array, heading: Array) -> Array:
    return jnp.asarray(_TURNS)[code.astype(jnp.int32) * 4 + heading]


def _count_open(turns: Array) -> Array:
    """Returns the number of open turns, 0 to 3, of packed turns."""
    return turns & 3


def _open_turn(turns: Array, index: Numeric) -> Array:
    """Returns an open turn of packed turns, in the order right, straight, left."""
    return turns >> (2 * index + 2) & 3


LaneDrive = Environment(_reset, _reset_to_level, _step, _observe, actions=None, action_size=2)
"""The environment; `LaneDriveParams` has its options.

An action is two numbers, see `LaneDriveParams.action`.
"""

# The speed of `pure_pursuit` in metres a second.
_SPEED = 0.3
# Tiles along the lane, from the point beside the robot to the point that it drives to.
_LOOKAHEAD = 0.12


@name_wrong_arguments
@runs_jax
@divide_batches
def pure_pursuit(state: LaneDriveState, params: LaneDriveParams) -> Float[Array, "2"]:
    """Returns the expert's action, which follows the lane at 0.3 m/s.

    The expert drives along the arc to a point of the lane 0.12 tiles ahead.

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
    turn = _SPEED / TILE * curvature
    if params.action == "twist":
        return jnp.clip(
            jnp.stack([_SPEED / params.robot.top_speed, turn / params.robot.top_turn]), -1, 1
        )
    return to_wheels(_SPEED, turn, params.robot)
