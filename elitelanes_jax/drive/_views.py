"""Batches of different views from robots on the lanes of maps, drawn inside a training program."""

from collections.abc import Iterator
from functools import partial
from itertools import count
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int32, Key, UInt8

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, instance, whole
from elitelanes_jax._util.copies import frozen_copy
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax.drive._scenes import Scenes
from elitelanes_jax.drive._view_plans import plan_views
from elitelanes_jax.drive.camera_options import Camera, Variation
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.view_drawing import draw_views
from elitelanes_jax.network.bits import check_key, seed_key
from elitelanes_jax.network.sharding import divide_batches


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
      variation: the ranges of poses, cameras and pictures.
      samples: n, 1 to 4: each pixel is the mean of n x n points; static. One point is faster, but
        thin lines flicker.

    Raises:
      InputError: for an argument of another type or out of its range.
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
    check_named("camera", instance(Camera), camera)
    for name, colour in (("ground", camera.ground), ("sky", camera.sky)):
        # An array of three numbers would be taken for a value for each of three pictures.
        if not isinstance(colour, tuple | list):
            raise InputError(name, "a tuple of red, green and blue", quote(colour))
    for record in (camera, variation):
        for path, number in jax.tree_util.tree_leaves_with_path(record):
            if np.shape(number) not in ((), (batch,)):
                name = jax.tree_util.keystr(path).lstrip(".")
                raise InputError(
                    name, f"a number or an array [{batch}]", f"shape {np.shape(number)}"
                )


@runs_jax
@partial(jax.jit, static_argnames=("batch", "samples"))
@divide_batches
def _draw(
    key: Array, scenes: Scenes, camera: Camera, variation: Variation, *, batch: int, samples: int
) -> Views:
    # Arrays of several ranks and dtypes are mixed here, which settings of JAX may forbid.
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        plans = plan_views(key, jnp.arange(batch), scenes, camera, variation, samples=samples)
        drawn = draw_views(scenes, plans)
    pixels = jax.lax.bitcast_convert_type(drawn.words, jnp.uint8)
    return Views(
        pixels[..., :3], pixels[..., 3], plans.lane, plans.pose, plans.map, drawn.instances
    )
