"""Makes the sight of `look` and the scenes of `views` from maps and pictures.

OpenCV scales the pictures.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, UInt32
from numpy.typing import NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import UserValue
from elitelanes_jax.drive._camera import Camera, Sight, pack_sight
from elitelanes_jax.drive._objects import Billboards, Floor, make_objects, pack_billboards
from elitelanes_jax.drive._scenes import PAVED, SceneMap, Scenes
from elitelanes_jax.formats.road_map import RoadMap, as_maps
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.tiles.object_set import ObjectPictures, ObjectSet, load_objects
from elitelanes_jax.tiles.rendering import check_tile_px, scale_tiles, show_paved
from elitelanes_jax.tiles.tileset import TileSet, load_tiles


@name_wrong_arguments
@runs_jax
def make_sight(
    tiles: TileSet | None = None,
    camera: Camera | None = None,
    *,
    tile_px: int = 64,
    objects: ObjectSet | None = None,
) -> Sight:
    """Makes what a camera sees: the pictures of a tile set, and of objects.

    Args:
      tiles: the tile set; by default the package's own.
      camera: the options of the camera; by default `Camera()`.
      tile_px: side of the pictures of tiles in pixels, 16 to 512.
      objects: the pictures of objects, scaled to 64 x 64 pixels: of each kind the first object's;
        all signs of a kind show the tag of their view. By default no objects are seen.

    Raises:
      InputError: for an argument of another type, or a bad size.
    """
    tiles = _check_tiles(tiles)
    _check_objects(objects)
    scaled = scale_tiles(tiles, check_tile_px(tile_px))
    views = None if objects is None else objects.views_by_kind
    return pack_sight(scaled["image"], scaled["labels"], tiles.rotations, camera, views)


@name_wrong_arguments
@runs_jax
def make_scenes(
    maps: UserValue,
    tiles: TileSet | None = None,
    *,
    tile_px: int = 128,
    objects: ObjectSet | None = None,
) -> Scenes:
    """Makes the scenes of `views`: maps, also of several sizes, and the pictures that show them.

    Photographs of tiles are not blended as `render` blends them: each keeps its light, and seams
    are sharp.

    Args:
      maps: one or more, as `as_maps` takes them: integer codes ``[M, H, W]``, a list of grids, or
        `RoadMap`s. Their objects are shown.
      tiles: the tile set; by default the package's own. Poses are on its lanes: see
        `TileSet.lane_offset`.
      tile_px: side of the largest pictures of tiles in pixels: 16, 32, 64, 128, 256 or 512. Near
        pixels of a picture of 120 x 160 need 256, and smaller pictures need less.
      objects: the pictures of objects; by default the package's own. They are scaled to 64 x 64
        pixels.

    Raises:
      InputError: for an argument of another type, no map, a map without a lane, a code or an object
        without a picture, a bad size, or objects of more than 512 different pictures and tags.
    """
    road_maps = check_named("maps", as_maps, maps)
    tiles = _check_tiles(tiles)
    # Maps without objects need no pictures of them, and the argument is checked all the same.
    _check_objects(objects)
    if check_tile_px(tile_px) & (tile_px - 1):
        raise InputError(f"tile_px: expected 16, 32, 64, 128, 256 or 512, got {tile_px}")
    if not road_maps:
        raise InputError("maps: expected one or more, got none")
    for index, road_map in enumerate(road_maps):
        _check_map(f"maps[{index}]", road_map, tiles)
    table, counts = _list_pictures(tiles)
    scene_maps, billboards = _place_objects(_stack(road_maps), road_maps, objects)
    return Scenes(
        scene_maps,
        _make_pyramid(tiles, tile_px),
        jnp.asarray(table),
        jnp.asarray(counts),
        billboards,
        tiles.lane_offset,
    )


def _check_tiles(tiles: UserValue) -> TileSet:
    """Returns the tile set; None is the package's own."""
    return load_tiles() if tiles is None else check_named("tiles", instance(TileSet), tiles)


def _check_objects(objects: UserValue) -> None:
    if objects is not None:
        check_named("objects", instance(ObjectSet), objects)


def _check_map(name: str, road_map: RoadMap, tiles: TileSet) -> None:
    codes = np.asarray(road_map.codes)
    if not movements_of(codes).row.size:
        raise InputError(f"{name}: expected a map with a lane, got one without any movement")
    for code in np.unique(codes).tolist():
        if code not in tiles.rotations:
            drawn = ", ".join(map(str, tiles.rotations))
            raise InputError(
                f"{name}: expected codes that the set {tiles.name!r} can draw ({drawn}), got {code}"
            )


