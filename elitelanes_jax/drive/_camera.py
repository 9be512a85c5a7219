"""The camera: a robot's picture of a map, with the label of every pixel.

A pixel's ray meets the ground at a point on a tile. The nearest pixel of the tile's picture and
labels is looked up, so that picture and labels agree exactly. Pixels whose ray meets no tile show
the ground's colour, or above the horizon the sky's. Objects stand in front of all that, see
`_objects_seen`. Tags on the floor are not shown.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Int, Int32, Integer, Key, UInt8, UInt32

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import AnyArray, Numeric
from elitelanes_jax.drive._billboards import Billboards, pack_billboards
from elitelanes_jax.drive._hashing import fork, hash_normal
from elitelanes_jax.drive._objects import Objects
from elitelanes_jax.drive._objects_seen import Rays, see_objects
from elitelanes_jax.drive.camera_options import Camera, LaneCamera, Variation
from elitelanes_jax.drive.lanes import Pose, single
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.formats.objects import OBJECT_KINDS
from elitelanes_jax.network.bits import mix, random_bits
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.pytrees import pytree
from elitelanes_jax.network.sharding import divide_batches
from elitelanes_jax.network.xla import once

# The options need no JAX. Whoever traces them needs this module.
for _options in (Camera, LaneCamera, Variation):
    pytree(_options)


class View(NamedTuple):
    """One frame.

    Attributes:
      image: uint8 ``[rows, columns, 3]``, RGB.
      labels: uint8 ``[rows, columns]``, indices of `tiles.LABELS`; 0 beyond the map, above the
        horizon and on objects.
      instances: int32 ``[rows, columns]``, 0, or the index of the object that is seen plus 1; None
        without objects.
    """

    image: UInt8[Array, "rows columns 3"]
    labels: UInt8[Array, "rows columns"]
    instances: Int32[Array, "rows columns"] | None = None


class Sight(NamedTuple):
    """A camera and the pictures of tiles that it shows, for observations of environments.

    Attributes:
      camera: its options.
      atlas: uint8 ``[T, P, P, 4]``, the pictures of the tiles: red, green, blue and label of tile
        ``4 * index in the set + quarter turns``.
      tiles: int32 ``[16, V]``, the atlas' tiles for each code. A cell shows the one at
        ``(row + 2 * column) % V``. If V is even, a code with two pictures shows the same one all
        along a row.
      billboards: the pictures of objects that stand; None to see none.
    """

    camera: Camera
    atlas: UInt8[Array, "T P P 4"]
    tiles: Int[Array, "16 V"]
    billboards: Billboards | None = None


def pack_sight(
    images: UInt8[np.ndarray, "T P P 3"],
    labels: UInt8[np.ndarray, "T P P"],
    rotations: Mapping[int, Sequence[tuple[int, int]]],
    camera: Camera,
    objects: Mapping[str, Mapping[int, AnyArray]] | None = None,
) -> Sight:
    """Packs a camera and pictures.

    Args:
      images: the pictures of tiles, of tile ``4 * index in the set + quarter turns``.
      labels: their labels.
      rotations: the pictures by code, each as (index in the set, quarter turns), as
        `TileSet.rotations` has them. A code without a picture is shown like code 0.
      camera: the options of the camera.
      objects: views of objects, as `ObjectSet.views_by_kind` has them; by default no objects are
        seen.

    Raises:
      InputError: for views of objects of other shapes.
    """
    # A colour and its label are four bytes, which `look` reads as one word.
    atlas = np.concatenate([images, labels[..., None]], axis=-1)
    tiles, _ = list_tiles(rotations)
    billboards = None
    if objects is not None:
        billboards = pack_billboards([objects.get(kind, {}) for kind in OBJECT_KINDS])
    return Sight(camera, jnp.asarray(atlas), jnp.asarray(tiles), billboards)


def list_tiles(
    rotations: Mapping[int, Sequence[tuple[int, int]]],
) -> tuple[Int32[np.ndarray, "16 V"], Int32[np.ndarray, "16"]]:
    """Returns a table of the tiles that show each code, and the number of tiles of each code.

    A tile is ``4 * index in the set + quarter turns``. A code without any has those of code 0.
    """
    tiles_by_code = [
        [4 * index + turns for index, turns in rotations.get(code, rotations[0])]
        for code in range(16)
    ]
    counts = np.array([len(tiles) for tiles in tiles_by_code], np.int32)
    # Repeated tiles make all rows equally long.
    table = [np.resize(tiles, counts.max()) for tiles in tiles_by_code]
    return np.array(table, np.int32), counts


def reach_ground(camera: Camera, rays: Rays) -> tuple[Array, Array, Array]:
    """Returns which rays meet the ground, and the depth and the distance ahead there, in tiles.

    Both are 0 above the horizon. Their shape is that of ``rays.fall``: a number for each row
    without distortion, otherwise one for each pixel.
    """
    # A ray that does not fall never meets the ground. Both branches of the selection are computed,
    # so the divisor is kept away from 0.
    depth = jnp.where(rays.fall > 1e-6, camera.height / jnp.maximum(rays.fall, 1e-6), jnp.inf)
    ahead = depth * rays.forward + camera.forward
    seen = jnp.isfinite(ahead)
    return seen, jnp.where(seen, depth, 0) / TILE, jnp.where(seen, ahead, 0) / TILE


def focal_length(camera: Camera, samples: int = 1) -> Array:
    """Returns the focal length of a pinhole camera, in samples: `samples` times its pixels."""
    return camera.rows * samples / 2 / jnp.tan(jnp.deg2rad(camera.field_of_view) / 2)


def rays_of(camera: Camera, samples: int = 1) -> Rays:
    """Returns the rays of pixels' centres, or of `samples` times `samples` points in each pixel."""
    rows, columns = camera.rows * samples, camera.columns * samples
    focal = focal_length(camera, samples)
    right = (jnp.arange(columns, dtype=jnp.float32) + 0.5 - columns / 2) / focal
    down = ((jnp.arange(rows, dtype=jnp.float32) + 0.5 - rows / 2) / focal)[:, None]
    if camera.distortion is not None:
        right, down = _undistort(*jnp.broadcast_arrays(right, down), *camera.distortion)
    # The rays turn downwards with the camera. Their depth along its axis stays 1.
    pitch = jnp.deg2rad(camera.pitch)
    cosine, sine = jnp.cos(pitch), jnp.sin(pitch)
    return Rays(jnp.atleast_2d(right), cosine - down * sine, sine + down * cosine)


