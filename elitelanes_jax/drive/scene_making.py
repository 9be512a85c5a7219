"""Makes the sight of `look` and the scenes of `views` from maps and pictures.

OpenCV scales the pictures.
"""

from collections.abc import Callable, Collection, Sequence
from functools import lru_cache, partial
from math import gcd
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int32, Shaped, UInt32
from numpy.typing import DTypeLike, NDArray

from elitelanes_jax._util.arguments import name_wrong_arguments
from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.running import runs_jax
from elitelanes_jax._util.types import Numeric, UserValue
from elitelanes_jax.drive._billboards import Billboards, Floor, pack_billboards
from elitelanes_jax.drive._camera import Sight, list_tiles, pack_sight
from elitelanes_jax.drive._objects import stack_objects
from elitelanes_jax.drive._scenes import PAVED, Blend, SceneMap, Scenes, halved_sizes
from elitelanes_jax.drive.camera_options import Camera
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap, as_maps
from elitelanes_jax.lanes.links import linked_codes
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.tiles.object_set import ObjectPictures, ObjectSet, load_objects
from elitelanes_jax.tiles.rendering import check_tile_px, scale_tiles, show_paved, solve_light
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

# What the lengths of arrays are rounded up to: multiples of cells, and doublings of all others.
_CELLS, _MOVEMENTS, _OBJECTS, _LYING, _PICTURES = 8, 64, 64, 8, 64


@name_wrong_arguments
@runs_jax
def make_sight(
    tiles: TileSet | None = None,
    camera: Camera | None = None,
    *,
    tile_px: int = 64,
    objects: ObjectSet | None = None,
) -> Sight:
    """Makes what a camera sees: the pictures of a tile set, and of objects that stand.

    Args:
      tiles: the tile set; by default the package's own.
      camera: the options of the camera; by default `Camera()`.
      tile_px: side of the pictures of tiles in pixels, 16 to 512.
      objects: the pictures of objects, scaled to 64 x 64 pixels: of each kind the first object's;
        all signs of a kind show the tag of their view. Tags on the floor are not seen. By default
        no objects are seen.

    Raises:
      InputError: for an argument of another type, or a bad size.
    """
    tiles = _check_tiles(tiles)
    _check_objects(objects)
    tile_px = check_tile_px(tile_px)
    camera = Camera() if camera is None else check_named("camera", instance(Camera), camera)
    scaled = scale_tiles(tiles, tile_px)
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
      tile_px: side of the largest pictures of tiles in pixels, 16 to 512. Near pixels of a picture
        of 120 x 160 need 256, and smaller pictures need less.
      objects: the pictures of objects; by default the package's own. They are scaled to 64 x 64
        pixels.

    Raises:
      InputError: for an argument of another type, no map, a map without a lane, or a bad size. Also
        for a code or an object without a picture, or objects of more than 4,096 different pictures
        and tags.
    """
    road_maps = check_named("maps", as_maps, maps)
    tiles = _check_tiles(tiles)
    # Maps without objects need no pictures of them, and the argument is checked all the same.
    _check_objects(objects)
    tile_px = check_tile_px(tile_px)
    if not road_maps:
        raise InputError("maps", "one or more", "none")
    for index, road_map in enumerate(road_maps):
        _check_map(f"maps[{index}]", road_map, tiles)
    pictures = None
    if any(road_map.objects for road_map in road_maps):
        pictures = PackedObjects(load_objects(objects))
    return pack_scenes(road_maps, tiles, tile_px, pictures)


def _check_tiles(tiles: UserValue) -> TileSet:
    """Returns the tile set; None is the package's own."""
    return load_tiles() if tiles is None else check_named("tiles", instance(TileSet), tiles)


def _check_objects(objects: UserValue) -> None:
    if objects is not None:
        check_named("objects", instance(ObjectSet), objects)


