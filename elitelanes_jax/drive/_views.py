"""Batches of different views from robots on the lanes of maps, drawn inside a training program.

The numbers of all views are drawn first, for the whole batch: poses, cameras, and a table for each
view with a row for each row of pixels. Then the pictures are drawn. A processor draws one view at a
time, because the arrays of one view fit its caches. A GPU draws all at once.

Positions on the map are whole numbers, in units of 2**-20 tile, because their bits are the cell,
the pixel of the tile's picture and the rest. Pixels see smaller pictures of tiles at larger
distances, as in the views of datasets.
"""

from collections.abc import Iterator
from functools import partial
from itertools import count
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32, Key, UInt8, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, frozen_copy, instance, whole
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.drive._camera import Camera, focal_length, rays_of, reach_ground
from elitelanes_jax.drive._hashing import fork, hash_bits, uniform
from elitelanes_jax.drive._objects import Floor, Objects, Rays, lie, see_objects, stands_on
from elitelanes_jax.drive._scenes import PAVED, SceneMap, Scenes
from elitelanes_jax.drive._variation import (
    LOOK_NUMBERS,
    Look,
    Variation,
    draw_look,
    lay_background,
    photograph,
)
from elitelanes_jax.drive.lanes import (
    Pose,
    lane_curvature,
    lane_errors,
    nearest_movement,
    pose_beside,
)
from elitelanes_jax.drive.robot import TILE, Robot
from elitelanes_jax.lanes.movements import Movement
from elitelanes_jax.network.bits import check_key, random_bits, seed_key
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import once, vary_together

# The bits of a position after the point.
_UNIT = 20
# The largest position in tiles. In units of 2**-20 tile it is just under 2**31, so it fits an
# int32.
_FARTHEST = 2000.0
# The distance of the white line from the tile's edge, in tiles.
_WHITE_LINE = 0.09
# The radius of a robot in metres.
_ROBOT = Robot().width / 2
# A view has a seed of other poses, one of the pictures of tiles, and one of its look.
_SEEDS = 3
# Uniform numbers of a view: map, height, pitch, field of view, lines, and four of the pose.
_NUMBERS = 9
# The most further tries to draw a pose where the robot touches no object.
_TRIES = 64
# The largest pitch and field of view in degrees after a wobble. A camera looks straight down at 90,
# and straight up at -90. At 180, the picture would have no focal length.
_STEEPEST, _WIDEST = 90, 175


class Views(NamedTuple):
    """A batch of B views.

    Attributes:
      images: uint8 ``[B, rows, columns, 3]``, RGB.
      labels: uint8 ``[B, rows, columns]``, indices of `tiles.LABELS`; 0 beyond the map, above the
        horizon and on objects.
      lanes: float32 ``[B, 3]``, the offset from the nearest lane in tiles and the angle to it in
        radians, both to the left, and its curvature in 1 / tiles. Lanes are those of the tile set.
      poses: the poses of the middle between the wheels, each field float32 ``[B]``.
      maps: int32 ``[B]``, the index of the map.
      instances: int32 ``[B, rows, columns]``, 0, or the index of the object that is seen plus 1;
        None without objects.
    """

    images: UInt8[Array, "B rows columns 3"]
    labels: UInt8[Array, "B rows columns"]
    lanes: Float[Array, "B 3"]
    poses: Pose
    maps: Int32[Array, " B"]
    instances: Int32[Array, "B rows columns"] | None = None


class _Rows(NamedTuple):
    """Where the rows of a picture meet the ground.

    Every shape is ``[R, 1]``, a row for each row of samples.

    Attributes:
      x: int32, position of the middle column, in 2**-20 tile, with the map's border.
      x_step: int32, from a column to the next.
      y: int32, as x.
      y_step: int32, as x_step.
      first: int32, the first pixel of the pictures' size in a row of the pyramid.
      bits: int32, the logarithm to base 2 of the side of these pictures.
      seen: bool, whether the row shows ground.
    """

    x: Int32[Array, "R 1"]
    x_step: Int32[Array, "R 1"]
    y: Int32[Array, "R 1"]
    y_step: Int32[Array, "R 1"]
    first: Int32[Array, "R 1"]
    bits: Int32[Array, "R 1"]
    seen: Bool[Array, "R 1"]


