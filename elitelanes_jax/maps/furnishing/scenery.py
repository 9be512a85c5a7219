"""Who lives in a town: buildings, vehicles, trees, cones and duckies, at random places where they fit."""

from collections.abc import Callable
from math import pi

import numpy as np
from numpy.typing import NDArray

from elitelanes_jax._util.errors import InputError
from elitelanes_jax.formats.objects import OBJECT_KINDS, MapObject
from elitelanes_jax.maps.furnishing.space import Space
from elitelanes_jax.maps.furnishing.spec import FurnishSpec
from elitelanes_jax.network.codes import SIDES

Place = tuple[float, float, float]
"""x and y in tiles, and an angle in radians."""

_TRIES = 64  # for each object
_BESIDE = (0.12, 0.3)  # from the road's tile to the middle of what is beside it, in tiles
_LANE = 0.2  # from the road's middle to the middle of a lane, in tiles

_QUARTERS = (0.0, pi / 2, pi, -pi / 2)


def place_scenery(space: Space, spec: FurnishSpec, seed: int) -> None:
    """Adds the objects of a specification to those that are on the map, large ones first.

    Each amount has random numbers of its own.

    Raises:
      InputError: if a number of objects do not fit; the message names the amount and how many fit.
    """
    for index, (name, (kind, draw)) in enumerate(_AMOUNTS.items()):
        amount = getattr(spec, name)
        wanted = round(amount * np.count_nonzero(space.codes == 0)) if amount < 1 else int(amount)
        random = np.random.default_rng([seed, index])
        placed, tries = 0, _TRIES * wanted
        while placed < wanted and tries:
            tries -= 1
            place = draw(space.codes, random)
            if place is None:
                break
            x, y, angle = (round(value, 6) for value in place)
            thing = MapObject(kind, x, y, angle, OBJECT_KINDS[kind].height, static=name != "crossing_duckies")
            placed += space.place(thing, in_lane=name.startswith("lane_"))
        if placed < wanted and amount >= 1:
            raise InputError(f"{name}: expected a number that fits, got {wanted}, of which {placed} fit")


def _in_a_block(codes: NDArray[np.int8], random: np.random.Generator) -> Place | None:
    """Draws a place anywhere on a cell without road, parallel to the cell's sides."""
    cell = _one(np.argwhere(codes == 0), random)
    return cell and (cell[1] + random.random(), cell[0] + random.random(), _QUARTERS[random.integers(4)])


def _beside_a_road(codes: NDArray[np.int8], random: np.random.Generator) -> Place | None:
    """Draws a place on a cell without road, at a side where the next cell has a road, and looks at it."""
    sides = [(row, column, side) for row, column, side in _kerbs(codes)]
    if not sides:
        return _in_a_block(codes, random)
    row, column, side = sides[random.integers(len(sides))]
    depth, along = random.uniform(*_BESIDE), random.uniform(-0.5, 0.5)
    x = column + 0.5 + SIDES[side].right * (0.5 - depth) + SIDES[(side + 1) % 4].right * along
    y = row + 0.5 + SIDES[side].down * (0.5 - depth) + SIDES[(side + 1) % 4].down * along
    return x, y, pi / 2 * (1 - side)


def _in_a_lane(codes: NDArray[np.int8], random: np.random.Generator) -> Place | None:
    """Draws a place in the middle of a lane of a straight tile, in the direction of its traffic."""
    cell = _one(np.argwhere((codes == 5) | (codes == 10)), random)
    if cell is None:
        return None
    heading = 2 * int(random.integers(2)) + int(codes[cell] == 10)
    ahead, right, along = SIDES[heading], SIDES[(heading + 1) % 4], random.uniform(-0.5, 0.5)
    x = cell[1] + 0.5 + along * ahead.right + _LANE * right.right
    y = cell[0] + 0.5 + along * ahead.down + _LANE * right.down
    return x, y, pi / 2 * (1 - heading)


def _one(cells: NDArray[np.int64], random: np.random.Generator) -> tuple[int, int] | None:
    return tuple(cells[random.integers(len(cells))].tolist()) if len(cells) else None


def _kerbs(codes: NDArray[np.int8]) -> NDArray[np.int64]:
    """Lists the sides of cells without road whose neighbour has one: (row, column, side) by rows."""
    padded = np.pad(codes, 1)
    height, width = codes.shape
    roads = [padded[1 + side.down :, 1 + side.right :][:height, :width] > 0 for side in SIDES]
    return np.argwhere((codes == 0)[..., None] & np.stack(roads, axis=-1))


_AMOUNTS: dict[str, tuple[str, Callable[[NDArray[np.int8], np.random.Generator], Place | None]]] = {
    "buildings": ("building", _in_a_block),
    "houses": ("house", _in_a_block),
    "buses": ("bus", _in_a_block),
    "trucks": ("truck", _in_a_block),
    "barriers": ("barrier", _beside_a_road),
    "robots": ("duckiebot", _in_a_block),
    "trees": ("tree", _in_a_block),
    "cones": ("cone", _beside_a_road),
    "crossing_duckies": ("duckie", _beside_a_road),
    "duckies": ("duckie", _beside_a_road),
    "lane_robots": ("duckiebot", _in_a_lane),
    "lane_duckies": ("duckie", _in_a_lane),
}
"""For each amount, the kind of object and the function that draws its place."""
