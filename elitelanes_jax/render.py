"""Rendering: a grid to one picture, its masks and its label map (paper, section "Real-World Data Integration")."""

import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.checks import check_grid
from elitelanes_jax.codes import KINDS
from elitelanes_jax.errors import InputError
from elitelanes_jax.roadmap import RoadMap
from elitelanes_jax.tilesets import MASKS, TileSet

__all__ = [
    "LABELS",
    "LABEL_COLOURS",
    "Picture",
    "check_tile_px",
    "choose_tiles",
    "overlay",
    "png_of",
    "recall_tiles",
    "render",
    "write_picture",
    "write_png",
]

LABELS = ("background", "road", "stop line", "lane separator")
"""The classes of a label map: a label is the place in this list. A line lies over the road."""

LABEL_COLOURS = ((40, 40, 48), (110, 150, 180), (235, 60, 60), (255, 215, 60))
"""A colour for each label, RGB."""

_SMALLEST, _LARGEST = 16, 512


class Picture(NamedTuple):
    """A rendered grid of H x W tiles of P pixels each.

    Attributes:
      image: uint8 ``[H·P, W·P, 3]``, RGB.
      road: uint8 ``[H·P, W·P]``, 0 or 255, the drivable surface.
      red: likewise, the stop lines.
      yellow: likewise, the lane separators.
      labels: uint8 ``[H·P, W·P]``, places in `LABELS`.
      layers: masks like road, those that the tile set has of its maker's own, by name.
      points: float64 ``[N, 2]``, x to the right and y down in pixels from the top left corner of the image, by name;
        tile by tile, row by row.
    """

    image: NDArray[np.uint8]
    road: NDArray[np.uint8]
    red: NDArray[np.uint8]
    yellow: NDArray[np.uint8]
    labels: NDArray[np.uint8]
    layers: Mapping[str, NDArray[np.uint8]] = {}
    points: Mapping[str, NDArray[np.float64]] = {}


def choose_tiles(grid: Any, tiles: TileSet, seed: int | list[int] = 0) -> NDArray[np.int_]:
    """Draws a picture for each cell at random among all that show its code.

    Args:
      grid: codes ``[H, W]``.
      tiles: whose pictures to choose from.
      seed: of a `numpy.random.default_rng`; the same one gives the same choice.

    Returns:
      int ``[H, W, 2]``, the place of the tile in the set and its quarter turns counter-clockwise.

    Raises:
      InputError: for a bad grid (see `check_grid`), or if the set has no picture for a cell.
    """
    grid = np.asarray(check_grid(grid))
    for row, column in np.argwhere(~np.isin(grid, list(tiles.turned))):
        code = grid[row, column]
        kind = next((kind for kind, codes in KINDS.items() if code in codes), "none")
        raise InputError(
            f"grid: expected tiles that the set {tiles.name!r} can draw (codes {', '.join(map(str, tiles.alphabet))}), "
            f"got {code} ({kind}) at row {row}, column {column}"
        )
    try:
        lots = np.random.default_rng(seed).random(grid.shape)
    except (TypeError, ValueError):
        raise InputError(f"seed: expected whole numbers, 0 or more, got {seed!r}") from None
    chosen = np.zeros((*grid.shape, 2), int)
    for code, draws in tiles.turned.items():
        cells = grid == code
        chosen[cells] = np.array(draws)[(lots[cells] * len(draws)).astype(int)]
    return chosen


