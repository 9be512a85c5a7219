"""Maps of tiles' pictures. Only the part that a view shows is made.

A view from a robot shows few tiles in full detail. To lay out a whole map of 7 x 7 tiles of 256 pixels for each view
takes five times as long as all else. The results are those of views of the whole map, bit for bit, because a map is
halved by the means of four pixels, and no four pixels belong to two tiles.
"""

from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Int, UInt8
from numpy.typing import NDArray

from elitelanes_jax.dataset._robot_views import LEVELS, MapPart, Rays, Viewpoint, see_parts
from elitelanes_jax.tiles.rendering import scale_opaque, scale_tiles
from elitelanes_jax.tiles.tileset import TileSet

_CHANNELS = 4  # of pictures, see `see_parts`
_SMALL = 32  # pixels, the side of tiles that are laid out whole, because cutting each one takes longer


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

    def see(self, viewpoint: Viewpoint, ground: tuple[int, int, int]) -> UInt8[NDArray, "rows columns 3"]:
        """Draws a camera's view of the map; see `see` in `_robot_views`."""
        return see_parts(self._part_of, viewpoint, ground, _CHANNELS)

    def _part_of(self, rank: int, x: NDArray[np.float32], y: NDArray[np.float32]) -> MapPart:
        """Makes the part of the map, halved `rank` times, that has some points; see `see_parts`."""
        images = _halve_tiles(self.tiles, self.tile_px, rank)
        size, (height, width) = images.shape[1], self.picture.shape
        across, down = (place * np.float32(0.5**rank) for place in (x, y))
        left, right = _pixels_between(across, width * size)
        top, bottom = _pixels_between(down, height * size)
        first_row, first_column = top // size, left // size
        cells = self.picture[first_row : (bottom - 1) // size + 1, first_column : (right - 1) // size + 1]
        if size <= _SMALL:
            part = _lay_out(images[cells])[
                top - first_row * size : bottom - first_row * size,
                left - first_column * size : right - first_column * size,
            ]
        else:
            part = np.empty((bottom - top, right - left, _CHANNELS), np.uint8)
            for (row, column), picture in np.ndenumerate(cells):
                rows = _overlap((first_row + row) * size, size, top, bottom)
                columns = _overlap((first_column + column) * size, size, left, right)
                part[rows.on_part, columns.on_part] = images[picture, rows.on_tile, columns.on_tile]
        # The points on the map stay exact, because their coordinates do not grow.
        across -= np.float32(left + 0.5)
        down -= np.float32(top + 0.5)
        return MapPart(part, across, down)


class SeenLabels(NamedTuple):
    """What rays meet on a map.

    Attributes:
      labels: uint8 ``[rows, columns]``, indices in `LABELS`.
      paved: bool ``[rows, columns]``, whether a ray meets a tile and not the ground, see `show_paved`.
    """

    labels: UInt8[NDArray, "rows columns"]
    paved: Bool[NDArray, "rows columns"]


def see_tiled_labels(tiled: TiledMap, rays: Rays) -> SeenLabels:
    """Returns the labels that rays meet, of the nearest pixels, as `see_labels` does."""
    size, (height, width) = np.int32(tiled.tile_px), tiled.picture.shape
    labels, paved = np.zeros(rays.x.shape, np.uint8), np.zeros(rays.x.shape, bool)
    near = slice(len(rays.near) - np.count_nonzero(rays.near), None)
    column, row = (np.rint(place[near] - np.float32(0.5)).astype(np.int32) for place in (rays.x, rays.y))
    # As unsigned numbers, those before the map are beyond it too.
    on_map = (column.view(np.uint32) < width * size) & (row.view(np.uint32) < height * size)
    column, row = np.clip(column, 0, width * size - 1), np.clip(row, 0, height * size - 1)
    tile_row, tile_column = row // size, column // size
    picture = tiled.picture.astype(np.int32).reshape(-1).take(tile_row * np.int32(width) + tile_column)
    pixel = (picture * size + (row - tile_row * size)) * size + (column - tile_column * size)
    labels[near] = scale_tiles(tiled.tiles, tiled.tile_px)["labels"].reshape(-1).take(pixel) * on_map
    paved[near] = scale_opaque(tiled.tiles, tiled.tile_px).reshape(-1).take(pixel) & on_map
    return SeenLabels(labels, paved)


def can_tile(tiles: TileSet, tile_px: int) -> bool:
    """Returns whether a map can be drawn as a `TiledMap`."""
    return not tiles.blend and tile_px % 2 ** (LEVELS - 1) == 0


def _pixels_between(places: NDArray[np.float32], count: int) -> tuple[int, int]:
    """Returns the first pixel, and the one after the last, that coordinates refer to; at least one of `count`."""
    # Interpolation reads one pixel beyond a point.
    first = min(max(int(places.min()) - 2, 0), count - 1)
    last = min(max(int(places.max()) + 2, first), count - 1)
    return first, last + 1


def _lay_out(pictures: UInt8[NDArray, "H W P P C"]) -> UInt8[NDArray, "h w C"]:
    """Lays pictures side by side."""
    height, width, size, _, channels = pictures.shape
    return pictures.swapaxes(1, 2).reshape(height * size, width * size, channels)


class _Overlap(NamedTuple):
    """The pixels that a tile and a part of a map have in common, along one axis."""

    on_tile: slice
    on_part: slice


def _overlap(start: int, size: int, first: int, end: int) -> _Overlap:
    """Returns what a tile of `size` pixels from `start` and a part from `first` to `end` have in common."""
    low, high = max(start, first), min(start + size, end)
    return _Overlap(slice(low - start, high - start), slice(low - first, high - first))


@lru_cache(maxsize=24)
def _halve_tiles(tiles: TileSet, size: int, rank: int) -> UInt8[NDArray, "N P P 4"]:
    """Returns the pictures of `scale_tiles`, halved `rank` times, with a fourth channel of zeros."""
    if not rank:
        return np.pad(scale_tiles(tiles, size)["image"], [(0, 0)] * 3 + [(0, _CHANNELS - 3)])
    larger = _halve_tiles(tiles, size, rank - 1)
    half = larger.shape[1] // 2
    return np.stack([cv2.resize(picture, (half, half), interpolation=cv2.INTER_AREA) for picture in larger])
