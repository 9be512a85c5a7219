"""Maps for training and tests, and the datasets drawn from them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax import InputError, SearchSpec, evolve
from elitelanes_jax.dataset import draw_sample
from elitelanes_jax.formats import RoadMap
from elitelanes_jax.network import rotate
from elitelanes_jax.network.wfc import generate_batch
from elitelanes_jax.optimizers import seed_keys
from elitelanes_jax.tiles import Tile, TileSet, load_tiles

__all__ = [
    "CONDITIONS",
    "SOURCES",
    "Condition",
    "Pictures",
    "draw_maps",
    "make_maps",
    "patterns",
    "shift_lines",
    "split_tiles",
    "training_set",
]

SOURCES = ("map-elites", "ea", "wfc")
"""The sources of maps."""

SIDE, TILE_PX = 8, 32
_WHITE_LINE = 0.12  # tiles from a tile's side to the middle of its white line


class Condition(NamedTuple):
    """A dataset that a network is trained on.

    Attributes:
      words: its description in tables.
      source: of the maps, one of `SOURCES`.
      maps: number of maps.
      drawings: number of pictures. All maps are drawn equally often.
      transforms: the variation of views, see `DatasetSpec`.
      one_picture: whether each kind of tile has one picture only.
    """

    words: str
    source: str
    maps: int
    drawings: int
    transforms: str = "standard"
    one_picture: bool = False


CONDITIONS = {
    "maps-1": Condition("1 map, again and again", "map-elites", 1, 1000),
    "maps-10": Condition("10 maps", "map-elites", 10, 1000),
    "maps-100": Condition("100 maps", "map-elites", 100, 1000),
    "maps-1000": Condition("1000 maps", "map-elites", 1000, 1000),
    "ea": Condition("100 maps, EA", "ea", 100, 1000),
    "wfc": Condition("100 maps, WFC", "wfc", 100, 1000),
    "drawings-1": Condition("1 map", "map-elites", 1, 1),
    "drawings-10": Condition("10 maps", "map-elites", 10, 10),
    "drawings-100": Condition("100 maps", "map-elites", 100, 100),
    "one-picture": Condition("1000 maps, one picture a kind", "map-elites", 1000, 1000, one_picture=True),
    "no-views": Condition("1000 maps, plain views", "map-elites", 1000, 1000, "none"),
}
"""The conditions by name. Maps are of MAP-Elites unless the words name another source."""


class Pictures(NamedTuple):
    """Pictures and their labels.

    Attributes:
      image: uint8 ``[N, H, W, 3]``, RGB.
      labels: uint8 ``[N, H, W]``.
    """

    image: NDArray[np.uint8]
    labels: NDArray[np.uint8]


def make_maps(source: str, count: int, seed: int, alphabet: Iterable[int], evaluations: int) -> NDArray[np.int8]:
    """Makes maps of 8 x 8 tiles without empty cells, int8 ``[count, 8, 8]``, in random order.

    Args:
      source: "map-elites", elites of many runs, spread over the niches, no two equal when rotated or mirrored; "ea",
        the best map of each of `count` runs; "wfc", by Wave Function Collapse with closed borders.
      count: number of maps.
      seed: of everything random.
      alphabet: the tile codes to use.
      evaluations: of each run.

    Raises:
      InputError: if MAP-Elites finds too few.
    """
    shape, rng = (SIDE, SIDE), np.random.default_rng(seed)
    if source == "wfc":
        return np.asarray(generate_batch(rng, count, shape, border="closed", alphabet=alphabet).grid)
    spec = SearchSpec(method="ea" if source == "ea" else "map-elites", preset="tuned", fill=True)
    search = partial(evolve, shape=shape, spec=spec, alphabet=alphabet, progress=False)
    if source == "ea":
        return np.asarray(search(seed_keys(seed, count), evaluations=evaluations).best())
    keys = seed_keys(seed, max(4, count // 25))
    chosen = search(keys, evaluations=evaluations // 2).choose(count, seed).maps
    if len(chosen) < count:
        raise InputError("maps", f"{count} different maps of {len(keys)} runs", len(chosen))
    return rng.permutation(np.stack([road_map.codes for road_map in chosen]))


def split_tiles(seed: int) -> tuple[TileSet, TileSet]:
    """Splits the drawn tiles into those for training and those held out: one of every kind that has several."""
    tiles, rng, kinds = load_tiles(), np.random.default_rng([seed, 2]), dict[str, list[Tile]]()
    for tile in tiles.tiles:
        kinds.setdefault(_kind(tile), []).append(tile)
    held = {some[index].name for some in kinds.values() for index in rng.permutation(len(some))[: len(some) > 1]}
    seen, held_out = (
        replace(tiles, tiles=tuple(tile for tile in tiles.tiles if (tile.name in held) == wanted))
        for wanted in (False, True)
    )
    return seen, held_out


def shift_lines(tiles: TileSet, shift: float) -> TileSet:
    """Shifts the white lines outwards by a share of a tile, inwards if negative, as ``dataset --camera lines=`` does.

    The wider the roads, the thinner are the stop lines.
    """
    shifted = []
    for tile in tiles.tiles:
        places = (np.arange(len(tile.road), dtype=np.float32) + 0.5) / len(tile.road)
        places += shift * np.sin(2 * np.pi * places) / np.sin(2 * np.pi * _WHITE_LINE)
        x, y = np.meshgrid(*(2 * [(places * len(tile.road) - 0.5).astype(np.float32)]))
        image = cv2.remap(tile.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        masks = [np.asarray(mask, np.uint8) for mask in (tile.road, tile.red, tile.yellow)]
        moved = [cv2.remap(mask, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE) > 0 for mask in masks]
        road, red, yellow = moved
        shifted.append(tile._replace(image=np.asarray(image, np.uint8), road=road, red=red, yellow=yellow))
    return replace(tiles, tiles=tuple(shifted))


def training_set(condition: Condition, grids: NDArray[np.int8], seed: int) -> Pictures:
    """Makes the pictures of a condition, as `make_dataset` draws them.

    Args:
      condition: the condition.
      grids: codes ``[N, H, W]``. The first ones are used.
      seed: of the drawings, and of the held-out tiles.
    """
    tiles = split_tiles(seed)[0]
    if condition.one_picture:
        first = {_kind(tile): tile for tile in reversed(tiles.tiles)}
        tiles = replace(tiles, tiles=tuple(tile for tile in tiles.tiles if tile is first[_kind(tile)]))
    repeated = grids[np.arange(condition.drawings) % condition.maps]
    return draw_maps(repeated, [tiles], seed, views=[condition.transforms])


def draw_maps(
    grids: NDArray[np.int8],
    sets: Sequence[TileSet],
    seed: int,
    tile_px: int = TILE_PX,
    views: Sequence[str] = ("standard",),
) -> Pictures:
    """Draws each map once; views take turns, and after each round of them the tile sets."""
    samples = [
        draw_sample(
            RoadMap(grid),
            sets[index // len(views) % len(sets)],
            index,
            seed=seed,
            tile_px=tile_px,
            transforms=views[index % len(views)],
        ).layers
        for index, grid in enumerate(grids)
    ]
    return Pictures(*(np.stack([layers[name] for layers in samples]) for name in Pictures._fields))


def patterns(grids: ArrayLike) -> set[bytes]:
    """Returns the neighbourhoods of 2 x 2 tiles in maps ``[N, H, W]``, each with its rotations as one."""
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(grids, np.int8), (2, 2), axis=(1, 2)).reshape(
        -1, 2, 2
    )
    return {min(rotate(window, turns).tobytes() for turns in range(4)) for window in np.unique(windows, axis=0)}


def _kind(tile: Tile) -> str:
    return tile.name.rpartition("_")[0]
