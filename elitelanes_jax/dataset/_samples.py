"""One sample: a map drawn in one view."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, whole
from elitelanes_jax._util.types import Plain
from elitelanes_jax.dataset._robot_views import (
    Viewpoint,
    draw_viewpoint,
    find_rays,
    see,
    see_labels,
    stand,
)
from elitelanes_jax.dataset._tiled_maps import TiledMap, can_tile, see_tiled_labels
from elitelanes_jax.dataset._transforms import Transforms, Viewpoints
from elitelanes_jax.dataset._variation import (
    compress,
    varies,
    vary_background,
    vary_light,
    vary_motion,
)
from elitelanes_jax.dataset._views import draw_numbers, draw_view, photograph, warp
from elitelanes_jax.formats.objects import NEAR
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import ObjectSet, lay_all_flat
from elitelanes_jax.tiles.pasting import paste_objects
from elitelanes_jax.tiles.rendering import (
    LABELS,
    TileChoice,
    check_tile_px,
    draw_layers,
    plan_choice,
    render,
    show_paved,
)
from elitelanes_jax.tiles.tileset import TileSet


class Sample(NamedTuple):
    """A drawn sample.

    Attributes:
      layers: by name: image, uint8 ``[h, w, 3]``; labels, uint8 ``[h, w]``; of a map with objects
        also instances, uint16 ``[h, w]``.
      record: its metadata, plain values for JSON.
    """

    layers: dict[str, NDArray[np.integer]]
    record: dict[str, Plain]


def layer_names(*, has_objects: bool) -> tuple[str, ...]:
    """Returns the names of a sample's layers, those of `Sample.layers`."""
    return ("image", "labels", "instances") if has_objects else ("image", "labels")


@name_wrong_arguments
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
      InputError: for a camera on a map without a lane, an object without a picture, or an argument
        of another type.
    """
    check_named("index", whole(0), index)
    check_named("tiles", instance(TileSet), tiles)
    tile_px = check_tile_px(tile_px)
    chosen = _plan_choice(road_map.codes.tobytes(), road_map.codes.shape, tiles).choose(
        [seed, index]
    )
    rng = np.random.default_rng([seed, index, 1])
    things = (road_map.objects or ()) if objects is not None else ()
    pictures = objects.choose(things, [seed, index, 2]) if objects is not None else []
    if camera is None:
        about, near = {}, 0.0
        size = (road_map.codes.shape[0] * tile_px, road_map.codes.shape[1] * tile_px)
        view = draw_view(rng, transforms, size)
        picture = render(road_map.codes, tiles, tile_px=tile_px, chosen=chosen)
        seen = {"image": warp(picture.image, view, GROUND), "labels": warp(picture.labels, view)}
        flat, order = lay_all_flat(things, pictures, tile_px)
        placed = [one._replace(matrix=view.matrix @ one.matrix) for one in flat]
        more: list[dict[str, Plain]] = [{} for _ in order]
    else:
        numbers = draw_numbers(rng)
        viewpoint = draw_viewpoint(
            rng, camera, road_map.codes, tile_px, road_map.objects or (), tiles.lane_offset
        )
        view = numbers.through(viewpoint.matrix, viewpoint.size, transforms)
        about, near = viewpoint.about, NEAR
        ground_view = _see_ground(road_map, tiles, chosen, tile_px, viewpoint)
        seen = {"image": ground_view.image, "labels": ground_view.labels}
        placed, order, distances = stand(things, pictures, viewpoint, tile_px)
        more = [{"distance": distance} for distance in distances]
    if transforms.background:
        if camera is None:
            paved = warp(show_paved(tiles, chosen, tile_px).astype(np.uint8), view) > 0
            sky = np.zeros(view.size, bool)
        else:
            paved, sky = ground_view.paved, ground_view.sky
        behind = np.random.default_rng([seed, index, 3])
        seen["image"] = vary_background(behind, seen["image"], ~paved & ~sky, sky, transforms)
    instances: dict[str, NDArray[np.uint16]] = {}
    if objects is not None:
        # Arrays may be shared with the rendered map.
        seen = {name: layer.copy() for name, layer in seen.items()}
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
        seen["image"] = vary_motion(
            rng, vary_light(rng, seen["image"], transforms), transforms.motion
        )
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
        "tiles": [[tiles.pictures[tile].name for tile in row] for row in chosen[..., 0].tolist()],
        "quarter_turns": chosen[..., 1].tolist(),
        "transform": transform,
        **about,
        "class_pixels": [
            int(np.count_nonzero(seen["labels"] == label)) for label in range(len(LABELS))
        ],
    }
    return Sample(
        {**seen, **instances},
        {name: value for name, value in metadata.items() if value is not None},
    )


@lru_cache(maxsize=64)
def _plan_choice(codes: bytes, shape: tuple[int, int], tiles: TileSet) -> TileChoice:
    """Lists the pictures of a map's cells, once for all views of the map."""
    return plan_choice(np.frombuffer(codes, np.int8).reshape(shape), tiles)


class _GroundView(NamedTuple):
    """What a robot sees of a map without its objects.

    Attributes:
      image: uint8 ``[h, w, 3]``, RGB.
      labels: uint8 ``[h, w]``, indices in `LABELS`.
      paved: bool ``[h, w]``, whether a pixel shows a tile, see `show_paved`.
      sky: bool ``[h, w]``, whether a pixel is above the horizon.
    """

    image: NDArray[np.uint8]
    labels: NDArray[np.uint8]
    paved: NDArray[np.bool_]
    sky: NDArray[np.bool_]


def _see_ground(
    road_map: RoadMap, tiles: TileSet, chosen: NDArray[np.int_], tile_px: int, viewpoint: Viewpoint
) -> _GroundView:
    """Draws a robot's view of a map: of the tiles that are seen, or of the whole map if its tiles are blended."""
    rays = find_rays(viewpoint, 1)
    sky = np.zeros(viewpoint.size, bool)
    sky[: rays.sky] = True
    if can_tile(tiles, tile_px):
        tiled = TiledMap(tiles, tile_px, chosen[..., 0] * 4 + chosen[..., 1])
        seen = see_tiled_labels(tiled, rays)
        return _GroundView(tiled.see(viewpoint, GROUND), seen.labels, seen.paved, sky)
    layers = draw_layers(road_map.codes, tiles, chosen, tile_px, ("image", "labels"))
    paved = see_labels(show_paved(tiles, chosen, tile_px).astype(np.uint8), viewpoint) > 0
    labels = see_labels(layers["labels"], viewpoint)
    return _GroundView(see(layers["image"], viewpoint, GROUND), labels, paved, sky)
