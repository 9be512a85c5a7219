"""Maps to train and to test on, and the datasets drawn from them."""

import shutil
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from elitelanes_jax import InputError, evolve
from elitelanes_jax.dataset import Settings, make_dataset
from elitelanes_jax.dataset.samples import draw_sample
from elitelanes_jax.dataset.settings import tiles_by_split
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.search import seed_keys
from elitelanes_jax.selection import choose_maps
from elitelanes_jax.symmetry import rotate
from elitelanes_jax.tile_files import read_picture
from elitelanes_jax.tilesets import TileSet, default_tiles, load_tiles
from elitelanes_jax.transforms import STANDARD, Transforms
from elitelanes_jax.wfc import generate_batch

__all__ = [
    "CONDITIONS",
    "SOURCES",
    "Condition",
    "Pictures",
    "drawn",
    "make_maps",
    "patterns",
    "split_tiles",
    "training_set",
]

SOURCES = ("map-elites", "ea", "wfc")
"""Where maps come from."""

SIDE, TILE_PX = 8, 32


class Condition(NamedTuple):
    """What a network is trained on.

    Attributes:
      words: what it is, for tables.
      source: of the maps, one of `SOURCES`.
      maps: how many.
      drawings: how many pictures there are, each map drawn as often as the others.
      transforms: how views of the drawings vary.
      one_picture: whether each kind of tile has one picture only.
    """

    words: str
    source: str
    maps: int
    drawings: int
    transforms: Transforms = STANDARD
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
    "no-views": Condition("1000 maps, plain views", "map-elites", 1000, 1000, Transforms()),
}
"""What is trained on, by name; where the words name no source, maps are of MAP-Elites."""


class Pictures(NamedTuple):
    """Pictures and their labels.

    Attributes:
      image: uint8 ``[N, H, W, 3]``, RGB.
      labels: uint8 ``[N, H, W]``.
    """

    image: NDArray[np.uint8]
    labels: NDArray[np.uint8]


def make_maps(source: str, count: int, seed: int, alphabet: Iterable[int], evaluations: int) -> NDArray[np.int8]:
    """Maps of 8 x 8 tiles without empty cells, int8 ``[count, 8, 8]``, in random order.

    Args:
      source: "map-elites", elites of many runs, spread over the niches, no two alike when turned or mirrored; "ea", the
        best map of each of so many runs; "wfc", by Wave Function Collapse with closed borders.
      count: how many.
      seed: of everything random.
      alphabet: codes that they are made of.
      evaluations: of each run.

    Raises:
      InputError: if MAP-Elites finds too few.
    """
    shape, rng = (SIDE, SIDE), np.random.default_rng(seed)
    if source == "wfc":
        return np.asarray(generate_batch(rng, count, shape, border="closed", alphabet=alphabet).grid)
    settings: dict[str, Any] = {"preset": "tuned", "fill": True, "alphabet": alphabet, "progress": False}
    if source == "ea":
        keys = seed_keys(seed, count)
        return np.asarray(evolve(keys, shape, method="ea", evaluations=evaluations, **settings).best())
    keys = seed_keys(seed, max(4, count // 25))
    chosen = choose_maps(evolve(keys, shape, evaluations=evaluations // 2, **settings), count, seed).maps
    if len(chosen) < count:
        raise InputError(f"maps: expected {count} different ones of {len(keys)} runs, got {len(chosen)}")
    return rng.permutation(np.stack([road_map.codes for road_map in chosen]))


def split_tiles(seed: int) -> tuple[TileSet, TileSet]:
    """The drawn tiles that are trained on, and those held out: one of every kind that has several."""
    seen, _, held_out = tiles_by_split(load_tiles(), _settings(seed))
    return seen, held_out


def training_set(condition: Condition, grids: NDArray[np.int8], seed: int) -> Pictures:
    """The dataset of a condition, made as anyone would make it, and read back.

    Args:
      condition: which.
      grids: codes ``[N, H, W]``, of which it takes the first.
      seed: of the drawings, and of what is held out.
    """
    maps = [RoadMap(grids[number % condition.maps]) for number in range(condition.drawings)]
    settings = _settings(seed)._replace(maps=condition.drawings, transforms=condition.transforms)
    with TemporaryDirectory() as folder:
        if condition.one_picture:
            settings = settings._replace(tiles=_one_of_each(split_tiles(seed)[0], Path(folder)), hold_out_tiles=False)
        make_dataset(settings, Path(folder) / "dataset", maps=maps)
        return Pictures(*(_read_all(Path(folder) / "dataset" / "train" / name) for name in Pictures._fields))


def drawn(grids: NDArray[np.int8], tiles: TileSet, seed: int) -> Pictures:
    """Maps as a set of tiles shows them, each once and in its own view."""
    samples = [
        draw_sample(RoadMap(grid), tiles, number, seed=seed, tile_px=TILE_PX, transforms=STANDARD, layers=()).layers
        for number, grid in enumerate(grids)
    ]
    return Pictures(*(np.stack([layers[name] for layers in samples]) for name in Pictures._fields))


def patterns(grids: ArrayLike) -> set[bytes]:
    """All neighbourhoods of 2 x 2 tiles in maps ``[N, H, W]``; those that are the same when turned count as one."""
    windows = np.lib.stride_tricks.sliding_window_view(np.asarray(grids, np.int8), (2, 2), axis=(1, 2)).reshape(
        -1, 2, 2
    )
    return {min(rotate(window, turns).tobytes() for turns in range(4)) for window in np.unique(windows, axis=0)}


def _settings(seed: int) -> Settings:
    return Settings(size=(SIDE, SIDE), tile_px=TILE_PX, split=(1.0, 0.0, 0.0), seed=seed, hold_out_tiles=True)


def _one_of_each(tiles: TileSet, folder: Path) -> Path:
    """A folder of tiles with the first of each kind."""
    for tile in {tile.name.rpartition("_")[0]: tile for tile in reversed(tiles.tiles)}.values():
        shutil.copytree(default_tiles() / tile.name, folder / "tiles" / tile.name)
    shutil.copy(default_tiles() / "tileset.toml", folder / "tiles")
    return folder / "tiles"


def _read_all(folder: Path) -> NDArray[np.uint8]:
    """All pictures of a folder, by name."""
    problems: list[str] = []
    pictures = [read_picture(file, problems) for file in sorted(folder.iterdir())]
    if problems:
        raise InputError(problems[0])
    return np.stack([picture for picture in pictures if picture is not None])
