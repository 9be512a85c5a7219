"""Poses on lanes, in JAX.

Lengths are in tiles. x points east and y south from the north-west corner of the grid. Therefore a
position times the side of a tile in pixels is the position in a picture of the map. Angles are
counter-clockwise as seen from above, in radians; 0 is east.

Nodes, movements and the curves of lanes are those of the room `lanes`. There are no U-turns, so a
stub has no movement. `lane_offset` is the distance from the road's middle to the centre of a lane,
a Python number, which compiled programs contain. A tile set may have its own
(`TileSet.lane_offset`).
"""

from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Int, Key
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import (
    Check,
    check_named,
    clip_to_int32,
    instance,
    is_real,
    is_whole,
    real,
)
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.records import one_number
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, ArrayOrRows, Numeric, UserValue
from elitelanes_jax.lanes.curves import (
    LANE_OFFSET,
    check_lane_offset,
    lane_bends,
    lane_lengths,
    lane_radii,
    on_road,
)
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import (
    MOVEMENTS,
    Movement,
    movements_of,
    no_lane_error,
    step_towards,
)
from elitelanes_jax.network.bits import uniform
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import vary_together

# The angle of each heading.
_ANGLE = np.array([np.pi / 2, 0, -np.pi / 2, np.pi], np.float32)
_BEND = lane_bends(np.float32)

# These numbers are added to the offsets in tiles of movements that point away from a pose, and of
# movements that do not exist. The first exceeds any offset on a tile, and the second exceeds the
# sum of both.
_RANK_OF_AWAY, _RANK_OF_NONE = 100.0, 10_000.0


def _turns_taken() -> NDArray[np.int8]:
    """Returns `TURN_TAKEN`."""
    taken = np.empty(MOVEMENTS.shape, np.int8)
    for code, heading, wanted in np.ndindex(*MOVEMENTS.shape):
        # The turns are tried in their order, from the wanted one on.
        in_order = [(wanted + step) % 3 for step in range(3)]
        is_open = MOVEMENTS[code, heading]
        taken[code, heading, wanted] = next((turn for turn in in_order if is_open[turn]), wanted)
    return taken


TURN_TAKEN = _turns_taken()
"""int8 ``[16, 4, 3]``: the turn that is taken for a wanted one, by the tile's code and the heading.

It is the wanted turn or the next open one, in the order right, straight, left, right; the wanted
one if none is open.
"""


# Beartype takes `type[R]` of a class, not of `tuple[...]`.
R = TypeVar("R", bound=tuple)


def single(kind: type[R]) -> Check[R]:
    """Makes a check for one `Pose`, `LaneNode` or `Movement`, whose fields are numbers.

    The fields of a `Pose` are real numbers, all others are whole numbers. The check returns a
    record whose whole numbers JAX can take: as floats in a `Pose`, otherwise clipped to 32 bits.
    """
    is_pose = kind is Pose
    kinds_of_arrays = "iufV" if is_pose else "iu"
    is_number = is_real if is_pose else is_whole
    words = "numbers" if is_pose else "whole numbers"

    def check(value: UserValue) -> R:
        fields = instance(kind)(value)
        if any(map(np.ndim, fields)):
            hint = "jax.vmap takes several"
            raise InputError("", f"one {kind.__name__}", quote(value), hint)
        for field in fields:
            is_array = hasattr(field, "dtype") and field.dtype.kind in kinds_of_arrays
            if not is_array and not is_number(field):
                raise InputError("", f"{kind.__name__} of {words}", quote(value))
        return kind(*map(_to_float if is_pose else clip_to_int32, fields))

    return check


def _to_float(number: Numeric) -> Numeric:
    """Returns a whole number of Python or NumPy as a float; anything else unchanged.

    JAX drops the upper bits of a larger whole number of NumPy, so that 2**32 becomes 0. For one of
    Python it raises `OverflowError`.
    """
    is_scalar = isinstance(number, np.ndarray) and number.dtype.kind in "iu"
    return float(number) if is_scalar or is_whole(number) else number


class Pose(NamedTuple):
    """A position and a direction.

    Attributes:
      x: float32, tiles east of the north-west corner of the grid.
      y: float32, tiles south of it.
      theta: float32, radians counter-clockwise from east.
    """

    x: Float[Array, "..."]
    y: Float[Array, "..."]
    theta: Float[Array, "..."]