def _check_map(name: str, road_map: RoadMap, tiles: TileSet) -> None:
    codes = np.asarray(road_map.codes)
    if not movements_of(codes).row.size:
        raise InputError(name, "a map with a lane", "one without any movement")
    for code in np.unique(codes).tolist():
        if code not in tiles.rotations:
            drawn = ", ".join(map(str, tiles.rotations))
            raise InputError(name, f"codes that the set {tiles.name!r} can draw ({drawn})", code)


class PackedObjects:
    """The pictures of objects that maps have, packed for cameras. Maps that come later may add some.

    Attributes:
      pictures: the pictures, by their indices in the billboards.
    """

    def __init__(self, objects: ObjectSet, *, whole: bool = False) -> None:
        """Starts without pictures.

        If they are `whole`, pictures keep their sizes, and objects all their views. Then arrays are
        longer than needed, so that one program serves more pictures.
        """
        self.pictures: list[ObjectPictures] = []
        self._objects, self._whole = objects, whole
        self._choices: dict[tuple[str, int | None], tuple[int, int]] = {}
        self._packed: tuple[int, Billboards] | None = None

    def choices(self, thing: MapObject) -> tuple[int, int]:
        """Returns the index of the first picture that may show an object, and how many may.

        Raises:
          InputError: for an object without a picture.
        """
        find = partial(check_named, "objects", self._objects.choices, thing)
        return self._add(thing.kind, thing.tag, find)

    def index(self, thing: MapObject, picture: ObjectPictures) -> tuple[int, int]:
        """Returns the index of the picture that was chosen for an object, and 1."""
        return self._add(picture.name, thing.tag, lambda: [picture])

    def _add(
        self, name: str, tag: int | None, pictures: Callable[[], list[ObjectPictures]]
    ) -> tuple[int, int]:
        if (name, tag) not in self._choices:
            added = pictures()
            self._choices[name, tag] = len(self.pictures), len(added)
            self.pictures += added
        return self._choices[name, tag]

    def pack(self) -> Billboards:
        """Packs all pictures so far."""
        count = len(self.pictures)
        if self._packed is None or self._packed[0] != count:
            # Objects on the floor have one picture, seen from above.
            views = [
                picture.views if picture.height else {0: picture.top} for picture in self.pictures
            ]
            if self._whole:
                views += [{}] * (_room_for(count, _PICTURES) - count)
                angles = {angle for picture in self._objects.pictures for angle in picture.views}
                packed = pack_billboards(views, None, 360 // gcd(360, *angles))
            else:
                packed = pack_billboards(views)
            self._packed = count, packed
        return self._packed[1]


class Room(NamedTuple):
    """The least lengths of the arrays of maps. With equal lengths one program serves more maps.

    Attributes:
      rows: of cells, without the border.
      columns: of cells, without the border.
      movements: of a map.
      objects: of a map.
      floor: objects on the floor of a map.
    """

    rows: int = 0
    columns: int = 0
    movements: int = 0
    objects: int = 0
    floor: int = 0

    @classmethod
    def for_maps(cls, road_maps: Collection[RoadMap], *, has_objects: bool) -> "Room":
        """Returns room for maps, rounded up, so that few programs serve maps of all sizes.

        If they `has_objects`, there is room for some even if these maps have none.
        """
        rows, columns = (
            max(road_map.codes.shape[axis] for road_map in road_maps) for axis in (0, 1)
        )
        movements = max(len(_lanes_of(road_map.codes).movements) for road_map in road_maps)
        objects = floor = 0
        for road_map in road_maps:
            things = road_map.objects or ()
            objects = max(objects, len(things))
            floor = max(floor, sum(not thing.height for thing in things))
        if objects or has_objects:
            objects = _room_for(objects, _OBJECTS)
        return cls(
            -(-rows // _CELLS) * _CELLS,
            -(-columns // _CELLS) * _CELLS,
            _room_for(movements, _MOVEMENTS),
            objects,
            floor and _room_for(floor, _LYING),
        )


_NO_ROOM = Room()


def _room_for(count: int, least: int) -> int:
    """Returns the first of `least`, twice as many and so on that is enough for `count`."""
    return least * 2 ** max(0, -(-count // least) - 1).bit_length()


class _Lanes(NamedTuple):
    """The lanes of a map.

    Attributes:
      links: the connections of each cell that the neighbour returns.
      movements: row, column, heading and turn of each movement.
    """

    links: NDArray[np.int8]
    movements: Int32[NDArray, "N 4"]


def _lanes_of(codes: NDArray[np.int8]) -> _Lanes:
    return _find_lanes(np.asarray(codes, np.int8).tobytes(), codes.shape)


@lru_cache(maxsize=64)
def _find_lanes(codes: bytes, shape: tuple[int, int]) -> _Lanes:
    """Finds the lanes of a map, once for all views of the map."""
    grid = np.frombuffer(codes, np.int8).reshape(shape)
    return _Lanes(linked_codes(grid), np.stack(movements_of(grid), axis=1).astype(np.int32))


def _stack_maps(
    road_maps: Sequence[RoadMap],
    pictures: PackedObjects | None,
    room: Room,
    shown: Sequence[Sequence[ObjectPictures]] | None,
) -> SceneMap:
    """Stacks maps, with their objects if there are pictures.

    Raises:
      InputError: for an object without a picture.
    """
    # The border is one empty cell wide. Points beyond the map are read there.
    height, width = (
        max(least, *(road_map.codes.shape[axis] for road_map in road_maps)) + 2
        for axis, least in enumerate(room[:2])
    )
    lanes = [_lanes_of(road_map.codes) for road_map in road_maps]
    codes = _pad_cells([road_map.codes for road_map in road_maps], (height, width), 0, np.int32)
    links = _pad_cells([lanes_of_map.links for lanes_of_map in lanes], (height, width), 0, np.int32)
    # Lists of movements have different lengths. `counts` tells how many rows are used.
    counts = np.array([len(lanes_of_map.movements) for lanes_of_map in lanes], np.int32)
    movements = np.zeros((len(road_maps), max(room.movements, counts.max()), 4), np.int32)
    for index, lanes_of_map in enumerate(lanes):
        movements[index, : counts[index]] = lanes_of_map.movements
    scene_maps = SceneMap(
        jnp.asarray(codes), jnp.asarray(links), jnp.asarray(movements), jnp.asarray(counts)
    )
    if not room.objects and not any(road_map.objects for road_map in road_maps):
        return scene_maps
    placed = stack_objects(road_maps, room.objects)
    if pictures is None:
        # Robots touch no object, whether it is shown or not.
        return scene_maps._replace(objects=placed)
    choices = np.zeros((*placed.x.shape, 2), np.int32)
    floors: list[list[tuple[int, float, float]]] = []
    # Each object refers to the first of its pictures and to how many they are.
    for number, road_map in enumerate(road_maps):
        floors.append([])
        for index, thing in enumerate(road_map.objects or ()):
            if shown is None:
                choice = pictures.choices(thing)
            else:
                choice = pictures.index(thing, shown[number][index])
            choices[number, index] = choice
            first, _ = choice
            # An object without height lies on the floor.
            if not pictures.pictures[first].height:
                floors[-1].append((index, *pictures.pictures[first].footprint))
    return scene_maps._replace(
        objects=placed, choices=jnp.asarray(choices), floor=_stack_floors(floors, room.floor)
    )


def _stack_floors(floors: list[list[tuple[int, float, float]]], room: int) -> Floor | None:
    """Stacks the index, the length and the width of objects on the floors of maps."""
    most = max(room, *map(len, floors))
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


def pack_scenes(
    road_maps: Sequence[RoadMap],
    tiles: TileSet,
    tile_px: int,
    pictures: PackedObjects | None,
    *,
    room: Room = _NO_ROOM,
    chosen: Sequence[NDArray[np.int_]] | None = None,
    shown: Sequence[Sequence[ObjectPictures]] | None = None,
) -> Scenes:
    """Packs maps, and the pictures that show them.

    Args:
      road_maps: the maps.
      tiles: the tile set.
      tile_px: side of the largest pictures of tiles in pixels.
      pictures: the pictures of the maps' objects; None to show no objects.
      room: the least lengths of arrays.
      chosen: the tiles of each map, see `choose_tiles`; by default each view draws them. Tiles that
        are chosen are blended as the set says.
      shown: the pictures of the objects of each map, see `ObjectSet.choose`; by default each view
        draws them.

    Raises:
      InputError: for an object without a picture.
    """
    maps = _stack_maps(road_maps, pictures, room, shown)
    if chosen is not None:
        count, *shape = maps.codes.shape
        ground = 4 * (len(tiles.pictures) - 1)
        cells = _pad_cells([choice @ (4, 1) for choice in chosen], shape, ground, np.int32)
        maps = maps._replace(cells=jnp.asarray(cells.reshape(count, -1)))
        if tiles.blend:
            light = [
                solve_light(road_map.codes, tiles, choice)
                for road_map, choice in zip(road_maps, chosen, strict=True)
            ]
            # Beyond the map the light does not change.
            tones = _pad_cells(light, shape, np.array([1.0, 0.0]), np.float32)
            blend = Blend(
                jnp.asarray(tones.reshape(count, -1, 3, 2)), maps.links.reshape(count, -1)
            )
            maps = maps._replace(blend=blend)
    packed = _pack_tiles(tiles, tile_px)
    billboards = None if pictures is None else pictures.pack()
    return Scenes(maps, *packed, billboards, tiles.lane_offset, tile_px)


def _pad_cells(
    values: Sequence[NDArray], shape: Sequence[int], outside: Numeric, dtype: DTypeLike
) -> Shaped[NDArray, "M H W ..."]:
    """Stacks the cells' values of maps inside of a border.

    `shape` has the rows and columns with the border, and cells beyond a map get the value `outside`.
    """
    padded = np.empty((len(values), *shape, *values[0].shape[2:]), dtype)
    padded[:] = outside
    for index, cells in enumerate(values):
        padded[index, 1 : cells.shape[0] + 1, 1 : cells.shape[1] + 1] = cells
    return padded


@lru_cache(maxsize=4)
def _pack_tiles(
    tiles: TileSet, tile_px: int
) -> tuple[UInt32[Array, "T P"], Int32[Array, "16 V"], Int32[Array, " 16"]]:
    """Returns the fields of `Scenes` with the pictures of tiles."""
    table, counts = list_tiles(tiles.rotations)
    return _make_pyramid(tiles, tile_px), jnp.asarray(table), jnp.asarray(counts)


def _make_pyramid(tiles: TileSet, tile_px: int) -> UInt32[Array, "T P"]:
    # Tile 4 * index + turns is the picture of an index, turned by quarters.
    count = 4 * len(tiles.pictures)
    all_tiles = np.stack(np.divmod(np.arange(count), 4), axis=-1)[None]
    levels = []
    for size in halved_sizes(tile_px):
        scaled = scale_tiles(tiles, size)
        # `show_paved` draws a map. Here the map is one row with each tile once, which is cut into
        # its tiles.
        paved = show_paved(tiles, all_tiles, size).reshape(size, count, size).swapaxes(0, 1)
        red, green, blue = np.moveaxis(scaled["image"].astype(np.uint32), -1, 0)
        # What is not paved shows the ground of the view, so its colour is left out.
        colours = np.where(paved, red | green << 8 | blue << 16, 0)
        labels = scaled["labels"].astype(np.uint32) + PAVED * paved
        levels.append((colours | labels << 24).astype(np.uint32).reshape(count, -1))
    return jnp.asarray(np.concatenate(levels, axis=1))
