"""One sample: a map drawn in one view."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, whole
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._robot_views import above_horizon, draw_viewpoint, see, see_labels, stand
from elitelanes_jax.dataset._transforms import Transforms, Viewpoints
from elitelanes_jax.dataset._variation import compress, varies, vary_background, vary_light, vary_motion
from elitelanes_jax.dataset._views import draw_view, photograph, warp
from elitelanes_jax.formats.objects import NEAR
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import ObjectSet, lay_all_flat
from elitelanes_jax.tiles.pasting import paste_objects
from elitelanes_jax.tiles.rendering import LABELS, choose_tiles, render, show_paved
from elitelanes_jax.tiles.tileset import TileSet


class Sample(NamedTuple):
    """A drawn sample.

    Attributes:
      layers: by name: image, uint8 ``[h, w, 3]``; labels, uint8 ``[h, w]``; of a map with objects also instances,
        uint16 ``[h, w]``.
      record: its metadata, plain values for JSON.
    """

    layers: dict[str, NDArray[np.integer]]
    record: dict[str, Plain]


def draw_sample(
    road_map: RoadMap,
    tiles: TileSet,
    index: int,
    *,
    seed: int = 0,
    tile_px: int = 64,
    transforms: Transforms = Transforms(),
    camera: Viewpoints | None = None,
    objects: ObjectSet | None = None,
) -> Sample:
    """Draws a map with tiles of a set in one view. All choices depend on `seed` and `index` alone.

    Args:
      road_map: the map.
      tiles: to draw it with.
      index: the index of the sample, 0 or more.
      seed: of the dataset.
      tile_px: side of a tile in pixels.
      transforms: the ranges of views.
      camera: the ranges of views from a robot on the lanes; by default views are from above.
      objects: whose pictures to draw the map's objects with; None to leave them out.

    Raises:
      InputError: for a camera on a map without a lane, an object without a picture, or an argument of another type.
    """
    check_named("index", whole(0), index)
    chosen = choose_tiles(road_map.codes, tiles, [seed, index])
    picture = render(road_map.codes, tiles, tile_px=tile_px, chosen=chosen)
    size = (picture.labels.shape[0], picture.labels.shape[1])
    rng = np.random.default_rng([seed, index, 1])
    view = draw_view(rng, transforms, size)
    things = (road_map.objects or ()) if objects is not None else ()
    pictures = objects.choose(things, [seed, index, 2]) if objects is not None else []
    if camera is None:
        about, near = {}, 0.0
        seen = {"image": warp(picture.image, view, GROUND), "labels": warp(picture.labels, view)}
        flat, order = lay_all_flat(things, pictures, tile_px)
        placed = [one._replace(matrix=view.matrix @ one.matrix) for one in flat]
        more: list[dict[str, Plain]] = [{} for _ in order]
    else:
        viewpoint = draw_viewpoint(rng, camera, road_map.codes, tile_px, road_map.objects or (), tiles.lane_offset)
        view = view._replace(matrix=viewpoint.matrix, size=viewpoint.size)
        about, near = viewpoint.about, NEAR
        seen = {"image": see(picture.image, viewpoint, GROUND), "labels": see_labels(picture.labels, viewpoint)}
        placed, order, distances = stand(things, pictures, viewpoint, tile_px)
        more = [{"distance": distance} for distance in distances]
    if transforms.background:
        paved = show_paved(tiles, chosen, tile_px).astype(np.uint8)
        sky = np.zeros(view.size, bool) if camera is None else above_horizon(viewpoint)
        ground_seen = (warp(paved, view) if camera is None else see_labels(paved, viewpoint)) == 0
        behind = np.random.default_rng([seed, index, 3])
        seen["image"] = vary_background(behind, seen["image"], ground_seen & ~sky, sky, transforms)
    instances: dict[str, NDArray[np.uint16]] = {}
    if objects is not None:
        seen = {name: layer.copy() for name, layer in seen.items()}  # arrays may be shared with the rendered map
        instances["instances"], found = paste_objects(seen, placed, order, near)
        about = about | {
            "objects": [
                {"kind": things[thing].kind, "instance": thing + 1, **one._asdict(), **further}
                for thing, one, further in zip(order, found, more, strict=True)
                if one.visible
            ]
        }
    if varies(transforms):
        rng = np.random.default_rng([seed, index, 4])
        seen["image"] = vary_motion(rng, vary_light(rng, seen["image"], transforms), transforms.motion)
    seen["image"] = photograph(seen["image"], view)
    if varies(transforms):
        seen["image"] = compress(rng, seen["image"], transforms.compression)
    transform = view._asdict() | {"matrix": view.matrix.tolist()}
    del transform["size"]
    metadata = {
        "number": index,
        "size": list(road_map.codes.shape),
        "pixels": list(view.size),
        "codes": road_map.codes.tolist(),
        "metrics": road_map.metrics,
        "fitness": road_map.fitness,
        "niche": road_map.niche,
        "map_seed": road_map.seed,
        "tiles": [[tiles.pictures[tile].name for tile, _ in row] for row in chosen],
        "quarter_turns": chosen[..., 1].tolist(),
        "transform": transform,
        **about,
        "class_pixels": [int(np.count_nonzero(seen["labels"] == label)) for label in range(len(LABELS))],
    }
    return Sample({**seen, **instances}, {name: value for name, value in metadata.items() if value is not None})
