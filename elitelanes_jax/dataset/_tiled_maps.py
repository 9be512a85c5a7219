"""Maps of tiles' pictures. Only the part that a view shows is made.

A view from a robot shows few tiles in full detail. To lay out a whole map of 7 x 7 tiles of 256
pixels for each view takes five times as long as all else. The results are those of views of the
whole map, bit for bit, because a map is halved by the means of four pixels, and no four pixels
belong to two tiles.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, UInt8
from numpy.typing import NDArray

from elitelanes_jax.dataset._robot_views import LEVELS, MapPart, Rays, Viewpoint, see_parts
from elitelanes_jax.tiles.rendering import scale_opaque, scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

# The channels of pictures, see `see_parts`.
_CHANNELS = 4
# The bits of the bytes of surfaces: the label, and whether the surface is paved.
_LABEL_BITS, _PAVED = 0x7F, 0x80
# The side of tiles in pixels up to which they are laid out whole, because cutting each of them
# takes longer. A part of 3.5 x 3.5 tiles takes 31 us whole and 46 us cut at 32 pixels. At 128 both
# take 80 us, and at 256 it takes 2,800 us whole and 210 us cut.
_SMALL = 32


class TiledMap(NamedTuple):
    """A map of H x W tiles.

    Attributes:
      tiles: whose pictures the map is drawn with. They are not blended.
      tile_px: side of a tile in pixels, a multiple of 32.
      picture: int ``[H, W]``, the index of each cell's picture in `scale_tiles`.
    """

    tiles: TileSet
    tile_px: int
    picture: Int[NDArray, "H W"]

    def see(
        self, viewpoint: Viewpoint, ground: tuple[int, int, int]
    ) -> UInt8[NDArray, "rows columns 3"]:
        """Draws a camera's view of the map; see `see` in `_robot_views`."""
        return see_parts(self._part_of, viewpoint, ground, _CHANNELS)

    def _part_of(
        self, rank: int, x: Float32[NDArray, "R C"], y: Float32[NDArray, "R C"]
    ) -> MapPart:
        """Makes the part of the map, halved `rank` times, that has some points; see `see_parts`."""
        images = _stack_tiles(self.tiles, self.tile_px).pictures[rank]
        size, (height, width) = images.shape[1], self.picture.shape
        # Points are in pixels of the whole map, and the part is of the map halved `rank` times.
        if rank:
            x *= np.float32(0.5**rank)
            y *= np.float32(0.5**rank)
        # The points tell which pixels of the map are needed, and these tell which cells.
        left, right = _pixels_between(x, width * size)
        top, bottom = _pixels_between(y, height * size)
        first_row, first_column = top // size, left // size
        # The range of pixels is widened to whole tiles.
        cells = self.picture[
            first_row : (bottom - 1) // size + 1, first_column : (right - 1) // size + 1
        ]
        if size <= _SMALL:
            part = _lay_out(images[cells])[
                top - first_row * size : bottom - first_row * size,
                left - first_column * size : right - first_column * size,
            ]
        else:
            part = np.empty((bottom - top, right - left, _CHANNELS), np.uint8)
            # Only the pixels of each tile that are on the part are copied.
            rows = [
                _overlap((first_row + row) * size, size, top, bottom) for row in range(len(cells))
            ]
            columns = [
                _overlap((first_column + column) * size, size, left, right)
                for column in range(cells.shape[1])
            ]
            for pictures, across in zip(cells.tolist(), rows, strict=True):
                for picture, down in zip(pictures, columns, strict=True):
                    part[across.on_part, down.on_part] = images[
                        picture, across.on_tile, down.on_tile
                    ]
        # The points on the map stay exact, because their coordinates do not grow.
        x -= np.float32(left + 0.5)
        y -= np.float32(top + 0.5)
        return MapPart(part, x, y)


class SeenLabels(NamedTuple):
    """What rays meet on a map.

    Attributes:
      labels: uint8 ``[rows, columns]``, indices in `LABELS`.
      paved: bool ``[rows, columns]``, whether a ray meets a tile and not the ground, see
        `show_paved`.
    """

    labels: UInt8[NDArray, "rows columns"]
    paved: Bool[NDArray, "rows columns"]


