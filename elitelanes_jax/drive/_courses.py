"""Where a robot of LaneDrive starts and goes: the turn at each node, and the course from each pose.

A start is a pose near the middle of a lane, where the robot touches no object if possible.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool
from numpy.typing import NDArray

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._distances import NO_WAY
from elitelanes_jax.drive._environment import read_at
from elitelanes_jax.drive._lane_drive_records import LaneDriveParams, LaneDriveState, Parts
from elitelanes_jax.drive._objects import Objects, stands_on
from elitelanes_jax.drive.lanes import Pose, lane_length, lane_point, wrap_angle
from elitelanes_jax.lanes.movements import MOVEMENTS, LaneNode, Movement
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.codes import SIDES
from elitelanes_jax.network.xla import rounded

# The places, evenly along the lane of a tile, at which a start that touches no object is sought.
_PLACES = 8

TileReader: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""A function that returns the code and the ways of the tile at a row and a column."""


def draw_bits(key: Array, params: LaneDriveParams) -> Array:
    """Draws all bits of a reset at once.

    There is a word for the level, two words for the start, and one for each random turn.
    """
    return random_bits(key, (5,) if params.task == "lane" else (3,))


def draw_start(
    bits: Array, node: LaneNode, read: TileReader, objects: Objects | None, params: LaneDriveParams
) -> Parts:
    """Returns the parts of a state that a start at a node decides, from bits of `draw_bits`."""
    # A share needs 16 bits. One word has two of them.
    along, beside, turned = (
        (word & 0xFFFF).astype(jnp.float32) / 2**16 for word in (bits[1], bits[1] >> 16, bits[2])
    )
    # With task "lane" these words are used for the turns alone. Otherwise no turn is random.
    turn = choose_turn(bits[-1], read, node, params)
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
        "next_turn": choose_turn(bits[-2], read, movement.next_node, params),
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
    steps = rounded(length * (np.arange(1, _PLACES, dtype=np.float32) / _PLACES))
    further = rounded(s) + steps
    further = jnp.where(further < length, further, further - length)
    places = jnp.concatenate([s[None], further])
    poses = lane_point(movement, places, d, params.lane_offset)
    is_free = ~jax.vmap(partial(stands_on, objects, radius=params.robot.width / 2))(poses)
    return places[jnp.argmax(is_free)]


class Course(NamedTuple):
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


def go_on(key: Array, state: LaneDriveState, pose: Pose, params: LaneDriveParams) -> Course:
    """Returns the course of a robot that has come to a new pose."""
    before = state.movement
    down = jnp.floor(pose.y).astype(jnp.int32) - before.row
    right = jnp.floor(pose.x).astype(jnp.int32) - before.column
    code = state.grid[before.row, before.column].astype(jnp.int32)
    heading, entered = _find_road(code, down, right)
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
    read = partial(read_at, (state.grid, state.ways))
    other = choose_turn(bits[0], read, node, params)
    turn = jnp.where(entered, jnp.where(is_announced, state.next_turn, other), before.turn)
    movement = Movement(*node, turn)
    onward = choose_turn(bits[1], read, movement.next_node, params)
    return Course(movement, jnp.where(entered, onward, state.next_turn), entered, astray)


def _find_road(code: Array, down: Array, right: Array) -> tuple[Array, Array]:
    """Returns the heading of the road from a tile to another one, and whether there is one.

    `code` is that of the tile, whose links are roads. The other tile is some rows down and some
    columns right. Without a road the heading is 0.
    """
    heading, exists = jnp.int32(0), jnp.bool_(False)
    for index, side in enumerate(SIDES):
        # Roads lead to the four neighbours alone.
        is_road = (down == side.down) & (right == side.right) & (code & side.bit > 0)
        heading = jnp.where(is_road, index, heading)
        exists |= is_road
    return heading, exists


def choose_turn(bits: Array, read: TileReader, node: LaneNode, params: LaneDriveParams) -> Array:
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


def ends_lane(grid: Array, node: LaneNode) -> Bool[Array, ""]:
    """Returns whether the lane ends on the tile of a node, because no turn is open there."""
    return _count_open(_turns_of(grid[node.row, node.column], node.heading)) == 0


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
    """Returns the packed turns of a tile and a heading."""
    return jnp.asarray(_TURNS)[code.astype(jnp.int32) * 4 + heading]


def _count_open(turns: Array) -> Array:
    """Returns the number of open turns, 0 to 3, of packed turns."""
    return turns & 3


def _open_turn(turns: Array, index: Numeric) -> Array:
    """Returns an open turn of packed turns, in the order right, straight, left."""
    return turns >> (2 * index + 2) & 3