class LanePose(NamedTuple):
    """A pose relative to its lane.

    Attributes:
      d: float32, tiles to the left of the lane's centre.
      phi: float32, radians that the pose is turned to the left of the lane, -pi to pi.
      s: float32, tiles along the movement from where it enters its tile.
      on_road: bool, the position is on the road, between the inner edges of the white tape.
      own_lane: bool, on the road and within `lane_offset` of the lane's centre, so not beyond the
        road's middle.
      oncoming: bool, on the road, farther to the left.
      movement: the movement of the lane.
      found: bool, whether that movement exists. If not, `d`, `phi` and `s` are 0, and `own_lane`
        and `oncoming` False.
    """

    d: Float[Array, "..."]
    phi: Float[Array, "..."]
    s: Float[Array, "..."]
    on_road: Bool[Array, "..."]
    own_lane: Bool[Array, "..."]
    oncoming: Bool[Array, "..."]
    movement: Movement
    found: Bool[Array, "..."]


@name_wrong_arguments
@runs_jax
@divide_batches
def movements(grid: Int[ArrayLike, "H W"]) -> Bool[Array, "H W 4 3"]:
    """Returns which movements each tile of a grid has.

    Movements are by the heading when the tile is entered, and by the turn. For traced codes see
    `measure`.

    Raises:
      InputError: for a bad grid.
    """
    return jnp.asarray(MOVEMENTS)[linked_codes(grid)]


def check_lane(codes: ArrayOrRows) -> None:
    """Raises `InputError` for a grid without a movement.

    Traced codes are unknown and not checked.
    """
    if not isinstance(codes, jax.core.Tracer) and not movements_of(codes).row.size:
        raise no_lane_error()


def lane_length(
    turn: Int[ArrayLike, "..."], lane_offset: float = LANE_OFFSET
) -> Float[Array, "..."]:
    """Returns the length of a movement's lane in tiles.

    The length is 1 straight on, and by default 0.3 or 0.7 times pi / 2 on an arc.
    """
    return _choose(lane_lengths(lane_offset, np.float32), turn)


def lane_curvature(
    turn: Int[ArrayLike, "..."], lane_offset: float = LANE_OFFSET
) -> Float[Array, "..."]:
    """Returns the curvature of a movement's lane to the left, in 1 / tiles.

    By default it is -1 / 0.3, 0 or 1 / 0.7.
    """
    return _choose(_BEND / lane_radii(lane_offset, np.float32), turn)


def lane_errors(
    pose: Pose, movement: Movement, lane_offset: float = LANE_OFFSET
) -> tuple[Float[Array, "..."], Float[Array, "..."], Float[Array, "..."]]:
    """Returns `d`, `phi` and `s` of a pose relative to a movement's lane (see `LanePose`).

    The pose is on the movement's tile or beyond. Beyond its tile a lane continues as a line or a
    circle.
    """
    forward, left = _from_entry(pose, movement)
    turned = pose.theta - _choose(_ANGLE, movement.heading)
    bend, radius = _arc_of(movement, lane_offset)
    # With `forward`, this is the position relative to the centre of an arc.
    across = 0.5 - bend * left
    angle = jnp.arctan2(forward, across)
    # Both formulas are computed, and the one for the turn is selected.
    straight = bend == 0
    d = jnp.where(straight, left + lane_offset, bend * (radius - jnp.hypot(forward, across)))
    s = jnp.where(straight, forward, radius * angle)
    return d, wrap_angle(turned - bend * angle), s


def lane_point(
    movement: Movement,
    s: Float[ArrayLike, "..."],
    d: Float[ArrayLike, "..."] = 0.0,
    lane_offset: float = LANE_OFFSET,
) -> Pose:
    """Returns the pose at a position on a movement's lane, in the lane's direction.

    The position is `s` tiles along the lane and `d` tiles to the left of its centre. It may be
    beyond the lane's end.
    """
    bend, radius = _arc_of(movement, lane_offset)
    angle = s / radius
    straight = bend == 0
    forward = jnp.where(straight, s, (radius - bend * d) * jnp.sin(angle))
    left = jnp.where(straight, d - lane_offset, bend * (0.5 - (radius - bend * d) * jnp.cos(angle)))
    (x, y), (ahead_x, ahead_y) = _frame_of(movement)
    x = x + (forward - 0.5) * ahead_x + left * ahead_y
    y = y + (forward - 0.5) * ahead_y - left * ahead_x
    return Pose(x, y, wrap_angle(_choose(_ANGLE, movement.heading) + bend * angle))


@name_wrong_arguments
@runs_jax
def random_pose(
    key: Key[Array, ""],
    grid: Int[ArrayLike, "H W"],
    *,
    offset: Float[ArrayLike, ""] = 0.1,
    heading: Float[ArrayLike, ""] = np.pi / 6,
    lane_offset: float = LANE_OFFSET,
) -> Pose:
    """Draws a pose on the lanes of a grid, as datasets of robots' views do.

    The movement is drawn uniformly from all movements of the grid; the position along it, the
    offset and the angle are uniform too.

    Args:
      key: consumed.
      grid: integer codes ``[H, W]`` with at least one movement; for traced codes see
        `measure`.
      offset: largest distance from the lane's centre in tiles, either way.
      heading: largest angle from the lane's direction in radians, either way.
      lane_offset: tiles from the road's middle to the centre of a lane.

    Raises:
      InputError: for a bad grid, a grid without a lane, a negative or infinite `offset` or
        `heading`, or a `lane_offset` that is not over 0 and under 0.5.
    """
    lane_offset = check_named("lane_offset", check_lane_offset, lane_offset)
    offset = check_named("offset", one_number(real(0)), offset)
    heading = check_named("heading", one_number(real(0)), heading)
    codes = check_grid(grid)
    check_lane(codes)
    return _random_pose(key, codes, offset, heading, lane_offset=lane_offset)