def _undistort(right: Array, down: Array, k1: Numeric, k2: Numeric) -> tuple[Array, Array]:
    """Finds the points that distortion moves to `right` and `down`.

    Their radius is found by halving a range, and then by Newton's method, which alone may leave the
    range. The range ends where distortion begins to move larger radii inwards. If it never does,
    its factor is over 4 / 9.
    """
    # Beyond a radius of sqrt(2 / turn) the distorted radius becomes smaller. Its derivative, 1 + 3
    # k1 r² + 5 k2 r⁴, is 0 there.
    far = jnp.sqrt(right**2 + down**2)
    root = 9 * k1**2 - 20 * k2
    turn = jnp.sqrt(jnp.maximum(root, 0)) - 3 * k1
    folds = (root >= 0) & (turn > 0)
    most = jnp.where(folds, jnp.sqrt(2 / jnp.where(folds, turn, 1)), 9 / 4 * far)
    low, high = jnp.zeros_like(most), most

    def distorted(radius: Array) -> Array:
        return radius * (1 + (k1 + k2 * radius**2) * radius**2)

    # Twelve halvings leave 1/4096 of the range.
    for _ in range(12):
        middle = (low + high) / 2
        beyond = distorted(middle) > far
        low, high = jnp.where(beyond, low, middle), jnp.where(beyond, middle, high)
    radius = (low + high) / 2
    # This near to the solution, Newton's method needs few steps.
    for _ in range(3):
        slope = jnp.maximum(1 + (3 * k1 + 5 * k2 * radius**2) * radius**2, 1e-6)
        radius = jnp.clip(radius - (distorted(radius) - far) / slope, low, high)
    # Distortion moves a point along its radius. The middle of the picture has none.
    factor = jnp.where(far > 0, radius / jnp.where(far > 0, far, 1), 1)
    return right * factor, down * factor