class _Plan(NamedTuple):
    """The numbers of one view. In a batch every shape starts with B.

    Attributes:
      map: int32, the index of the map.
      pose: the pose of the middle between the wheels.
      lane: float32 ``[3]``, of `Views`.
      cells: int32 ``[H * W]``, the picture of each cell, with the map's border.
      samples: the rows of samples.
      centres: the rows of pixels' centres, in the largest pictures of tiles.
      lines: float32, the shift of positions where a tile is stretched most, in 2**-20 tile; None
        for none.
      camera: the camera with the height, pitch and field of view that were drawn.
      look: the numbers of the variation.
      objects: the objects of the map; None if no map has any.
      pictures: int32 ``[O]``, the billboards that show the objects; None if no map has objects.
      floor: the objects on the floor; None if no map has any.
    """

    map: Int32[Array, ""]
    pose: Pose
    lane: Float[Array, "3"]
    cells: Int32[Array, " N"]
    samples: _Rows
    centres: _Rows
    lines: Float[Array, ""] | None
    camera: Camera
    look: Look
    objects: Objects | None
    pictures: Int32[Array, " O"] | None
    floor: Floor | None


@name_wrong_arguments
def views(
    key: Key[Array, ""],
    scenes: Scenes,
    batch: int,
    *,
    camera: Camera = Camera(),
    variation: Variation = Variation(),
    samples: int = 2,
) -> Views:
    """Draws a batch of views with labels and lane poses.

    This is a pure function for the inside of compiled programs. The map of each view and the pose
    on its lanes are drawn as `elitelanes dataset --camera` draws them, but from other random
    numbers. View i depends on the key and i alone, not on the batch.

    Args:
      key: consumed.
      scenes: maps and pictures, of `make_scenes`.
      batch: the number of views; static.
      camera: its options; numbers may be arrays ``[batch]``. Its noise is added to the variation's.
        A distorted lens is not drawn.
      variation: the ranges of poses, cameras and pictures.
      samples: n, 1 to 4: each pixel is the mean of n x n points; static. One point is faster, but
        thin lines flicker.

    Raises:
      InputError: for an argument of another type or out of its range, or a camera with distortion.
    """
    _check_arguments(scenes, batch, camera, variation, samples)
    check_key(key)
    return _draw(key, scenes, camera, variation, batch=int(batch), samples=int(samples))


@name_wrong_arguments
def stream_views(
    seed: int,
    scenes: Scenes,
    batch: int,
    *,
    camera: Camera = Camera(),
    variation: Variation = Variation(),
    samples: int = 2,
    first: int = 0,
) -> Iterator[Views]:
    """Yields batches of views without end, for training programs that do not use JAX.

    The next batch is drawn in the background while the caller uses the last one. On a processor
    ``np.asarray`` and ``torch.from_dlpack`` read the arrays without a copy. NumPy's array is
    read-only.

    Args:
      seed: the seed of all batches, 0 to 2**32 - 1.
      scenes: see `views`.
      batch: see `views`.
      camera: see `views`.
      variation: see `views`.
      samples: see `views`.
      first: the index of the first batch, to resume a training. Batch i is the same in each stream
        of the seed.

    Raises:
      InputError: as `views`, at the call.
    """
    key, first = seed_key(check_named("seed", SEED, seed)), check_named("first", whole(0), first)
    _check_arguments(scenes, batch, camera, variation, samples)
    draw = partial(
        _draw,
        # Put on the device once, because every batch would transfer an array of NumPy.
        scenes=jax.device_put(jax.tree.map(frozen_copy, scenes)),
        camera=camera,
        variation=variation,
        batch=int(batch),
        samples=int(samples),
    )
    return _stream(draw, key, first)


def _stream(draw: partial[Views], key: Key[Array, ""], first: int) -> Iterator[Views]:
    # JAX returns before a batch is drawn. So one batch is always being drawn ahead.
    following = draw(jax.random.fold_in(key, first))
    for index in count(first + 1):
        drawn, following = following, draw(jax.random.fold_in(key, index))
        yield drawn


