"""Where a robot of LaneDrive goes: the turn at each node, and the course from each pose."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool
from numpy.typing import NDArray

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._distances import NO_WAY
from elitelanes_jax.drive._environment import read_at
from elitelanes_jax.drive._lane_drive_records import LaneDriveParams, LaneDriveState
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.lanes.movements import MOVEMENTS, LaneNode, Movement
from elitelanes_jax.network.bits import randint, random_bits
from elitelanes_jax.network.codes import SIDES

TileReader: TypeAlias = Callable[[Array, Array], tuple[Array, Array]]
"""A function that returns the code and the ways of the tile at a row and a column."""


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