@name_wrong_arguments
@runs_jax
def look(
    pose: Pose,
    grid: Int[ArrayLike, "H W"],
    sight: Sight,
    objects: Objects | None = None,
    key: Key[Array, ""] | None = None,
    chosen: Integer[ArrayLike, "H W 2"] | None = None,
) -> View:
    """Renders the view from a pose on a grid.

    Args:
      pose: the pose of the middle between the wheels, in tiles.
      grid: integer codes ``[H, W]``; for traced ones see `measure`.
      sight: the camera and its pictures, from `make_sight`. For a camera that differs in a batch,
        give ``sight._replace(camera=camera)``.
      objects: the objects of the map, from `make_objects`. Those that stand are shown if the sight
        has their pictures. Tags on the floor are not shown.
      key: consumed for the camera's noise; by default the noise depends on the pose alone.
      chosen: the picture of each cell, from `choose_tiles`; by default see `Sight.tiles`.

    Returns:
      A record of `image`, uint8 ``[rows, columns, 3]``, RGB; `labels`, uint8 ``[rows, columns]``,
      indices of `tiles.LABELS`, 0 beyond the map, above the horizon and on objects; and
      `instances`, int32 ``[rows, columns]``, 0, or the index of the object that is seen plus 1;
      None without objects.

    Raises:
      InputError: for a bad grid, a pose that is not a `Pose`, or objects of several maps. Also for
        chosen pictures that do not fit the grid, or that the sight does not have.
    """
    pose = check_named("pose", single(Pose), pose)
    codes = jnp.asarray(check_grid(grid))
    if objects is not None and np.ndim(objects.kind) != 1:
        got = f"shape {list(np.shape(objects.kind))}"
        raise InputError("objects", "those of one map", got, "jax.vmap takes several")
    tiles = None
    if chosen is not None:
        tiles = _chosen_tiles(jnp.asarray(chosen), codes.shape, len(sight.atlas))
    return _look(pose, codes, sight, objects, key, tiles)


# Other compiled programs include this one as if it were written in them.
@partial(jax.jit, inline=True)
@divide_batches
def _look(
    pose: Pose,
    codes: Int[Array, "H W"],
    sight: Sight,
    objects: Objects | None,
    key: Key[Array, ""] | None,
    tiles: Int[Array, "H W"] | None,
) -> View:
    """Renders a view; `tiles` are the atlas' tiles that cells show, by default the sight's."""
    if tiles is None:
        tiles = _tiles_of(codes, sight)
    if key is None:
        # Environments observe without a key. The noise is hashed from the pose instead.
        seed = jnp.uint32(0)
        for part in pose:
            word = jax.lax.bitcast_convert_type(jnp.asarray(part, jnp.float32), jnp.uint32)
            seed = mix(seed ^ word)
    else:
        # The noise of all pixels is hashed from one draw.
        seed = random_bits(key, ())
    return _render(seed, pose, tiles, sight, objects)


def _chosen_tiles(
    chosen: Integer[Array, "H W 2"], shape: tuple[int, ...], count: int
) -> Int[Array, "H W"]:
    """Returns the tile of an atlas of `count` tiles that each cell shows, from its picture."""
    if chosen.shape != (*shape, 2) or not jnp.issubdtype(chosen.dtype, jnp.integer):
        raise InputError(
            "chosen", f"integers of shape {(*shape, 2)}", f"{chosen.dtype} of shape {chosen.shape}"
        )
    # In 8 bits, four times an index may overflow.
    chosen = chosen.astype(jnp.int32)
    # Traced pictures are unknown, and are not checked.
    if not isinstance(chosen, jax.core.Tracer):
        indices, quarters = np.asarray(chosen).reshape(-1, 2).T
        is_turn = (quarters >= 0) & (quarters < 4)
        is_missing = ~is_turn | (indices < 0) | (4 * indices + quarters >= count)
        if is_missing.any():
            first = is_missing.argmax()
            index, turns = indices[first], quarters[first]
            raise InputError(
                "chosen",
                f"tiles of the {count} pictures, each an index and 0 to 3 quarter turns",
                f"{index} and {turns}",
            )
    return 4 * chosen[..., 0] + chosen[..., 1]