def _check_arguments(
    scenes: Scenes, batch: int, camera: Camera, variation: Variation, samples: int
) -> None:
    check_named("scenes", instance(Scenes), scenes)
    check_named("batch", whole(1), batch)
    check_named("samples", whole(1, 4), samples)
    check_named("variation", instance(Variation), variation)
    if check_named("camera", instance(Camera), camera).distortion is not None:
        raise InputError(
            f"camera: expected no distortion, which views do not draw, got {camera.distortion!r}"
        )
    for name, colour in (("ground", camera.ground), ("sky", camera.sky)):
        # An array of three numbers would be taken for a value for each of three pictures.
        if not isinstance(colour, tuple | list):
            raise InputError(
                f"{name}: expected a tuple of red, green and blue, got {shorten(repr(colour))}"
            )
    for record in (camera, variation):
        for path, number in jax.tree_util.tree_leaves_with_path(record):
            if np.shape(number) not in ((), (batch,)):
                name = jax.tree_util.keystr(path).lstrip(".")
                raise InputError(
                    f"{name}: expected a number or an array [{batch}], got shape {np.shape(number)}"
                )


@runs_jax
def _draw(
    key: Array, scenes: Scenes, camera: Camera, variation: Variation, *, batch: int, samples: int
) -> Views:
    # Arrays of several ranks and dtypes are mixed here, which settings of JAX may forbid.
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        return _draw_batch(key, scenes, camera, variation, batch=batch, samples=samples)


@partial(jax.jit, static_argnames=("batch", "samples"))
@divide_batches
def _draw_batch(
    key: Array, scenes: Scenes, camera: Camera, variation: Variation, *, batch: int, samples: int
) -> Views:
    keys = jax.vmap(partial(jax.random.fold_in, key))(jnp.arange(batch))
    # Each view gets its own options, also where they are equal.
    camera, variation = jax.tree.map(
        lambda number: jnp.broadcast_to(jnp.asarray(number, jnp.float32), batch),
        (camera, variation),
    )
    plans = jax.vmap(partial(_plan_view, samples=samples), in_axes=(0, None, 0, 0))(
        keys, scenes, camera, variation
    )
    # The arrays of one view fit the caches of a processor. A GPU needs many views to be busy.
    words, instances = jax.lax.platform_dependent(
        plans, cpu=partial(_draw_each, scenes), default=partial(_draw_all, scenes)
    )
    pixels = jax.lax.bitcast_convert_type(words, jnp.uint8)
    return Views(pixels[..., :3], pixels[..., 3], plans.lane, plans.pose, plans.map, instances)


def _draw_each(scenes: Scenes, plans: _Plan) -> tuple[Array, Array | None]:
    return jax.lax.map(partial(_draw_view, scenes), plans)


def _draw_all(scenes: Scenes, plans: _Plan) -> tuple[Array, Array | None]:
    return jax.vmap(partial(_draw_view, scenes))(plans)


def _plan_view(
    key: Array, scenes: Scenes, camera: Camera, variation: Variation, *, samples: int
) -> _Plan:
    """Draws all numbers of one view."""
    # One call, because each call of the generator compiles for half a second.
    bits = random_bits(key, (_SEEDS + _NUMBERS + LOOK_NUMBERS,))
    pose_seed, tile_seed, look_seed = bits[:_SEEDS]
    numbers = uniform(bits[_SEEDS:])
    which, *wobbles, lines = numbers[:5]
    # The scene is the map that the view shows.
    number = (which * len(scenes.maps.codes)).astype(jnp.int32)
    scene = jax.tree.map(lambda part: part[number], scenes.maps)
    lane_offset = scenes.lane_offset
    pose = _draw_pose(numbers[5:_NUMBERS], pose_seed, scene, variation, lane_offset)
    # Wobbles are factors. The angles are limited, because a wobble may exceed what a camera can
    # have.
    lower, tilt, wide = (1 + (2 * wobble - 1) * variation.wobble for wobble in wobbles)
    camera = camera.replace(
        height=camera.height * lower,
        pitch=jnp.clip(camera.pitch * tilt, -_STEEPEST, _STEEPEST),
        field_of_view=jnp.minimum(camera.field_of_view * wide, _WIDEST),
    )
    stretch = None
    if variation.lines is not None:
        # Positions shift by a sine, whose top is at a quarter of the tile. The divisor makes the
        # shift at the white line the one that was drawn.
        most = (2 * lines - 1) * variation.lines / np.float32(np.sin(2 * np.pi * _WHITE_LINE))
        stretch = most * np.float32(1 << _UNIT)
    look = draw_look(look_seed, numbers[_NUMBERS:], variation, camera)
    return _Plan(
        number,
        pose,
        _lane_of(pose, scene, lane_offset),
        _choose_pictures(tile_seed, scene, scenes),
        _meet_ground(pose, camera, scenes.tile_bits, samples, smaller=True),
        _meet_ground(pose, camera, scenes.tile_bits, 1, smaller=False),
        stretch,
        camera,
        look,
        scene.objects,
        _choose_billboards(tile_seed, scene),
        scene.floor,
    )


