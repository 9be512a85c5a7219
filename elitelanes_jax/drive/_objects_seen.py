"""What a camera sees of objects.

In views an object is an upright picture at its position, parallel to the view's rows. So without
distortion a row of pixels shows one row of each picture, and one look-up for the row tells which of
its pixels are opaque. Tags on the floor are pictures on the ground, which only `views` draws.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int32, UInt32

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._billboards import INDEX_BITS, Billboards, Floor
from elitelanes_jax.drive._objects import Objects
from elitelanes_jax.drive.camera_options import Camera
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.objects import NEAR
from elitelanes_jax.network.xla import once, vary_together

# The objects that are laid over each other in one step.
_GROUP = 8

# The tiles that are added to distances of objects behind a robot, so that others are nearer.
_BEHIND = 1e4


class Rays(NamedTuple):
    """Metres that a camera's rays go for each metre of depth.

    All fields broadcast to ``[rows, columns]``.

    Attributes:
      right: float32, metres to the right.
      forward: float32, metres ahead along the ground.
      fall: float32, metres down; less than 0 above the horizon.
    """

    right: Float[Array, "..."]
    forward: Float[Array, "..."]
    fall: Float[Array, "..."]


class SeenObjects(NamedTuple):
    """The objects that the pixels of a view show.

    Attributes:
      hit: bool ``[rows, columns]``, whether there is an object.
      pixel: int32 ``[rows, columns]``, the index in `Billboards.pixels`; 0 without an object.
      instances: int32 ``[rows, columns]``, the object's index plus 1, or 0.
      covered: int32 ``[M]``, the number of pixels that each object would cover alone; None if they
        are not counted.
    """

    hit: Bool[Array, "rows columns"]
    pixel: Int32[Array, "rows columns"]
    instances: Int32[Array, "rows columns"]
    covered: Int32[Array, " M"] | None = None

    def colours(self, billboards: Billboards) -> UInt32[Array, "rows columns"]:
        """Returns the colour of each pixel, red, green and blue from the lowest byte."""
        return billboards.pixels.at[self.pixel].get(mode="promise_in_bounds")

    def over(self, other: "SeenObjects") -> "SeenObjects":
        """Returns these objects in front of others."""
        covered = None
        if self.covered is not None and other.covered is not None:
            covered = self.covered + other.covered
        return SeenObjects(
            self.hit | other.hit,
            jnp.where(self.hit, self.pixel, other.pixel),
            jnp.where(self.hit, self.instances, other.instances),
            covered,
        )


def see_objects(
    pose: Pose,
    objects: Objects,
    pictures: Int32[Array, " M"],
    billboards: Billboards,
    rays: Rays,
    camera: Camera,
    *,
    counts: bool = False,
) -> SeenObjects:
    """Finds the objects that a camera sees, among the nearest ones in front of it.

    The pose is that of the middle between the wheels, and the rays are those of the camera.
    `pictures` has the index of each object in the billboards. `counts` says whether the pixels that
    each object would cover alone are counted.
    """
    upright = _stand_upright(pose, objects, pictures, billboards, rays, camera.forward)
    most = len(upright.ahead)
    # `top_k` sorts the objects by their distance ahead, the nearest one first.
    nearest, near = jax.lax.top_k(-upright.ahead, _limit(most, camera))
    shape = jnp.broadcast_shapes(rays.forward.shape, rays.right.shape)

    def lay(near: Int32[Array, " C"], shown: Bool[Array, " C"]) -> _Layers:
        parts = _Upright(*(part[near] for part in upright))
        # Indices that fill up a group show nothing.
        parts = parts._replace(ahead=jnp.where(shown, parts.ahead, jnp.inf))
        rows = once(lambda: _cross_rows(parts, billboards, rays, camera.height))
        show = partial(_show_upright, rows, rays)
        return once(lambda: _lay_over_each_other(show, len(near), shape, counts=counts))

    # Objects that are not shown are infinitely far away.
    shown = jnp.isfinite(nearest)[::-1]
    return _lay_groups(lay, near[::-1], shown, jnp.arange(most), shape, most, counts=counts)


def _limit(count: int, camera: Camera) -> int:
    """Returns how many of `count` objects a camera shows."""
    return count if camera.objects is None else min(camera.objects, count)


class _Layers(NamedTuple):
    """Pictures over each other.

    Attributes:
      seen: int32 ``[rows, columns]``, the number of each pixel's picture among C, from 1, times
        2**27, plus the index of the picture's pixel; 0 without a picture.
      covered: int32 ``[C]``, the number of pixels that each picture would cover alone.
    """

    seen: Int32[Array, "rows columns"]
    covered: Int32[Array, " C"]


def _lay_over_each_other(
    show: Callable[[int], tuple[Array, Array]], count: int, shape: tuple[int, ...], *, counts: bool
) -> _Layers:
    """Lays `count` pictures over each other, the last one in front.

    `show` returns which pixels a picture covers, and the index of the picture's pixel in each.
    """
    seen = jnp.zeros(shape, jnp.int32)
    covered = []
    for index in range(count):
        hit, pixel = show(index)
        seen = jnp.where(hit, ((index + 1) << INDEX_BITS) + pixel, seen)
        covered.append(hit.sum(dtype=jnp.int32) if counts else 0)
    return _Layers(seen, jnp.asarray(covered, jnp.int32))


def _lay_groups(
    lay: Callable[[Int32[Array, " C"], Bool[Array, " C"]], _Layers],
    indices: Int32[Array, " K"],
    shown: Bool[Array, " K"],
    numbers: Int32[Array, " N"],
    shape: tuple[int, ...],
    most: int,
    *,
    counts: bool,
) -> SeenObjects:
    """Lays objects over each other, from the back to the front, some at a time.

    Args:
      lay: draws some objects, from their indices and whether each is shown.
      indices: of the objects.
      shown: whether an object is shown.
      numbers: the object's index on the map, by these indices.
      shape: rows and columns.
      most: the number of objects of the map.
      counts: see `see_objects`.
    """
    covered = jnp.zeros(most, jnp.int32) if counts else None

    def read(indices: Array, shown: Array) -> SeenObjects:
        layers, on_map = lay(indices, shown), numbers[indices].astype(jnp.int32)
        # The bits above the index of a pixel hold the number of an object in its group, from 1.
        seen = layers.seen
        # Number 0, no object, has instance 0.
        instances = jnp.concatenate([jnp.zeros(1, jnp.int32), on_map + 1])
        # An index of -1 is of no object, and covers no pixel.
        alone = None if covered is None else covered.at[on_map].add(layers.covered)
        return SeenObjects(
            seen > 0, seen & ((1 << INDEX_BITS) - 1), instances[seen >> INDEX_BITS], alone
        )

    if len(indices) <= _GROUP:
        return read(indices, shown)
    # Indices are filled up in front, where they are behind all others.
    missing = -len(indices) % _GROUP
    indices, shown = jnp.pad(indices, (missing, 0)), jnp.pad(shown, (missing, 0))
    # The groups before the first object that is shown are skipped.
    first = jnp.argmax(shown) // _GROUP
    groups = jnp.where(shown.any(), len(indices) // _GROUP, first)

    def add(group: Array, behind: SeenObjects) -> SeenObjects:
        here = [
            jax.lax.dynamic_slice_in_dim(part, group * _GROUP, _GROUP) for part in (indices, shown)
        ]
        return read(*here).over(behind)

    nothing = jnp.zeros(shape, jnp.int32)
    unseen = SeenObjects(nothing > 0, nothing, nothing, covered)
    return jax.lax.fori_loop(first, groups, add, vary_together(unseen, indices, shown))


class _Upright(NamedTuple):
    """Upright pictures of objects, seen from a camera.

    Attributes:
      ahead: float32 ``[M]``, metres from the camera; infinite if the picture is not shown.
      left: float32 ``[M]``, metres to the left of the camera.
      width: float32 ``[M]``, of the picture, metres.
      height: float32 ``[M]``, of the picture, metres.
      picture: int32 ``[M]``, the index of the picture among all views.
    """

    ahead: Float[Array, " M"]
    left: Float[Array, " M"]
    width: Float[Array, " M"]
    height: Float[Array, " M"]
    picture: Int32[Array, " M"]


def _stand_upright(
    pose: Pose,
    objects: Objects,
    pictures: Int32[Array, " M"],
    billboards: Billboards,
    rays: Rays,
    forward: Numeric,
) -> _Upright:
    """Returns the pictures of all objects, from a camera some metres ahead of a pose."""
    # The objects are relative to the camera, in metres ahead and to the left.
    cosine, sine = jnp.cos(pose.theta), jnp.sin(pose.theta)
    east, north = (objects.x - pose.x) * TILE, (pose.y - objects.y) * TILE
    ahead, left = east * cosine + north * sine - forward, north * cosine - east * sine
    # The direction from the object to the camera, counter-clockwise from the object's front,
    # chooses the view.
    towards = jnp.arctan2(-left, -ahead) + pose.theta - objects.angle
    views = billboards.aspect.shape[1]
    view = jnp.round(towards / (2 * jnp.pi / views)).astype(jnp.int32) % views
    picture = pictures * views + view
    width = objects.height * billboards.aspect.reshape(-1)[picture]
    # The most that the picture shows to either side at this distance, plus half of the object.
    reach = ahead * jnp.abs(rays.right).max() / jnp.maximum(jnp.min(rays.forward), 1e-6) + width / 2
    # Objects beside the picture would take the places of objects in it.
    shown = (ahead > NEAR) & (objects.height > 0) & (jnp.abs(left) <= reach)
    return _Upright(jnp.where(shown, ahead, jnp.inf), left, width, objects.height, picture)


class _CrossedRows(NamedTuple):
    """What rows of pixels show of upright pictures, the same for all pixels of a row.

    Attributes:
      slope: float32, columns of the picture for each metre that a ray goes to the right.
      middle: float32, the column of the picture straight ahead.
      first: int32, the index of the first pixel of the picture's row in `Billboards.pixels`.
      words: uint32, the opacity of the picture's row, 32 pixels in each word.
    """

    slope: Float[Array, "C rows _"]
    middle: Float[Array, " C"]
    first: Int32[Array, "C rows _"]
    words: UInt32[Array, "W C rows _"]


def _cross_rows(
    upright: _Upright, billboards: Billboards, rays: Rays, height: Numeric
) -> _CrossedRows:
    """Computes all that is the same for a row of pixels, for each of C pictures."""
    column = (..., *[None] * 2)
    forward, fall = rays.forward[None], rays.fall[None]
    # `scale` is the depth at which a ray meets the upright plane of the object. A ray that does not
    # go forward never meets it.
    scale = jnp.where(forward > 1e-6, upright.ahead[column] / jnp.maximum(forward, 1e-6), jnp.inf)
    scale = jnp.where(jnp.isfinite(scale), scale, 0)
    # The height above the ground there gives the row of the picture, the upper edge first.
    up = height - scale * fall
    high = jnp.where(upright.height > 0, upright.height, 1)[column]
    first, rows, columns = (
        table.reshape(-1)[upright.picture]
        for table in (billboards.first, billboards.rows, billboards.columns)
    )
    row = jnp.floor((1 - up / high) * rows[column].astype(jnp.float32)).astype(jnp.int32)
    hit = (row >= 0) & (row < rows[column]) & (scale > 0)
    first = first[column] + jnp.clip(row, 0, rows[column] - 1)
    words = jnp.where(hit[..., None], billboards.opaque.at[first].get(mode="promise_in_bounds"), 0)
    # Objects that fill up a batch have no width. The divisor 1 keeps them finite.
    pixels = columns.astype(jnp.float32) / jnp.where(upright.width > 0, upright.width, 1)
    # The column of the picture is linear in the direction of the ray to the right: a slope for each
    # row, and one middle.
    return _CrossedRows(
        slope=scale * pixels[column],
        middle=upright.left * pixels + columns.astype(jnp.float32) / 2,
        first=first * (32 * billboards.opaque.shape[1]),
        words=jnp.moveaxis(words, -1, 0),
    )


def _show_upright(rows: _CrossedRows, rays: Rays, index: int) -> tuple[Array, Array]:
    """Returns which pixels an upright picture covers, and the index of the picture's pixel there."""
    slope, middle, first, words = rows
    column = jnp.floor(slope[index] * rays.right + middle[index]).astype(jnp.int32)
    word = words[0, index]
    # The words of a row are selected one by one. A look-up for each pixel would not use the
    # processor's vectors.
    for part in range(1, len(words)):
        word = jnp.where(column >= 32 * part, words[part, index], word)
    opaque = (word >> (column & 31).astype(jnp.uint32)) & 1 > 0
    hit = opaque & (column >= 0) & (column < 32 * len(words))
    return hit, first[index] + column