def _tiles_of(grid: Int[Array, "H W"], sight: Sight) -> Int[Array, "H W"]:
    """Returns the tile of the atlas that each cell of a grid shows."""
    height, width = grid.shape
    index = jnp.arange(height)[:, None] + 2 * jnp.arange(width)[None]
    # The four lowest bits of a traced code are read.
    return sight.tiles[grid.astype(jnp.int32) & 15, index % sight.tiles.shape[1]]


def _render(
    seed: UInt32[Array, ""],
    pose: Pose,
    tiles: Int[Array, "H W"],
    sight: Sight,
    objects: Objects | None,
) -> View:
    """Renders a view from the tile of the atlas for each cell, and the seed of the noise."""
    camera, atlas, _, billboards = sight
    height, width = tiles.shape
    size = atlas.shape[1]
    rays = once(lambda: rays_of(camera))
    seen, depth, ahead = once(lambda: reach_ground(camera, rays))
    # Whatever computes the pose, XLA would repeat it for each pixel.
    east, south, cosine, sine = once(
        lambda: (pose.x, pose.y, jnp.cos(pose.theta), jnp.sin(pose.theta))
    )
    # The points on the ground are in tiles, ahead and to the right of the robot.
    right = depth * rays.right
    # In pixels of the rendered map, because positions are rounded on the map, not on the tile.
    x = jnp.floor((east + ahead * cosine + right * sine) * size).astype(jnp.int32)
    y = jnp.floor((south - ahead * sine + right * cosine) * size).astype(jnp.int32)
    inside = seen & (x >= 0) & (x < width * size) & (y >= 0) & (y < height * size)
    # Points beyond the map are read as well, at its edge, and replaced later.
    x, y = jnp.clip(x, 0, width * size - 1), jnp.clip(y, 0, height * size - 1)
    # Indices have loops of their own and are unsigned, see `_look_up` in `_ground`.
    cell = once(lambda: ((y // size) * width + x // size).astype(jnp.uint32))
    tile = tiles.reshape(-1).at[cell].get(mode="promise_in_bounds")
    flat = once(lambda: ((tile * size + y % size) * size + x % size).astype(jnp.uint32))
    # Reads one word instead of four bytes.
    words = jax.lax.bitcast_convert_type(atlas, jnp.uint32).reshape(-1)
    pixel = once(lambda: words.at[flat].get(mode="promise_in_bounds"))

    instances = None
    if objects is not None and billboards is not None:
        seen_objects = see_objects(pose, objects, objects.kind, billboards, rays, camera)
        instances = seen_objects.instances
        # The closure needs the pixels under the objects by another name.
        road = pixel
        pixel = once(lambda: jnp.where(seen_objects.hit, seen_objects.colours(billboards), road))
        # An object is also seen where no tile is behind it.
        inside |= seen_objects.hit

    noise_seed = None if camera.noise is None else once(lambda: seed)
    colours = []
    for channel, (ground, sky) in enumerate(zip(camera.ground, camera.sky, strict=True)):
        # A ray that meets neither a tile nor an object shows the ground, or above the horizon the
        # sky.
        around = jnp.where(seen, ground, sky)
        colour = (
            jnp.where(inside, (pixel >> (8 * channel) & 255).astype(jnp.float32), around)
            * camera.light
        )
        if noise_seed is not None and camera.noise is not None:
            normals = hash_normal(fork(noise_seed, channel), colour.shape)
            colour += jnp.multiply(camera.noise, normals)
        colours.append(jnp.clip(jnp.round(colour), 0, 255).astype(jnp.uint32))
    red, green, blue = colours
    # One word for each pixel is one loop. Bytes that are stacked are a loop for each, without the
    # processor's vectors.
    words = once(lambda: red | green << 8 | blue << 16 | jnp.where(inside, pixel >> 24, 0) << 24)
    pixels = jax.lax.bitcast_convert_type(words, jnp.uint8)
    return View(pixels[..., :3], pixels[..., 3], instances)