# Uncompiled operations round products that compiled ones add without rounding.
@partial(jax.jit, static_argnames="lane_offset")
@divide_batches
def _random_pose(
    key: Array, grid: AnyArray, offset: ArrayLike, heading: ArrayLike, *, lane_offset: float
) -> Pose:
    exists = movements(grid)
    choice, along, across, angle = uniform(key, (4,))
    movement = _nth_movement(exists, choice)
    return pose_beside(
        movement, along, across, angle, offset=offset, heading=heading, lane_offset=lane_offset
    )


def _nth_movement(exists: Bool[Array, "H W 4 3"], choice: Float[Array, ""]) -> Movement:
    """Returns the movement at a share, 0 to 1, of all that exist."""
    count = jnp.cumsum(exists.reshape(-1))
    # The movement is the first one where the running count exceeds this number.
    number = jnp.floor(choice * count[-1].astype(jnp.float32)).astype(jnp.int32)
    # JAX 0.7 looks up only arrays that differ between the same devices.
    index = jnp.searchsorted(*vary_together((count, number + 1)))
    index = jnp.minimum(index, count.size - 1).astype(jnp.int32)
    return Movement(*jnp.unravel_index(index, exists.shape))


def pose_beside(
    movement: Movement,
    along: Array,
    across: Array,
    angle: Array,
    *,
    offset: ArrayLike,
    heading: ArrayLike,
    lane_offset: float = LANE_OFFSET,
) -> Pose:
    """Returns the pose of `random_pose` for uniform numbers, 0 to 1.

    The numbers are for the position along the movement and across it, and for the angle.
    """
    s = along * lane_length(movement.turn, lane_offset)
    pose = lane_point(movement, s, (2 * across - 1) * offset, lane_offset)
    return pose._replace(theta=wrap_angle(pose.theta + (2 * angle - 1) * heading))


class Ground(NamedTuple):
    """What is at a point of a map.

    Attributes:
      row: int32, the row of the tile.
      column: int32, the column of the tile.
      code: the code of the tile; 0 beyond the grid.
      on_road: bool, whether the point is on the tile's road.
    """

    row: Int[Array, ""]
    column: Int[Array, ""]
    code: Int[Array, ""]
    on_road: Bool[Array, ""]


def ground_at(grid: Int[Array, "H W"], x: Float[ArrayLike, ""], y: Float[ArrayLike, ""]) -> Ground:
    """Returns the tile at a point, and whether the point is on its road."""
    height, width = grid.shape
    row, column = jnp.floor(y).astype(jnp.int32), jnp.floor(x).astype(jnp.int32)
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    # JAX would read the nearest cell for an index beyond the grid.
    code = jnp.where(inside, grid[jnp.clip(row, 0, height - 1), jnp.clip(column, 0, width - 1)], 0)
    east = jnp.subtract(x, column.astype(jnp.float32))
    south = jnp.subtract(y, row.astype(jnp.float32))
    return Ground(row, column, code, on_road(code, east, south))


@name_wrong_arguments
@runs_jax
def lane_pose(
    grid: Int[ArrayLike, "H W"],
    pose: Pose,
    movement: Movement | None = None,
    *,
    lane_offset: float = LANE_OFFSET,
) -> LanePose:
    """Computes the position of a pose on the lanes of a grid.

    Args:
      grid: integer codes ``[H, W]``; for traced ones see `measure`.
      pose: finite; beyond the grid it is on no road.
      movement: the movement of the lane to use. By default, of the movements on the pose's tile
        that point less than a quarter turn away from it, the one with the smallest offset; if none
        does, the one with the smallest offset. Among equal ones the first heading clockwise from
        north is used, then right before straight before left.
      lane_offset: tiles from the road's middle to the centre of a lane.

    Raises:
      InputError: for a bad grid, a pose that is not a `Pose`, or a movement that is not a
        `Movement` of whole numbers. Also for a `lane_offset` that is not over 0 and under 0.5.
    """
    lane_offset = check_named("lane_offset", check_lane_offset, lane_offset)
    pose = check_named("pose", single(Pose), pose)
    if movement is not None:
        movement = check_named("movement", single(Movement), movement)
    return _lane_pose(check_grid(grid), pose, movement, lane_offset=lane_offset)


