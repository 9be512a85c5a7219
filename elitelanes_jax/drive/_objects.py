"""Objects of maps as arrays, and whether a robot touches one."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, listed
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive.lanes import Pose, wrap_angle
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.objects import OBJECT_KINDS, base_kind
from elitelanes_jax.formats.road_map import RoadMap

# The position, in tiles, of objects that fill up a batch.
_AWAY = -1e6


class Objects(NamedTuple):
    """The objects of a map.

    A batch has N in front of every shape. Its maps are filled up with objects far away.

    Attributes:
      kind: int32 ``[M]``, the index in `OBJECT_KINDS`.
      x: float32 ``[M]``, tiles.
      y: float32 ``[M]``, tiles.
      angle: float32 ``[M]``, of its front, radians.
      height: float32 ``[M]``, metres.
      radius: float32 ``[M]``, of the disc around its footprint, metres; 0 for tags on the floor.
    """

    kind: Int32[Array, " M"]
    x: Float[Array, " M"]
    y: Float[Array, " M"]
    angle: Float[Array, " M"]
    height: Float[Array, " M"]
    radius: Float[Array, " M"]


@name_wrong_arguments
@runs_jax
def make_objects(maps: Sequence[RoadMap]) -> Objects | None:
    """Makes the objects of maps, a batch; None if no map has any.

    Raises `InputError` for other things than maps.
    """
    check_named("maps", listed(RoadMap), maps)
    if not any(road_map.objects for road_map in maps):
        return None
    return stack_objects(maps)


def stack_objects(maps: Sequence[RoadMap], room: int = 0) -> Objects:
    """Stacks the objects of maps, with room for `room` objects of a map at least."""
    objects_of_maps = [road_map.objects or () for road_map in maps]
    shape = len(maps), max(room, *map(len, objects_of_maps))
    # What fills up a batch is far away and has neither height nor radius.
    fields = np.zeros((6, *shape), np.float32)
    fields[1:3] = _AWAY
    kinds = list(OBJECT_KINDS)
    for number, map_objects in enumerate(objects_of_maps):
        for index, thing in enumerate(map_objects):
            kind = kinds.index(base_kind(thing.kind))
            # A robot drives over objects without height.
            radius = thing.radius if thing.height else 0
            fields[:, number, index] = kind, thing.x, thing.y, thing.angle, thing.height, radius
    return Objects(jnp.asarray(fields[0], jnp.int32), *map(jnp.asarray, fields[1:]))


def stands_on(objects: Objects, pose: Pose, radius: Numeric) -> Bool[Array, ""]:
    """Returns whether a disc, of a radius in metres, touches an object's disc where it stands."""
    # Squares are compared, because a root for each object takes most of the time.
    to_east, to_south = (objects.x - pose.x) * TILE, (objects.y - pose.y) * TILE
    reach = objects.radius + radius
    is_near = to_east**2 + to_south**2 <= reach**2
    return ((objects.radius > 0) & is_near).any()


def touches(objects: Objects, start: Pose, end: Pose, radius: Numeric) -> Bool[Array, ""]:
    """Returns whether a disc touches an object's disc anywhere on an arc between two poses.

    The arc is less than half a turn. The radius is in metres. Objects that lie on the floor are not
    touched.
    """
    turn = wrap_angle(end.theta - start.theta)
    # `way` and the positions below are metres to the east and to the north of the start.
    way = jnp.stack([end.x - start.x, start.y - end.y]) * TILE
    length = jnp.hypot(*way)
    offset = jnp.stack([(objects.x - start.x) * TILE, (start.y - objects.y) * TILE])
    # Nearly straight arcs are lines: from them an arc is at most 1/4000 of its length away.
    is_line = (jnp.abs(turn) < 1e-3) | (length < 1e-6)
    # `share` is the share of the line before its nearest point to each object.
    share = jnp.clip(way @ offset / jnp.where(length > 0, length, 1) ** 2, 0, 1)
    to_line = jnp.hypot(*(offset - share[None] * way[:, None]))
    # The centre of the arc is to the left of the middle of the chord. Its distance is half of the
    # chord over the tangent of half of the turn. For lines any turn serves, because their result is
    # not used.
    half = jnp.where(is_line, 1, turn) / 2
    left = jnp.stack([-way[1], way[0]])
    centre = (way + left / jnp.tan(half)) / 2
    # `round_it` has the objects relative to the centre of the arc.
    round_it = offset - centre[:, None]
    away = jnp.hypot(*round_it)
    # `middle` points from the centre to the middle of the arc. An object at most half of the turn
    # away from this direction is nearest to the arc itself. Any other object is nearest to an end.
    middle = -jnp.sign(half) * left / jnp.where(length > 0, length, 1)
    beside = middle @ round_it >= away * jnp.cos(half)
    ends = jnp.minimum(jnp.hypot(*offset), jnp.hypot(*(offset - way[:, None])))
    to_arc = jnp.where(beside, jnp.abs(away - jnp.hypot(*centre)), ends)
    reach = objects.radius + radius
    return ((objects.radius > 0) & (jnp.where(is_line, to_line, to_arc) <= reach)).any()