def _draw_pose(
    numbers: Float[Array, "4"],
    seed: UInt32[Array, ""],
    scene: SceneMap,
    variation: Variation,
    lane_offset: float,
) -> Pose:
    """Returns the pose of uniform numbers.

    If the robot would touch an object, others are hashed, at most 64 times.
    """

    def place(numbers: Float[Array, "4"]) -> Pose:
        which, along, beside, turned = numbers
        # The largest number of `uniform` times a count of up to 2**24 is still under the count.
        index = (which * scene.movement_count).astype(jnp.int32)
        movement = Movement(*scene.movements[index])
        heading = jnp.deg2rad(variation.heading)
        return pose_beside(
            movement,
            along,
            beside,
            turned,
            offset=variation.offset,
            heading=heading,
            lane_offset=lane_offset,
        )

    objects = scene.objects
    if objects is None:
        return place(numbers)

    def is_bad(carry: tuple[Array, Pose]) -> Array:
        attempt, pose = carry
        return (attempt < _TRIES) & stands_on(objects, pose, _ROBOT)

    def retry(carry: tuple[Array, Pose]) -> tuple[Array, Pose]:
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
    """Draws a picture for each cell among all that show its code."""
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


def _meet_ground(
    pose: Pose, camera: Camera, tile_bits: int, samples: int, *, smaller: bool
) -> _Rows:
    """Returns where the rows of samples meet the ground.

    `smaller` chooses smaller pictures for larger distances.
    """
    # Each row uses the angles' sines, cosines and tangents.
    cosine, sine, rays = once(
        lambda: (jnp.cos(pose.theta), jnp.sin(pose.theta), rays_of(camera, samples))
    )
    # Without distortion a row of pixels meets the ground in a line. So a position and a step
    # describe the whole row.
    columns = rays.right.shape[1]
    middle = columns // 2
    if columns > 1:
        gap = (rays.right[0, -1] - rays.right[0, 0]) / (columns - 1)
    else:
        # A single column has no neighbour. The distance to the next row is the same.
        gap = 1 / focal_length(camera, samples)
    reach, ahead = reach_ground(camera, rays)
    seen = jnp.isfinite(ahead)
    ahead, reach = (jnp.where(seen, part, 0) / TILE for part in (ahead, reach))
    x_step, y_step = reach * sine * gap, reach * cosine * gap
    # With an even number of columns, the middle column is half a step beside the robot's axis.
    offset = rays.right[0, middle] / gap
    # The map has a border of one tile.
    x = 1 + pose.x + ahead * cosine + x_step * offset
    y = 1 + pose.y - ahead * sine + y_step * offset
    # Whole numbers of 32 bits must hold the positions of both ends of a row.
    ends = jnp.maximum(
        jnp.abs(x) + jnp.abs(x_step) * columns, jnp.abs(y) + jnp.abs(y_step) * columns
    )
    # Beyond that a row shows the border's corner, which is ground.
    x, x_step, y, y_step = (
        jnp.round(jnp.where(ends < _FARTHEST, part, 0) * (1 << _UNIT)).astype(jnp.int32)
        for part in (x, x_step, y, y_step)
    )
    level = jnp.zeros(reach.shape, jnp.int32)
    if smaller:
        # The distance between samples is the root of the area between four of them, in pixels of
        # the largest pictures.
        height = camera.height / TILE
        apart = jnp.sqrt(reach**3 / height) * gap * (1 << tile_bits)
        level = jnp.floor(jnp.log2(jnp.maximum(apart, 1)) + 0.5).astype(jnp.int32)
        level = jnp.minimum(level, tile_bits)
    # The pyramid has the pictures of a tile one after another, from the largest one.
    sizes = 4 ** np.arange(tile_bits, -1, -1)
    starts = jnp.asarray(np.concatenate([[0], np.cumsum(sizes)[:-1]]), jnp.int32)
    return _Rows(x, x_step, y, y_step, starts[level], tile_bits - level, seen)


