"""Finds tape of neighbours along the sides of a tile's picture, and removes it.

A tile that is cut out of a photograph of a floor ends within 1 % of its border. So it may show a
narrow strip of what is beyond: a neighbour's stop line, its separator, or other tape. Tape of the
tile itself is wider than such a strip, and continues inwards.
"""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from elitelanes_jax.network.codes import CONNECTIONS, SIDES, Side
from elitelanes_jax.tiles.light import colours_on_ground

# The depth along a side, in tiles, within which a neighbour's tape is seen.
_RIM = 0.03
# The depth behind the rim, in tiles, in which tape of the tile itself continues.
_BEHIND = 0.01
# How far beside it tape of the tile itself may continue, in tiles. White tape around the corners of
# a crossing may be at a slant of 45 degrees.
_BESIDE = {"red": 0.01, "yellow": 0.01, "white": 0.04}
# The pixels around a strip that are mixed with it.
_MIXED_PX = 2


TAPE = {"red": 0.9, "yellow": 0.9, "white": 0.9}
"""By how much tape exceeds what is behind it, relative to the ground.

Excesses are of red above other channels, of yellow above blue, and of brightness. Tape has 1.8 or
more, and a floor of wood has 0.7.
"""

MIXED = {"red": 0.25, "yellow": 0.25, "white": 0.5}
"""By how much pixels that are partly tape exceed what is behind them."""


class Strip(NamedTuple):
    """Tape of a neighbour along one side of a tile.

    Attributes:
      side: the side.
      colour: red, yellow or white.
      depths: int ``[S]``, the pixels that it reaches into the tile, at each place along the side as
        seen from inside; 0 where it is not.
    """

    side: Side
    colour: str
    depths: NDArray[np.int_]


def find_strips(image: NDArray[np.uint8], code: int, least: Mapping[str, float]) -> Iterator[Strip]:
    """Yields the strips of tape of neighbours that a tile of this code cannot have.

    `least` says by how much each colour exceeds what is behind it: `TAPE` or `MIXED`.

    A crossing has its own stop lines on the incoming lanes. White lines along a closed side are the
    tile's own.
    """
    size = len(image)
    rim, behind = _rim_of(size)
    relative, red, yellow = colours_on_ground(image, size)
    # White tape has all colours, and coloured tape lacks blue.
    parts = {"red": red, "yellow": yellow, "white": relative.min(axis=-1)}
    for turns, side in enumerate(SIDES):
        is_open = bool(code & side.bit)
        for colour, part in parts.items():
            # The side is turned to the top.
            turned = np.rot90(part, turns)
            beside = np.ones((1, 2 * round(size * _BESIDE[colour]) + 1), np.uint8)
            inner = turned[rim : rim + behind].max(axis=0, keepdims=True)
            excess = turned[:rim] - cv2.dilate(np.ascontiguousarray(inner), beside)
            is_strip = excess > least[colour]
            if colour == "white" and not is_open:
                continue
            if colour == "red" and is_open and CONNECTIONS[code] > 2:
                # Seen from inside, the incoming lane is the left half of the side.
                is_strip[:, : size // 2] = False
            if is_strip.any():
                # The deepest pixel of a strip counts, because the outermost ones may be blurred.
                depths = rim - np.argmax(is_strip[::-1], axis=0)
                yield Strip(side, colour, np.where(is_strip.any(axis=0), depths, 0))


def without_strips(image: NDArray[np.uint8], code: int) -> NDArray[np.uint8]:
    """Returns the picture of a tile with its own ground in place of the tape of neighbours."""
    clean = image.copy()
    rim, behind = _rim_of(len(image))
    mixed = np.ones((1, 2 * _MIXED_PX + 1), np.uint8)
    for strip in find_strips(image, code, MIXED):
        depths = cv2.dilate(strip.depths[None].astype(np.uint8), mixed)[0].astype(int)
        depths = np.where(depths > 0, np.minimum(depths + _MIXED_PX, rim), 0)
        rows = np.arange(rim)[:, None]
        # What is between the strip and the end of the band behind the rim is repeated outwards, as
        # its own mirror image. It has the light and the grain of the ground, and no tape.
        width = rim + behind - depths
        away = (depths - rows - 1) % (2 * width)
        sources = depths + np.minimum(away, 2 * width - 1 - away)
        turned = np.rot90(clean, SIDES.index(strip.side))
        ground = np.take_along_axis(turned, sources[..., None], axis=0)
        turned[:rim] = np.where((rows < depths)[..., None], ground, turned[:rim])
    return clean


def _rim_of(size: int) -> tuple[int, int]:
    """Returns the depths of the rim and of the band behind it, in pixels."""
    return round(size * _RIM), max(1, round(size * _BEHIND))
