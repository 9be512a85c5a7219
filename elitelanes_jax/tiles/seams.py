"""Seams between the tiles of a set, measured and drawn.

Tiles are rotated freely, so any open side may meet any other, and the road should continue there. The offset of a seam
is how far the road is displaced.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.checks import check_named, instance
from elitelanes_jax.network.codes import EAST, SIDES, WEST, Side
from elitelanes_jax.tiles.contact_sheet import write_text
from elitelanes_jax.tiles.files import Tile
from elitelanes_jax.tiles.tileset import TileSet, edge_pixels

_DEPTH = 1 / 32  # of the strip along a side whose colour is compared, as a part of the tile
_WHOLE, _NEAR, _GAP, _TOP, _LINE = 300, 360, 24, 96, 20  # lengths on the picture, in pixels
_GROUND, _INK, _FAINT, _EDGE, _BOX = (250, 249, 246), (40, 40, 44), (120, 120, 126), (0, 190, 230), (235, 40, 160)
_ADVICE = (
    "Blue: the edge of road.png. Both tiles are rotated so that these sides meet.",
    "To mend a seam, crop the photographs again or correct road.png, so that",
    "the road leaves every tile at the same position.",
)


class Seams(NamedTuple):
    """All seams between the N open sides of a set's tiles; a side also meets itself, on the same tile rotated.

    Attributes:
      sides: of each, the index of its tile in the set, and the side.
      pixels: side of the largest tile, in whose pixels offsets are given.
      offsets: float64 ``[N, N]``, the largest distance, along the seam, from road on one tile to road on the other: 0
        if the masks meet exactly, the displacement if an edge is displaced.
      colours: float64 ``[N, N]``, the difference of the road's mean colour, of 255, in the channel that differs most.
    """

    sides: tuple[tuple[int, Side], ...]
    pixels: int
    offsets: NDArray[np.float64]
    colours: NDArray[np.float64]

    @property
    def worst(self) -> tuple[int, int]:
        """The indices of the two sides that meet with the largest offset; among equal ones the first."""
        one, other = np.unravel_index(self.offsets.argmax(), self.offsets.shape)
        return int(one), int(other)


def find_seams(tiles: TileSet) -> Seams:
    """Compares all open sides of a set's tiles. Each has road on it, as `inspect_tiles` checks."""
    check_named("tiles", instance(TileSet), tiles)
    sides = tuple((index, side) for index, tile in enumerate(tiles.tiles) for side in SIDES if tile.code & side.bit)
    pixels = max(tile.image.shape[0] for tile in tiles.tiles)
    roads = np.stack([_scale(edge_pixels(tiles.tiles[index].road, side), pixels) for index, side in sides])
    away = np.stack([_distances(road) for road in roads])
    # Seen from the other tile, the side runs the other way.
    offsets = [
        np.maximum((road * away[:, ::-1]).max(axis=1), (far[::-1] * roads).max(axis=1))
        for road, far in zip(roads, away, strict=True)
    ]
    colours = np.stack([_colour(tiles.tiles[index], side) for index, side in sides])
    differences = np.abs(colours[:, None] - colours).max(axis=-1)
    return Seams(sides, pixels, np.stack(offsets), differences)


def describe_seams(tiles: TileSet, seams: Seams) -> str:
    """Returns a few lines of text about a set's seams."""
    pairs = np.triu_indices(len(seams.sides))
    lines = [
        f"seams: {len(pairs[0])} pairs of sides may meet; the road is displaced by {seams.offsets.max():.0f} pixels of "
        f"{seams.pixels} at most, by {seams.offsets[pairs].mean():.1f} on average"
    ]
    if seams.offsets.any():
        one, other = seams.worst
        means = seams.offsets.mean(axis=1)
        rough = [
            f"{_side_name(tiles, seams, side)} {means[side]:.1f}" for side in np.argsort(-means, kind="stable")[:3]
        ]
        lines += [
            f"  worst: {_side_name(tiles, seams, one)} with {_side_name(tiles, seams, other)}",
            f"  sides that fit worst, on average over all that they may meet: {', '.join(rough)}",
        ]
    lines.append(
        f"  the road's colour differs by {seams.colours.max():.0f} of 255 at most, "
        f"by {seams.colours[pairs].mean():.0f} on average"
    )
    return "\n".join(lines)