def _draw_view(scenes: Scenes, plan: _Plan) -> tuple[UInt32[Array, "rows columns"], Array | None]:
    """Draws one view.

    Returns red, green, blue and label from the lowest byte, and the objects' indices.
    """
    camera = plan.camera
    samples = plan.samples.x.shape[0] // camera.rows
    # Colours are means of samples. Labels and objects' indices are those at pixels' centres,
    # because means of them have no meaning.
    fine = _stand(plan, scenes, samples, plan.samples)
    red_blue, green_paved, above = once(lambda: _sum_samples(plan, scenes, samples, fine))
    # The sums are unpacked into one plane for each colour.
    share = np.float32(1 / samples**2)
    sums = red_blue & 0xFFFF, green_paved & 0xFFFF, red_blue >> 16
    road = [total.astype(jnp.float32) * share for total in sums]
    paved = (green_paved >> 16).astype(jnp.float32) * (share / PAVED)
    image = lay_background(road, paved, above.astype(jnp.float32) * share, plan.look)
    image = [plane * camera.light for plane in image]
    red, green, blue = photograph(image, plan.look)
    label, instances = _label(plan, scenes)
    return once(lambda: red | green << 8 | blue << 16 | label << 24), instances


class _Standing(NamedTuple):
    """The objects in a view, for each sample.

    Attributes:
      hit: bool ``[rows, columns]``, whether an object is seen.
      colours: uint32 ``[rows, columns]``, red, green and blue from the lowest byte.
      instances: int32 ``[rows, columns]``, the index of the object plus 1.
    """

    hit: Bool[Array, "rows columns"]
    colours: UInt32[Array, "rows columns"]
    instances: Int32[Array, "rows columns"]


def _stand(plan: _Plan, scenes: Scenes, samples: int, ground: _Rows) -> _Standing | None:
    """Draws the objects; `ground` is where the rows of samples meet it."""
    objects, pictures, billboards = plan.objects, plan.pictures, scenes.billboards
    if objects is None or pictures is None or billboards is None:
        return None
    camera = plan.camera
    rays: Rays = once(lambda: rays_of(camera, samples))
    sizes = camera.height, camera.forward, camera.objects
    hit, index, instances = see_objects(plan.pose, objects, pictures, billboards, rays, *sizes)
    if plan.floor is not None:
        columns = camera.columns * samples
        # Objects on the floor are behind all standing ones.
        column = jnp.arange(columns) - columns // 2
        x, y = _lines_in_tiles(ground)
        lying, lying_index, lying_instances = lie(
            plan.pose, objects, plan.floor, pictures, billboards, x, y, column, camera.objects
        )
        index = jnp.where(hit, index, lying_index)
        instances = jnp.where(hit, instances, lying_instances)
        hit |= lying
    return _Standing(hit, billboards.pixels.at[index].get(mode="promise_in_bounds"), instances)