@partial(jax.jit, static_argnames="lane_offset")
@divide_batches
def _lane_pose(
    grid: Array, pose: Pose, movement: Movement | None, *, lane_offset: float
) -> LanePose:
    links = linked_codes(grid)
    pose = Pose(*(jnp.asarray(part, jnp.float32) for part in pose))
    ground = ground_at(links, pose.x, pose.y)
    if movement is None:
        movement = nearest_movement(ground.code, pose, ground.row, ground.column, lane_offset)
    else:
        movement = Movement(*(jnp.asarray(part, jnp.int32) for part in movement))
    # A movement that the caller gives need not exist.
    found = _has_movement(links, movement)
    d, phi, s = (jnp.where(found, error, 0) for error in lane_errors(pose, movement, lane_offset))
    return LanePose(
        d,
        phi,
        s,
        on_road=ground.on_road,
        own_lane=ground.on_road & found & (jnp.abs(d) <= lane_offset),
        oncoming=ground.on_road & found & (d > lane_offset),
        movement=movement,
        found=found,
    )


def _has_movement(links: Array, movement: Movement) -> Bool[Array, ""]:
    """Returns whether a grid of links has a movement. Its fields may be any whole numbers."""
    exists = jnp.bool_(True)
    for index, count in zip(movement, (*links.shape, *MOVEMENTS.shape[1:]), strict=True):
        # JAX reads the nearest index instead of one that is too large.
        exists &= (index >= 0) & (index < count)
    code = links[movement.row, movement.column].astype(jnp.int32)
    return exists & jnp.asarray(MOVEMENTS)[code, movement.heading, movement.turn]


def nearest_movement(
    code: Array, pose: Pose, row: Array, column: Array, lane_offset: float = LANE_OFFSET
) -> Movement:
    """Returns the movement that `lane_pose` uses by default.

    `code` is the code of the tile, and has only links.
    """
    # All twelve movements of a tile are compared at once.
    heading, turn = (jnp.asarray(index, jnp.int32) for index in np.indices((4, 3)).reshape(2, 12))
    d, phi, _ = lane_errors(pose, Movement(row, column, heading, turn), lane_offset)
    exists = jnp.asarray(MOVEMENTS)[code].reshape(12)
    points_away = jnp.cos(phi) <= 0
    # Ranks are offsets. A movement that points away comes after all that do not, and one that does
    # not exist after all others.
    rank = (
        jnp.abs(d)
        + jnp.where(points_away, _RANK_OF_AWAY, 0.0)
        + jnp.where(exists, 0.0, _RANK_OF_NONE)
    )
    best = jnp.argmin(rank)
    return Movement(row, column, heading[best], turn[best])


def _from_entry(pose: Pose, movement: Movement) -> tuple[Array, Array]:
    """Returns a point's distances from the middle of the side by which a movement enters.

    The first distance is forward, and the second one to the left.
    """
    (x, y), (ahead_x, ahead_y) = _frame_of(movement)
    east, south = pose.x - x, pose.y - y
    return east * ahead_x + south * ahead_y + 0.5, east * ahead_y - south * ahead_x


def _frame_of(movement: Movement) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Returns the middle of a movement's tile, and the direction in which the tile is entered.

    Both are in tiles east and south.
    """
    x, y = (jnp.asarray(part, jnp.float32) + 0.5 for part in (movement.column, movement.row))
    down, right = step_towards(jnp.asarray(movement.heading, jnp.int32))
    return (x, y), (right.astype(jnp.float32), down.astype(jnp.float32))


def _arc_of(movement: Movement, lane_offset: float) -> tuple[Array, Array]:
    """Returns how a movement's lane bends, -1 right, 0 straight, 1 left, and its radius in tiles."""
    radii = lane_radii(lane_offset, np.float32)
    return _choose(_BEND, movement.turn), _choose(radii, movement.turn)


def _choose(table: NDArray[np.generic], index: Int[ArrayLike, "..."]) -> Array:
    """Reads a table of a few numbers.

    Unlike a look-up, selections let the compiler use the processor's vectors.
    """
    # The last row is the default, so a table of N rows needs N - 1 selections.
    chosen = jnp.asarray(table[-1])
    for row in range(len(table) - 2, -1, -1):
        chosen = jnp.where(jnp.asarray(index) == row, table[row], chosen)
    return chosen


def wrap_angle(angle: Float[ArrayLike, "..."]) -> Float[Array, "..."]:
    """Returns the equal angle within -pi to pi, in radians."""
    angle = jnp.asarray(angle)
    # Rounding may leave an angle a little beyond pi.
    return jnp.clip(angle - 2 * jnp.pi * jnp.ceil(angle / (2 * jnp.pi) - 0.5), -jnp.pi, jnp.pi)
