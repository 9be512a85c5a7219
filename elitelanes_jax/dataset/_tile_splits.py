"""The tiles of each split of a dataset, and checks of a tile set against maps."""

import hashlib
from dataclasses import replace

import numpy as np

from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax._util.errors import InputError
from elitelanes_jax._util.types import AnyArray
from elitelanes_jax.dataset.spec import DatasetSpec, maps_by_split
from elitelanes_jax.maps.given import GivenMaps
from elitelanes_jax.network.checks import check_grid
from elitelanes_jax.network.codes import KINDS
from elitelanes_jax.network.movements import list_movements
from elitelanes_jax.network.symmetry import canonical_form
from elitelanes_jax.tiles.files import Tile
from elitelanes_jax.tiles.tileset import MASKS, TileSet


def check_given(spec: DatasetSpec, own: GivenMaps, tiles: TileSet) -> None:
    """Checks maps that are used instead of evolved ones: number, sizes, tiles to draw them, and lanes for a camera."""
    source = "maps" if spec.maps_from is None else "maps_from"
    if len(own.maps) != spec.maps:
        raise InputError(f"{source}: expected {spec.maps} of them, as the specification says, got {len(own.maps)}")
    for index, road_map in enumerate(own.maps):
        codes = np.asarray(check_grid(road_map.codes))
        if codes.shape not in spec.shapes:
            raise InputError(
                f"{source}: expected sizes {' x '.join(f'{low}..{high}' for low, high in spec.size)}, "
                f"got {codes.shape[0]} x {codes.shape[1]}, {own.names[index]}"
            )
        if spec.camera is not None and not len(list_movements(codes)):
            raise InputError(f"{source}: expected maps with lanes, for a camera, got none, {own.names[index]}")
        if lacking := set(codes.flat) - set(tiles.rotations):
            kinds = [kind for kind, members in KINDS.items() if lacking & set(members)]
            expected = f"{source}: expected codes that the tile set has pictures for"
            raise InputError(f"{expected}, got {' and '.join(kinds)}, {own.names[index]}")
    known: dict[bytes, int] = {}
    for index, road_map in enumerate(own.maps if max(maps_by_split(spec)) < spec.maps else ()):
        if (first := known.setdefault(canonical_form(road_map.codes), index)) != index:
            expected = f"{source}: expected different networks, because no two splits may show the same one"
            raise InputError(f"{expected}, got {own.names[index]}, which is map {first}, rotated or mirrored or not")


def tiles_by_split(tiles: TileSet, spec: DatasetSpec) -> tuple[TileSet, TileSet, TileSet]:
    """Returns the tile set of each split.

    If tiles are held out, the test has its share of the pictures of every kind with several pictures, drawn at random,
    and at least one; kinds with a single picture are not in the test.

    Raises:
      InputError: if no map could be drawn from the tiles held out, or for arguments of other types.
    """
    check_named("tiles", instance(TileSet), tiles)
    check_named("spec", instance(DatasetSpec), spec)
    if not spec.hold_out_tiles:
        return tiles, tiles, tiles
    rng = np.random.default_rng([spec.seed, 2])
    kinds: dict[str, list[str]] = {}
    for tile in tiles.tiles:
        kinds.setdefault(tile.name.rpartition("_")[0], []).append(tile.name)
    held: set[str] = set()
    for names in kinds.values():
        count = min(max(1, round(spec.split[2] * len(names))), len(names) - 1)
        held |= {names[index] for index in rng.permutation(len(names))[:count]}
    single = [kind for kind, names in kinds.items() if len(names) == 1 and kind in ("straight", "turn")]
    if single or not any(name.startswith("crossing") for name in held):
        raise InputError(
            "hold_out_tiles: expected two pictures or more of straight, turn and one kind of crossing, got one of "
            + (" and ".join(single) or "each kind of crossing")
        )
    seen, unseen = (
        replace(tiles, tiles=tuple(_with_all(tile, tiles) for tile in tiles.tiles if (tile.name in held) == wanted))
        for wanted in (False, True)
    )
    return seen, seen, unseen


def _with_all(tile: Tile, tiles: TileSet) -> Tile:
    """Gives a tile all masks and points of the set, so that both parts have the same."""
    empty = np.zeros(tile.road.shape, bool)
    return tile._replace(
        layers={name: tile.layers.get(name, empty) for name in tiles.layers},
        points={name: tile.points.get(name, np.zeros((0, 2))) for name in tiles.points},
    )


def digest(tiles: TileSet) -> str:
    """Returns a digest of all names, pictures, masks and points of a tile set."""
    said = hashlib.sha256(repr((tiles.name, tiles.licence)).encode())
    for tile in tiles.tiles:
        said.update(repr((tile.name, tile.code, tile.image.shape, sorted(tile.layers), sorted(tile.points))).encode())
        arrays: list[AnyArray] = [tile.image, *(getattr(tile, name) for name in MASKS)]
        arrays += [tile.layers[name] for name in sorted(tile.layers)]
        arrays += [tile.points[name] for name in sorted(tile.points)]
        for array in arrays:
            said.update(np.ascontiguousarray(array).tobytes())
    return said.hexdigest()[:16]