def _lines_in_tiles(ground: _Rows) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Returns the lines of `lie`."""
    tile = np.float32(1 / (1 << _UNIT))
    x, x_step, y, y_step = (
        part.astype(jnp.float32) * tile
        for part in (ground.x, ground.x_step, ground.y, ground.y_step)
    )
    # Without the map's border of one tile.
    return (jnp.where(ground.seen, x - 1, jnp.nan), x_step), (y - 1, y_step)


def _sum_samples(
    plan: _Plan, scenes: Scenes, samples: int, standing: _Standing | None
) -> tuple[Array, Array, Array]:
    """Sums the samples of each pixel, two sums in each word.

    Returns red and blue, green and `PAVED`, and the number of samples of sky. Of two sums the
    second one is times 2**16. The samples of sky are one column if no object covers them.
    """
    rows, columns = plan.camera.rows, plan.camera.columns
    # Two sums share a word: at most 16 samples of 255 fit 16 bits. That saves half of the
    # additions.
    red_blue = green_paved = jnp.zeros((rows, columns), jnp.uint32)
    above = jnp.zeros((rows, 1), jnp.uint32)
    for down in range(samples):
        part = jax.tree.map(lambda table, down=down: table[down::samples], plan.samples)
        for right in range(samples):
            column = jnp.arange(columns) * samples + (right - columns * samples // 2)
            word = jnp.where(part.seen, _look_up(part, column, plan, scenes), 0)
            is_sky = ~part.seen
            if standing is not None:
                hit, colours = (layer[down::samples, right::samples] for layer in standing[:2])
                # The bit `PAVED` also marks objects, which hide the background.
                word = jnp.where(hit, colours | PAVED << 24, word)
                is_sky &= ~hit
            red_blue += word & 0xFF00FF
            green_paved += word >> 8 & (PAVED << 16 | 0xFF)
            above += is_sky.astype(jnp.uint32)
    return red_blue, green_paved, above


def _look_up(
    rows: _Rows, column: Int32[Array, " columns"], plan: _Plan, scenes: Scenes
) -> UInt32[Array, "R columns"]:
    """Returns the words of the pyramid at columns of samples, counted from the middle.

    Indices are computed by loops of their own, because a loop that reads at them does not use the
    processor's vectors. They are unsigned, so that JAX does not look for negative ones.
    """
    height, width = scenes.maps.codes.shape[1:]
    # Beyond the map the position is moved to its border, which is ground.
    x = jnp.clip(rows.x + rows.x_step * column, 0, (width << _UNIT) - 1)
    y = jnp.clip(rows.y + rows.y_step * column, 0, (height << _UNIT) - 1)
    cell = once(lambda: ((y >> _UNIT) * width + (x >> _UNIT)).astype(jnp.uint32))
    tile = plan.cells.at[cell].get(mode="promise_in_bounds")
    x, y = (_stretch(part & ((1 << _UNIT) - 1), plan.lines) for part in (x, y))
    # The upper bits of a position on the tile are the row and the column of the picture's pixel.
    shift = _UNIT - rows.bits
    pixel = rows.first + (y >> shift << rows.bits) + (x >> shift)
    index = once(lambda: (tile * scenes.pyramid.shape[1] + pixel).astype(jnp.uint32))
    return once(lambda: scenes.pyramid.reshape(-1).at[index].get(mode="promise_in_bounds"))


def _stretch(position: Int32[Array, "..."], lines: Array | None) -> Int32[Array, "..."]:
    """Shifts positions on a tile away from its middle, as the dataset's `lines` does.

    The middle and the edges of the tile stay.
    """
    if lines is None:
        return position
    # The sine is 0 at both edges and in the middle of the tile, so these stay.
    sides = jnp.sin(position.astype(jnp.float32) * np.float32(2 * np.pi / (1 << _UNIT)))
    moved = position + jnp.round(sides * lines).astype(jnp.int32)
    return jnp.clip(moved, 0, (1 << _UNIT) - 1)


def _label(plan: _Plan, scenes: Scenes) -> tuple[UInt32[Array, "rows columns"], Array | None]:
    """Returns the label at the centre of each pixel, and the index of the object there plus 1."""
    columns = plan.camera.columns
    word = _look_up(plan.centres, jnp.arange(columns) - columns // 2, plan, scenes)
    label = jnp.where(plan.centres.seen, word >> 24 & (PAVED - 1), 0)
    standing = _stand(plan, scenes, 1, plan.centres)
    if standing is None:
        return label, None
    return jnp.where(standing.hit, 0, label), standing.instances
