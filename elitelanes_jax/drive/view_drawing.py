"""Draws views from their plans."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int32, Key, UInt32

from elitelanes_jax._util.types import Numeric
from elitelanes_jax.drive._camera import rays_of
from elitelanes_jax.drive._ground import (
    UNIT,
    Points,
    Rows,
    interpolate,
    interpolation_weights,
    look_up,
    take_points,
)
from elitelanes_jax.drive._objects_seen import Rays, SeenObjects, lie, see_objects
from elitelanes_jax.drive._scenes import PAVED, Scenes
from elitelanes_jax.drive._variation import lay_background, photograph
from elitelanes_jax.drive._view_plans import Plan, plan_views
from elitelanes_jax.drive.camera_options import Camera, Variation
from elitelanes_jax.network.xla import once


class DrawnView(NamedTuple):
    """One view. In a batch every shape starts with B.

    Attributes:
      words: uint32 ``[rows, columns]``, red, green, blue and label from the lowest byte.
      instances: int32 ``[rows, columns]``, see `views`; None without objects.
      covered: int32 ``[O]``, the number of pixels that each object would cover alone; None without
        objects.
    """

    words: UInt32[Array, "rows columns"]
    instances: Int32[Array, "rows columns"] | None
    covered: Int32[Array, " O"] | None


def draw_views(scenes: Scenes, plans: Plan) -> DrawnView:
    """Draws a batch of views."""
    # A processor draws one view at a time, because the arrays of one view fit its caches. A GPU
    # needs many views to be busy.
    draw = partial(_draw_view, scenes)
    return jax.lax.platform_dependent(plans, cpu=partial(jax.lax.map, draw), default=jax.vmap(draw))


@partial(jax.jit, static_argnames="room")
def draw_some(
    key: Key[Array, ""],
    indices: Int32[Array, " B"],
    scenes: Scenes,
    camera: Camera,
    variation: Variation,
    first: Numeric,
    count: Numeric,
    *,
    room: int,
) -> tuple[Plan, DrawnView]:
    """Draws some views of a batch, for datasets.

    View i shows the map i of the scenes, and depends on the key and ``indices[i]`` alone. The
    program for a batch is the same however many views are drawn. Therefore a view has the same bits
    in each batch.

    Args:
      key: consumed.
      indices: of the views.
      scenes: a map for each view, and the pictures.
      camera: the options of all views.
      variation: the ranges of all views.
      first: the first view that is drawn.
      count: the number of views that are drawn, at most `room`.
      room: the length of the drawn arrays; static.

    Returns:
      The plans of all views, and the drawn views.
    """
    with jax.numpy_rank_promotion("allow"), jax.numpy_dtype_promotion("standard"):
        maps = jnp.arange(len(indices), dtype=jnp.int32)
        plans = plan_views(key, indices, scenes, camera, variation, samples=2, maps=maps)

        def draw(index: Numeric) -> DrawnView:
            plan = jax.tree.map(lambda part: part[index], plans)
            return _draw_view(scenes, plan, interpolates=True)

        def add(index: Array, drawn: DrawnView) -> DrawnView:
            view = draw(first + index)
            return jax.tree.map(lambda views, view: views.at[index].set(view), drawn, view)

        shapes = jax.eval_shape(draw, 0)
        empty = jax.tree.map(lambda part: jnp.zeros((room, *part.shape), part.dtype), shapes)
        return plans, jax.lax.fori_loop(0, count, add, empty)


def _draw_view(scenes: Scenes, plan: Plan, *, interpolates: bool = False) -> DrawnView:
    """Draws one view.

    If `interpolates`, pixels that are smaller than those of the largest pictures of tiles are
    interpolated between these. That needs 2 x 2 samples a pixel. The pixels that objects would
    cover alone are counted too.
    """
    camera = plan.camera
    samples = plan.samples.seen.shape[0] // camera.rows
    centre, is_ground = take_points(plan.centres, plan.lines, camera.columns)
    near = plan.centres.is_near if interpolates else None
    # Colours are means of samples. Labels and objects' indices are those at pixels' centres,
    # because means of them have no meaning.
    fine = _find_objects(plan, scenes, samples, plan.samples)
    red_blue, green_paved, above = once(
        lambda: _sum_samples(plan, scenes, samples, fine, centre, near)
    )
    # The sums are unpacked into one plane for each colour.
    share = np.float32(1 / (256 if interpolates else samples**2))
    sums = red_blue & 0xFFFF, green_paved & 0xFFFF, red_blue >> 16
    road = [total.astype(jnp.float32) * share for total in sums]
    paved = (green_paved >> 16).astype(jnp.float32) * (share / PAVED)
    image = lay_background(road, paved, above.astype(jnp.float32) * share, plan.look)
    image = [plane * camera.light for plane in image]
    red, green, blue = photograph(image, plan.look)
    word = look_up(centre, plan.cells, scenes, None)
    label = jnp.where(is_ground, word >> 24 & (PAVED - 1), 0)
    objects = _find_objects(plan, scenes, 1, plan.centres, counts=interpolates)
    instances = covered = None
    if objects is not None:
        seen = objects.seen
        label = jnp.where(seen.hit, 0, label)
        instances, covered = seen.instances, seen.covered
    words = once(lambda: red | green << 8 | blue << 16 | label << 24)
    return DrawnView(words, instances, covered)


class _ColouredObjects(NamedTuple):
    """The objects in a view, for each sample.

    Attributes:
      seen: the objects.
      colours: uint32 ``[rows, columns]``, red, green and blue from the lowest byte.
    """

    seen: SeenObjects
    colours: UInt32[Array, "rows columns"]


def _find_objects(
    plan: Plan, scenes: Scenes, samples: int, ground: Rows, *, counts: bool = False
) -> _ColouredObjects | None:
    """Finds the objects in a view; `ground` is where the rows of samples meet it."""
    objects, pictures, billboards = plan.objects, plan.pictures, scenes.billboards
    if objects is None or pictures is None or billboards is None:
        return None
    camera = plan.camera
    rays: Rays = once(lambda: rays_of(camera, samples))
    shown = plan.pose, objects
    seen = see_objects(*shown, pictures, billboards, rays, camera, counts=counts)
    if plan.floor is not None:
        # Objects on the floor are behind all standing ones.
        column = jnp.arange(camera.columns * samples) - camera.columns * samples // 2
        lines = _lines_in_tiles(ground)
        on_floor = lie(
            *shown, plan.floor, pictures, billboards, *lines, column, camera, counts=counts
        )
        seen = seen.over(on_floor)
    return _ColouredObjects(seen, seen.colours(billboards))


def _lines_in_tiles(ground: Rows) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Returns the lines of `lie`."""
    tile = np.float32(1 / (1 << UNIT))
    x, x_step, y, y_step = (
        part.astype(jnp.float32) * tile
        for part in (ground.x, ground.x_step, ground.y, ground.y_step)
    )
    # Without the map's border of one tile.
    return (jnp.where(ground.seen, x - 1, jnp.nan), x_step), (y - 1, y_step)