def render(grid: Any, tiles: TileSet, *, tile_px: int = 64, seed: int = 0, chosen: Any = None) -> Picture:
    """Draws a grid.

    Args:
      grid: codes ``[H, W]``, each with a picture in the set.
      tiles: whose pictures to draw with.
      tile_px: side of a tile in pixels, 16 to 512.
      seed: of the choice among the pictures of each code (see `choose_tiles`).
      chosen: that choice, to be taken in place of the seed's.

    Raises:
      InputError: for a bad grid, a cell without picture in the set, a choice that does not show the grid, or a size
        out of its range.
    """
    check_tile_px(tile_px)
    chosen = choose_tiles(grid, tiles, seed) if chosen is None else _checked_choice(grid, tiles, chosen)
    place = chosen[..., 0] * 4 + chosen[..., 1]
    layers = {name: _laid_out(turned[place]) for name, turned in _scaled(tiles, int(tile_px)).items()}
    return Picture(
        **{name: layers.pop(name) for name in ("image", *MASKS, "labels")},
        layers=layers,
        points={name: _laid_points(name, tiles, place, int(tile_px)) for name in tiles.points},
    )


def check_tile_px(tile_px: Any) -> None:
    """Raises InputError unless a tile's side is a whole number of pixels within limits."""
    if not isinstance(tile_px, int | np.integer) or not _SMALLEST <= tile_px <= _LARGEST:
        raise InputError(f"tile_px: expected {_SMALLEST} to {_LARGEST} pixels a tile, got {tile_px!r}")


def recall_tiles(road_map: RoadMap, tiles: TileSet) -> NDArray[np.int_] | None:
    """The choice of tiles that a map was drawn with, or None where the set or the map's codes are others now."""
    if road_map.drawn is None or road_map.drawn.tile_set != tiles.name:
        return None
    places = {tile.name: place for place, tile in enumerate(tiles.pictures)}
    names, turns = np.array(road_map.drawn.tiles), np.array(road_map.drawn.quarter_turns)
    if not names.shape == turns.shape == road_map.codes.shape or not set(names.flat) <= set(places):
        return None
    chosen = np.stack([np.vectorize(places.__getitem__)(names), turns], axis=-1)
    return chosen if _misfits(road_map.codes, tiles, chosen).size == 0 else None


def _checked_choice(grid: Any, tiles: TileSet, chosen: Any) -> NDArray[np.int_]:
    grid, chosen = np.asarray(check_grid(grid)), np.asarray(chosen)
    if chosen.shape != (*grid.shape, 2) or not np.issubdtype(chosen.dtype, np.integer):
        raise InputError(
            f"chosen: expected integers of shape {(*grid.shape, 2)}, got {chosen.dtype} of shape {chosen.shape}"
        )
    for row, column in _misfits(grid, tiles, chosen):
        raise InputError(
            f"chosen: expected a tile of the set {tiles.name!r} turned to show code {grid[row, column]} at row {row}, "
            f"column {column}, got tile {chosen[row, column, 0]} turned {chosen[row, column, 1]} times"
        )
    return chosen


def _misfits(grid: NDArray[np.int8], tiles: TileSet, chosen: NDArray[np.int_]) -> NDArray[np.int_]:
    """Row and column of the cells whose chosen tile does not show their code."""
    shown = np.full((len(tiles.pictures), 4), -1)
    for code, draws in tiles.turned.items():
        shown[tuple(np.array(draws).T)] = code
    known = (chosen >= 0).all(axis=-1) & (chosen[..., 0] < len(tiles.pictures)) & (chosen[..., 1] < 4)
    place = np.where(known[..., None], chosen, 0)
    return np.argwhere(~known | (shown[place[..., 0], place[..., 1]] != grid))


def write_picture(folder: Path, picture: Picture) -> None:
    """Writes image.png, road.png, red.png, yellow.png, labels.png; where there are more masks or points, these too."""
    for name in ("image", *MASKS, "labels"):
        write_png(folder / f"{name}.png", getattr(picture, name))
    for name, mask in picture.layers.items():
        write_png(folder / f"{name}.png", mask)
    if picture.points:
        points = {name: listed.tolist() for name, listed in picture.points.items()}
        (folder / "points.json").write_text(json.dumps(points) + "\n", encoding="utf-8")


def write_png(file: Path, pixels: NDArray[np.uint8]) -> None:
    """Writes a picture ``[H, W]`` or, in RGB, ``[H, W, 3]``."""
    file.write_bytes(png_of(pixels))