def seam_picture(tiles: TileSet, seams: Seams) -> NDArray[np.uint8]:
    """Draws the worst seam: its two tiles side by side, and an enlargement of the largest displacement.

    Returns uint8 ``[., ., 3]``, RGB.
    """
    one, other = seams.worst
    size, offset = seams.pixels, seams.offsets[one, other]
    left, right = (_facing(tiles, seams.sides[one], EAST, size), _facing(tiles, seams.sides[other], WEST, size))
    image, road = (np.hstack(pair) for pair in zip(left, right, strict=True))
    here, there = road[:, size - 1], road[:, size]
    gaps = np.maximum(here * _distances(there), there * _distances(here)) if offset else here
    widest = int(np.argmax(gaps))
    half = int(np.clip(1.5 * offset, size // 12, size // 2))
    top = int(np.clip(widest - half, 0, size - 2 * half))
    near = np.s_[top : top + 2 * half, size - half : size + half]

    sheet = np.full((_TOP + _NEAR + _GAP, 3 * _GAP + 2 * _WHOLE + _NEAR, 3), _GROUND, np.uint8)
    second = 2 * _GAP + 2 * _WHOLE
    sheet[_TOP : _TOP + _WHOLE, _GAP : _GAP + 2 * _WHOLE] = _outline(image, road, 2 * _WHOLE, _WHOLE)
    sheet[_TOP : _TOP + _NEAR, second : second + _NEAR] = _outline(image[near], road[near], _NEAR, _NEAR)
    x, y, box = (round(length * _WHOLE / size) for length in (size - half, top, 2 * half))
    for left_top, side in (((_GAP + x, _TOP + y), box), ((second, _TOP), _NEAR - 1)):
        cv2.rectangle(sheet, left_top, (left_top[0] + side, left_top[1] + side), _BOX, 2)

    title = f"{tiles.name[:40]}: the worst seam. The road is displaced by {offset:.0f} pixels of {size}."
    write_text(sheet, title, (_GAP, 40), 0.65, _INK)
    write_text(sheet, f"left: {_side_name(tiles, seams, one)}", (_GAP, _TOP - 10), 0.48, _INK)
    write_text(sheet, f"right: {_side_name(tiles, seams, other)}", (_GAP + _WHOLE, _TOP - 10), 0.48, _INK)
    write_text(sheet, "the box, enlarged", (second, _TOP - 10), 0.48, _INK)
    for index, line in enumerate(_ADVICE):
        write_text(sheet, line, (_GAP, _TOP + _WHOLE + 28 + index * _LINE), 0.48, _FAINT)
    return sheet


def _side_name(tiles: TileSet, seams: Seams, index: int) -> str:
    tile, side = seams.sides[index]
    return f"{tiles.tiles[tile].name} {side.name}"


def _distances(road: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Returns the distance of each pixel of a line from the nearest road pixel."""
    away = cv2.distanceTransform((~road).astype(np.uint8)[None], cv2.DIST_L1, cv2.DIST_MASK_3)
    return np.asarray(away[0], np.float64)


def _scale(line: NDArray[np.bool_], pixels: int) -> NDArray[np.bool_]:
    """Scales a line of pixels to another length by the nearest pixels."""
    return line[(2 * np.arange(pixels) + 1) * len(line) // (2 * pixels)]


def _colour(tile: Tile, side: Side) -> NDArray[np.float64]:
    """Returns the mean colour of the road along a side, if possible without stop lines and separators."""
    image, road, red, yellow = (np.rot90(layer, SIDES.index(side)) for layer in tile[2:6])
    strip = np.s_[: max(1, round(road.shape[0] * _DEPTH))]
    bare = road[strip] & ~red[strip] & ~yellow[strip]
    return np.asarray(image[strip][bare if bare.any() else road[strip]].mean(axis=0), np.float64)


def _facing(
    tiles: TileSet, open_side: tuple[int, Side], towards: int, pixels: int
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Returns image and road of a tile, rotated so that a side points to another, at a common size."""
    tile = tiles.tiles[open_side[0]]
    turns = SIDES.index(open_side[1]) - [side.bit for side in SIDES].index(towards)
    image = cv2.resize(np.rot90(tile.image, turns), (pixels, pixels), interpolation=cv2.INTER_LINEAR)
    road = cv2.resize(np.rot90(tile.road, turns).astype(np.uint8), (pixels, pixels), interpolation=cv2.INTER_NEAREST)
    return np.asarray(image, np.uint8), road > 0


def _outline(image: NDArray[np.uint8], road: NDArray[np.bool_], width: int, height: int) -> NDArray[np.uint8]:
    large = np.array(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
    mask = cv2.resize(road.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
    outlines, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(large, outlines, -1, _EDGE, 2)
    return large
