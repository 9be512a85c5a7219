"""Draws samples of maps, from above or as robots see them."""

from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import SEED, check_named, none_or, whole
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.dataset._samples import Sample, SampleSettings
from elitelanes_jax.dataset._transforms import Transforms, for_camera, parse_transforms
from elitelanes_jax.dataset._views_from_above import draw_from_above
from elitelanes_jax.drive.camera_options import LaneCamera, parse_camera
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.object_set import ObjectSet
from elitelanes_jax.tiles.packed import Pictures
from elitelanes_jax.tiles.rendering import check_tile_px
from elitelanes_jax.tiles.tileset import TileSet


@name_wrong_arguments
def draw_sample(
    road_map: RoadMap,
    tiles: TileSet,
    index: int,
    *,
    seed: int = 0,
    tile_px: int = 64,
    transforms: UserValue = "none",
    camera: UserValue = None,
    objects: ObjectSet | None = None,
) -> Sample:
    """Draws a map with tiles of a set in one view. All choices depend on `seed` and `index` alone.

    Args:
      road_map: the map.
      tiles: the tile set to draw the map with.
      index: the index of the sample, 0 or more.
      seed: the seed of the dataset.
      tile_px: side of a tile in pixels.
      transforms: the ranges of views, as `DatasetSpec` takes them: ``"standard"``, or settings such
        as ``{"noise": 4}``.
      camera: the ranges of views from a robot on the lanes, as `DatasetSpec` takes them, such as
        ``{"rows": 120}``; by default views are from above.
      objects: whose pictures to draw the map's objects with; None to leave them out.

    Raises:
      InputError: for a camera on a map without a lane, an object without a picture, or an argument
        of another type.
    """
    index = check_named("index", whole(0), index)
    seed = check_named("seed", SEED, seed)
    ranges: Transforms = check_named("transforms", parse_transforms, transforms)
    lane_camera: LaneCamera | None = check_named("camera", none_or(parse_camera), camera)
    if lane_camera is not None:
        ranges = for_camera(ranges)
    settings = SampleSettings(
        Pictures(tiles, objects), seed, check_tile_px(tile_px), ranges, lane_camera
    )
    (sample,) = make_drawer(settings, [road_map]).draw([road_map], [index])
    return sample


class Drawer(NamedTuple):
    """Draws samples of a dataset.

    Attributes:
      draw: (maps, indices of samples) -> the samples.
      at_once: the most samples of a call, which should have as many.
    """

    draw: Callable[[Sequence[RoadMap], Sequence[int]], list[Sample]]
    at_once: int


def make_drawer(settings: SampleSettings, maps: Collection[RoadMap]) -> Drawer:
    """Makes a drawer of samples of maps, which may be furnished anew for each sample."""
    if settings.camera is not None:
        # This module loads JAX, which views from above do not need.
        from elitelanes_jax.dataset._views_from_robots import BATCH, RobotViews

        return Drawer(RobotViews(settings, maps).draw, BATCH)

    def draw(maps: Sequence[RoadMap], indices: Sequence[int]) -> list[Sample]:
        return [
            draw_from_above(settings, road_map, index)
            for road_map, index in zip(maps, indices, strict=True)
        ]

    return Drawer(draw, 1)
