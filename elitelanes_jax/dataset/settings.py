"""What a dataset is to be."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from math import floor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from elitelanes_jax.checks import LONGEST_SIDE, check_count, check_grid
from elitelanes_jax.dataset.formats import SPLITS
from elitelanes_jax.errors import InputError
from elitelanes_jax.render import check_tile_px
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.tilesets import MASKS, Tile, TileSet
from elitelanes_jax.transforms import STANDARD, Transforms, check_transforms
from elitelanes_jax.wishes import Wishes

__all__ = ["Settings", "check_given", "checked", "digest", "maps_by_side", "maps_by_split", "tiles_by_split"]


class Settings(NamedTuple):
    """What to make.

    Attributes:
      maps: how many.
      size: smallest and largest side of the maps, which are square, in tiles; there are as many of each.
      tile_px: side of a tile in pixels.
      split: shares of maps for training, validation and test; they sum to 1.
      seed: of everything random.
      tiles: folder of the tile set; the package's own by default.
      format: one of `elitelanes_jax.dataset.formats.FORMATS`.
      views: how often each map is drawn, each time with other tile pictures, in another view.
      hold_out_tiles: whether the test's tile pictures are seen in no other split.
      transforms: how views of the maps vary.
      wishes: what to evolve. Longer runs give hardly more maps that differ, more runs do.
    """

    maps: int = 1000
    size: tuple[int, int] = (8, 14)
    tile_px: int = 64
    split: tuple[float, float, float] = (0.8, 0.1, 0.1)
    seed: int = 0
    tiles: Path | None = None
    format: str = "imagefolder"
    views: int = 1
    hold_out_tiles: bool = False
    transforms: Transforms = STANDARD
    wishes: Wishes = Wishes(evaluations=100_000)


def checked(settings: Settings) -> Settings:
    """The settings, if they go together.

    Raises:
      InputError: for those that do not; the message names them.
    """
    low, high = settings.size
    for name in ("maps", "views"):
        check_count("settings", name, getattr(settings, name))
    if not isinstance(settings.seed, int) or not 0 <= settings.seed < 2**32:
        raise InputError(f"seed: expected a whole number, 0 to {2**32 - 1}, got {settings.seed!r}")
    if not 2 <= low <= high <= LONGEST_SIDE:
        raise InputError(f"size: expected the smallest and the largest side, 2 to {LONGEST_SIDE}, got {low} and {high}")
    if settings.maps < high - low + 1:
        raise InputError(f"maps: expected one of each size at least, {high - low + 1}, got {settings.maps}")
    if settings.wishes.fix is not None and low < high:
        raise InputError(f"fix: expected maps of one size for cells that are given, got {low} to {high}")
    shares = settings.split
    if len(shares) != 3 or not all(0 <= share <= 1 for share in shares) or abs(sum(shares) - 1) > 1e-6:
        got = " ".join(f"{share:g}" for share in shares)
        raise InputError(f"split: expected three shares that sum to 1, got {got}")
    for name, share, count in zip(SPLITS, shares, maps_by_split(settings), strict=True):
        if share and not count:
            raise InputError(f"maps: expected enough for one in the {name}, {share:g} of them, got {settings.maps}")
    check_tile_px(settings.tile_px)
    check_transforms(settings.transforms)
    smallest = low * settings.tile_px * min(1.0, settings.transforms.scale[0])
    if settings.transforms.crop > smallest:
        raise InputError(
            f"transform: expected a crop within the smallest maps, {low} tiles of {settings.tile_px} pixels at the "
            f"smallest scale, {smallest:g} pixels, got {settings.transforms.crop}"
        )
    return settings


def check_given(settings: Settings, maps: Sequence[RoadMap], tiles: TileSet) -> None:
    """Raises InputError unless given maps are as many as settings say, square, of their sizes, and can be drawn."""
    if len(maps) != settings.maps:
        raise InputError(f"maps: expected {settings.maps} of them, as settings say, got {len(maps)}")
    for number, road_map in enumerate(maps):
        codes = np.asarray(check_grid(road_map.codes))
        height, width = codes.shape
        if height != width or not settings.size[0] <= height <= settings.size[1]:
            raise InputError(
                f"maps: expected square ones of {settings.size[0]} to {settings.size[1]} tiles, got number {number} of "
                f"{height} x {width}"
            )
        if not np.isin(codes, list(tiles.turned)).all():
            raise InputError(f"maps: expected codes that the tile set has pictures for, got others in number {number}")


def maps_by_side(settings: Settings) -> dict[int, int]:
    """How many maps there are of each side."""
    sides = range(settings.size[0], settings.size[1] + 1)
    least, more = divmod(settings.maps, len(sides))
    return {side: least + (place < more) for place, side in enumerate(sides)}


def maps_by_split(settings: Settings) -> tuple[int, int, int]:
    """How many maps each split gets: a whole number next to its share, together all."""
    validation, test = (floor(settings.maps * share + 0.5) for share in settings.split[1:])
    test = min(test, settings.maps - validation)
    return settings.maps - validation - test, validation, test


def tiles_by_split(tiles: TileSet, settings: Settings) -> tuple[TileSet, TileSet, TileSet]:
    """The tile set that each split is drawn from.

    Where tiles are held out, the test has of every kind that has several pictures about its own share of them, drawn
    at random, and at least one; what has one picture only is not in the test.

    Raises:
      InputError: if no map could be drawn from what is held out.
    """
    if not settings.hold_out_tiles:
        return tiles, tiles, tiles
    rng = np.random.default_rng([settings.seed, 2])
    kinds: dict[str, list[str]] = {}
    for tile in tiles.tiles:
        kinds.setdefault(tile.name.rpartition("_")[0], []).append(tile.name)
    held: set[str] = set()
    for names in kinds.values():
        count = min(max(1, round(settings.split[2] * len(names))), len(names) - 1)
        held |= {names[place] for place in rng.permutation(len(names))[:count]}
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
    """A tile with masks and points of all the names that the set has: each part of it is to have the same."""
    empty = np.zeros(tile.road.shape, bool)
    return tile._replace(
        layers={name: tile.layers.get(name, empty) for name in tiles.layers},
        points={name: tile.points.get(name, np.zeros((0, 2))) for name in tiles.points},
    )


def digest(tiles: TileSet) -> str:
    """A name for all that a tile set shows: other pictures, another name."""
    said = hashlib.sha256(repr((tiles.name, tiles.licence)).encode())
    for tile in tiles.tiles:
        said.update(repr((tile.name, tile.code, tile.image.shape, sorted(tile.layers), sorted(tile.points))).encode())
        arrays: list[Any] = [tile.image, *(getattr(tile, name) for name in MASKS)]
        arrays += [tile.layers[name] for name in sorted(tile.layers)]
        arrays += [tile.points[name] for name in sorted(tile.points)]
        for array in arrays:
            said.update(np.ascontiguousarray(array).tobytes())
    return said.hexdigest()[:16]
