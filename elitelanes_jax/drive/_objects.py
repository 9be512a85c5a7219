"""Objects of maps as arrays: what the camera shows of them, and whether a robot touches one.

In views an object is an upright picture at its position, parallel to the view's rows. So without
distortion a row of pixels shows one row of each picture, and one look-up for the row tells which of
its pixels are opaque. Tags on the floor are pictures on the ground, which only `views` draws.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32, UInt8, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, listed
from elitelanes_jax._util.errors import InputError, shorten
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Numeric
from elitelanes_jax.drive.lanes import Pose, wrap_angle
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.objects import NEAR, OBJECT_KINDS, OPAQUE, base_kind, nearest_view
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.network.xla import once, vary_together

SIDE = 64
"""The default number of rows and columns of pictures of objects, a multiple of 32."""

# The default number of views, evenly around an object.
_VIEWS = 8
# The objects that are laid over each other in one step.
_GROUP = 8
# The bits for the index of a pixel in all pictures. The bits above them hold the number of an
# object in its group, from 1.
_INDEX = 27
# The tiles that are added to distances of objects behind a robot, so that others are nearer.
_BEHIND = 1e4
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


class Billboards(NamedTuple):
    """Pictures of objects, for cameras: P pictures, V views of each of N objects.

    Billboards of `make_billboards` have an object for each of `OBJECT_KINDS`. All rows of all
    pictures are one after another, each of S pixels. Shorter rows are filled up with transparent
    pixels.

    Attributes:
      pixels: uint32 ``[R * S]``, red, green and blue from the lowest byte, row by row.
      opaque: uint32 ``[R, S / 32]``, a bit for each pixel of a row, the first one the lowest.
      aspect: float32 ``[N, V]``, width over height.
      first: int32 ``[N, V]``, the first row.
      rows: int32 ``[N, V]``, the number of rows.
      columns: int32 ``[N, V]``, the number of columns.
    """

    pixels: UInt32[Array, " N"]
    opaque: UInt32[Array, "R W"]
    aspect: Float[Array, "N V"]
    first: Int32[Array, "N V"]
    rows: Int32[Array, "N V"]
    columns: Int32[Array, "N V"]


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
    kind = np.zeros(shape, np.int32)
    x, y = np.full((2, *shape), _AWAY, np.float32)
    angle, height, radius = np.zeros((3, *shape), np.float32)
    kinds = list(OBJECT_KINDS)
    for number, map_objects in enumerate(objects_of_maps):
        for index, map_object in enumerate(map_objects):
            slot = number, index
            kind[slot] = kinds.index(base_kind(map_object.kind))
            x[slot], y[slot] = map_object.x, map_object.y
            angle[slot], height[slot] = map_object.angle, map_object.height
            # A robot drives over objects without height.
            radius[slot] = map_object.radius if map_object.height else 0
    return Objects(*map(jnp.asarray, (kind, x, y, angle, height, radius)))


@name_wrong_arguments
@runs_jax
def make_billboards(views: Mapping[str, Mapping[int, AnyArray]]) -> Billboards:
    """Makes the pictures that cameras show of objects; what has none is not shown.

    Each picture is scaled to 64 x 64 pixels. All signs of a kind show the tag of their view.

    Args:
      views: uint8 ``[rows, columns, 4]``, RGB and opacity, by kind and by degrees counter-clockwise
        from the front, as `ObjectSet.views_by_kind` has them.

    Raises:
      InputError: for unknown kinds, or arrays of other shapes.
    """
    for name, pictures in views.items():
        if name not in OBJECT_KINDS:
            raise InputError("objects", f"kinds of {', '.join(OBJECT_KINDS)}", repr(name))
        if not isinstance(pictures, Mapping):
            raise InputError("objects", f"views of {name} by degrees", shorten(repr(pictures)))
    return pack_billboards([views.get(kind, {}) for kind in OBJECT_KINDS])


def pack_billboards(
    objects: Sequence[Mapping[int, AnyArray]], side: int | None = SIDE, views: int = _VIEWS
) -> Billboards:
    """Packs the views of objects, by degrees. An object without any view is not shown.

    Args:
      objects: the views of each object.
      side: the side of the packed pictures in pixels, a multiple of 32; None to keep the pictures'
        sizes.
      views: the number of packed views of each object, evenly around it.

    Raises:
      InputError: for arrays of other shapes, or too many objects, whose pixels 27 bits count.
    """
    packed, aspect = [], np.ones((len(objects), views), np.float32)
    for index, pictures in enumerate(objects):
        for view in range(views):
            picture = np.zeros((1, 1, 4), np.uint8)
            if pictures:
                picture = _check_picture(pictures[nearest_view(pictures, 360 / views * view)])
            rows, columns = picture.shape[:2]
            aspect[index, view] = columns / rows
            if side is not None:
                # Each pixel shows the nearest pixel of the original.
                down, across = ((np.arange(side) + 0.5) * size // side for size in (rows, columns))
                picture = picture[down.astype(int)[:, None], across.astype(int)]
            packed.append(picture)
    sizes = np.array([picture.shape[:2] for picture in packed])
    ends = np.cumsum(sizes[:, 0])
    # A word holds the opacity of 32 pixels.
    stride = -(-sizes[:, 1].max() // 32) * 32
    if ends[-1] * stride > 2**_INDEX:
        most = int(len(objects) * 2**_INDEX / (ends[-1] * stride))
        raise InputError(
            "objects", f"at most {most} different objects, counting each AprilTag", len(objects)
        )
    pixels = np.zeros((ends[-1], stride, 4), np.uint8)
    for picture, end in zip(packed, ends, strict=True):
        pixels[end - len(picture) : end, : picture.shape[1]] = picture
    opaque = (pixels[..., 3] >= OPAQUE).reshape(len(pixels), -1, 32)
    words = (opaque.astype(np.uint32) << np.arange(32, dtype=np.uint32)).sum(
        axis=-1, dtype=np.uint32
    )
    # The label of what is no road is 0.
    pixels[..., 3] = 0
    colours = pixels.view("<u4").reshape(-1).astype(np.uint32)
    tables = (ends - sizes[:, 0], *sizes.T)
    return Billboards(
        *map(jnp.asarray, (colours, words, aspect)),
        *(jnp.asarray(table.reshape(aspect.shape), jnp.int32) for table in tables),
    )


def _check_picture(picture: AnyArray) -> UInt8[np.ndarray, "rows columns 4"]:
    picture = np.asarray(picture)
    has_pixels = picture.ndim == 3 and picture.shape[2] == 4 and picture.size > 0
    if not has_pixels or picture.dtype != np.uint8:
        raise InputError("objects", "uint8 [rows, columns, 4]", f"{picture.dtype} {picture.shape}")
    return picture


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
    height: Numeric,
    forward: Numeric,
    count: int | None,
    *,
    counts: bool = False,
) -> SeenObjects:
    """Finds the objects that are seen, among the `count` nearest ones in front of a camera.

    The pose is that of the middle between the wheels. The camera is `height` metres above the
    ground, and `forward` metres ahead of this middle. `pictures` has the index of each object in
    the billboards. If `count` is None, all objects are seen. `counts` says whether the pixels that
    each object would cover alone are counted.
    """
    upright = _stand_upright(pose, objects, pictures, billboards, rays, forward)
    most = len(upright.ahead)
    # `top_k` sorts the objects by their distance ahead, the nearest one first.
    nearest, near = jax.lax.top_k(-upright.ahead, most if count is None else min(count, most))
    shape = jnp.broadcast_shapes(rays.forward.shape, rays.right.shape)

    def lay(near: Int32[Array, " C"], shown: Bool[Array, " C"]) -> _Layers:
        parts = _Upright(*(part[near] for part in upright))
        # Indices that fill up a group show nothing.
        parts = parts._replace(ahead=jnp.where(shown, parts.ahead, jnp.inf))
        rows = once(lambda: _cross_rows(parts, billboards, rays, height))
        return once(lambda: _lay_over_each_other(rows, rays, counts=counts))

    # Objects that are not shown are infinitely far away.
    shown = jnp.isfinite(nearest)[::-1]
    return _lay_groups(lay, near[::-1], shown, jnp.arange(most), shape, most, counts=counts)


class _Layers(NamedTuple):
    """Pictures over each other.

    Attributes:
      seen: int32 ``[rows, columns]``, the number of each pixel's picture among C, from 1, times
        2**27, plus the index of the picture's pixel; 0 without a picture.
      covered: int32 ``[C]``, the number of pixels that each picture would cover alone.
    """

    seen: Int32[Array, "rows columns"]
    covered: Int32[Array, " C"]


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
        seen = layers.seen
        # Number 0, no object, has instance 0.
        instances = jnp.concatenate([jnp.zeros(1, jnp.int32), on_map + 1])
        # An index of -1 is of no object, and covers no pixel.
        alone = None if covered is None else covered.at[on_map].add(layers.covered)
        return SeenObjects(seen > 0, seen & ((1 << _INDEX) - 1), instances[seen >> _INDEX], alone)

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


def _lay_over_each_other(rows: _CrossedRows, rays: Rays, *, counts: bool) -> _Layers:
    """Lays the pictures of objects over each other, the last one in front."""
    slope, middle, first, words = rows
    side = 32 * len(words)
    seen = jnp.zeros(jnp.broadcast_shapes(slope.shape[1:], rays.right.shape), jnp.int32)
    covered = []
    for index in range(len(slope)):
        column = jnp.floor(slope[index] * rays.right + middle[index]).astype(jnp.int32)
        word = words[0, index]
        # The words of a row are selected one by one. A look-up for each pixel would not use the
        # processor's vectors.
        for part in range(1, side // 32):
            word = jnp.where(column >= 32 * part, words[part, index], word)
        opaque = (word >> (column & 31).astype(jnp.uint32)) & 1 > 0
        hit = opaque & (column >= 0) & (column < side)
        seen = jnp.where(hit, ((index + 1) << _INDEX) + first[index] + column, seen)
        covered.append(hit.sum(dtype=jnp.int32) if counts else 0)
    return _Layers(seen, jnp.asarray(covered, jnp.int32))


class Floor(NamedTuple):
    """The objects on the floor of a map. A batch has N in front of every shape.

    Attributes:
      indices: int32 ``[F]``, of the map's objects, ascending. -1 fills up a batch.
      length: float32 ``[F]``, metres along the object's angle.
      width: float32 ``[F]``, metres.
    """

    indices: Int32[Array, " F"]
    length: Float[Array, " F"]
    width: Float[Array, " F"]


def lie(
    pose: Pose,
    objects: Objects,
    floor: Floor,
    pictures: Int32[Array, " M"],
    billboards: Billboards,
    x: tuple[Float[Array, "rows _"], Float[Array, "rows _"]],
    y: tuple[Float[Array, "rows _"], Float[Array, "rows _"]],
    column: Int32[Array, " columns"],
    count: int | None,
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
    most = len(away) if count is None else min(count, len(away))
    slots = jnp.sort(jax.lax.top_k(-away, most)[1])
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

        def layers() -> _Layers:
            seen = jnp.zeros(shape, jnp.int32)
            covered = []
            for number in range(len(near)):
                east, south = x[0] - objects.x[near[number]], y[0] - objects.y[near[number]]
                turn = cosine[number], sine[number]
                # Tiles along the object's angle and to its right, which is downwards in the
                # picture.
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
                seen = jnp.where(hit, ((number + 1) << _INDEX) + row * stride + across, seen)
                covered.append(hit.sum(dtype=jnp.int32) if counts else 0)
            return _Layers(seen, jnp.asarray(covered, jnp.int32))

        return once(layers)

    # Indices of -1 fill up a batch.
    is_object = floor.indices[slots] >= 0
    return _lay_groups(lay, slots, is_object, floor.indices, shape, len(objects.x), counts=counts)


def _turn(east: Array, south: Array, turn: tuple[Array, Array]) -> tuple[Array, Array]:
    """Returns the parts of a way along an angle and to its right.

    `turn` has the cosine and the sine of the angle.
    """
    cosine, sine = turn
    return east * cosine - south * sine, east * sine + south * cosine


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
    # To the east and to the north in metres, as the numbers below.
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
