"""Who lives in a town: buildings, vehicles, trees, cones and duckies, at random places where they fit."""

from collections.abc import Callable
from math import pi

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.maps.furnishing.space import Space, make_object
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.network.codes import SIDES

Place = tuple[float, float, float]
"""x and y in tiles, and an angle in radians."""

_TRIES = 64  # for each object
_BESIDE = (0.12, 0.3)  # from the road's tile to the middle of what is beside it, in tiles

_QUARTERS = (0.0, pi / 2, pi, -pi / 2)


def place_scenery(space: Space, spec: FurnishSpec, seed: int, lane_offset: float) -> None:
    """Adds the objects of a specification to those that are on the map, large ones first.

    Each amount has random numbers of its own. Without a side of a road, objects beside roads are in blocks. The middle
    of a lane is `lane_offset` tiles from the road's middle.

    Raises:
      InputError: if a number of objects do not fit; the message names the amount and how many fit.
    """
    for index, (name, (kind, list_spots, draw)) in enumerate(_AMOUNTS.items()):
        spots = list_spots(space.codes).tolist()
        if not spots and draw is _beside_a_road:
            spots, draw = _blocks(space.codes).tolist(), _in_a_block
        amount = getattr(spec, name)
        wanted = round(amount * np.count_nonzero(space.codes == 0)) if amount < 1 else int(amount)
        random = np.random.default_rng([seed, index])
        placed, tries = 0, _TRIES * wanted if spots else 0
        while placed < wanted and tries:
            tries -= 1
            spot = spots[random.integers(len(spots))]
            x, y, angle = draw(spot, random, lane_offset)
            thing = make_object(kind, x, y, round(angle, 6), static=name != "crossing_duckies")
            placed += space.place(thing, in_lane=name.startswith("lane_"))
        if placed < wanted and amount >= 1:
            raise InputError(f"{name}: expected a number that fits, got {wanted}, of which {placed} fit")


def _blocks(codes: NDArray[np.int8]) -> NDArray[np.int64]:
    """Lists the cells without road: (row, column)."""
    return np.argwhere(codes == 0)


def _kerbs(codes: NDArray[np.int8]) -> NDArray[np.int64]:
    """Lists the sides of cells without road whose neighbour has one: (row, column, side)."""
    padded = np.pad(codes, 1)
    height, width = codes.shape
    roads = [padded[1 + side.down :, 1 + side.right :][:height, :width] > 0 for side in SIDES]
    return np.argwhere((codes == 0)[..., None] & np.stack(roads, axis=-1))


def _straights(codes: NDArray[np.int8]) -> NDArray[np.int64]:
    """Lists the straight tiles: (row, column, whether the road leads from west to east)."""
    return np.stack([*np.nonzero(np.isin(codes, (5, 10))), codes[np.isin(codes, (5, 10))] == 5], axis=-1)


def _in_a_block(spot: list[int], random: np.random.Generator, _: float) -> Place:
    """Draws a place anywhere on a cell, parallel to its sides."""
    row, column = spot
    return column + random.random(), row + random.random(), _QUARTERS[random.integers(4)]


def _beside_a_road(spot: list[int], random: np.random.Generator, _: float) -> Place:
    """Draws a place at a side of a cell, looking at the road there."""
    row, column, side = spot
    depth, along = random.uniform(*_BESIDE), random.uniform(-0.5, 0.5)
    x = column + 0.5 + SIDES[side].right * (0.5 - depth) + SIDES[(side + 1) % 4].right * along
    y = row + 0.5 + SIDES[side].down * (0.5 - depth) + SIDES[(side + 1) % 4].down * along
    return x, y, pi / 2 * (1 - side)


def _in_a_lane(spot: list[int], random: np.random.Generator, lane_offset: float) -> Place:
    """Draws a place in the middle of a lane of a straight tile, in the direction of its traffic."""
    row, column, across = spot
    heading = 2 * int(random.integers(2)) + across
    ahead, right, along = SIDES[heading], SIDES[(heading + 1) % 4], random.uniform(-0.5, 0.5)
    x = column + 0.5 + along * ahead.right + lane_offset * right.right
    y = row + 0.5 + along * ahead.down + lane_offset * right.down
    return x, y, pi / 2 * (1 - heading)


_BLOCK, _BESIDE_ROAD, _LANE = (_blocks, _in_a_block), (_kerbs, _beside_a_road), (_straights, _in_a_lane)

_AMOUNTS: dict[
    str,
    tuple[
        str, Callable[[NDArray[np.int8]], NDArray[np.int64]], Callable[[list[int], np.random.Generator, float], Place]
    ],
] = {
    "buildings": ("building", *_BLOCK),
    "houses": ("house", *_BLOCK),
    "buses": ("bus", *_BLOCK),
    "trucks": ("truck", *_BLOCK),
    "barriers": ("barrier", *_BESIDE_ROAD),
    "robots": ("duckiebot", *_BLOCK),
    "trees": ("tree", *_BLOCK),
    "cones": ("cone", *_BESIDE_ROAD),
    "crossing_duckies": ("duckie", *_BESIDE_ROAD),
    "duckies": ("duckie", *_BESIDE_ROAD),
    "lane_robots": ("duckiebot", *_LANE),
    "lane_duckies": ("duckie", *_LANE),
}
"""For each amount, the kind of object, and the functions that list its spots on a map and draw a place at one."""