def png_of(pixels: NDArray[np.uint8]) -> bytes:
    """The bytes of a PNG file with a picture ``[H, W]`` or, in RGB, ``[H, W, 3]``."""
    return cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)[1].tobytes()


def overlay(picture: Picture, opacity: float = 0.6) -> NDArray[np.uint8]:
    """The picture with its labels laid over it in colour, uint8 ``[H·P, W·P, 3]``, RGB."""
    colours = np.array(LABEL_COLOURS, np.uint8)[picture.labels]
    return np.asarray(cv2.addWeighted(picture.image, 1 - opacity, colours, opacity, 0), np.uint8)


@lru_cache(maxsize=4)
def _scaled(tiles: TileSet, size: int) -> dict[str, NDArray[np.uint8]]:
    """What is drawn of all tiles in all four turns, at one size: uint8 ``[4·T, P, P]``, images ``[4·T, P, P, 3]``."""
    layers: dict[str, list[NDArray[np.uint8]]] = {}
    for tile in tiles.pictures:
        empty = np.zeros(tile.road.shape, bool)
        masks = {name: getattr(tile, name) for name in MASKS}
        masks |= {name: tile.layers.get(name, empty) for name in tiles.layers}
        masks = {name: _resized_mask(mask, size, name) for name, mask in masks.items()}
        labels = np.where(masks["yellow"], 3, np.where(masks["red"], 2, masks["road"])).astype(np.uint8)
        drawn = {name: mask * np.uint8(255) for name, mask in masks.items()}
        for name, layer in (drawn | {"image": _resized(tile.image, size), "labels": labels}).items():
            layers.setdefault(name, []).extend(np.rot90(layer, turns) for turns in range(4))
    return {name: np.stack(turned) for name, turned in layers.items()}


def _resized(picture: NDArray[Any], size: int) -> NDArray[Any]:
    if picture.shape[0] == size:
        return picture
    shrinks = size < picture.shape[0]
    return cv2.resize(picture, (size, size), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def _resized_mask(mask: NDArray[np.bool_], size: int, name: str) -> NDArray[np.bool_]:
    """A mask through the same transform as its image: the pixels that it covers by half or more.

    Lines are at some sizes about as thin as a pixel, and would grow or vanish. Where a line's area does not come out
    within a third, as many of its pixels stay as it has area, those that it covers most; what is covered alike stays or
    goes together. So each class has its share of the picture at any size.
    """
    cover = _resized(mask.astype(np.float32), size)
    half, area = cover >= 0.5, round(float(cover.sum()))
    if name == "road" or not area or 0.75 * area <= half.sum() <= 1.33 * area:
        return half
    return cover >= np.sort(cover, axis=None)[-area] - 1e-4


@lru_cache(maxsize=64)
def _turned_points(name: str, tiles: TileSet, size: int) -> list[NDArray[np.float64]]:
    """Points of all tiles in all four turns, in pixels of a tile of one size."""
    turned = []
    for tile in tiles.pictures:
        own = tile.image.shape[0]
        points = tile.points.get(name, np.zeros((0, 2)))
        for _ in range(4):
            turned.append(points * size / own)
            points = np.stack([points[:, 1], own - points[:, 0]], axis=1)  # a quarter turn counter-clockwise
    return turned


def _laid_points(name: str, tiles: TileSet, place: NDArray[np.int_], size: int) -> NDArray[np.float64]:
    """Points of a map whose cells show the turned tiles ``place``."""
    turned = _turned_points(name, tiles, size)
    cells = np.ndindex(place.shape)
    return np.concatenate([turned[place[row, column]] + (column * size, row * size) for row, column in cells])


def _laid_out(tiles: NDArray[Any]) -> NDArray[Any]:
    """Pictures ``[H, W, P, P, ...]`` side by side, ``[H·P, W·P, ...]``."""
    height, width, size, _, *channels = tiles.shape
    return tiles.swapaxes(1, 2).reshape(height * size, width * size, *channels)