def _stack(road_maps: list[RoadMap]) -> SceneMap:
    # The border is one empty cell wide. Points beyond the map are read there.
    height, width = (max(road_map.codes.shape[axis] for road_map in road_maps) for axis in (0, 1))
    codes = np.zeros((len(road_maps), height + 2, width + 2), np.int32)
    links = np.zeros_like(codes)
    # Lists of movements have different lengths. `counts` tells how many rows are used.
    listed = [np.stack(movements_of(road_map.codes), axis=1) for road_map in road_maps]
    counts = np.array([len(movements) for movements in listed], np.int32)
    movements = np.zeros((len(road_maps), counts.max(), 4), np.int32)
    for index, road_map in enumerate(road_maps):
        rows, columns = road_map.codes.shape
        inside = (index, slice(1, rows + 1), slice(1, columns + 1))
        codes[inside] = road_map.codes
        links[inside] = linked_codes(np.asarray(road_map.codes))
        movements[index, : counts[index]] = listed[index]
    return SceneMap(
        jnp.asarray(codes),
        jnp.asarray(links),
        jnp.asarray(movements),
        jnp.asarray(counts),
        None,
        None,
        None,
    )


def _place_objects(
    scene_maps: SceneMap, road_maps: list[RoadMap], objects: ObjectSet | None
) -> tuple[SceneMap, Billboards | None]:
    """Returns the maps with their objects, and the pictures of the objects."""
    placed = make_objects(road_maps)
    if placed is None:
        return scene_maps, None
    object_set = load_objects(objects)
    pictures: list[ObjectPictures] = []
    choices_of: dict[tuple[str, int | None], tuple[int, int]] = {}
    choices = np.zeros((*placed.x.shape, 2), np.int32)
    floors: list[list[tuple[int, float, float]]] = []
    # Pictures are listed once for each kind and tag. Each object refers to the first of its
    # pictures and to how many they are.
    for number, road_map in enumerate(road_maps):
        floors.append([])
        for index, thing in enumerate(road_map.objects or ()):
            kind = thing.kind, thing.tag
            if kind not in choices_of:
                pictures_of_kind = check_named("objects", object_set.choices, thing)
                choices_of[kind] = len(pictures), len(pictures_of_kind)
                pictures += pictures_of_kind
            choices[number, index] = choices_of[kind]
            # An object without height lies on the floor.
            first_picture = pictures[choices_of[kind][0]]
            if not first_picture.height:
                floors[-1].append((index, *first_picture.footprint))
    scene_maps = scene_maps._replace(
        objects=placed, choices=jnp.asarray(choices), floor=_stack_floors(floors)
    )
    # Objects on the floor have one picture, seen from above.
    views = [picture.views if picture.height else {0: picture.top} for picture in pictures]
    return scene_maps, pack_billboards(views)


def _stack_floors(floors: list[list[tuple[int, float, float]]]) -> Floor | None:
    """Stacks the index, the length and the width of objects on the floors of maps."""
    most = max(map(len, floors))
    if not most:
        return None
    values = np.ones((len(floors), most, 3), np.float32)
    # The index -1 marks rows that are not used. Their sides are 1, because they are divisors.
    values[..., 0] = -1
    for number, floor in enumerate(floors):
        if floor:
            values[number, : len(floor)] = floor
    index, length, width = np.moveaxis(values, -1, 0)
    return Floor(jnp.asarray(index, jnp.int32), jnp.asarray(length), jnp.asarray(width))


def _list_pictures(tiles: TileSet) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Lists the pictures of each code, and how many there are.

    A code without any has those of code 0.
    """
    shown = [tiles.rotations.get(code, tiles.rotations[0]) for code in range(16)]
    counts = np.array([len(pictures) for pictures in shown], np.int32)
    table = np.zeros((16, counts.max()), np.int32)
    for code, pictures in enumerate(shown):
        table[code, : len(pictures)] = [4 * tile + turns for tile, turns in pictures]
    return table, counts


def _make_pyramid(tiles: TileSet, tile_px: int) -> UInt32[Array, "T P"]:
    # Tile 4 * index + turns is the picture of an index, turned by quarters.
    count = 4 * len(tiles.pictures)
    all_tiles = np.stack(np.divmod(np.arange(count), 4), axis=-1)[None]
    levels = []
    size = tile_px
    while size:
        scaled = scale_tiles(tiles, size)
        # `show_paved` draws a map. Here the map is one row with each tile once, which is cut into
        # its tiles.
        paved = show_paved(tiles, all_tiles, size).reshape(size, count, size).swapaxes(0, 1)
        red, green, blue = np.moveaxis(scaled["image"].astype(np.uint32), -1, 0)
        # What is not paved shows the ground of the view, so its colour is left out.
        colours = np.where(paved, red | green << 8 | blue << 16, 0)
        labels = scaled["labels"].astype(np.uint32) + PAVED * paved
        levels.append((colours | labels << 24).astype(np.uint32).reshape(count, -1))
        size //= 2
    return jnp.asarray(np.concatenate(levels, axis=1))
