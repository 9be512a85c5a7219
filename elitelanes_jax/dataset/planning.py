"""From a specification to a planned dataset.

Tiles are read and searches are resolved, before JAX is imported.
"""

import json
from importlib.metadata import version
from typing import NamedTuple

from elitelanes_jax._util.cells import describe_size
from elitelanes_jax._util.errors import InputError, quote
from elitelanes_jax._util.packages import installed_versions
from elitelanes_jax._util.progress import announce_at_end
from elitelanes_jax.dataset._layouts import find_layout
from elitelanes_jax.dataset.spec import DatasetSpec
from elitelanes_jax.dataset.tables import DatasetRecord
from elitelanes_jax.formats.objects import MapObject
from elitelanes_jax.formats.road_map import RoadMap
from elitelanes_jax.lanes.movements import movements_of
from elitelanes_jax.maps.furnishing.placing import placed_kinds
from elitelanes_jax.maps.furnishing.space import make_object
from elitelanes_jax.maps.given import GivenMaps
from elitelanes_jax.maps.planning import check_furnishable, resolve_to_draw
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.search.resolve import Search
from elitelanes_jax.tiles.object_set import ObjectSet, load_objects
from elitelanes_jax.tiles.tileset import TileSet, load_tiles

# The largest whole number that columns of whole numbers and of fractions both hold in Parquet.
_LARGEST_IN_PARQUET = 2**53


class PlannedDataset(NamedTuple):
    """A dataset before its maps are evolved.

    Attributes:
      spec: the specification of the dataset.
      tiles: the tile set to draw the maps with.
      searches: resolved, by the (height, width) of the maps; empty for given maps.
      objects: whose pictures to draw the maps' objects with; None if there are no objects.
      identity: all that the files depend on, plain values for JSON.
    """

    spec: DatasetSpec
    tiles: TileSet
    searches: dict[tuple[int, int], Search]
    objects: ObjectSet | None
    identity: DatasetRecord


def plan_dataset(spec: DatasetSpec) -> PlannedDataset:
    """Loads the pictures of a dataset, and resolves its search on each size.

    Raises:
      InputError: for constraints that no map can meet, given maps that cannot be drawn, or objects
        that no map has room for. Also for a bad set of tiles or objects, or a missing package of
        the layout.
    """
    find_layout(spec.format)
    tiles = load_tiles(spec.tiles)
    searches = {}
    if spec.maps_from is None:
        _check_fixed_cells(spec)
        # Constraints are checked for each size, because a small map may not be able to meet them.
        for shape in spec.shapes:
            searches[shape] = resolve_to_draw(spec.search, shape, tiles)
            # Objects that no map has room for would end the run only after the search.
            if spec.furnish is not None:
                check_furnishable(spec.furnish, searches[shape])
    else:
        _check_given(spec, spec.maps_from, tiles)
    objects = _load_objects(spec, searches)
    identity = _identify(spec, tiles, objects)
    return PlannedDataset(spec, tiles, searches, objects, identity)


def _identify(spec: DatasetSpec, tiles: TileSet, objects: ObjectSet | None) -> DatasetRecord:
    """Returns all that the files depend on, plain values for JSON."""
    plain = spec.to_plain() | {"tile_px": spec.pixels}
    # The pictures and the maps count, not their paths.
    del plain["tiles"], plain["objects"], plain["maps_from"]
    tile_set = tiles.to_plain()
    # Poses are on the lanes of the tile set.
    if spec.camera is not None:
        tile_set["lane_offset"] = tiles.lane_offset
        if tiles.lane_offset_spread is not None:
            tile_set["lane_offset_spread"] = tiles.lane_offset_spread
    versions = installed_versions()
    # The bytes of Parquet depend on the version of pyarrow.
    if spec.format == "parquet":
        versions["pyarrow"] = version("pyarrow")
    identity = {
        "settings": plain,
        "given_maps": None if spec.maps_from is None else spec.maps_from.digest,
        "tile_set": tile_set,
        "versions": versions,
    }
    if objects is not None:
        identity["object_set"] = {"name": objects.name, "pictures": objects.digest}
    # Tuples become lists here, as in a record that is read from its file.
    return json.loads(json.dumps(identity))


def _check_fixed_cells(spec: DatasetSpec) -> None:
    """Checks that all maps have the size of the user's fixed cells."""
    fix = spec.search.options.get("fix")
    if fix is None or spec.shapes == [fix.shape]:
        return
    sizes = spec.shapes
    got = describe_size(sizes[0]) if len(sizes) == 1 else f"{len(sizes)} sizes"
    raise InputError("fix", f"maps of the given cells' size, {describe_size(fix.shape)}", got)


def _check_given(spec: DatasetSpec, given: GivenMaps, tiles: TileSet) -> None:
    """Checks that the tiles can draw given maps, and that they have lanes for a camera."""
    for road_map, name in zip(given.maps, given.names, strict=True):
        if spec.camera is not None and not movements_of(road_map.codes).row.size:
            raise InputError("maps_from", "maps with lanes, for a camera", f"none, {name}")
        # A code without a picture would be an error only while its map is drawn.
        missing = set(road_map.codes.flat) - set(tiles.rotations)
        if missing:
            kinds = [kind for kind, members in KINDS.items() if not missing.isdisjoint(members)]
            got = " and ".join(kinds)
            raise InputError(
                "maps_from", "codes that the tile set has pictures for", f"{got}, {name}"
            )
        if spec.format == "parquet":
            _check_columns(road_map, name)


def _check_columns(road_map: RoadMap, name: str) -> None:
    """Checks that the columns of a Parquet file hold the whole numbers of a map."""
    numbers = [*(road_map.metrics or {}).values(), road_map.fitness]
    numbers += [*(road_map.niche or ()), *(road_map.seed or ())]
    for number in numbers:
        if isinstance(number, int) and abs(number) > _LARGEST_IN_PARQUET:
            raise InputError(
                "maps_from",
                f"whole numbers to {_LARGEST_IN_PARQUET}, for parquet",
                f"{quote(number)}, {name}",
            )


def _load_objects(spec: DatasetSpec, searches: dict[tuple[int, int], Search]) -> ObjectSet | None:
    """Loads the pictures of the maps' objects; None if there are no objects.

    Raises:
      InputError: if the set has no pictures of an object of the given maps, or of a kind that may
        be placed on the maps.
    """
    objects = _list_objects(spec, searches)
    if not objects and spec.furnish is None:
        if spec.objects is not None:
            # A wrong folder is refused before the search.
            load_objects(spec.objects)
            announce_at_end(str(spec.objects), "not drawn, because the maps have no objects")
        return None
    pictures = load_objects(spec.objects)
    # A kind without pictures is an error here, before any picture is drawn.
    pictures.choose(objects)
    return pictures


def _list_objects(spec: DatasetSpec, searches: dict[tuple[int, int], Search]) -> list[MapObject]:
    """Lists the objects of the given maps, or an object of each kind that may be placed."""
    given = [] if spec.maps_from is None else spec.maps_from.maps
    objects: list[MapObject] = []
    if spec.furnish is None:
        for road_map in given:
            objects += road_map.objects or ()
        return objects
    codes: set[int] = set()
    for road_map in given:
        codes.update(road_map.codes.ravel().tolist())
    for search in searches.values():
        codes.update(search.alphabet)
    objects += spec.furnish.objects
    for kind in sorted(placed_kinds(spec.furnish, codes)):
        objects.append(make_object(kind, 0, 0, 0))
    return objects
