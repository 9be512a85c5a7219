"""One sample: a map drawn in one view."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance, none_or, whole
from elitelanes_jax._util.types import Plain, UserValue
from elitelanes_jax.dataset._robot_views import (
    Viewpoint,
    draw_viewpoint,
    find_rays,
    place_objects,
    see,
    see_labels,
)
from elitelanes_jax.dataset._tiled_maps import TiledMap, can_tile, see_tiled_labels
from elitelanes_jax.dataset._transforms import (
    Transforms,
    Viewpoints,
    parse_transforms,
    parse_viewpoints,
)
from elitelanes_jax.dataset._variation import (
    compress,
    varies,
    vary_background,
    vary_light,
    vary_motion,
)
from elitelanes_jax.dataset._views import DrawnTransform, draw_numbers, draw_view, photograph, warp
from elitelanes_jax.formats.objects import NEAR, MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.tiles.files import GROUND
from elitelanes_jax.tiles.object_set import ObjectPictures, ObjectSet, lay_all_flat
from elitelanes_jax.tiles.pasting import Placed, paste_objects
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
      layers: the layers by name: image, uint8 ``[h, w, 3]``; labels, uint8 ``[h, w]``; with an
        object set also instances, uint16 ``[h, w]``.
      record: the metadata of the sample, plain values for JSON.
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
    check_named("tiles", instance(TileSet), tiles)
    ranges: Transforms = check_named("transforms", parse_transforms, transforms)
    viewpoints: Viewpoints | None = check_named("camera", none_or(parse_viewpoints), camera)
    tile_px = check_tile_px(tile_px)
    # Each purpose has random numbers of its own, by the last number of its seed. Therefore no
    # choice changes another one.
    choice = _plan_choice(road_map.codes.tobytes(), road_map.codes.shape, tiles)
    drawn: Sequence[MapObject] = ()
    pictures: Sequence[ObjectPictures] = ()
    if objects is not None:
        drawn = road_map.objects or ()
        pictures = objects.choose(drawn, [seed, index, 2])
    scene = _Scene(road_map, tiles, choice.choose([seed, index]), tile_px, drawn, pictures)
    rng = np.random.default_rng([seed, index, 1])
    if viewpoints is None:
        shot = _see_from_above(rng, scene, ranges)
    else:
        shot = _see_from_robot(rng, scene, ranges, viewpoints)
    ground, about = shot.ground, shot.about
    layers = {"image": ground.image, "labels": ground.labels}
    instances: dict[str, NDArray[np.uint16]] = {}
    if ranges.background:
        # The background is drawn before objects are pasted, so that it never covers them.
        behind = np.random.default_rng([seed, index, 3])
        bare = ~ground.paved & ~ground.sky
        layers["image"] = vary_background(behind, ground.image, bare, ground.sky, ranges)
    if objects is not None:
        # Arrays may be shared with the rendered map.
        layers = {name: layer.copy() for name, layer in layers.items()}
        instances["instances"], listed = _paste(layers, scene, shot)
        about = about | {"objects": listed}
    # Light, blur, noise and compression come last, because they change objects too.
    layers["image"] = _expose(layers["image"], shot.view, ranges, [seed, index, 4])
    # The classes are counted in the labels after objects were pasted.
    record = _describe(scene, shot.view, layers["labels"], index, about)
    return Sample({**layers, **instances}, record)


class _Scene(NamedTuple):
    """A map with the pictures of its tiles and objects.

    Attributes:
      road_map: the map.
      tiles: the tile set of the map.
      chosen: int ``[H, W, 2]``, the picture of each cell and its quarter turns, see `TileChoice`.
      tile_px: side of a tile in pixels.
      objects: the objects of the map that are drawn.
      pictures: the pictures of each object in `objects`.
    """

    road_map: RoadMap
    tiles: TileSet
    chosen: NDArray[np.int_]
    tile_px: int
    objects: Sequence[MapObject]
    pictures: Sequence[ObjectPictures]


class _Ground(NamedTuple):
    """What a view shows of a map without its objects.

    Attributes:
      image: uint8 ``[h, w, 3]``, RGB.
      labels: uint8 ``[h, w]``, indices in `LABELS`.
      paved: bool ``[h, w]``, whether a pixel shows a tile, see `show_paved`; all False in a view
        from above whose background does not vary.
      sky: bool ``[h, w]``, whether a pixel is above the horizon.
    """

    image: NDArray[np.uint8]
    labels: NDArray[np.uint8]
    paved: NDArray[np.bool_]
    sky: NDArray[np.bool_]


class _Shot(NamedTuple):
    """A view of a scene.

    Attributes:
      ground: what the view shows without the objects.
      view: the transform of the view.
      about: entries of the metadata about the camera.
      placed: the pictures of the objects in the view, from back to front.
      order: the index of each of them in the scene.
      further: entries of the metadata about each of them.
      near: pictures nearer to the camera than this distance in metres are not shown.
    """

    ground: _Ground
    view: DrawnTransform
    about: dict[str, Plain]
    placed: list[Placed]
    order: list[int]
    further: list[dict[str, Plain]]
    near: float


def _see_from_above(rng: np.random.Generator, scene: _Scene, transforms: Transforms) -> _Shot:
    """Draws a map and warps it into a view from above."""
    codes, tiles, tile_px = scene.road_map.codes, scene.tiles, scene.tile_px
    view = draw_view(rng, transforms, (codes.shape[0] * tile_px, codes.shape[1] * tile_px))
    picture = render(codes, tiles, tile_px=tile_px, chosen=scene.chosen)
    paved = np.zeros(view.size, bool)
    if transforms.background:
        paved = warp(show_paved(tiles, scene.chosen, tile_px).astype(np.uint8), view) > 0
    # From above, all objects are pictures in the plane of the map, moved by the view's matrix.
    flat, order = lay_all_flat(scene.objects, scene.pictures, tile_px)
    image, labels = warp(picture.image, view, GROUND), warp(picture.labels, view)
    return _Shot(
        ground=_Ground(image, labels, paved, sky=np.zeros(view.size, bool)),
        view=view,
        about={},
        placed=[item._replace(matrix=view.matrix @ item.matrix) for item in flat],
        order=order,
        further=[{} for _ in order],
        near=0.0,
    )


def _see_from_robot(
    rng: np.random.Generator, scene: _Scene, transforms: Transforms, camera: Viewpoints
) -> _Shot:
    """Draws what a robot on a lane sees of a map."""
    road_map, tiles, tile_px = scene.road_map, scene.tiles, scene.tile_px
    # These numbers come before those of the pose, so that the light of a view does not depend on
    # the map.
    numbers = draw_numbers(rng)
    viewpoint = draw_viewpoint(
        rng, camera, road_map.codes, tile_px, road_map.objects or (), tiles.lane_offset
    )
    # Objects stand upright in the camera's view, so they are placed by the camera and not by the
    # map.
    placed, order, distances = place_objects(scene.objects, scene.pictures, viewpoint, tile_px)
    return _Shot(
        ground=_see_ground(scene, viewpoint),
        view=numbers.through(viewpoint.matrix, viewpoint.size, transforms),
        about=viewpoint.about,
        placed=placed,
        order=order,
        further=[{"distance": distance} for distance in distances],
        near=NEAR,
    )


def _paste(
    layers: dict[str, NDArray[np.uint8]], scene: _Scene, shot: _Shot
) -> tuple[NDArray[np.uint16], list[dict[str, Plain]]]:
    """Pastes the objects into the layers.

    Returns the instances, and the metadata of objects that are seen.
    """
    instances, seen = paste_objects(layers, shot.placed, shot.order, shot.near)
    listed: list[dict[str, Plain]] = []
    for index, item, further in zip(shot.order, seen, shot.further, strict=True):
        # Objects that are outside the view, or hidden by others, are no annotations.
        if item.visible:
            names = {"kind": scene.objects[index].kind, "instance": index + 1}
            listed.append({**names, **item._asdict(), **further})
    return instances, listed


def _expose(
    image: NDArray[np.uint8], view: DrawnTransform, transforms: Transforms, seed: Sequence[int]
) -> NDArray[np.uint8]:
    """Takes a picture of what is seen.

    The picture has light and motion, the view's blur and noise, and compression.
    """
    if not varies(transforms):
        return photograph(image, view)
    rng = np.random.default_rng(seed)
    image = vary_motion(rng, vary_light(rng, image, transforms), transforms.motion)
    # Compression comes after noise, as in a camera.
    return compress(rng, photograph(image, view), transforms.compression)


def _describe(
    scene: _Scene,
    view: DrawnTransform,
    labels: NDArray[np.uint8],
    index: int,
    about: dict[str, Plain],
) -> dict[str, Plain]:
    """Returns the metadata of a sample, without entries that the map does not have."""
    road_map, names = scene.road_map, [picture.name for picture in scene.tiles.pictures]
    transform = view._asdict() | {"matrix": view.matrix.tolist()}
    # The entry `pixels` has the size.
    del transform["size"]
    # Maps from files may lack metrics, fitness, a niche or a seed.
    metadata = {
        "number": index,
        "size": list(road_map.codes.shape),
        "pixels": list(view.size),
        "codes": road_map.codes.tolist(),
        "metrics": road_map.metrics,
        "fitness": road_map.fitness,
        "niche": road_map.niche,
        "map_seed": road_map.seed,
        "tiles": [[names[tile] for tile in row] for row in scene.chosen[..., 0].tolist()],
        "quarter_turns": scene.chosen[..., 1].tolist(),
        "transform": transform,
        **about,
        "class_pixels": [int(np.count_nonzero(labels == label)) for label in range(len(LABELS))],
    }
    return {name: value for name, value in metadata.items() if value is not None}


@lru_cache(maxsize=64)
def _plan_choice(codes: bytes, shape: tuple[int, int], tiles: TileSet) -> TileChoice:
    """Lists the pictures of a map's cells, once for all views of the map."""
    return plan_choice(np.frombuffer(codes, np.int8).reshape(shape), tiles)


def _see_ground(scene: _Scene, viewpoint: Viewpoint) -> _Ground:
    """Draws a robot's view of a map.

    Only the tiles that are seen are drawn, or the whole map if its tiles are blended.
    """
    tiles, chosen, tile_px = scene.tiles, scene.chosen, scene.tile_px
    rays = find_rays(viewpoint, 1)
    # Rows without a ray that meets the ground show sky.
    sky = np.zeros(viewpoint.size, bool)
    sky[: rays.sky] = True
    if can_tile(tiles, tile_px):
        tiled = TiledMap(tiles, tile_px, chosen[..., 0] * 4 + chosen[..., 1])
        seen = see_tiled_labels(tiled, rays)
        return _Ground(tiled.see(viewpoint, GROUND), seen.labels, seen.paved, sky)
    # Blended tiles depend on their neighbours, so a map of such tiles is drawn whole.
    layers = draw_layers(scene.road_map.codes, tiles, chosen, tile_px, ("image", "labels"))
    paved = see_labels(show_paved(tiles, chosen, tile_px).astype(np.uint8), viewpoint) > 0
    labels = see_labels(layers["labels"], viewpoint)
    return _Ground(see(layers["image"], viewpoint, GROUND), labels, paved, sky)