def _sum_samples(
    plan: Plan,
    scenes: Scenes,
    samples: int,
    objects: _ColouredObjects | None,
    centre: Points,
    near: Bool[Array, "rows _"] | None,
) -> tuple[Array, Array, Array]:
    """Sums the samples of each pixel, two sums in each word.

    Returns red and blue, green and `PAVED`, and the number of samples of sky. Of two sums the
    second one is times 2**16. The samples of sky are one column if no object covers them.

    If `near` says which pixels are interpolated, the samples have weights, 256 in all.
    """
    rows, columns = plan.camera.rows, plan.camera.columns
    # Two sums share a word: at most 16 samples of 255, or weights of 256, fit 16 bits. That saves
    # half of the additions.
    red_blue = green_paved = jnp.zeros((rows, columns), jnp.uint32)
    above = jnp.zeros((rows, 1), jnp.uint32)
    weights = None
    if near is not None:
        if objects is not None:
            # The samples of an object have equal weights.
            hits = [objects.seen.hit[i % 2 :: 2, i // 2 :: 2] for i in range(4)]
            near &= ~(hits[0] | hits[1] | hits[2] | hits[3])
        weights = interpolation_weights(centre, near, scenes.tile_px)
    for down in range(samples):
        for right in range(samples):
            points, seen = take_points(plan.samples, plan.lines, columns, samples, down, right)
            if near is not None:
                points = interpolate(centre, near, points, down, right, scenes.tile_px)
            word = jnp.where(seen, look_up(points, plan.cells, scenes, plan.blend), 0)
            is_sky = ~seen
            if objects is not None:
                layers = objects.seen.hit, objects.colours
                hit, colours = (layer[down::samples, right::samples] for layer in layers)
                # The bit `PAVED` also marks objects, which hide the background.
                word = jnp.where(hit, colours | PAVED << 24, word)
                is_sky &= ~hit
            weight = np.uint32(1) if weights is None else weights[down][right]
            red_blue += (word & 0xFF00FF) * weight
            green_paved += (word >> 8 & (PAVED << 16 | 0xFF)) * weight
            above += is_sky.astype(jnp.uint32) * (1 if weights is None else 64)
    return red_blue, green_paved, above