def lie(
    pose: Pose,
    objects: Objects,
    floor: Floor,
    pictures: Int32[Array, " M"],
    billboards: Billboards,
    x: tuple[Float[Array, "rows _"], Float[Array, "rows _"]],
    y: tuple[Float[Array, "rows _"], Float[Array, "rows _"]],
    column: Int32[Array, " columns"],
    camera: Camera,
    *,
    counts: bool = False,
) -> SeenObjects:
    """Finds the objects on the floor that are seen, as `see_objects` does for those that stand.

    Rows of pixels see lines on the ground: `x` and `y` are the position at column 0 in tiles, and
    the step to the next column. A pixel without ground has the position NaN. With distortion, there
    is a position for each column, and the step is 0.
    """
    # As with standing objects, only the nearest ones are drawn.
    east, south = objects.x[floor.indices] - pose.x, objects.y[floor.indices] - pose.y
    is_ahead = east * jnp.cos(pose.theta) > south * jnp.sin(pose.theta)
    away = jnp.hypot(east, south) + jnp.where(is_ahead, 0, _BEHIND)
    away = jnp.where(floor.indices >= 0, away, jnp.inf)
    # Ascending, because of two objects the later one is on top, as in datasets.
    slots = jnp.sort(jax.lax.top_k(-away, _limit(len(away), camera))[1])
    stride = 32 * billboards.opaque.shape[1]
    shape = len(x[0]), len(column)

    def lay(slot: Int32[Array, " C"], shown: Bool[Array, " C"]) -> _Layers:
        near = floor.indices[slot]
        cosine, sine = jnp.cos(objects.angle[near]), jnp.sin(objects.angle[near])
        # All views of an object on the floor are the same.
        first, rows, columns = (
            table[pictures[near], 0]
            for table in (billboards.first, billboards.rows, billboards.columns)
        )

        def show(number: int) -> tuple[Array, Array]:
            east, south = x[0] - objects.x[near[number]], y[0] - objects.y[near[number]]
            turn = cosine[number], sine[number]
            # Tiles along the object's angle and to its right, which is downwards in the picture.
            ahead, beside = _turn(east, south, turn)
            ahead_step, beside_step = _turn(x[1], y[1], turn)
            wide, high = columns[number], rows[number]
            along = wide * TILE / floor.length[slot[number]]
            sideways = high * TILE / floor.width[slot[number]]
            # Both are linear in the column, because a row of pixels sees a line on the ground.
            across = jnp.floor(wide / 2 + (ahead + ahead_step * column) * along)
            below = jnp.floor(high / 2 + (beside + beside_step * column) * sideways)
            # Comparisons with NaN are False, so a row without ground shows nothing.
            inside = (across >= 0) & (across < wide) & (below >= 0) & (below < high)
            inside &= shown[number]
            across, below = (
                jnp.where(inside, part, 0).astype(jnp.int32) for part in (across, below)
            )
            row = first[number] + below
            word = billboards.opaque.at[row, across >> 5].get(mode="promise_in_bounds")
            hit = inside & ((word >> (across & 31).astype(jnp.uint32)) & 1 > 0)
            return hit, row * stride + across

        return once(lambda: _lay_over_each_other(show, len(near), shape, counts=counts))

    # Indices of -1 fill up a batch.
    is_object = floor.indices[slots] >= 0
    return _lay_groups(lay, slots, is_object, floor.indices, shape, len(objects.x), counts=counts)


def _turn(east: Array, south: Array, turn: tuple[Array, Array]) -> tuple[Array, Array]:
    """Returns the parts of a way along an angle and to its right.

    `turn` has the cosine and the sine of the angle.
    """
    cosine, sine = turn
    return east * cosine - south * sine, east * sine + south * cosine