def see_tiled_labels(tiled: TiledMap, rays: Rays) -> SeenLabels:
    """Returns the labels that rays meet, of the nearest pixels, as `see_labels` does."""
    surfaces, size = _stack_tiles(tiled.tiles, tiled.tile_px).surfaces, tiled.tile_px
    # Cells around the map have the last picture, which is ground.
    height, width = (count + 2 for count in tiled.picture.shape)
    pictures = np.full((height, width), len(surfaces) - 1)
    pictures[1:-1, 1:-1] = tiled.picture
    row, column = (
        _pixels_with_border(rays.y, size, height),
        _pixels_with_border(rays.x, size, width),
    )
    # Arrays are changed in place below, which saves new arrays of this size.
    tile_row, tile_column = row // np.int32(size), column // np.int32(size)
    tile_row *= np.int32(width)
    tile_row += tile_column
    # The index in the flat `surfaces` is this part, which depends on the cell alone, plus the row
    # on the map times the size, plus the column on the map.
    first = ((pictures - np.arange(height)[:, None]) * size - np.arange(width)) * size
    pixel = first.astype(np.int32).reshape(-1).take(tile_row)
    row *= np.int32(size)
    pixel += row
    pixel += column
    # Rows of sky stay 0, which is background and not paved.
    seen = np.zeros((rays.sky + len(row), row.shape[1]), np.uint8)
    surfaces.reshape(-1).take(pixel, out=seen[rays.sky :])
    return SeenLabels(seen & _LABEL_BITS, seen >= _PAVED)


def _pixels_with_border(
    places: Float32[NDArray, "R C"], size: int, count: int
) -> Int32[NDArray, "R C"]:
    """Returns the pixels nearest to coordinates on a map, along one axis.

    Pixel 0 is that of a border of one tile around the map, `count` tiles with both borders. Pixels
    beyond the borders are in them.
    """
    pixel = np.rint(places - np.float32(0.5)).astype(np.int32)
    # The border adds one tile before the map.
    pixel += np.int32(size)
    # All pixels of a border show the same ground, so the nearest one to the map stands for them.
    np.maximum(pixel, np.int32(size - 1), out=pixel)
    return np.minimum(pixel, np.int32((count - 1) * size), out=pixel)


def can_tile(tiles: TileSet, tile_px: int) -> bool:
    """Returns whether a map can be drawn as a `TiledMap`."""
    return not tiles.blend and tile_px % 2 ** (LEVELS - 1) == 0


def _pixels_between(places: NDArray[np.float32], count: int) -> tuple[int, int]:
    """Returns the first pixel, and the one after the last, that coordinates refer to.

    At least one of `count` pixels is between them.
    """
    # Along a row the coordinates increase or decrease, also with shifted lines: the shift is less
    # than a tile's width divided by 2 pi. Interpolation reads one pixel beyond a point.
    ends = places[:, [0, -1]]
    first = min(max(int(ends.min()) - 2, 0), count - 1)
    last = min(max(int(ends.max()) + 2, first), count - 1)
    return first, last + 1


def _lay_out(pictures: UInt8[NDArray, "H W P P C"]) -> UInt8[NDArray, "h w C"]:
    """Lays pictures side by side."""
    height, width, size, _, channels = pictures.shape
    return pictures.swapaxes(1, 2).reshape(height * size, width * size, channels)


class _Overlap(NamedTuple):
    """The pixels that a tile and a part of a map have in common, along one axis.

    Attributes:
      on_tile: the pixels, counted from the start of the tile.
      on_part: the pixels, counted from the start of the part.
    """

    on_tile: slice
    on_part: slice


def _overlap(start: int, size: int, first: int, end: int) -> _Overlap:
    """Returns what a tile and a part of a map have in common.

    The tile has `size` pixels from `start`. The part is from `first` to `end`.
    """
    # The two ranges have in common what follows both starts and precedes both ends.
    low, high = max(start, first), min(start + size, end)
    return _Overlap(slice(low - start, high - start), slice(low - first, high - first))


class _Stack(NamedTuple):
    """What all tiles of a set show, each in four rotations.

    Attributes:
      pictures: uint8 ``[N, P, P, 4]`` for each number of halvings, with a fourth channel of zeros.
      surfaces: uint8 ``[N + 1, P, P]``, labels, and the bit `_PAVED` where a tile is not ground.
        The last is ground.
    """

    pictures: list[UInt8[NDArray, "N P P 4"]]
    surfaces: UInt8[NDArray, "M P P"]


@lru_cache(maxsize=4)
def _stack_tiles(tiles: TileSet, size: int) -> _Stack:
    """Returns the pictures of `scale_tiles` at all sizes, and their surfaces."""
    scaled = scale_tiles(tiles, size)
    # The fourth channel is empty, and only makes OpenCV faster.
    pictures = [np.pad(scaled["image"], [(0, 0)] * 3 + [(0, _CHANNELS - 3)])]
    # Tiles are halved one by one, so that no pixel mixes two tiles.
    for _ in range(1, LEVELS):
        half = pictures[-1].shape[1] // 2
        smaller = [
            cv2.resize(picture, (half, half), interpolation=cv2.INTER_AREA)
            for picture in pictures[-1]
        ]
        pictures.append(np.stack(smaller))
    # Label and paved bit share a byte, so that one lookup returns both.
    surfaces = scaled["labels"] | scale_opaque(tiles, size) * np.uint8(_PAVED)
    return _Stack(pictures, np.pad(surfaces, [(0, 1), (0, 0), (0, 0)]))
