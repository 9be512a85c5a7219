"""Plans of views: all numbers of a view, before it is drawn.

The numbers of all views of a batch are drawn first: poses, cameras, and a table for each view with
a row for each row of pixels.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32, Key, UInt32

from elitelanes_jax.drive._billboards import Floor
from elitelanes_jax.drive._ground import UNIT, Rows, meet_ground
from elitelanes_jax.drive._hashing import fork, hash_bits, uniform
from elitelanes_jax.drive._objects import Objects, stands_on
from elitelanes_jax.drive._scenes import Blend, SceneMap, Scenes
from elitelanes_jax.drive._variation import LOOK_NUMBERS, Look, draw_look
from elitelanes_jax.drive.camera_options import STEEPEST, WIDEST, Camera, Variation
from elitelanes_jax.drive.lanes import (
    Pose,
    lane_curvature,
    lane_errors,
    nearest_movement,
    pose_beside,
)
from elitelanes_jax.drive.robot import Robot
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.network.bits import random_bits
from elitelanes_jax.network.xla import vary_together

# The radius of a robot in metres.
_ROBOT = Robot().width / 2
# A view has a seed of other poses, one of the pictures of tiles, and one of its look.
_SEEDS = 3
# Uniform numbers of a view: map, height, pitch, field of view, lines, and four of the pose.
_NUMBERS = 9
# The most further tries to draw a pose where the robot touches no object. With a dozen robots in
# the lanes of a 5 x 5 town, a pose touches an object in one of seven cases. So all 64 poses fail
# only if objects fill the lanes.
_TRIES = 64


class Plan(NamedTuple):
    """The numbers of one view. In a batch every shape starts with B.

    Attributes:
      map: int32, the index of the map.
      pose: the pose of the middle between the wheels.
      movement: the movement on whose lane the pose was drawn.
      errors: float32 ``[3]``: the offset from the lane of `movement` in tiles, the angle to it in
        radians, and its curvature in 1 / tiles. Offset and angle are to the left.
      lane: float32 ``[3]``, the same for the nearest lane.
      cells: int32 ``[H * W]``, the picture of each cell, with the map's border.
      samples: the rows of samples.
      centres: the rows of pixels' centres, in the largest pictures of tiles.
      lines: float32, the shift of positions at the white lines of a tile, in 2**-20 tile; None for
        none.
      camera: the camera with the height, pitch and field of view that were drawn.
      look: the numbers of the variation.
      objects: the objects of the map; None if no map has any.
      pictures: int32 ``[O]``, the billboards that show the objects; None if no map has objects.
      floor: the objects on the floor; None if no map has any.
      blend: how the tiles are blended; None if they are not.
    """

    map: Int32[Array, ""]
    pose: Pose
    movement: Movement
    errors: Float[Array, "3"]
    lane: Float[Array, "3"]
    cells: Int32[Array, " N"]
    samples: Rows
    centres: Rows
    lines: Float[Array, ""] | None
    camera: Camera
    look: Look
    objects: Objects | None
    pictures: Int32[Array, " O"] | None
    floor: Floor | None
    blend: Blend | None


def plan_views(
    key: Key[Array, ""],
    indices: Int32[Array, " B"],
    scenes: Scenes,
    camera: Camera,
    variation: Variation,
    *,
    samples: int,
    maps: Int32[Array, " B"] | None = None,
) -> Plan:
    """Plans a batch of views.

    A view depends on the key and its index alone, not on the batch. The numbers of `camera` and
    `variation` are numbers, or arrays ``[B]``. `maps` has the map of each view; by default maps are
    drawn.
    """
    keys = jax.vmap(partial(jax.random.fold_in, key))(indices)
    # Each view gets its own options, also where they are equal.
    camera, variation = jax.tree.map(
        lambda number: jnp.broadcast_to(jnp.asarray(number, jnp.float32), len(indices)),
        (camera, variation),
    )
    plan = partial(_plan_view, samples=samples)
    return jax.vmap(plan, in_axes=(0, None, 0, 0, 0))(keys, scenes, camera, variation, maps)


def _plan_view(
    key: Array,
    scenes: Scenes,
    camera: Camera,
    variation: Variation,
    number: Int32[Array, ""] | None,
    *,
    samples: int,
) -> Plan:
    """Draws all numbers of one view."""
    # One call, because each call of the generator compiles for half a second.
    bits = random_bits(key, (_SEEDS + _NUMBERS + LOOK_NUMBERS,))
    pose_seed, tile_seed, look_seed = bits[:_SEEDS]
    numbers = uniform(bits[_SEEDS:])
    which, *wobbles, lines = numbers[:5]
    if number is None:
        number = (which * len(scenes.maps.codes)).astype(jnp.int32)
    # The scene is the map that the view shows.
    scene = jax.tree.map(lambda part: part[number], scenes.maps)
    lane_offset = scenes.lane_offset
    pose, movement, errors = _draw_pose(
        numbers[5:_NUMBERS], pose_seed, scene, variation, lane_offset
    )
    # Wobbles are factors. The angles are limited, because a wobble may exceed what a camera can
    # have.
    lower, tilt, wide = (1 + (2 * wobble - 1) * variation.wobble for wobble in wobbles)
    camera = camera.replace(
        height=camera.height * lower,
        pitch=jnp.clip(camera.pitch * tilt, -STEEPEST, STEEPEST),
        field_of_view=jnp.minimum(camera.field_of_view * wide, WIDEST),
    )
    stretch = None
    if variation.lines is not None:
        stretch = (2 * lines - 1) * variation.lines * np.float32(1 << UNIT)
    look = draw_look(look_seed, numbers[_NUMBERS:], variation, camera)
    return Plan(
        number,
        pose,
        movement,
        errors,
        _lane_of(pose, scene, lane_offset),
        _choose_pictures(tile_seed, scene, scenes),
        meet_ground(pose, camera, scenes.sizes, samples, smaller=True),
        meet_ground(pose, camera, scenes.sizes, 1, smaller=False),
        stretch,
        camera,
        look,
        scene.objects,
        _choose_billboards(tile_seed, scene),
        scene.floor,
        scene.blend,
    )


def _draw_pose(
    numbers: Float[Array, "4"],
    seed: UInt32[Array, ""],
    scene: SceneMap,
    variation: Variation,
    lane_offset: float,
) -> tuple[Pose, Movement, Float[Array, "3"]]:
    """Returns the pose of uniform numbers, its movement, and its errors; see `Plan`.

    If the robot would touch an object, others are hashed, at most 64 times.
    """

    def place(numbers: Float[Array, "4"]) -> tuple[Pose, Movement, Float[Array, "3"]]:
        which, along, beside, turned = numbers
        # The largest number of `uniform` times a count of up to 2**24 is still under the count.
        index = (which * scene.movement_count).astype(jnp.int32)
        movement = Movement(*scene.movements[index])
        heading = jnp.deg2rad(variation.heading)
        pose = pose_beside(
            movement,
            along,
            beside,
            turned,
            offset=variation.offset,
            heading=heading,
            lane_offset=lane_offset,
        )
        d, phi = (2 * beside - 1) * variation.offset, (2 * turned - 1) * heading
        return pose, movement, jnp.stack([d, phi, lane_curvature(movement.turn, lane_offset)])

    objects = scene.objects
    if objects is None:
        return place(numbers)

    def is_bad(carry: tuple[Array, tuple[Pose, Movement, Array]]) -> Array:
        attempt, (pose, *_) = carry
        return (attempt < _TRIES) & stands_on(objects, pose, _ROBOT)

    def retry(
        carry: tuple[Array, tuple[Pose, Movement, Array]],
    ) -> tuple[Array, tuple[Pose, Movement, Array]]:
        attempt, _ = carry
        return attempt + 1, place(uniform(hash_bits(fork(seed, attempt), (4,))))

    first = vary_together((jnp.int32(0), place(numbers)))
    return jax.lax.while_loop(is_bad, retry, first)[1]


def _lane_of(pose: Pose, scene: SceneMap, lane_offset: float) -> Float[Array, "3"]:
    row, column = jnp.floor(pose.y).astype(jnp.int32), jnp.floor(pose.x).astype(jnp.int32)
    # The scene has a border of one tile, and poses do not count it.
    code = scene.links[row + 1, column + 1]
    movement = nearest_movement(code, pose, row, column, lane_offset)
    d, phi, _ = lane_errors(pose, movement, lane_offset)
    return jnp.stack([d, phi, lane_curvature(movement.turn, lane_offset)])


def _choose_pictures(seed: Array, scene: SceneMap, scenes: Scenes) -> Int32[Array, " N"]:
    """Draws a picture for each cell among all that show its code, unless the map has them."""
    if scene.cells is not None:
        return scene.cells
    codes = scene.codes.reshape(-1)
    return scenes.tiles[codes, _draw_indices(seed, scenes.picture_counts[codes])]


def _choose_billboards(seed: Array, scene: SceneMap) -> Int32[Array, " O"] | None:
    """Draws a picture for each object among all that may show it."""
    if scene.choices is None:
        return None
    first, numbers = scene.choices.T
    return first + _draw_indices(fork(seed, 1), numbers)


def _draw_indices(seed: Array, numbers: Int32[Array, " N"]) -> Int32[Array, " N"]:
    """Draws an index below each of the numbers."""
    return (uniform(hash_bits(seed, numbers.shape)) * numbers).astype(jnp.int32)
