"""What the pixels of a camera see of the ground: where they meet it, and which pixels of tiles.

Positions on the map are whole numbers, in units of 2**-20 tile. Their bits are the cell, the pixel
of the tile's picture and the rest. The map has a border of one tile of ground.

Pixels see smaller pictures of tiles at larger distances.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int32, UInt32

from elitelanes_jax.drive._camera import focal_length, rays_of, reach_ground
from elitelanes_jax.drive._scenes import PAVED, Blend, Scenes
from elitelanes_jax.drive.camera_options import Camera
from elitelanes_jax.drive.lanes import Pose
from elitelanes_jax.drive.robot import TILE
from elitelanes_jax.network.codes import EAST, NORTH, SOUTH, WEST
from elitelanes_jax.network.xla import once

UNIT = 20
"""The bits of a position after the point."""

_TILE, _WITHIN = 1 << UNIT, (1 << UNIT) - 1
# The largest position in tiles. In units of 2**-20 tile it is just under 2**31, so it fits an
# int32.
_FARTHEST = 2000.0
# The distance of the white line from the tile's edge, in tiles.
_WHITE_LINE = 0.09
# The coefficients of sin(2 pi x) / (x - 4 x³) from -0.5 to 0.5, in powers of x². The error of the
# sine is at most 3e-4. XLA's own sine takes three times as long as all else of a plain view.
_SINE = (6.2780686, -15.958950, 13.880676)
# The byte of a word with the label, and whether the tile is paved.
_LABEL = np.uint32(0xFF000000)
# The width of the blend on both sides of a seam in tiles, and at least two pixels, as in pictures
# from above.
_FEATHER, _LEAST_FEATHER_PX = 0.02, 2


class Rows(NamedTuple):
    """Where the rows of a picture meet the ground.

    Without distortion every shape is ``[R, 1]``, a row for each row of samples. A distorted row is
    no line on the ground, so every shape is ``[R, C]``, with a column for each column of samples.

    Attributes:
      x: int32, position of the middle column, or of each column.
      x_step: int32, from a column to the next; 0 with distortion.
      y: int32, as x.
      y_step: int32, as x_step.
      first: int32, the first pixel of the pictures' size in a row of the pyramid.
      size: int32, the side of these pictures.
      seen: bool, whether the ground is seen.
      is_near: bool, whether a row's pixels are smaller than those of the largest pictures.
    """

    x: Int32[Array, "R _"]
    x_step: Int32[Array, "R _"]
    y: Int32[Array, "R _"]
    y_step: Int32[Array, "R _"]
    first: Int32[Array, "R _"]
    size: Int32[Array, "R _"]
    seen: Bool[Array, "R _"]
    is_near: Bool[Array, "R _"]


class Points(NamedTuple):
    """Points on the ground that a picture sees, with the pictures of tiles that it sees there.

    Attributes:
      x: int32 ``[rows, columns]``.
      y: int32 ``[rows, columns]``.
      first: int32, see `Rows`.
      size: int32, see `Rows`.
    """

    x: Int32[Array, "rows columns"]
    y: Int32[Array, "rows columns"]
    first: Int32[Array, "..."]
    size: Int32[Array, "..."]


def meet_ground(
    pose: Pose, camera: Camera, sizes: tuple[int, ...], samples: int, *, smaller: bool
) -> Rows:
    """Returns where the rows of samples meet the ground.

    `sizes` are the sides of pictures, and `smaller` chooses smaller ones for larger distances.
    """
    # Each row uses the angles' sines, cosines and tangents.
    cosine, sine, rays = once(
        lambda: (jnp.cos(pose.theta), jnp.sin(pose.theta), rays_of(camera, samples))
    )
    columns = rays.right.shape[1]
    middle = columns // 2
    if camera.distortion is not None or columns == 1:
        # A single column has no neighbour. The distance to the next row is the same.
        gap = 1 / focal_length(camera, samples)
    else:
        gap = (rays.right[0, -1] - rays.right[0, 0]) / (columns - 1)
    seen, depth, ahead = reach_ground(camera, rays)
    x_step, y_step = depth * sine * gap, depth * cosine * gap
    if camera.distortion is None:
        # Without distortion a row of pixels meets the ground in a line. So a position and a step
        # describe the whole row. With an even number of columns, the middle column is half a step
        # beside the robot's axis.
        offset = rays.right[0, middle] / gap
    else:
        offset = rays.right / gap
    # The map has a border of one tile.
    x = 1 + pose.x + ahead * cosine + x_step * offset
    y = 1 + pose.y - ahead * sine + y_step * offset
    if camera.distortion is not None:
        x_step, y_step = jnp.zeros_like(x), jnp.zeros_like(y)
    # Whole numbers of 32 bits must hold the positions of both ends of a row.
    ends = jnp.maximum(
        jnp.abs(x) + jnp.abs(x_step) * columns, jnp.abs(y) + jnp.abs(y_step) * columns
    )
    # Beyond that a row shows the border's corner, which is ground.
    x, x_step, y, y_step = (
        jnp.round(jnp.where(ends < _FARTHEST, part, 0) * _TILE).astype(jnp.int32)
        for part in (x, x_step, y, y_step)
    )
    # The distance between samples is the root of the area between four of them, in pixels of the
    # largest pictures.
    height = camera.height / TILE
    apart = jnp.sqrt(depth**3 / height) * gap * sizes[0]
    level = jnp.zeros(depth.shape, jnp.int32)
    if smaller:
        level = jnp.floor(jnp.log2(jnp.maximum(apart, 1)) + 0.5).astype(jnp.int32)
        level = jnp.minimum(level, len(sizes) - 1)
    # The pyramid has the pictures of a tile one after another, from the largest one.
    starts = np.concatenate([[0], np.cumsum(np.square(sizes))[:-1]])
    first, size = (jnp.asarray(table, jnp.int32)[level] for table in (starts, sizes))
    return Rows(x, x_step, y, y_step, first, size, seen, seen & (apart < 1))


def take_points(
    rows: Rows, lines: Array | None, columns: int, samples: int = 1, down: int = 0, right: int = 0
) -> tuple[Points, Bool[Array, "rows _"]]:
    """Returns the points of one sample of each pixel, and which of them are on the ground.

    The sample is in row `down` and column `right` of the pixel's samples. `lines` is the shift of
    positions where a tile is stretched most, in 2**-20 tile; None for none.
    """
    column = jnp.arange(columns) * samples + (right - columns * samples // 2)
    is_distorted = rows.x.shape[1] > 1
    part = jax.tree.map(
        lambda table: (
            table[down::samples, right::samples] if is_distorted else table[down::samples]
        ),
        rows,
    )
    x, y = part.x + part.x_step * column, part.y + part.y_step * column
    points = Points(_stretch(x, lines), _stretch(y, lines), part.first, part.size)
    return points, part.seen


def _stretch(position: Int32[Array, "..."], lines: Array | None) -> Int32[Array, "..."]:
    """Shifts positions on their tiles away from the tiles' middles, by the most at white lines.

    The middle and the edges of a tile stay.
    """
    if lines is None:
        return position
    within = position & _WITHIN
    # The sine is 0 at both edges and in the middle of the tile, so these stay. The divisor makes
    # the shift at the white line the one that was drawn.
    most = lines / np.float32(np.sin(2 * np.pi * _WHITE_LINE))
    turns = within.astype(jnp.float32) * np.float32(1 / _TILE)
    moved = within + jnp.round(_sine(turns) * most).astype(jnp.int32)
    return position - within + jnp.clip(moved, 0, _WITHIN)


def _sine(turns: Float[Array, "..."]) -> Float[Array, "..."]:
    """Returns the sine of an angle in full turns, from 0 to 1; see `_SINE`."""
    x = 0.5 - turns
    square = x * x
    a, b, c = map(np.float32, _SINE)
    return x * (1 - 4 * square) * (a + square * (b + square * c))


def interpolate(
    centre: Points, near: Bool[Array, "rows _"], point: Points, down: int, right: int, size: int
) -> Points:
    """Returns one of the four points of a pixel whose pictures are interpolated where it is near.

    A near pixel is smaller than a pixel of the tile's largest picture, of `size` pixels a side.
    There the four points are the nearest four pixels around the pixel's centre, and elsewhere
    `point`. `interpolation_weights` returns their weights.
    """
    half = _TILE // size // 2
    x = jnp.where(near, centre.x + (2 * right - 1) * half, point.x)
    y = jnp.where(near, centre.y + (2 * down - 1) * half, point.y)
    return Points(x, y, jnp.where(near, 0, point.first), jnp.where(near, size, point.size))


def interpolation_weights(
    centre: Points, near: Bool[Array, "rows columns"], size: int
) -> list[list[Array]]:
    """Returns the weights of the points of `interpolate`, in 1/256, row by row."""
    half = _TILE // size // 2
    shares = []
    for position in (centre.x, centre.y):
        # The four bits after the point of the position in pixels.
        sixteenths = ((position - half & _WITHIN) * size) >> (UNIT - 4) & 15
        shares.append(jnp.where(near, sixteenths, 8).astype(jnp.uint32))
    across, below = shares
    return [[(16 - across) * part, across * part] for part in (16 - below, below)]


def look_up(
    points: Points, cells: Int32[Array, " N"], scenes: Scenes, blend: Blend | None
) -> UInt32[Array, "rows columns"]:
    """Returns the words of the pyramid at points.

    `cells` has the picture of each cell.
    """
    if blend is None:
        return _look_up(points, cells, scenes)[0]
    word, cell = _look_up_toned(points, cells, scenes, blend)
    reach = max(_FEATHER, _LEAST_FEATHER_PX / scenes.tile_px) * _TILE
    mixed = [colour.astype(jnp.float32) for colour in colours_of(word)]
    # A pixel near a seam is mixed with its mirror image on the other side. Near corners both
    # changes are added.
    for axis, (before, after) in (("x", (WEST, EAST)), ("y", (NORTH, SOUTH))):
        position = getattr(points, axis)
        seam = (position + _TILE // 2) & ~_WITHIN
        mirrored = points._replace(**{axis: 2 * seam - 1 - position})
        other, _ = _look_up_toned(mirrored, cells, scenes, blend)
        meets = blend.meetings.at[cell].get(mode="promise_in_bounds") & jnp.where(
            position >= seam, before, after
        )
        away = jnp.abs(position - seam).astype(jnp.float32) / reach
        # The byte of the label also says what is paved.
        mixes = (meets > 0) & (away < 1) & (word >> 24 == other >> 24)
        # The share is one half at the seam, and falls by a cosine.
        share = jnp.where(mixes, (1 + _sine(0.25 + away / 2)) / 4, 0)
        for index, (here, there) in enumerate(
            zip(colours_of(word), colours_of(other), strict=True)
        ):
            change = there.astype(jnp.float32) - here.astype(jnp.float32)
            mixed[index] = mixed[index] + share * change
    red, green, blue = (_to_byte(colour) for colour in mixed)
    return once(lambda: red | green << 8 | blue << 16 | word & _LABEL)


def colours_of(word: UInt32[Array, "..."]) -> list[UInt32[Array, "..."]]:
    """Returns the red, green and blue of words."""
    return [word >> (8 * channel) & 255 for channel in range(3)]


def _to_byte(colour: Float[Array, "..."]) -> UInt32[Array, "..."]:
    return jnp.clip(jnp.round(colour), 0, 255).astype(jnp.uint32)


def _look_up(
    points: Points, cells: Int32[Array, " N"], scenes: Scenes
) -> tuple[UInt32[Array, "rows columns"], UInt32[Array, "rows columns"]]:
    """Returns the words at points, and the cells there.

    Indices are computed by loops of their own, because a loop that reads at them does not use the
    processor's vectors. They are unsigned, so that JAX does not look for negative ones.
    """
    height, width = scenes.maps.codes.shape[1:]
    # Beyond the map the position is moved to its border, which is ground.
    x = jnp.clip(points.x, 0, width * _TILE - 1)
    y = jnp.clip(points.y, 0, height * _TILE - 1)
    cell = once(lambda: ((y >> UNIT) * width + (x >> UNIT)).astype(jnp.uint32))
    tile = cells.at[cell].get(mode="promise_in_bounds")
    # The row and the column of the picture's pixel are the whole parts of the position times the
    # picture's side.
    row, column = ((part & _WITHIN) * points.size >> UNIT for part in (y, x))
    pixel = points.first + row * points.size + column
    index = once(lambda: (tile * scenes.pyramid.shape[1] + pixel).astype(jnp.uint32))
    word = once(lambda: scenes.pyramid.reshape(-1).at[index].get(mode="promise_in_bounds"))
    return word, cell


def _look_up_toned(
    points: Points, cells: Int32[Array, " N"], scenes: Scenes, blend: Blend
) -> tuple[UInt32[Array, "rows columns"], UInt32[Array, "rows columns"]]:
    """Returns what `_look_up` does, with the light of each cell."""
    word, cell = _look_up(points, cells, scenes)
    toned = []
    for index, colour in enumerate(colours_of(word)):
        gain, offset = (
            blend.tones[:, index, part].at[cell].get(mode="promise_in_bounds") for part in (0, 1)
        )
        toned.append(_to_byte(colour.astype(jnp.float32) * gain + offset))
    red, green, blue = toned
    # What is not paved shows the ground of the view, whose light does not change.
    colours = jnp.where(word >> 24 & PAVED > 0, red | green << 8 | blue << 16, 0)
    return once(lambda: colours | word & _LABEL), cell
